"""What errors of the focal length and the principal point add to the covariance of a trajectory.

A wrong focal length moves the camera along its axis by its share of the distance to the ground. A wrong
principal point moves it across, or turns it, as far as the rims' perspective leaves open. Estimators take
both as exact; all frames err alike, so that other frames do not show it.
"""

from dataclasses import replace

import numpy as np

from craternav_fg.estimators.base import Descent
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# How far a wrong focal length moves the camera in other directions, over how far along its axis: rims lie to
# one side, and IMU or motion model do not follow. RMS of 21 % on `measured_descent`, 6 % on `orbit_coast`.
_ACROSS = 0.2


def with_intrinsics_error(trajectory: Trajectory, descent: Descent) -> Trajectory:
    """Add the stated errors of the intrinsics to the covariances of poses and velocities.

    Parameters
    ----------
    trajectory : Trajectory
        By rims.
    descent : Descent

    Returns
    -------
    Trajectory
        As it is without a stated error, and where the intrinsics were estimated along.
    """
    camera, calibrated = descent.camera, trajectory.calibrated
    estimated = calibrated is not None and calibrated.intrinsics is not None
    focal = 0.01 * (camera.focal_sigma_percent or 0.0)
    point = (camera.principal_sigma_px or 0.0) / np.array([camera.fx_px, camera.fy_px])
    if not (focal or point.any()) or estimated:
        return trajectory
    # Of where a point of the ground is in c, over its depth.
    sigmas = np.append(np.hypot(point, _ACROSS * focal), focal)
    gRc = trajectory.gRb @ camera.bTc[:3, :3]
    gPc = trajectory.gP + trajectory.gRb @ camera.bTc[:3, 3]
    # Of a unit error along each axis of c.
    moved = _depths_m(gPc, gRc[:, :, 2], descent.body.radius_m)[:, None, None] * gRc
    poses, velocities = trajectory.pose_covariance, trajectory.velocity_covariance
    if poses is not None:
        poses = poses.copy()
        poses[:, 3:, 3:] += _covariance(moved, sigmas)
        # What moves along x turns about y, and the other way round.
        turned = camera.bTc[:3, [1, 0]] * point
        poses[:, :3, :3] += turned @ turned.T
    if velocities is not None and len(trajectory) > 1:
        seconds = 1e-9 * (trajectory.stamps_ns - trajectory.stamps_ns[0])
        velocities = velocities + _covariance(np.gradient(moved, seconds, axis=0), sigmas)
    return replace(trajectory, pose_covariance=poses, velocity_covariance=velocities)


def _covariance(slopes: FloatArray, sigmas: FloatArray) -> FloatArray:
    """Covariances (k, 3, 3) in g from slopes (k, 3, 3)."""
    roots = slopes * sigmas
    return np.asarray(roots @ np.swapaxes(roots, 1, 2))


def _depths_m(gPc: FloatArray, axis: FloatArray, radius_m: float) -> FloatArray:
    """Distances (k,) to the sphere along the optical axis; to the horizon where the axis misses it."""
    inwards = -np.sum(gPc * axis, axis=1)
    tangent2 = np.maximum(np.sum(gPc**2, axis=1) - radius_m**2, 0.0)
    meets = (inwards > 0.0) & (inwards**2 > tangent2)
    near = inwards - np.sqrt(np.where(meets, inwards**2 - tangent2, 0.0))
    return np.asarray(np.where(meets, near, np.sqrt(tangent2)))
