"""Residuals of measured rims at an estimated trajectory."""

from collections.abc import Sequence

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.intrinsics import intrinsic_slopes
from craternav_fg.linalg import whitening
from craternav_fg.mapping.apply_errors import apply_errors
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Calibrated, Trajectory
from factors.arrays import FloatArray
from factors.kernels import conic

# A rim with a larger squared residual is an outlier: 7 sigma, which no noise of 5 components explains.
OUTLIER_CHI2 = 50.0
# A crater is wrong whose rims are outliers in this share of its frames, of which there are so many; and at
# most this share of the craters is.
_MIN_OUTLIERS, _MIN_FRAMES, _MAX_WRONG = 0.8, 3, 0.1


def rim_residuals(
    trajectory: Trajectory, measured: Sequence[FrameMeasurement], camera: Camera, catalog: Catalog
) -> FloatArray:
    """Whitened residuals, measured minus predicted chart, of all rims at an estimator's poses.

    Parameters
    ----------
    trajectory : Trajectory
        At the frames' stamps. What it estimated beside the states is applied: mounting, time offset and
        intrinsics of the camera, errors of the map.
    measured : sequence of FrameMeasurement
        n rims in all.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n, 5)
        In the order of the frames and of their rims; NaN where the pose cannot see the crater.
    """
    begin, parts = 0, [np.empty((0, 5))]
    for segment in trajectory.segments():
        end = begin + len(segment)
        parts += _residuals(segment, measured[begin:end], camera, catalog)
        begin = end
    return np.concatenate(parts)


def _residuals(
    trajectory: Trajectory, measured: Sequence[FrameMeasurement], camera: Camera, catalog: Catalog
) -> list[FloatArray]:
    """Residuals of each frame of a segment, see `rim_residuals`."""
    parts = []
    found = trajectory.calibrated or Calibrated()
    if found.map_errors is not None:
        catalog = apply_errors(catalog, found.map_errors).catalog
    for frame, gTb in zip(measured, _poses_at_exposure(trajectory), strict=True):
        intrinsics = None if found.intrinsics is None else found.intrinsics[0]
        parts.append(frame_residuals(frame, gTb, camera, catalog, intrinsics))
    return parts


def frame_residuals(
    frame: FrameMeasurement,
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    intrinsics: FloatArray | None = None,
) -> FloatArray:
    """Whitened residuals, measured minus predicted chart, of a frame's rims at a pose.

    Parameters
    ----------
    frame : FrameMeasurement
        With n rims.
    gTb : ndarray, shape (4, 4)
        Pose of the body at the exposure, in g, m.
    camera : Camera
    catalog : Catalog
    intrinsics : ndarray, shape (4,), optional
        Errors of the intrinsics, see `Calibrated.intrinsics`.

    Returns
    -------
    ndarray, shape (n, 5)
        NaN where the pose cannot see the crater.
    """
    rims = frame.rims
    centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
    predicted, _ = conic.project_rims(np.ascontiguousarray(gTb), camera.bTc, centres, axes)
    if intrinsics is not None:
        predicted = predicted + intrinsic_slopes(predicted, camera) @ intrinsics
    return np.einsum("nij,nj->ni", whitening(rims.covariance), rims.chart - predicted)


def outlier_share(residuals: FloatArray) -> float | None:
    """Share of rims whose residual no noise explains.

    Parameters
    ----------
    residuals : ndarray, shape (n, 5)
        Whitened. What is not finite counts as an outlier.

    Returns
    -------
    float or None
        None without rims.
    """
    chi2 = np.sum(residuals**2, axis=1)
    return float(np.mean(~(chi2 <= OUTLIER_CHI2))) if len(chi2) else None


def outlying_craters(residuals: FloatArray, measured: Sequence[FrameMeasurement]) -> dict[int, int]:
    """Find craters that contradict a trajectory which the others agree with.

    Parameters
    ----------
    residuals : ndarray, shape (n, 5)
        See `rim_residuals`.
    measured : sequence of FrameMeasurement
        The frames, with n rims.

    Returns
    -------
    dict of int to int
        By row of the catalogue, in how many frames; empty where they are many: then it is not the craters
        that are wrong.
    """
    craters = np.concatenate([np.empty(0, np.int64), *(frame.rims.craters for frame in measured)])
    rows, index, counts = np.unique(craters, return_inverse=True, return_counts=True)
    outliers = np.bincount(index, ~(np.sum(residuals**2, axis=1) <= OUTLIER_CHI2), len(rows))
    wrong = (counts >= _MIN_FRAMES) & (outliers >= _MIN_OUTLIERS * counts)
    if not wrong.any() or wrong.sum() > max(_MAX_WRONG * len(rows), 1.0):
        return {}
    return dict(zip(rows[wrong].tolist(), counts[wrong].tolist(), strict=True))


def poses_at_exposure(trajectory: Trajectory) -> FloatArray:
    """Poses of the body at the exposures, with an estimated time offset and mounting of the camera applied.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    ndarray, shape (k, 4, 4)
        In g: a camera mounted as the data set says took the images from there.
    """
    return np.concatenate([_poses_at_exposure(segment) for segment in trajectory.segments()])


def _poses_at_exposure(trajectory: Trajectory) -> FloatArray:
    """Poses (k, 4, 4) at the exposures of a segment."""
    gTb, found = trajectory.gTb.copy(), trajectory.calibrated
    if found is None:
        return gTb
    if found.time_offset_s is not None and len(trajectory) > 1:
        offset_s = found.time_offset_s[0]
        seconds = np.diff(trajectory.stamps_ns)[:, None] * 1e-9
        steps = np.swapaxes(gTb[:-1, :3, :3], 1, 2) @ gTb[1:, :3, :3]
        rates = np.array([frames.rotation_log(step) for step in steps]) / seconds
        # The offset is milliseconds: the mean angular velocity between frames is accurate enough.
        rates = 0.5 * (np.concatenate([rates[:1], rates]) + np.concatenate([rates, rates[-1:]]))
        gTb[:, :3, :3] = gTb[:, :3, :3] @ np.array([frames.rotation_exp(offset_s * rate) for rate in rates])
        gTb[:, :3, 3] += offset_s * trajectory.gV
    if found.mounting_rad is not None:
        gTb[:, :3, :3] = gTb[:, :3, :3] @ frames.rotation_exp(found.mounting_rad[0])
    return gTb
