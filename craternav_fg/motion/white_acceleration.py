"""White noise on acceleration: a Gaussian-process prior on SE(3) with the mean of a constant twist.

The body-fixed velocity and the angular velocity random-walk. A circular orbit with the camera at nadir is
such a motion, and so is any gentle flight over a few seconds; no gravity field is needed.
"""

from craternav_fg.motion.model import Motion
from factors.kernels.motion import WHITE_ACCELERATION


def white_acceleration(
    acceleration_density_m_s2_sqrt_hz: float,
    *,
    rate_rad_s: tuple[float, float, float] = Motion.rate_rad_s,
    rate_sigma_rad_s: float = Motion.rate_sigma_rad_s,
    rate_walk_rad_s2_sqrt_hz: float = Motion.rate_walk_rad_s2_sqrt_hz,
) -> Motion:
    """Make the model.

    Parameters
    ----------
    acceleration_density_m_s2_sqrt_hz : float
        White noise of the acceleration per axis, m/s^2/sqrt(Hz).
    rate_rad_s : tuple of float
        Prior mean of the inertial angular velocity in b, where there is no gyro.
    rate_sigma_rad_s : float
        Its standard deviation per axis.
    rate_walk_rad_s2_sqrt_hz : float
        White noise of the angular acceleration per axis, rad/s^2/sqrt(Hz).

    Returns
    -------
    Motion

    References
    ----------
    Anderson, S., Barfoot, T. D. (2015), Full STEAM ahead: exactly sparse Gaussian process regression for
    batch continuous-time trajectory estimation on SE(3), IROS, 157-164.
    """
    return Motion(
        name="white_acceleration",
        kind=WHITE_ACCELERATION,
        acceleration_density_m_s2_sqrt_hz=acceleration_density_m_s2_sqrt_hz,
        rate_rad_s=rate_rad_s,
        rate_sigma_rad_s=rate_sigma_rad_s,
        rate_walk_rad_s2_sqrt_hz=rate_walk_rad_s2_sqrt_hz,
    )
