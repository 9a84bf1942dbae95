"""Flanks of one rim: views and brightness along its normals, compiled; see `edge_kernel`, `reflectance`."""

import numpy as np

from craternav_fg.vision.crest_tables import CrestTables, crossing_parts, flank_terms, of_lambertian, turning
from craternav_fg.vision.ground_level import steepness_of_flanks
from craternav_fg.vision.image_sampling import SATURATED_BRIGHTNESS
from craternav_fg.vision.normal_profile import (
    flank_samples,
    mean_between,
    sample_normal,
    sample_step,
    smoothing_px_at,
)
from craternav_fg.vision.rim_geometry import distorts, rim_point, through_lens
from craternav_fg.vision.rim_shading import (
    NormalView,
    RimLight,
    RimShading,
    normal_view,
    reference_along,
    rim_light,
)
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Normals per pixel of radius, and their range: one every three pixels along the rim of a
# mid-sized crater.
_NORMALS_PER_PX = 2.0
_MIN_NORMALS, _MAX_NORMALS = 56, 160
# Range of the steepness over the canonical crater's: of less, the step between the flanks tells nothing.
LEAST_STEEPNESS, MOST_STEEPNESS = 0.2, 2.5
# Rounds in which the steepness is found of flanks whose slopes bend the brightness.
ROUNDS = 2
# Terms of a normal that are kept: its view and its radius.
NORMAL_TERMS = 9


@njit(cache=True, error_model="numpy")
def normal_count(radius_px: float) -> int:
    """Return the number of normals around a rim.

    Parameters
    ----------
    radius_px : float
        Size of the rim.
    """
    return int(min(max(_NORMALS_PER_PX * radius_px, _MIN_NORMALS), _MAX_NORMALS))


@njit(cache=True, error_model="numpy")
def keep(view: NormalView, radius_px: float, out: FloatArray) -> None:
    """Write a view and the radius along its normal to an array.

    Parameters
    ----------
    view : NormalView
    radius_px : float
    out : ndarray, shape (9,)
        Written.
    """
    out[0], out[1], out[2], out[3] = view.cosine, view.sine, view.contrast, view.along
    out[4], out[5], out[6], out[7] = view.curvature, view.lift, view.lift_along, view.lean
    out[8] = radius_px


@njit(cache=True, error_model="numpy")
def kept(row: FloatArray) -> NormalView:
    """Return the view of an array.

    Parameters
    ----------
    row : ndarray, shape (9,)
        See `keep`.
    """
    return NormalView(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7])


@njit(cache=True, error_model="numpy")
def flanks_of_steepness(
    tables: CrestTables, light: RimLight, normals: FloatArray, flanks: FloatArray, slopes: FloatArray,
    bends: FloatArray, rounds: int,
) -> float:  # fmt: skip
    """Compute what flanks (n, 2) show whose step is that which is seen, see `flank_terms`.

    Parameters
    ----------
    tables : CrestTables
    light : RimLight
    normals : ndarray, shape (n, 9)
        See `keep`.
    flanks : ndarray, shape (n, 2)
        Brightness of the inner and the outer flank over the reference, minus 1.
    slopes, bends : ndarray, shape (n, 2)
        Written, see `ground_level.levels_of_flanks`.
    rounds : int
        In the first of them the steepness is the canonical crater's.

    Returns
    -------
    float
        Steepness, over the canonical crater's.
    """
    count = len(normals)
    contrasts = normals[:, 2]
    steepness, step = 1.0, 1.0
    for _ in range(rounds):
        steepness = min(max(steepness * step, LEAST_STEEPNESS), MOST_STEEPNESS)
        for i in range(count):
            flank_terms(tables, light, kept(normals[i]), normals[i, 8], steepness, slopes[i], bends[i])
        step = steepness_of_flanks(flanks, contrasts, slopes[:count], bends[:count])
    return steepness * step


