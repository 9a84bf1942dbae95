"""The true trajectory of a ROS bag: poses of any frame that is fixed to the IMU's."""

import numpy as np
from scipy.interpolate import CubicSpline

from craternav_fg.errors import InputError
from craternav_fg.interchange.bag_reading import (
    Bag,
    increasing_stamps,
    pose_of,
    stamp_ns,
    vector,
)
from craternav_fg.interchange.bag_transforms import StaticTransforms
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray


def read_truth(bag: Bag, topic: str | None, stamps_ns: IntArray, imu_frame: str) -> Trajectory | None:
    """Read the trajectory for comparison.

    Parameters
    ----------
    bag : Bag
    topic : str or None
        Of `PoseStamped`, taken as poses of the IMU, or of `Odometry`.
    stamps_ns : ndarray of int64, shape (k,)
        Stamps of the images.
    imu_frame : str
        Name of the IMU's frame, b; empty when the bag does not say it.

    Returns
    -------
    Trajectory or None
        None without a topic, or when it does not cover the images.

    Raises
    ------
    InputError
        When a number is not finite, stamps do not increase, or the poses are those of a frame whose place on
        the lander is unknown.
    """
    found, poses, twists, frame = [], [], [], ""
    for message in bag.messages(topic):
        stamp, odometry = stamp_ns(message), hasattr(message, "twist")
        where = f"{topic}, stamp {stamp}"
        pose = message.pose.pose if odometry else message.pose
        found.append(stamp)
        poses.append(pose_of(bag, where, pose.position, pose.orientation))
        if odometry:
            twist = message.twist.twist
            twists.append([*vector(twist.linear), *vector(twist.angular)])
            frame = message.child_frame_id
            if not np.all(np.isfinite(twists[-1])):
                raise InputError(bag.path, f"{where}: expected finite velocities, found {twists[-1]}")
    if len(found) < 2:
        return None
    all_ns = increasing_stamps(bag, topic, found)
    if all_ns[0] > stamps_ns[0] or all_ns[-1] < stamps_ns[-1]:
        return None
    # f is the frame of the poses, fixed to the lander.
    fTb = StaticTransforms(bag).pose(frame, imu_frame) if frame and imu_frame else np.eye(4)
    if fTb is None:
        problem = f"expected poses of {imu_frame}, the IMU's frame, or a static transform to it"
        raise InputError(
            bag.path, f"{topic}: {problem}, found those of {frame}: --truth-topic none takes none"
        )
    gTf = np.array(poses)
    gTb = gTf @ fTb
    gV = _velocities(gTf[:, :3, :3], np.array(twists), fTb[:3, 3])
    if gV is None:
        seconds = 1e-9 * (all_ns - all_ns[0])
        gV = CubicSpline(seconds, gTb[:, :3, 3])(seconds, 1)
    return Trajectory(all_ns, gTb, gV, np.zeros((len(gTb), 6)))


def _velocities(gRf: FloatArray, twists: FloatArray, fPb: FloatArray) -> FloatArray | None:
    """Velocities of b in g, shape (k, 3), by the twists of f; None when they do not state them.

    Zeros throughout are what a writer leaves that knows no velocity, or no rate, which a lever arm needs.
    """
    if not len(twists) or not twists[:, :3].any() or (fPb.any() and not twists[:, 3:].any()):
        return None
    fV = twists[:, :3] + np.cross(twists[:, 3:], fPb)
    return np.asarray(np.einsum("kij,kj->ki", gRf, fV))
