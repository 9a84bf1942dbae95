"""Residuals of the rims at every estimator's poses: the table residuals.parquet.

One row per rim and estimator:

estimator           name
stamp_ns            of the frame
crater_id           the crater that the rim was matched with
chart               the rim as measured, 5 numbers
whitened            measured minus predicted chart, whitened with the rim's covariance
chi2                squared norm of `whitened`
weight              weight of the match: 1 inlier, 0 outlier; null where the estimator rejects no matches
reassociated_with   the crater that the estimator used the rim for, if that is another one; else null
and the fields of `RimQuality`, null for rims that were not measured in an image.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement, RimQuality, RimSet
from craternav_fg.runs.columns import list_column
from craternav_fg.trajectory import Trajectory
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Components of a rim's chart.
DIMENSION = 5
# A rim with a larger squared residual is an outlier: 7 sigma, which no noise of 5 components explains.
OUTLIER_CHI2 = 50.0


def rim_residuals(
    trajectories: Mapping[str, Trajectory],
    measured: Sequence[FrameMeasurement],
    camera: Camera,
    catalog: Catalog,
) -> pa.Table:
    """Tabulate the residuals of all rims at the poses of all estimators.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By estimator, at the stamps of the frames.
    measured : sequence of FrameMeasurement
    camera : Camera
    catalog : Catalog

    Returns
    -------
    pyarrow.Table
        With the columns that the module lists.
    """
    stamps = np.concatenate([np.full(len(f.rims), f.stamp_ns, dtype=np.int64) for f in measured])
    craters = np.concatenate([f.rims.craters for f in measured])
    charts = np.concatenate([f.rims.chart for f in measured])
    quality = {
        name: pa.array(np.concatenate([_quality(f.rims, name) for f in measured]), from_pandas=True)
        for name in (field.name for field in fields(RimQuality))
    }
    parts = []
    for name, trajectory in trajectories.items():
        whitened = _whitened(trajectory, measured, camera, catalog)
        weights = trajectory.rim_weights
        columns = {
            "estimator": pa.array([name] * len(whitened)),
            "stamp_ns": pa.array(stamps),
            "crater_id": pa.array([catalog.identifiers[row] for row in craters]),
            "chart": list_column(charts),
            "whitened": list_column(whitened),
            "chi2": pa.array(np.sum(whitened**2, axis=1)),
            "weight": pa.nulls(len(whitened), pa.float64())
            if weights is None
            else pa.array(np.concatenate(weights)),
            "reassociated_with": pa.array(_reassociations(trajectory, craters, catalog), pa.string()),
        }
        parts.append(pa.table({**columns, **quality}))
    return pa.concat_tables(parts)


def outlier_share(residuals: pa.Table, estimator: str) -> float | None:
    """Share of the rims that lie beyond 7 sigma from where an estimator's poses put them.

    Parameters
    ----------
    residuals : pyarrow.Table
        See `rim_residuals`.
    estimator : str

    Returns
    -------
    float or None
        None without rims.
    """
    chi2 = residuals.filter(pc.equal(residuals["estimator"], estimator))["chi2"].to_numpy()
    # Residuals that are not finite count as outliers.
    return float(np.mean(~(chi2 <= OUTLIER_CHI2))) if len(chi2) else None


def _whitened(
    trajectory: Trajectory, measured: Sequence[FrameMeasurement], camera: Camera, catalog: Catalog
) -> FloatArray:
    """Whitened chart residuals (n, 5) of all rims at an estimator's poses."""
    parts = [np.empty((0, DIMENSION))]
    for frame, gTb in zip(measured, _poses_at_exposure(trajectory), strict=True):
        rims = frame.rims
        predicted, _ = conic.project_rims(
            gTb, camera.bTc, catalog.centres[rims.craters], catalog.axes[rims.craters]
        )
        L = np.linalg.cholesky(rims.covariance)
        parts.append(np.linalg.solve(L, (rims.chart - predicted)[..., None])[..., 0])
    return np.concatenate(parts)


def _poses_at_exposure(trajectory: Trajectory) -> FloatArray:
    """Body poses (k, 4, 4) at the exposures, with the estimated time offset and mounting applied."""
    gTb, found = trajectory.gTb.copy(), trajectory.calibrated
    if found is None:
        return gTb
    if found.image_delay_s is not None and len(trajectory) > 1:
        offset_s = found.image_delay_s[0]
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


def _reassociations(trajectory: Trajectory, craters: IntArray, catalog: Catalog) -> list[str | None]:
    """Give the craters (n,) that rims were used for by identifier; None for the matched ones."""
    if trajectory.rim_craters is None:
        return [None] * len(craters)
    used = np.concatenate(trajectory.rim_craters).tolist()
    return [
        None if row in (-1, matched) else catalog.identifiers[row]
        for row, matched in zip(used, craters.tolist(), strict=True)
    ]


def _quality(rims: RimSet, name: str) -> FloatArray:
    """One field of `RimQuality` for all rims of a frame (n,); NaN for rims not measured in an image."""
    return np.full(len(rims), np.nan) if rims.quality is None else np.asarray(getattr(rims.quality, name))
