"""What the canonical crater's rim crest shows across the rim: tables, and what is read from them; compiled.

Around the rim, the crest differs in the slope contrast across it, and in oblique views in its lift: how far
outward higher ground appears. Both change where its blurred brightness crosses that of flat terrain, and the
brightness of its flanks: the inner wall is stretched on the far side of the rim, and foreshortened and
hidden on the near side. Where the normal in the image leans along the rim, or heights are lifted along it,
the slope turns along the normal as well.

The crossing is that of ground of the two terms of the photometric law at which both orders of the slope have
the ratio that they have. With this ratio k, the excess of the Lommel-Seeliger term over that of flat terrain
is in proportion to s / (1 - k s), exactly. The flanks are steep: their brightness is that of the law.
"""

from functools import cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from craternav_fg.vision import crater_profile as canonical
from craternav_fg.vision.normal_profile import flank_samples, sample_step, smoothing_px_at
from craternav_fg.vision.rim_shading import NormalView, RimLight, relative_brightness
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Grids of the tables: standard deviation of the blur, in radii, slope contrast across the rim, lift, and the
# reciprocal of the radius along the normal, 1/px.
BLUR_RADII = np.linspace(0.0, 0.24, 25)
SLOPE_CONTRASTS = np.linspace(-4.0, 4.0, 17)
LIFTS = np.linspace(-2.4, 2.4, 25)
# Grid of the ratio of the second order of the slope to the first on Lommel-Seeliger ground, and the least of
# the denominator there: beyond, the ground is hardly seen.
_RATIOS = np.linspace(-2.0, 2.0, 33)
_LEAST_DENOMINATOR = 0.15
_INVERSE_RADII_PX = np.linspace(0.005, 0.245, 13)
# Contrast that stands for the limit at zero, and that of a crossing as others are.
_VANISHING_CONTRAST, _COMMON_CONTRAST = 1e-3, 1.0
# Least blur of a flank, in radii: without any, its ends are sharp.
_LEAST_BLUR = 1e-6
# Points that stand for the blurred ground of a flank.
_NODES = 10
# Slope contrasts of a rim between which its flanks go from those of the photometric law to its second
# order of the slope: in the shadow, how dark a wall is says nothing of how steep it is.
_FIRST_SHADOWS, _ALL_SHADOWS = 2.5, 6.5
# Largest ratio of the contrast along the rim to that across it that counts for the crossing: beyond, edges
# have little weight.
_MOST_ALONG = 3.0


class CrestTables(NamedTuple):
    """Tables of the canonical rim crest, on regular grids.

    Attributes
    ----------
    blurs : ndarray, shape (b,)
        Grid: standard deviation of the blur, in radii.
    contrasts : ndarray, shape (c,)
        Grid: slope contrast across the rim of Lambertian ground.
    lifts : ndarray, shape (l,)
        Grid: outward displacement in the image, in radii, of ground that is higher by a radius.
    inverse_radii_px : ndarray, shape (r,)
        Grid: reciprocal of the radius along the normal, 1/px.
    crossings : ndarray, shape (b, c, l)
        Outward displacement of the crossing from the image of the crest, in radii.
    ratios : ndarray, shape (k,)
        Grid: second order of the slope over the first, of Lommel-Seeliger ground.
    lommel_crossings, lommel_falls : ndarray, shape (b, k)
        There, seen from above: displacement of the crossing as above, and fall at the crossing over that of
        the blurred slope.
    falls : ndarray, shape (b,)
        Fall of the blurred slope at its crossing, seen from above, 1/radii.
    flanks : ndarray, shape (r, l, 2, 10, 3)
        Ground, equally likely, of the image of the inner wall and of the outer slope: outward distance from
        the crest and height over it, in radii, and slope.
    """

    blurs: FloatArray
    contrasts: FloatArray
    lifts: FloatArray
    inverse_radii_px: FloatArray
    crossings: FloatArray
    ratios: FloatArray
    lommel_crossings: FloatArray
    lommel_falls: FloatArray
    falls: FloatArray
    flanks: FloatArray


