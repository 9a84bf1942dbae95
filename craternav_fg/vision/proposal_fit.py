"""Measurement of craters that the network proposes: the rim where it can be traced, else an ellipse.

A rim is traced from the matched filter's candidate of the same crater, which is closer to the rim, and from
the proposed circle. Where neither works, it is traced from an ellipse of the shape that rims have around it,
as perspective foreshortens all alike, and from a larger one where the border cuts the circle: the network
places those inside the image. A fit counts by how well the rim agrees, not by how much the shading looks like
a bowl: that there is a crater is known from the network.
"""

from typing import NamedTuple

import numpy as np

from craternav_fg.ellipse import axes_covariance, half_sides, mean_radius
from craternav_fg.vision.blind_fit import BlindFit, BlindFitter, Judge
from craternav_fg.vision.candidates import Candidates
from craternav_fg.vision.detect import SUN_REACH_SHARE, circle_charts
from craternav_fg.vision.threads import in_threads
from factors.arrays import BoolArray, FloatArray

# Standard deviations of centre and semi-axes of a circle whose rim cannot be traced, in radii. Fitted on
# rendered ground by `craternav_fg.training.judgement`; of one that the border cuts, by
# `craternav_fg.training.rim_fits`, which knows the whole rim.
CIRCLE_SIGMA_RADII = np.array([0.12, 0.219])
CUT_SIGMA_RADII = np.array([0.27, 0.39])
# Logistic regression of right and wrong fits of proposed craters on rendered ground: weights of the share of
# normals that agree, of the scatter in radii and of `distance2`, and the constant. Fitted by
# `craternav_fg.training.rim_fits`.
RIM_WEIGHTS, RIM_OFFSET = np.array([7.9, -144.0, -0.31]), 1.9
# Least logarithm of the odds of a fit that is taken for the rim: on photographs more fits are wrong than on
# rendered ground.
LEAST_LOG_ODDS = 1.0
# Logarithm of the odds above which no other start is tried.
_SURE_LOG_ODDS = 4.0
# Minimum share of a rim that is covered: where it is tells the proposal, too.
MIN_ARC_SHARE = 0.25
# Weight of a circle in the mean shape of the traced rims.
_CIRCLE_WEIGHT = 1.0
# Least share of its radius by which a circle reaches beyond the border that cuts it, the factor on its radius
# and its shift outwards, in radii.
_LEAST_CUT, _CUT_GROWTH, _CUT_SHIFT = 0.1, 1.3, 0.3


class MeasuredRims(NamedTuple):
    """Ellipses of proposals.

    Attributes
    ----------
    charts_px : ndarray, shape (n, 5)
        Ellipse charts in pixels: of the rim where it can be traced.
    covariance_px : ndarray, shape (n, 5, 5)
        Their covariances.
    traced : ndarray of bool, shape (n,)
        Whether the rim was traced.
    """

    charts_px: FloatArray
    covariance_px: FloatArray
    traced: BoolArray


def measured(
    fitter: BlindFitter, circles: Candidates, starts: Candidates, sun_angles_rad: FloatArray
) -> MeasuredRims:
    """Measure proposals.

    Parameters
    ----------
    fitter : BlindFitter
    circles : Candidates
        The proposals; n of them.
    starts : Candidates
        The same craters as the matched filter sees them, or the proposals again.
    sun_angles_rad : ndarray, shape (n,)
        Direction towards the sun in the image at each, from x towards y.

    Returns
    -------
    MeasuredRims
    """
    first, charts = first_fits(fitter, circles, starts, sun_angles_rad, LEAST_LOG_ODDS)
    covariance = coarse_covariances(charts)
    traced = np.zeros(len(charts), dtype=np.bool_)
    beyond = beyond_border(charts, fitter.pixels.shape)

    def best_of(k: int) -> BlindFit | None:
        best, most, chart = None, LEAST_LOG_ODDS, charts[k]
        for start in [None, chart, *_grown(chart, beyond[k])]:
            if most > _SURE_LOG_ODDS:
                break
            rim = first[k] if start is None else fitter.fit(start, float(sun_angles_rad[k]), _above(most))
            if rim is not None and (log_odds := rim_log_odds(rim, chart, covariance[k])) > most:
                best, most = rim, log_odds
        return best

    for k, best in enumerate(in_threads(best_of, range(len(charts)))):
        if best is not None:
            charts[k], covariance[k] = best.fit.chart_px, best.fit.covariance
            traced[k] = True
        elif _grown(charts[k], beyond[k]):
            covariance[k] = _coarse_covariance(charts[k], CUT_SIGMA_RADII)
    return MeasuredRims(charts, covariance, traced)


