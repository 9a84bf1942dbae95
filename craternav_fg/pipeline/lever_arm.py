"""Where the camera is on the lander, and how it is turned: what errors of both add to covariances.

Rims tell where the camera is; the lander is that less the lever arm. An error of the lever arm shifts a
lander that does not turn by the same vector in every frame, which no measurement contradicts. Landers turn
too little to show it. Nor does an error of the rotation: the attitude is wrong by as much, and the
accelerometer's bias takes up what gravity contradicts.
"""

from dataclasses import replace

import numpy as np

from craternav_fg import frames
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.sensor_bank import gyro_at
from craternav_fg.trajectory import Trajectory


def with_lever_arm_error(trajectory: Trajectory, descent: Descent) -> Trajectory:
    """Add the stated error of the camera's lever arm to the covariances of positions and velocities.

    Parameters
    ----------
    trajectory : Trajectory
        By rims.
    descent : Descent

    Returns
    -------
    Trajectory
        As it is without a stated error.
    """
    variance = (descent.camera.lever_arm_sigma_m or 0.0) ** 2
    poses, velocities = trajectory.pose_covariance, trajectory.velocity_covariance
    if not variance:
        return trajectory
    if poses is not None:
        poses = poses.copy()
        poses[:, 3:, 3:] += variance * np.eye(3)
    if velocities is not None:
        # The lever arm's end moves against b by the product of the angular velocity relative to g and it.
        gyro = np.array([gyro_at(descent, int(stamp_ns)) for stamp_ns in trajectory.stamps_ns])
        of_b = np.einsum("kij,kj->ki", trajectory.gRb, gyro - trajectory.bias[:, :3])
        rate = of_b - np.array(descent.body.spin_rad_s)
        across = np.sum(rate**2, axis=1)[:, None, None] * np.eye(3) - rate[:, :, None] * rate[:, None, :]
        velocities = velocities + variance * across
    return replace(trajectory, pose_covariance=poses, velocity_covariance=velocities)


def with_mounting_error(trajectory: Trajectory, descent: Descent) -> Trajectory:
    """Add the stated error of the camera's rotation in b to the covariances of poses.

    Parameters
    ----------
    trajectory : Trajectory
        By rims.
    descent : Descent

    Returns
    -------
    Trajectory
        As it is without a stated error, and where the mounting was estimated along.
    """
    poses, calibrated = trajectory.pose_covariance, trajectory.calibrated
    estimated = calibrated is not None and calibrated.mounting_rad is not None
    if poses is None or estimated or not descent.camera.mounting_sigma_deg:
        return trajectory
    # The error of the lever arm itself is added apart: it counts for velocities, too.
    of_b = replace(descent.camera, lever_arm_sigma_m=None).mounting_covariance()
    added = np.array([frames.rotate_position_block(of_b, gRb) for gRb in trajectory.gRb])
    return replace(trajectory, pose_covariance=poses + added)