@cache
def crest_tables(psf_px: float, smoothing_px: float, smoothing_share: float) -> CrestTables:
    """Compute the tables for images of a camera.

    Parameters
    ----------
    psf_px : float
        Standard deviation of the point-spread function.
    smoothing_px, smoothing_share : float
        See `edges.EdgeOptions`.

    Returns
    -------
    CrestTables
    """
    crossings = _crossing_table()
    high, low = (int(np.argmin(np.abs(SLOPE_CONTRASTS - c))) for c in (_COMMON_CONTRAST, -_COMMON_CONTRAST))
    common = 0.5 * (crossings[:, high] + crossings[:, low])
    flanks = np.empty((len(_INVERSE_RADII_PX), len(LIFTS), 2, _NODES, 3))
    for i, radius_px in enumerate((1.0 / _INVERSE_RADII_PX).tolist()):
        step = sample_step(radius_px)
        smooth = smoothing_px_at(radius_px, smoothing_px, smoothing_share)
        gap, side = (n * step / radius_px for n in flank_samples(radius_px, step, smooth, psf_px))
        nodes = _nodes(side, psf_px / radius_px)
        for k, lift in enumerate(LIFTS.tolist()):
            place = 1.0 + np.interp(np.hypot(smooth, psf_px) / radius_px, BLUR_RADII, common[:, k])
            distance, height, slope = canonical.seen_ground(lift)
            for j, begin in enumerate((place - gap - side, place + gap)):
                at = begin + nodes
                flanks[i, k, j, :, 0] = np.interp(at, canonical.IMAGE_RADII, distance) - 1.0
                flanks[i, k, j, :, 1] = np.interp(at, canonical.IMAGE_RADII, height)
                flanks[i, k, j, :, 2] = np.interp(at, canonical.IMAGE_RADII, slope)
    flanks.flags.writeable = False
    return CrestTables(
        BLUR_RADII, SLOPE_CONTRASTS, LIFTS, _INVERSE_RADII_PX, crossings, _RATIOS, *_lommel_tables(),
        _fall_table(), flanks,
    )  # fmt: skip


def _nodes(length: float, blur: float) -> FloatArray:
    """Equally likely places (10,) of light that falls, blurred, on a length."""
    blur = max(blur, _LEAST_BLUR)
    x = np.linspace(-4.0 * blur, length + 4.0 * blur, 400)
    cumulated = np.cumsum([NormalDist().cdf(a / blur) - NormalDist().cdf((a - length) / blur) for a in x])
    share = (np.arange(_NODES) + 0.5) / _NODES
    return np.interp(share, (cumulated - 0.5 * cumulated[0]) / cumulated[-1], x)


@cache
def _crossing_table() -> FloatArray:
    table = np.zeros((len(BLUR_RADII), len(SLOPE_CONTRASTS), len(LIFTS)))
    for k, lift in enumerate(LIFTS.tolist()):
        _, _, slope = canonical.seen_ground(lift)
        for j, grid_contrast in enumerate(SLOPE_CONTRASTS.tolist()):
            # The sign of a vanishing contrast does not matter, its limit does.
            contrast = grid_contrast if grid_contrast != 0.0 else _VANISHING_CONTRAST
            excess = canonical.excess_brightness(slope, contrast)
            place = 1.0
            for i, profile in enumerate(np.sign(contrast) * canonical.blurred(excess, BLUR_RADII)):
                place = canonical.crossing(profile, place)
                table[i, j, k] = place - 1.0
    # At zero contrast the square of the slope is all there is: take the mean of the neighbours.
    middle = len(SLOPE_CONTRASTS) // 2
    table[:, middle] = 0.5 * (table[:, middle - 1] + table[:, middle + 1])
    table.flags.writeable = False
    return table


@cache
def _lommel_tables() -> tuple[FloatArray, FloatArray]:
    crossings, falls = np.empty((2, len(BLUR_RADII), len(_RATIOS)))
    _, _, slope = canonical.seen_ground(0.0)
    for j, ratio in enumerate(_RATIOS.tolist()):
        excess = slope / np.maximum(1.0 - ratio * slope, _LEAST_DENOMINATOR)
        places, falls[:, j] = _crossings_of(excess)
        crossings[:, j] = places - 1.0
    falls /= _fall_table()[:, None]
    crossings.flags.writeable = falls.flags.writeable = False
    return crossings, falls


@cache
def _fall_table() -> FloatArray:
    _, falls = _crossings_of(canonical.seen_ground(0.0)[2])
    falls.flags.writeable = False
    return falls


