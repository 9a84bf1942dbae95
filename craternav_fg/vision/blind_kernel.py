"""Tracing and fitting of a rim without a camera model, compiled: both passes in one call; see `blind_fit`.

A rim takes a quarter of a millisecond, and the calls between its parts would take as long again.
"""

from typing import NamedTuple

import numpy as np

from craternav_fg.ellipse import moments_kernel, points_on, semi_axes_kernel, whiten_kernel
from craternav_fg.vision import ellipse_kernel
from craternav_fg.vision.crest_tables import CrestTables
from craternav_fg.vision.dense_kernel import ordered
from craternav_fg.vision.edge_kernel import trace_rim
from craternav_fg.vision.flank_kernel import normal_count
from craternav_fg.vision.ground_level import LEVEL_TERMS
from craternav_fg.vision.reference_brightness import MIN_REFERENCE_BRIGHTNESS
from craternav_fg.vision.rim_shading import RimShading
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Rings of flat terrain around a crater, in radii, and the points on each.
_GROUND_RING_RADII, _RING_POINTS = (1.5, 1.75, 2.0), 32
_GROUND_RINGS = np.concatenate(
    [radius * points_on(np.zeros(5), _RING_POINTS) for radius in _GROUND_RING_RADII]
)
# Half lengths of the normals along which a rim is traced, first and second: px, share of the radius.
_NORMAL_REACHES = np.array([[2.0, 0.35], [1.5, 0.14]])
# Minimum share of the normals that have contrast and lie in the image, and of these that have an edge.
_MIN_TRIED_SHARE, _MIN_FOUND_SHARE = 0.3, 0.35
# Minimum semi-minor axis and largest shift of a rim, in radii of its start: another crater's rim beyond.
_MIN_MINOR_RADII, _MAX_SHIFT_RADII = 0.5, 0.6


class Tracing(NamedTuple):
    """What all rims of an image are traced with, as kernels take it.

    Attributes
    ----------
    contrast : float
        Slope contrast, see `photometry`.
    noise_step : float
        Least brightness step between two pixels that noise does not explain.
    psf_px : float
        Standard deviation of the point-spread function.
    smoothing_share, smoothing_px, min_slope_contrast, min_step : float
        See `edges.EdgeOptions`.
    tables : CrestTables
    lens : ndarray, shape (14,)
        Of a camera whose pixels are its coordinates.
    min_points : int
        This and the following: see `ellipse_fit.FitOptions`.
    min_arc_share, max_gap_rad, max_sigma_share, min_scatter_px : float
    brightness_sigma : float
        Relative standard deviation of the reference brightness.
    """

    contrast: float
    noise_step: float
    psf_px: float
    smoothing_share: float
    smoothing_px: float
    min_slope_contrast: float
    min_step: float
    tables: CrestTables
    lens: FloatArray
    min_points: int
    min_arc_share: float
    max_gap_rad: float
    max_sigma_share: float
    min_scatter_px: float
    brightness_sigma: float


