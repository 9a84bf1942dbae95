"""Trajectories in the format of KITTI; `runs.write` has that of TUM, which runs are stored in."""

from pathlib import Path

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.files import replacing
from craternav_fg.trajectory import Trajectory


def kitti_times(path: Path) -> Path:
    """Return the path of the times beside a file of KITTI.

    Parameters
    ----------
    path : Path
        File of the poses.

    Returns
    -------
    Path
    """
    return path.with_name(f"{path.stem}_times{path.suffix}")


def write_kitti(path: Path, trajectory: Trajectory, camera: Camera) -> None:
    """Write poses of the camera relative to the first one, as KITTI's odometry benchmark has them.

    Parameters
    ----------
    path : Path
        Twelve numbers a line: the upper rows of the pose, row by row, m. The stamps are beside it, in s from
        the first, see `kitti_times`.
    trajectory : Trajectory
    camera : Camera

    Raises
    ------
    InputError
        When a file cannot be written.
    """
    gTc = camera.gTc(trajectory.gTb)
    poses = frames.inverse(gTc[0]) @ gTc
    seconds = 1e-9 * (trajectory.stamps_ns - trajectory.stamps_ns[0])
    with replacing(path) as temporary:
        np.savetxt(temporary, poses[:, :3].reshape(-1, 12), fmt="%.17g")
    with replacing(kitti_times(path)) as temporary:
        np.savetxt(temporary, seconds, fmt="%.9f")
