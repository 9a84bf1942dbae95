"""Errors of the map that single frames take for larger, with one size in all frames.

Rims whose shape contradicts the map have larger variances in their frame, see `shape_scatter`. The error of a
crater on the map is one vector in all frames: a root that is larger in a single one would say that the crater
is farther off there. A crater that is badly mapped shows it in all frames, one that is badly seen in some.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions, map_roots
from factors.arrays import FloatArray


def with_steady_roots(
    frames: Sequence[FrameMeasurement],
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    options: CorrelatedErrorOptions,
) -> tuple[FrameMeasurement, ...]:
    """Give the errors of each crater on the map their mean variance in all frames; the rest is white.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    gTb : ndarray, shape (k, 4, 4)
        Approximate poses of the body in g, m.
    camera : Camera
    catalog : Catalog
    options : CorrelatedErrorOptions
        By which the rims were measured.

    Returns
    -------
    tuple of FrameMeasurement
    """
    if catalog.errors is None or catalog.errors.exact:
        return tuple(frames)
    factors = [
        _factors(frame.rims, np.ascontiguousarray(pose), camera, catalog, options)
        for frame, pose in zip(frames, gTb, strict=True)
    ]
    rows = np.concatenate([np.empty(0, np.int64), *(frame.rims.craters for frame in frames)])
    sums = np.bincount(rows, np.concatenate([np.empty(0), *factors]), len(catalog))
    means = sums / np.maximum(np.bincount(rows, minlength=len(catalog)), 1)
    return tuple(
        replace(frame, rims=_steady(frame.rims, means[frame.rims.craters] / own))
        for frame, own in zip(frames, factors, strict=True)
    )


def _factors(
    rims: RimSet, gTb: FloatArray, camera: Camera, catalog: Catalog, options: CorrelatedErrorOptions
) -> FloatArray:
    """By how much (n,) the variances of a frame's rims on the map are larger than those of the catalogue."""
    roots = map_roots(rims.craters, gTb, camera, catalog, options)
    if rims.of_map is None or roots is None:
        return np.ones(len(rims))
    stated, own = (np.sum(A**2, axis=(1, 2)) for A in (roots, rims.of_map))
    return np.divide(own, stated, out=np.ones(len(rims)), where=stated > 0.0)


def _steady(rims: RimSet, ratios: FloatArray) -> RimSet:
    """Multiply the variances of the map by ratios (n,); what they lose is white."""
    if rims.of_map is None:
        return rims
    before = rims.of_map @ np.swapaxes(rims.of_map, 1, 2)
    lost, gained = (np.maximum(part, 0.0)[:, None, None] * before for part in (1.0 - ratios, ratios - 1.0))
    return replace(
        rims,
        of_map=np.sqrt(ratios)[:, None, None] * rims.of_map,
        covariance=rims.covariance + gained,
        fused_white=None if rims.fused_white is None else rims.fused_white + lost,
    )
