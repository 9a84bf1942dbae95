"""Crater rims from Canny edges: dark and bright arcs paired along the direction towards the sun.

For comparison with `detect`: the method of Tian et al. (2019, section 4.1) and of most crater detectors
before it. Along a rim the brightness rises towards the sun on both walls: from the shadowed wall to the
ground outside, and from the ground outside to the lit wall. Edges that fall towards the sun belong to no rim.
The other edges fall into arcs; two that face each other along the direction towards the sun and bend around
one centre are taken for one crater's, and an ellipse is fitted to their points.

References
----------
Tian et al. (2019), DOI 10.1017/S0373463318000966, section 4.1.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import axes_of_chart
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.detect import (
    BlindOptions,
    FoundRims,
    agreed_sun_angle,
    candidates_in,
    gather,
    require_finite_angle,
)
from craternav_fg.vision.ellipse_fit import FitFailure, RimFit, fit_rim
from factors.arrays import FloatArray, ImageArray

# Standard deviation of the Gaussian blur before gradients are taken, px.
_BLUR_PX = 1.2
# Canny's thresholds, as shares of this percentile of the gradient, and the minimum upper one, brightness per
# pixel.
_LOW_THRESHOLD_SHARE, _HIGH_THRESHOLD_SHARE, _GRADIENT_PERCENTILE = 0.25, 0.6, 98.0
_MIN_HIGH_THRESHOLD = 0.5
# Canny takes gradients as 16-bit integers: this many units per brightness and pixel, up to this limit.
_GRADIENT_UNITS, _MAX_GRADIENT_UNITS = 32.0, 32000
# Minimum cosine between an edge's gradient and the direction towards the sun.
_MIN_SUN_COSINE = 0.2
# Minimum number of points of an arc; its radius within these factors of the searched ones.
_MIN_ARC_POINTS = 8
_MIN_RADIUS_FACTOR, _MAX_RADIUS_FACTOR = 0.5, 2.0
# Two arcs of one crater: largest ratio of their radii; largest distance of their centres, and of the line
# between their middles from the direction towards the sun, in mean radii; range of its length along it, in
# mean radii.
_MAX_RADIUS_RATIO, _MAX_CENTRE_DISTANCE_RADII, _MAX_LATERAL_OFFSET_RADII = 2.0, 0.8, 0.7
_MIN_SEPARATION_RADII, _MAX_SEPARATION_RADII = 0.8, 2.4
# Largest scatter of the points about the ellipse: px, share of the semi-minor axis.
_MAX_SCATTER = (0.5, 0.05)
# Minimum share of the rim that the arcs cover, and largest ratio of its axes.
_MIN_COVERED_SHARE, _MAX_AXIS_RATIO = 0.45, 2.2


@dataclass(frozen=True)
class _Arc:
    """Edge points (n, 2), px, their circle, and whether the gradient points away from its centre."""

    points: FloatArray
    centre: FloatArray
    radius: float
    outward: bool


def find_rims_canny(
    image: npt.NDArray[np.generic], sun_angle_rad: float | None = None, options: BlindOptions | None = None
) -> FoundRims:
    """Find crater rims as `detect.find_rims` does, from Canny edges.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        See `brightness.brightness`.
    sun_angle_rad : float, optional
        Direction towards the sun in the image, from x towards y; found in the image if not given.
    options : BlindOptions, optional
        Those of sizes, candidates, fit and minimum quality count.

    Returns
    -------
    FoundRims
        Their quality is the share of the rim that edges cover.

    Raises
    ------
    ValueError
        When the array is no image, or the angle not finite.

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, section 4.1.
    """
    require_finite_angle(sun_angle_rad)
    options = options or BlindOptions()
    everywhere, pixels = filled(brightness(image))
    largest = options.max_radius_share * min(pixels.shape)
    candidates = candidates_in(everywhere, options)
    nothing = float("nan") if sun_angle_rad is None else float(sun_angle_rad)
    if len(candidates) == 0:
        return gather([], [], [], nothing)
    agreed, certain, seen = agreed_sun_angle(candidates, sun_angle_rad)
    if not certain:
        return replace(gather([], [], [], agreed), seen_sun_angle_rad=seen)
    arcs = _arcs(everywhere, np.isnan(pixels), agreed, options.min_radius_px, largest)
    camera = Camera(pixels.shape[1], pixels.shape[0], 1.0, 1.0, 0.0, 0.0)
    fits: list[RimFit] = []
    covered: list[float] = []
    for one, other in _pairs(arcs, agreed):
        fit = fit_rim(np.concatenate([one.points, other.points]), camera, options.fit)
        if isinstance(fit, FitFailure) or not _plausible(fit, options, largest):
            continue
        fits.append(fit)
        covered.append(fit.arc_share)
    return replace(gather(fits, covered, [agreed] * len(fits), agreed), seen_sun_angle_rad=seen)


def _arcs(
    image: ImageArray,
    holes: npt.NDArray[np.bool_],
    sun_angle_rad: float,
    min_radius_px: float,
    max_radius_px: float,
) -> list[_Arc]:
    """Chains of edge pixels whose brightness rises towards the sun."""
    smooth = cv2.GaussianBlur(image, (0, 0), _BLUR_PX)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125)
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    strength = cv2.magnitude(gx, gy)
    high = _HIGH_THRESHOLD_SHARE * float(np.percentile(strength, _GRADIENT_PERCENTILE))
    high = max(high, _MIN_HIGH_THRESHOLD)
    low = _GRADIENT_UNITS * _LOW_THRESHOLD_SHARE / _HIGH_THRESHOLD_SHARE * high
    limit = _MAX_GRADIENT_UNITS
    whole = [np.rint(_GRADIENT_UNITS * g).clip(-limit, limit).astype(np.int16) for g in (gx, gy)]
    edge = cv2.Canny(whole[0], whole[1], low, _GRADIENT_UNITS * high, L2gradient=True) > 0
    towards = np.cos(sun_angle_rad) * gx + np.sin(sun_angle_rad) * gy
    edge &= (towards > _MIN_SUN_COSINE * strength) & ~holes
    count, label = cv2.connectedComponents(edge.astype(np.uint8), connectivity=8)
    y, x = np.nonzero(label)
    order = np.argsort(label[y, x], kind="stable")
    y, x = y[order], x[order]
    bounds = np.searchsorted(label[y, x], np.arange(1, count + 1))
    out = []
    for first, last in pairwise(bounds):
        if last - first < _MIN_ARC_POINTS:
            continue
        rows, columns = y[first:last], x[first:last]
        points = np.column_stack([columns, rows]).astype(np.float64)
        centre, radius = _circle(points)
        if not _MIN_RADIUS_FACTOR * min_radius_px < radius < _MAX_RADIUS_FACTOR * max_radius_px:
            continue
        out_of = (points - centre) * np.column_stack([gx[rows, columns], gy[rows, columns]])
        out.append(_Arc(points, centre, radius, bool(out_of.sum() > 0.0)))
    return out


def _circle(points: FloatArray) -> tuple[FloatArray, float]:
    """Centre and radius of the circle through points, algebraic least squares; radius inf for a line."""
    middle = points.mean(axis=0)
    p = points - middle
    square = np.sum(p**2, axis=1)
    M = np.column_stack([2.0 * p, np.ones(len(p))])
    solution, _, rank, _ = np.linalg.lstsq(M, square, rcond=1e-9)
    if rank < 3:
        return middle, float("inf")
    return middle + solution[:2], float(np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0.0)))


def _pairs(arcs: list[_Arc], sun_angle_rad: float) -> list[tuple[_Arc, _Arc]]:
    """Pairs of a shadowed and a lit wall that may belong to one crater."""
    dark, lit = [a for a in arcs if a.outward], [a for a in arcs if not a.outward]
    if not dark or not lit:
        return []
    s = np.array([np.cos(sun_angle_rad), np.sin(sun_angle_rad)])
    radius = [np.array([a.radius for a in side]) for side in (dark, lit)]
    centre = [np.array([a.centre for a in side]) for side in (dark, lit)]
    middle = [np.array([a.points.mean(axis=0) for a in side]) for side in (dark, lit)]
    size = np.sqrt(radius[0][:, None] * radius[1])
    ratio = np.abs(np.log(radius[0][:, None] / radius[1]))
    apart = np.linalg.norm(centre[0][:, None] - centre[1], axis=-1)
    step = middle[0][:, None] - middle[1]
    along, aside = step @ s, np.abs(step @ np.array([-s[1], s[0]]))
    good = (
        (ratio < np.log(_MAX_RADIUS_RATIO))
        & (apart < _MAX_CENTRE_DISTANCE_RADII * size)
        & (along > _MIN_SEPARATION_RADII * size)
        & (along < _MAX_SEPARATION_RADII * size)
        & (aside < _MAX_LATERAL_OFFSET_RADII * size)
    )
    return [(dark[i], lit[j]) for i, j in zip(*np.nonzero(good), strict=True)]


def _plausible(fit: RimFit, options: BlindOptions, largest: float) -> bool:
    """Return whether a fit may be the rim of one crater."""
    _, _, major, minor, _ = axes_of_chart(fit.chart_px[None])[0]
    return bool(
        fit.arc_share >= max(_MIN_COVERED_SHARE, options.min_quality)
        and fit.rms_px < _MAX_SCATTER[0] + _MAX_SCATTER[1] * minor
        and _MIN_RADIUS_FACTOR * options.min_radius_px < minor
        and major < min(largest, _MAX_AXIS_RATIO * minor)
    )
