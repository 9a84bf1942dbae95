"""A family of cross-sections of craters, and how far outside of their crests their blurred edges lie.

Its members are those of `crater_profile` with other exponents and sizes,

    bowl = -depth + (depth + rim) rho^wall,  apron = rim rho^-flank,

from straight walls to walls far steeper at the crest than at the floor, from low and wide flanks to high
and steep ones, and from crests that are round over a sixth of the radius to sharp ones. Each shows its edge
as an image would: the crossing of the flat ground's brightness under two blurs, its steepness, and the means
over wall and flank beside it. From these `crest_sharpness` is to tell where the crest is; how well it does
over the family is the uncertainty of the size that it leaves.
"""

from functools import cache
from itertools import product

import numpy as np

from craternav_fg.vision import crater_profile, edge_kernel
from craternav_fg.vision.crest_sharpness import (
    FIRST_RADIUS_PX,
    LAST_RADIUS_PX,
    displacement_over_growth,
    gaussian_fall,
)
from factors.arrays import FloatArray

# Exponents of walls and flanks, heights of rims and roundings of crests, in radii; one crest is a kink.
_WALLS, _FLANKS, _RIMS = (1.0, 2.0, 3.5), (2.0, 3.0, 4.5), (0.03, 0.06, 0.1)
_ROUNDINGS, _KINK = (0.0025, 0.005, 0.01, 0.02, 0.04, 0.08), 0.001
_ROWS = 8
# Samples of the cross-sections, in radii.
_STEP = 0.004
_RHO = np.arange(0.2, 2.2, _STEP)
_BORDER = 200


@cache
def crest_table(psf_px: float, smoothing_px: float, smoothing_share: float) -> FloatArray:
    """Compute what the edge of a rim says about its crest, over the family.

    Parameters
    ----------
    psf_px : float
        Standard deviation of the point-spread function.
    smoothing_px, smoothing_share : float
        See `edges.EdgeOptions`.

    Returns
    -------
    ndarray, shape (8, 7)
        A row for each radius of the rim. Columns: mean fall of the edge of a kink, over that of a blurred
        step; f of `crest_sharpness` for the canonical crater; square of the second blur over the first; how
        much of the relative excess of f over the canonical crater's the displacement has, and the scatter of
        this excess over the family; scatter of the displacement that is left, over the blur: that of round
        crests, and per excess.
    """
    slopes, kinks = _family()
    table = np.array([
        _row(slopes, kinks, radius_px, psf_px, max(smoothing_px, smoothing_share * radius_px))
        for radius_px in np.geomspace(FIRST_RADIUS_PX, LAST_RADIUS_PX, _ROWS)
    ])  # fmt: skip
    table.flags.writeable = False
    return table


@cache
def _family() -> tuple[FloatArray, int]:
    """Slopes (n, k) of the members, the canonical crater first and kinks last, and the number of kinks."""
    shapes = list(product(_WALLS, _FLANKS, _RIMS))
    members = [(*shape, rounding) for rounding in _ROUNDINGS for shape in shapes]
    members += [(*shape, _KINK) for shape in shapes]
    slopes = [crater_profile.slopes(_RHO)]
    fine = np.arange(_RHO[0] - 0.05, _RHO[-1] + 0.3, 0.25 * _STEP)
    depth = crater_profile.BOWL_DEPTH_RADII
    for wall, flank, rim, rounding in members:
        bowl, apron = -depth + (depth + rim) * fine**wall, rim * fine**-flank
        share = 1.0 / (1.0 + np.exp(np.clip((bowl - apron) / rounding, -60.0, 60.0)))
        slope = share * wall * (depth + rim) * fine ** (wall - 1.0)
        slope -= (1.0 - share) * flank * rim * fine ** (-flank - 1.0)
        crest = _crossings(slope[None], fine)[0][0]
        slopes.append(np.interp(_RHO, fine / crest, slope))
    return np.array(slopes), len(shapes)


