"""Rims searched more than once, where the map is off by more than the edge search reaches.

On real ground a rim has several edges: crests are worn, and craters overlap. The search finds those near the
place where it begins, so a rim would depend on the prediction that found it, and confirm it. Here it is
searched from several places, as far apart as the map's errors, and from each until it stays where it was
found. Sharp rims are then the same; of others the mean depends less on the prediction, and the scatter is
part of their error, which no single fit shows.
"""

from dataclasses import replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import pixel_chart, points_on
from craternav_fg.measurements import RimQuality
from craternav_fg.vision.error_model.systematic import RimErrors
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.predicted_rims import PredictedRims
from craternav_fg.vision.rim_fitting import FittedRims, RimFitter
from factors.arrays import FloatArray

# Movement, px, of a rim's points below which it is where it was searched, and the number of these points.
_MIN_MOVED_PX, _MOVED_POINTS = 0.05, 8
# Farthest that a search begins from the predicted rim, as a share of the semi-minor axis: beyond, other rims
# may be nearer.
_MAX_STEP = 0.3


def recentred(fitter: RimFitter, fitted: FittedRims, camera: Camera, options: GuidedOptions) -> FittedRims:
    """Search rims again around the ellipses just fitted, until they stay there.

    Parameters
    ----------
    fitter : RimFitter
    fitted : FittedRims
    camera : Camera
    options : GuidedOptions

    Returns
    -------
    FittedRims
        Those that are found again, with their first predictions.
    """
    for _ in range(options.recentrings):
        before_px = pixel_chart(fitted.charts, camera)
        around = replace(fitted.predicted, charts_px=before_px)
        reach_px = around.reach_px(options.second_reach_px, options.second_reach_share)
        again = fitter.fit(around, reach_px, options.recentred_found_share, rough=True)
        kept = np.flatnonzero(np.isin(around.rows, again.predicted.rows))
        fitted = replace(again, predicted=fitted.predicted.take(kept))
        after_px = pixel_chart(fitted.charts, camera)
        moved_px = np.abs(points_on(after_px, _MOVED_POINTS) - points_on(before_px[kept], _MOVED_POINTS))
        if np.max(moved_px, initial=0.0) < _MIN_MOVED_PX:
            break
    return fitted


def searched_around(
    fitter: RimFitter, first: FittedRims, place_px: FloatArray, camera: Camera, options: GuidedOptions
) -> FittedRims:
    """Search rims from places around where they were found as well, and take the means.

    Parameters
    ----------
    fitter : RimFitter
    first : FittedRims
        Rims that were found, n.
    place_px : ndarray, shape (n,)
        Standard deviations of their places on the map.
    camera : Camera
    options : GuidedOptions

    Returns
    -------
    FittedRims
        Rims that enough of the searches found again: means of their charts, with the scatter in their
        covariances. The quality is that of the search whose rim is nearest to the mean.
    """
    rims = first.predicted
    found = [recentred(fitter, first, camera, options)]
    step_px = np.minimum(options.search_sigmas * place_px, _MAX_STEP * rims.smallest_radii_px())
    for angle in 2.0 * np.pi * np.arange(options.searches - 1) / max(options.searches - 1, 1):
        charts_px = pixel_chart(first.charts, camera)
        charts_px[:, :2] += step_px[:, None] * [np.cos(angle), np.sin(angle)]
        moved = replace(rims, charts_px=charts_px)
        reach_px = moved.reach_px(options.second_reach_px, options.second_reach_share)
        again = fitter.fit(moved, reach_px, options.recentred_found_share, rough=True)
        found.append(recentred(fitter, again, camera, options))
    return _means(rims, found, min(options.least_searches, options.searches))


def _means(rims: PredictedRims, found: list[FittedRims], least: int) -> FittedRims:
    """Means of rims that at least so many searches found."""
    of_rim: dict[int, list[tuple[FittedRims, int]]] = {row: [] for row in rims.rows.tolist()}
    for one in found:
        for i, row in enumerate(one.predicted.rows.tolist()):
            of_rim[row].append((one, i))
    kept = [k for k, row in enumerate(rims.rows.tolist()) if len(of_rim[row]) >= least]
    charts, errors, quality = [], [], []
    for row in rims.rows[kept].tolist():
        every = np.array([one.charts[i] for one, i in of_rim[row]])
        off = every - every.mean(axis=0)
        scatter = off.T @ off / max(len(every) - 1, 1)
        nearest, i = of_rim[row][int(np.argmin(np.sum(off[:, :2] ** 2, axis=1)))]
        own = nearest.errors
        charts.append(every.mean(axis=0))
        errors.append(
            RimErrors(own.covariance[i] + scatter, own.systematic[i] + scatter, own.brightness_root[i])
        )
        quality.append(nearest.quality.take(np.array([i])))
    return FittedRims(
        rims.take(np.array(kept, dtype=np.int64)),
        np.array(charts).reshape(-1, 5),
        RimErrors.stack(errors),
        RimQuality.joined(quality),
    )
