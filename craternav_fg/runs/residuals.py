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

from dataclasses import fields

import numpy as np
import pyarrow as pa

from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import RimQuality, RimSet
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.runs.columns import list_column
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray


def residuals_table(result: Reconstruction) -> pa.Table:
    """Tabulate the residuals of all rims at the poses of all estimators.

    Parameters
    ----------
    result : Reconstruction

    Returns
    -------
    pyarrow.Table
        With the columns that the module lists.
    """
    measured, catalog = result.frames, result.problems[0].catalog
    stamps = np.concatenate([np.full(len(f.rims), f.stamp_ns, dtype=np.int64) for f in measured])
    craters = np.concatenate([f.rims.craters for f in measured])
    charts = np.concatenate([f.rims.chart for f in measured])
    quality = {
        name: pa.array(np.concatenate([_quality(f.rims, name) for f in measured]), from_pandas=True)
        for name in (field.name for field in fields(RimQuality))
    }
    parts = []
    for name, trajectory in result.trajectories.items():
        whitened = result.residuals[name]
        weights = trajectory.rim_weights
        columns = {
            # Without a rim the types would be unknown.
            "estimator": pa.array([name] * len(whitened), pa.string()),
            "stamp_ns": pa.array(stamps),
            "crater_id": pa.array([catalog.identifiers[row] for row in craters], pa.string()),
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


def _reassociations(trajectory: Trajectory, craters: IntArray, catalog: Catalog) -> list[str | None]:
    """Return the craters (n,) that rims were used for by identifier; None for the matched ones."""
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
