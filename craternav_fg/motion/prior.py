"""The prior of the states that stand for the motion where there is no IMU."""

from dataclasses import replace

from craternav_fg.motion.model import Motion
from craternav_fg.trajectory import InitialState


def with_motion_prior(initial: InitialState, motion: Motion, *, has_gyro: bool) -> InitialState:
    """Give the biases of an initial state the sigmas of what they stand for under a motion model.

    Its own are those of an IMU: as the prior of the angular velocity, the bias of a gyro is much too sure.

    Parameters
    ----------
    initial : InitialState
    motion : Motion
    has_gyro : bool
        The angular velocity is then measured, and the gyro's bias is one.

    Returns
    -------
    InitialState
        Without a gyro, an angular velocity that it states has the sigma that it states, otherwise that of the
        model.
    """
    initial = replace(initial, accelerometer_bias_sigma_m_s2=motion.acceleration_sigma_m_s2)
    if has_gyro:
        return initial
    sigma = motion.rate_sigma_rad_s
    if initial.angular_velocity_rad_s is not None:
        sigma = initial.angular_velocity_sigma_rad_s
    return replace(initial, angular_velocity_sigma_rad_s=sigma, gyro_bias_sigma_rad_s=sigma)