def _row(slopes: FloatArray, kinks: int, radius_px: float, psf_px: float, smoothing_px: float) -> list[float]:
    """One row of the table."""
    fixed2 = psf_px**2 + edge_kernel.PIXEL_VARIANCE_PX2
    blur = float(np.sqrt(smoothing_px**2 + fixed2)) / radius_px
    wide = float(np.hypot(edge_kernel.SECOND_SMOOTHING_FACTOR * smoothing_px, np.sqrt(fixed2))) / radius_px
    place, fall = _crossings(_blurred(slopes, blur), _RHO)
    growth = _crossings(_blurred(slopes, wide), _RHO)[0] - place
    side = max(edge_kernel.MIN_SIDE_PX / radius_px, edge_kernel.SIDE_SHARE)
    seen = _blurred(slopes, float(np.sqrt(fixed2)) / radius_px)
    inner, outer = _means(seen, place - blur - side, side), _means(seen, place + blur, side)
    flank = -outer / (inner - outer)
    kink = np.array([gaussian_fall(p) for p in flank])
    steepness = fall * blur / (inner - outer) / kink
    of_kinks = steepness[-kinks:]
    growth2 = (wide / blur) ** 2
    ratio = np.array([displacement_over_growth(r, growth2) for r in steepness / of_kinks.mean()])
    excess = ratio / ratio[0] - 1.0
    # The displacement over its growth, and what the excess explains of it.
    share = (place - 1.0) / growth
    one = slice(1, -kinks)
    found = (share / share[0] - 1.0)[one]
    weight = growth[one] ** 2
    gain = np.sum(weight * excess[one] * found) / np.sum(weight * excess[one] ** 2)
    left2 = ((found - gain * excess[one]) * share[0] * growth[one] / blur) ** 2
    is_round = excess[one] <= 0.0
    at_round = np.mean(left2[is_round]) if is_round.any() else 0.0
    sharp2 = excess[one][~is_round] ** 2
    per_excess = np.sum(np.maximum(left2[~is_round] - at_round, 0.0)) / max(np.sum(sharp2), 1e-12)
    return [
        float(of_kinks.mean()), float(ratio[0]), growth2, float(gain),
        float(np.sqrt(np.mean(excess[one] ** 2))), float(np.sqrt(at_round)), float(np.sqrt(per_excess)),
    ]  # fmt: skip


def _blurred(slopes: FloatArray, sigma: float) -> FloatArray:
    """Cross-sections (n, k) after Gaussian blur; `sigma` is in radii."""
    padded = np.pad(slopes, ((0, 0), (_BORDER, _BORDER)), mode="edge")
    frequency = np.fft.rfftfreq(padded.shape[1], _STEP)
    spectrum = np.fft.rfft(padded, axis=1) * np.exp(-2.0 * (np.pi * sigma * frequency) ** 2)
    return np.asarray(np.fft.irfft(spectrum, padded.shape[1], axis=1)[:, _BORDER:-_BORDER])


def _crossings(slopes: FloatArray, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Falls through zero (n,) nearest the crest, and how steep they are."""
    down = (slopes[:, :-1] > 0.0) & (slopes[:, 1:] <= 0.0)
    i = np.argmin(np.where(down, np.abs(rho[:-1] - 1.0), np.inf), axis=1)
    rows, step = np.arange(len(slopes)), rho[1] - rho[0]
    here, after = slopes[rows, i], slopes[rows, i + 1]
    return rho[i] + step * here / (here - after), (here - after) / step


def _means(slopes: FloatArray, first: FloatArray, length: float) -> FloatArray:
    """Means (n,) of cross-sections (n, k) from radii (n,) over a length."""
    sums = np.pad(np.cumsum(slopes, axis=1), ((0, 0), (1, 0))) * _STEP
    ends = np.stack([first, first + length]) / _STEP - (_RHO[0] / _STEP - 0.5)
    ends = np.clip(ends, 0.0, slopes.shape[1] - 1e-6)
    i = ends.astype(np.int64)
    rows = np.arange(len(slopes))
    low, high = sums[rows, i] + (ends - i) * (sums[rows, i + 1] - sums[rows, i])
    return np.asarray((high - low) / length)