@njit(cache=True, error_model="numpy")
def sample_flanks(
    image: ImageArray, chart_px: FloatArray, shading: RimShading, smoothing_share: float, smoothing_px: float,
    psf_px: float, count: int, tables: CrestTables, lens: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Sample the brightness of the flanks of a known crest, all around the rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    chart_px : ndarray, shape (5,)
        Fitted rim, chart in pixels of the camera without distortion.
    shading : RimShading
    smoothing_share, smoothing_px, psf_px : float
        As in `trace_rim`, as the next two.
    count : int
    tables : CrestTables
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.

    Returns
    -------
    angles : ndarray, shape (n,)
        Affine angles of the normals that lie in the image.
    flanks : ndarray, shape (n, 2)
        Brightness of the inner and the outer flank over the reference, minus 1.
    normals : ndarray, shape (n, 9)
        See `keep`.
    """
    angles, flanks = np.empty(count), np.empty((count, 2))
    normals = np.empty((count, NORMAL_TERMS))
    q = np.empty(6)
    bent = distorts(lens)
    light = rim_light(chart_px, shading)
    samples = np.empty(0)
    found = 0
    for k in range(count):
        angle = 2.0 * np.pi * (k + 0.5) / count
        rim_point(chart_px, angle, q)
        view = normal_view(chart_px, light, shading.curvature_px, angle, q)
        local = shading.reference * reference_along(shading.gradient, chart_px, q)
        if bent:
            through_lens(q, lens)
        h = q[4]
        step = sample_step(h)
        smooth = smoothing_px_at(h, smoothing_px, smoothing_share)
        gap, n_side = flank_samples(h, step, smooth, psf_px)
        blur = np.sqrt(smooth * smooth + psf_px * psf_px) / h
        parts = crossing_parts(tables, of_lambertian(view), view.lift, blur, 1.0, light.lommel_share)
        shift = h * (parts[0] + parts[1] + parts[2] + turning(view, blur)) / step
        half = gap + n_side + int(np.abs(shift)) + 2
        if 2 * half + 1 > len(samples):
            samples = np.empty(4 * half)
        raw = samples[: 2 * half + 1]
        if not sample_normal(image, q, step, raw):
            continue
        middle = int(half + shift)
        inner = mean_between(raw, middle - gap - n_side + 1, middle - gap + 1)
        outer = mean_between(raw, middle + 1 + gap, middle + 1 + gap + n_side)
        if np.isnan(inner + outer) or max(inner, outer) > SATURATED_BRIGHTNESS:
            continue
        angles[found] = angle
        flanks[found, 0], flanks[found, 1] = inner / local - 1.0, outer / local - 1.0
        keep(view, h, normals[found])
        found += 1
    return angles[:found], flanks[:found], normals[:found]


@njit(cache=True, error_model="numpy")
def flanks_around(
    image: ImageArray, chart_px: FloatArray, shading: RimShading, smoothing_share: float, smoothing_px: float,
    psf_px: float, count: int, tables: CrestTables, lens: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Sample the flanks of a known crest, and compute what slopes of its steepness show there.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    chart_px : ndarray, shape (5,)
    shading : RimShading
    smoothing_share, smoothing_px, psf_px : float
    count : int
    tables : CrestTables
    lens : ndarray, shape (14,)
        As of `sample_flanks`, all of them.

    Returns
    -------
    angles : ndarray, shape (n,)
        Affine angles of the normals that lie in the image.
    flanks, contrasts, slopes, bends : ndarray, shapes (n, 2), (n,), (n, 2), (n, 2)
        See `ground_level.levels_of_flanks`.
    """
    angles, flanks, normals = sample_flanks(
        image, chart_px, shading, smoothing_share, smoothing_px, psf_px, count, tables, lens
    )
    slopes, bends = np.empty((len(angles), 2)), np.empty((len(angles), 2))
    light = rim_light(chart_px, shading)
    flanks_of_steepness(tables, light, normals, flanks, slopes, bends, ROUNDS)
    return angles, flanks, normals[:, 2].copy(), slopes, bends
