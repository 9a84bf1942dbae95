"""White noise on the translation's jerk: a Gaussian-process prior whose body-fixed acceleration random-walks.

The acceleration is a state and takes the place of the accelerometer's bias, with the opposite sign. The
attitude follows the gyro, or has the rate prior of the other models: a random walk of the angular velocity.
The prior of Tang et al. (2019) has white jerk in the rotation, too, with the angular acceleration as a state.
"""

from craternav_fg.motion.model import Motion
from factors.kernels.motion import WHITE_JERK

# About what a lander's engine gives.
ACCELERATION_SIGMA_M_S2 = 1.0


def white_jerk(
    jerk_density_m_s3_sqrt_hz: float,
    *,
    acceleration_sigma_m_s2: float = ACCELERATION_SIGMA_M_S2,
    rate_rad_s: tuple[float, float, float] = Motion.rate_rad_s,
    rate_sigma_rad_s: float = Motion.rate_sigma_rad_s,
    rate_walk_rad_s2_sqrt_hz: float = Motion.rate_walk_rad_s2_sqrt_hz,
) -> Motion:
    """Make the model.

    Parameters
    ----------
    jerk_density_m_s3_sqrt_hz : float
        White noise of the jerk per axis, m/s^3/sqrt(Hz).
    acceleration_sigma_m_s2 : float
        Prior standard deviation per axis of the acceleration relative to a constant twist, whose mean is 0.
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
    Tang, T. Y., Yoon, D. J., Barfoot, T. D. (2019), A white-noise-on-jerk motion prior for continuous-time
    trajectory estimation on SE(3), IEEE RA-L 4 (2), 594-601.
    """
    return Motion(
        name="white_jerk",
        kind=WHITE_JERK,
        acceleration_density_m_s2_sqrt_hz=0.0,
        jerk_density_m_s3_sqrt_hz=jerk_density_m_s3_sqrt_hz,
        rate_rad_s=rate_rad_s,
        rate_sigma_rad_s=rate_sigma_rad_s,
        rate_walk_rad_s2_sqrt_hz=rate_walk_rad_s2_sqrt_hz,
        acceleration_sigma_m_s2=acceleration_sigma_m_s2,
    )
