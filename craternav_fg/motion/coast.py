"""Coasting: free fall in a gravity field; white noise of the acceleration stands for what the field lacks."""

from craternav_fg.motion.gravity import GravityField
from craternav_fg.motion.model import Motion
from factors.kernels.motion import COAST

# Mass concentrations of the Moon, left out, pull with some 1e-3 m/s^2 for some 100 s in an orbit of 100 km.
ACCELERATION_DENSITY = 1e-5


def coast(
    acceleration_density_m_s2_sqrt_hz: float = ACCELERATION_DENSITY,
    *,
    gravity: GravityField | None = None,
    rate_rad_s: tuple[float, float, float] = Motion.rate_rad_s,
    rate_sigma_rad_s: float = Motion.rate_sigma_rad_s,
    rate_walk_rad_s2_sqrt_hz: float = Motion.rate_walk_rad_s2_sqrt_hz,
) -> Motion:
    """Make the model of a lander in free fall, without thrust.

    Parameters
    ----------
    acceleration_density_m_s2_sqrt_hz : float
        White noise of the acceleration per axis, m/s^2/sqrt(Hz).
    gravity : GravityField, optional
        A point mass by default.
    rate_rad_s : tuple of float
        Prior mean of the inertial angular velocity in b, where there is no gyro.
    rate_sigma_rad_s : float
        Its standard deviation per axis.
    rate_walk_rad_s2_sqrt_hz : float
        White noise of the angular acceleration per axis, rad/s^2/sqrt(Hz).

    Returns
    -------
    Motion
    """
    return Motion(
        name="coast",
        kind=COAST,
        acceleration_density_m_s2_sqrt_hz=acceleration_density_m_s2_sqrt_hz,
        rate_rad_s=rate_rad_s,
        rate_sigma_rad_s=rate_sigma_rad_s,
        rate_walk_rad_s2_sqrt_hz=rate_walk_rad_s2_sqrt_hz,
        gravity=gravity or GravityField(),
    )