@njit(cache=True, error_model="numpy")
def ring_brightness(image: ImageArray, chart_px: FloatArray) -> float:
    """Estimate the brightness of the terrain around a rim: the median of rings.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    chart_px : ndarray, shape (5,)
        Chart of the rim in pixels.

    Returns
    -------
    float
        0 where the image has none of the rings.
    """
    half_x, half_y = np.exp(chart_px[2]), np.exp(chart_px[4])
    values = np.empty(len(_GROUND_RINGS))
    count = 0
    for i in range(len(_GROUND_RINGS)):
        u, v = _GROUND_RINGS[i, 0], _GROUND_RINGS[i, 1]
        x = np.rint(chart_px[0] + half_x * u)
        y = np.rint(chart_px[1] + chart_px[3] * half_x * u + half_y * v)
        if x >= 0.0 and y >= 0.0 and x < image.shape[1] and y < image.shape[0]:
            value = image[int(y), int(x)]
            if np.isfinite(value):
                values[count] = value
                count += 1
    return ordered(values[:count])[count // 2] if count > 0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def traced_rim(
    image: ImageArray, start_px: FloatArray, sun: FloatArray, given: Tracing
) -> tuple[bool, FloatArray, FloatArray, FloatArray, int, FloatArray, float, float, int, float]:
    """Trace a rim and fit an ellipse to it, twice: the second time from the first, along shorter normals.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    start_px : ndarray, shape (5,)
        Ellipse near the rim, chart in pixels.
    sun : ndarray, shape (2,)
        Unit vector towards the sun in the image.
    given : Tracing

    Returns
    -------
    ok : bool
        Whether there is a rim near the start; nothing else is valid if there is none.
    points, sigma_ratio, motion : ndarray, shapes (n, 2), (n,), (n, 2)
        Edge points of the second pass, see `edge_kernel.trace_rim`.
    tried : int
        Its normals with contrast that lie in the image.
    chart_px : ndarray, shape (5,)
        The ellipse.
    minor_px : float
        Its semi-minor axis.
    rms_px, kept, arc_share : float, int, float
        See `ellipse_kernel.fit`.
    """
    chart = start_px
    points, ratio, motion = np.empty((0, 2)), np.empty(0), np.empty((0, 2))
    tried, kept, rms, arc, minor = 0, 0, 0.0, 0.0, 0.0
    no_sun, even = np.zeros(2), np.zeros(2)
    cosines = np.array([1.0 / np.hypot(1.0, given.contrast), 1.0])
    lambertian = np.empty((2, 2))
    for turn in range(len(_NORMAL_REACHES)):
        size = np.exp(0.5 * (chart[2] + chart[4]))
        reference = ring_brightness(image, chart)
        if not reference > MIN_REFERENCE_BRIGHTNESS:
            return False, points, ratio, motion, tried, chart, minor, rms, kept, arc
        # The crater's radius towards the sun, in the image.
        u, v = whiten_kernel(
            chart[0] + sun[0], chart[1] + sun[1], chart[0], chart[1], chart[2], chart[3], chart[4]
        )
        reach_px = _NORMAL_REACHES[turn, 0] + _NORMAL_REACHES[turn, 1] * size
        normals = normal_count(size)
        sxx, sxy, syy = moments_kernel(chart[2], chart[3], chart[4])
        lambertian[0, 0], lambertian[1, 1] = -0.5 * sxx, -0.5 * syy
        lambertian[0, 1] = lambertian[1, 0] = -0.5 * sxy
        # As from above, and by Lambert's law: the slope contrast is the tangent of the angle of incidence.
        contrast = given.contrast / np.hypot(u, v) * sun
        shading = RimShading(reference, even, contrast, lambertian, cosines[0] * contrast, even, cosines, 0.0)
        points, ratio, motion, tried, _, _ = trace_rim(
            image, chart, shading, reach_px, given.smoothing_share, given.smoothing_px, given.psf_px,
            given.min_slope_contrast, given.min_step, given.noise_step / reference, normals, given.tables,
            given.lens, np.zeros(LEVEL_TERMS), False,
        )  # fmt: skip
        found = len(points)
        if tried < _MIN_TRIED_SHARE * normals or found < max(_MIN_FOUND_SHARE * tried, given.min_points):
            return False, points, ratio, motion, tried, chart, minor, rms, kept, arc
        ok, fitted, cov, _, _, rms, kept, arc, _ = ellipse_kernel.fit(
            points, ratio, motion, given.brightness_sigma, 0.0, no_sun, chart, given.min_scatter_px,
            given.max_gap_rad, 0.0,
        )  # fmt: skip
        if not ok or np.sqrt(max(cov[2, 2], cov[4, 4])) > given.max_sigma_share:
            return False, points, ratio, motion, tried, chart, minor, rms, kept, arc
        if kept < given.min_points or arc < given.min_arc_share:
            return False, points, ratio, motion, tried, chart, minor, rms, kept, arc
        chart = fitted
    sxx, sxy, syy = moments_kernel(chart[2], chart[3], chart[4])
    _, minor = semi_axes_kernel(sxx, sxy, syy, np.exp(chart[2] + chart[4]))
    radius = np.exp(0.5 * (start_px[2] + start_px[4]))
    moved = np.hypot(chart[0] - start_px[0], chart[1] - start_px[1])
    near = minor >= _MIN_MINOR_RADII * radius and moved <= _MAX_SHIFT_RADII * radius
    return near, points, ratio, motion, tried, chart, minor, rms, kept, arc