def first_fits(
    fitter: BlindFitter,
    circles: Candidates,
    starts: Candidates,
    sun_angles_rad: FloatArray,
    least_log_odds: float = -np.inf,
) -> tuple[list[BlindFit | None], FloatArray]:
    """Trace rims from the matched filter's candidates, and find the shape that they have in common.

    Parameters
    ----------
    fitter : BlindFitter
    circles, starts : Candidates
    sun_angles_rad : ndarray, shape (n,)
        As in `measured`.
    least_log_odds : float
        Rims that cannot have more are not fitted to the end.

    Returns
    -------
    fits : list of BlindFit or None, length n
        None where no rim can be traced, or even one at the proposal would have fewer odds.
    charts_px : ndarray, shape (n, 5)
        The proposals as ellipses of the common shape, charts in pixels.
    """
    proposed = circle_charts(circles)
    covariance = coarse_covariances(proposed)
    at = circle_charts(starts)
    fits = in_threads(lambda k: fitter.fit(at[k], sun_angles_rad[k], _above(least_log_odds)), range(len(at)))
    likely = [
        rim.fit.chart_px
        for k, rim in enumerate(fits)
        if rim is not None and rim_log_odds(rim, proposed[k], covariance[k]) > LEAST_LOG_ODDS
    ]
    reach_px = SUN_REACH_SHARE * max(fitter.pixels.shape)
    return fits, _of_common_shape(proposed, np.array(likely).reshape(-1, 5), reach_px)


def _above(least_log_odds: float) -> Judge:
    """Tell from a rim's evidence whether its log odds can be above some: at the proposal they are largest."""
    return lambda evidence: float(RIM_WEIGHTS[:2] @ evidence[:2]) + RIM_OFFSET > least_log_odds


def rim_log_odds(rim: BlindFit, proposed_px: FloatArray, covariance_px: FloatArray) -> float:
    """Return the logarithm of the odds that a fit is the rim of a proposed crater.

    Parameters
    ----------
    rim : BlindFit
    proposed_px : ndarray, shape (5,)
        The proposal's ellipse, chart in pixels.
    covariance_px : ndarray, shape (5, 5)
        Its covariance.
    """
    evidence = [*rim.evidence[:2], distance2(rim, proposed_px, covariance_px)]
    return float(RIM_WEIGHTS @ evidence + RIM_OFFSET)


def distance2(rim: BlindFit, proposed_px: FloatArray, covariance_px: FloatArray) -> float:
    """Return the squared Mahalanobis distance of a fit from a proposed crater.

    Parameters
    ----------
    rim : BlindFit
    proposed_px : ndarray, shape (5,)
        The proposal's ellipse, chart in pixels.
    covariance_px : ndarray, shape (5, 5)
        Its covariance.
    """
    off = rim.fit.chart_px - proposed_px
    return float(off @ np.linalg.solve(covariance_px + rim.fit.covariance, off))


def coarse_covariances(charts_px: FloatArray) -> FloatArray:
    """Return the covariances of proposals whose rims are whole.

    Parameters
    ----------
    charts_px : ndarray, shape (n, 5)
        Their ellipses, charts in pixels.

    Returns
    -------
    ndarray, shape (n, 5, 5)
        In pixels.
    """
    each = [_coarse_covariance(chart, CIRCLE_SIGMA_RADII) for chart in charts_px]
    return np.array(each).reshape(-1, 5, 5)


def _of_common_shape(charts: FloatArray, fits: FloatArray, reach_px: float) -> FloatArray:
    """Ellipses (n, 5) of the places and sizes of circles, of the mean shape of the fits around each."""
    step = charts[:, None, :2] - fits[None, :, :2]
    weight = np.exp(-0.5 * np.sum(step**2, axis=-1) / reach_px**2)
    size = 0.5 * (fits[:, 2] + fits[:, 4])
    shape = np.column_stack([fits[:, 2] - size, fits[:, 3], fits[:, 4] - size])
    out = charts.copy()
    out[:, 2:] += weight @ shape / (weight.sum(axis=1) + _CIRCLE_WEIGHT)[:, None]
    return out


def beyond_border(charts: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return how far ellipses reach beyond the image's borders.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In pixels.
    shape : tuple of int
        Height and width of the image.

    Returns
    -------
    ndarray, shape (..., 2)
        Outwards along x and y, in radii; 0 where no border cuts the ellipse by a tenth of its radius.
    """
    half, centres = half_sides(charts), charts[..., :2]
    high = np.array([shape[1] - 1.0, shape[0] - 1.0])
    beyond = np.maximum(centres + half - high, 0.0) - np.maximum(half - centres, 0.0)
    beyond /= mean_radius(charts)[..., None]
    cut = np.abs(beyond).max(axis=-1, keepdims=True) > _LEAST_CUT
    return np.asarray(np.where(cut, beyond, 0.0))


def _grown(chart: FloatArray, beyond: FloatArray) -> list[FloatArray]:
    """Ellipse beyond the border that cuts one, see `beyond_border`; none if no border does."""
    if not beyond.any():
        return []
    out = chart.copy()
    radius = np.exp(0.5 * (chart[2] + chart[4]))
    out[:2] += _CUT_SHIFT * radius * beyond / np.hypot(*beyond)
    out[[2, 4]] += np.log(_CUT_GROWTH)
    return [out]


def _coarse_covariance(chart: FloatArray, sigma_radii: FloatArray) -> FloatArray:
    """Covariance (5, 5) of the chart of a proposal."""
    centre, axes = sigma_radii * np.exp(0.5 * (chart[2] + chart[4]))
    out = axes_covariance(chart, axes)
    out[0, 0] = out[1, 1] = centre * centre
    return out