def _crossings_of(profile: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (b,) of the crossing of a profile with more and more blur, and falls (b,) there, in radii."""
    places, falls = np.empty((2, len(BLUR_RADII)))
    place = 1.0
    for i, one in enumerate(canonical.blurred(profile, BLUR_RADII)):
        places[i] = place = canonical.crossing(one, place)
        falls[i] = -np.interp(place, canonical.IMAGE_RADII, np.gradient(one, canonical.STEP_RADII))
    return places, falls


@njit(cache=True, error_model="numpy")
def of_lambertian(view: NormalView) -> float:
    """Return the slope contrast at which Lambertian ground has the same ratio of both orders of the slope.

    Parameters
    ----------
    view : NormalView
    """
    return -0.5 * view.contrast / view.curvature


@njit(cache=True, error_model="numpy")
def crossing_parts(
    tables: CrestTables, contrast: float, lift: float, blur: float, steepness: float, lommel_share: float
) -> tuple[float, float, float]:
    """Compute the outward displacement of a crossing, in parts.

    The crater is the canonical one with all heights times the steepness: what the second order of the slope
    does relative to the first, and how far heights are displaced, is larger by as much, and what the third
    order does by its square.

    Parameters
    ----------
    tables : CrestTables
    contrast : float
        Slope contrast of Lambertian ground, see `of_lambertian`.
    lift : float
        Outward displacement in the image, in radii, of ground that is higher by a radius.
    blur : float
        Standard deviation, in radii.
    steepness : float
        Over the canonical crater's.
    lommel_share : float
        Share L of the Lommel-Seeliger term, see `photometry`.

    Returns
    -------
    odd : float
        In radii: what the asymmetry of the crest does, whichever side is bright and wherever the camera is.
    bent : float
        What the second order of the slope does: also in proportion to how narrow the crest is.
    lifted : float
        What the lift does.
    """
    above, below = _between(tables, blur, contrast, 0.0), _between(tables, blur, -contrast, 0.0)
    lifted = steepness * (_between(tables, blur, contrast, lift) - above)
    # Of steeper slopes one is in the shadow before the brightness of the other bends any more.
    bends = min(steepness, max(_FIRST_SHADOWS / np.abs(contrast), 1.0))
    ratio = -0.5 * steepness / contrast
    rising, falling = _lommel(tables, blur, ratio), _lommel(tables, blur, -ratio)
    # Without any order of the slope but the first, the crossing is that of the blurred slope.
    linear = _lommel(tables, blur, 0.0)
    odd = linear + steepness * steepness * (0.5 * (above + below) - linear)
    return (
        0.5 * lommel_share * (rising + falling) + (1.0 - lommel_share) * odd,
        0.5 * lommel_share * (rising - falling) + 0.5 * (1.0 - lommel_share) * bends * (above - below),
        lifted,
    )


@njit(cache=True, error_model="numpy")
def turning(view: NormalView, blur: float) -> float:
    """Compute the outward displacement of a crossing where the contrast changes along the normal, in radii.

    Parameters
    ----------
    view : NormalView
    blur : float
        Standard deviation, in radii.
    """
    along = min(max(view.along / view.contrast, -_MOST_ALONG), _MOST_ALONG)
    return -along * view.lean * blur * blur


@njit(cache=True, error_model="numpy")
def expected_fall(
    tables: CrestTables, contrast: float, blur: float, steepness: float, lommel_share: float
) -> float:
    """Compute the canonical crater's fall of the brightness at the crossing over the slope contrast, 1/radii.

    On Lambertian ground it is the fall of the slope within a few per cent.

    Parameters
    ----------
    tables : CrestTables
    contrast, blur, steepness, lommel_share : float
        As in `crossing_parts`. The fall is that of a crater as steep as the canonical one, on ground whose
        orders of the slope have the ratio that they have for the steepness.
    """
    i, u = _cell(tables.blurs, blur)
    k, w = _cell(tables.ratios, -0.5 * steepness / contrast)
    of_law = 1.0 + lommel_share * (_bilinear(tables.lommel_falls, i, k, u, w) - 1.0)
    return of_law * ((1.0 - u) * tables.falls[i] + u * tables.falls[i + 1])


@njit(cache=True, error_model="numpy")
def flank_terms(
    tables: CrestTables, light: RimLight, view: NormalView, radius_px: float, steepness: float,
    slopes: FloatArray, bends: FloatArray,
) -> None:  # fmt: skip
    """Compute what the flanks of a crater show that is the canonical one, all heights times the steepness.

    Parameters
    ----------
    tables : CrestTables
    light : RimLight
    view : NormalView
    radius_px : float
        Radius along the normal.
    steepness : float
    slopes, bends : ndarray, shape (2,)
        Written, of the inner wall and of the outer slope: mean slope as seen from above, and relative
        brightness, less 1, beyond the contrast times that slope.
    """
    i, u = _cell(tables.inverse_radii_px, 1.0 / radius_px)
    above, none = _cell(tables.lifts, 0.0)
    k, w = _cell(tables.lifts, steepness * view.lift)
    strength = np.hypot(light.contrast[0], light.contrast[1])
    lit = min(max((_ALL_SHADOWS - strength) / (_ALL_SHADOWS - _FIRST_SHADOWS), 0.0), 1.0)
    for side in range(2):
        excess, slope, square = 0.0, 0.0, 0.0
        for node in range(_NODES):
            table = tables.flanks[:, :, side, node]
            square += (steepness * _bilinear(table[:, :, 2], i, above, u, none)) ** 2
            slope += steepness * _bilinear(table[:, :, 2], i, above, u, none)
            distance = _bilinear(table[:, :, 0], i, k, u, w)
            height = steepness * _bilinear(table[:, :, 1], i, k, u, w)
            turn = view.lean * distance - view.lift_along * height
            seen = steepness * _bilinear(table[:, :, 2], i, k, u, w)
            excess += relative_brightness(light, view, turn, seen) - 1.0
        slopes[side] = slope / _NODES
        of_law = excess / _NODES - view.contrast * slopes[side]
        bends[side] = lit * of_law + (1.0 - lit) * view.curvature * square / _NODES


@njit(cache=True, error_model="numpy")
def flank_means(tables: CrestTables, view: NormalView, radius_px: float, out: FloatArray) -> None:
    """Compute the mean ground of the canonical crater's flanks.

    Parameters
    ----------
    tables : CrestTables
    view : NormalView
    radius_px : float
        Radius along the normal.
    out : ndarray, shape (2, 2)
        Written, of the inner wall and of the outer slope: angle along the rim, rad, and slope.
    """
    i, u = _cell(tables.inverse_radii_px, 1.0 / radius_px)
    k, w = _cell(tables.lifts, view.lift)
    for side in range(2):
        distance, height, slope = 0.0, 0.0, 0.0
        for node in range(_NODES):
            table = tables.flanks[:, :, side, node]
            distance += _bilinear(table[:, :, 0], i, k, u, w)
            height += _bilinear(table[:, :, 1], i, k, u, w)
            slope += _bilinear(table[:, :, 2], i, k, u, w)
        out[side, 0] = (view.lean * distance - view.lift_along * height) / _NODES
        out[side, 1] = slope / _NODES


@njit(cache=True, error_model="numpy")
def _between(tables: CrestTables, blur: float, contrast: float, lift: float) -> float:
    """Displacement of the crossing, in radii, trilinear; constant beyond the ends of the grids."""
    i, u = _cell(tables.blurs, blur)
    j, v = _cell(tables.contrasts, contrast)
    k, w = _cell(tables.lifts, lift)
    table = tables.crossings
    return (1.0 - u) * _bilinear(table[i], j, k, v, w) + u * _bilinear(table[i + 1], j, k, v, w)


@njit(cache=True, error_model="numpy")
def _lommel(tables: CrestTables, blur: float, ratio: float) -> float:
    """Displacement of the crossing on Lommel-Seeliger ground, in radii; constant beyond the ends."""
    i, u = _cell(tables.blurs, blur)
    k, w = _cell(tables.ratios, ratio)
    return _bilinear(tables.lommel_crossings, i, k, u, w)


@njit(cache=True, error_model="numpy")
def _cell(grid: FloatArray, value: float) -> tuple[int, float]:
    """Cell of a regular grid (n,) and the place in it, 0 to 1; at its ends beyond them."""
    x = min(max((value - grid[0]) / (grid[1] - grid[0]), 0.0), len(grid) - 1.0)
    i = min(int(x), len(grid) - 2)
    return i, x - i


@njit(cache=True, error_model="numpy")
def _bilinear(table: FloatArray, j: int, k: int, v: float, w: float) -> float:
    """Value of a table (m, n) in a cell."""
    near = (1.0 - w) * table[j, k] + w * table[j, k + 1]
    far = (1.0 - w) * table[j + 1, k] + w * table[j + 1, k + 1]
    return (1.0 - v) * near + v * far
