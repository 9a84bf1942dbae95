"""How sharp the crest of a rim is, as its edge shows it, and how far outside of the crest that edge lies.

The blurred rim is as bright as flat ground outside of the crest. How far depends on the crest: the distance
grows with the square of the blur where the crest is round, in proportion to it where the crest is sharp. A
second smoothing shows how it grows (see `edge_kernel`), but not which of the two it is. The steepness of the
edge does. Where wall and flank meet in an edge that is blurred to a Gaussian of width W, the fall of the
brightness over the step from wall to flank is that of this Gaussian. The known blur sigma = r W is a part of
the width, and the crest's own width is the rest. The crossing lies z W outside of the place where wall and
flank meet, and the crest z times its own width. So the displacement is, over its growth up to a blur g sigma,

    f(r) = (1 - sqrt(1 - r^2)) / (sqrt(1 + (g^2 - 1) r^2) - 1).

Walls and flanks are curved, so this holds up to constants, and up to an uncertainty: see `crest_family`.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Radii, px, of the first and the last row of a table of the family; between them they are evenly spaced in
# their logarithm. Columns of the table, see `crest_family.crest_table`.
FIRST_RADIUS_PX, LAST_RADIUS_PX = 6.0, 150.0
(
    FALL, CANONICAL_RATIO, GROWTH_SQUARED, GAIN, GAIN_SCATTER, SCATTER_ROUND, SCATTER_SHARP
) = range(7)  # fmt: skip
# Sectors of the rim, each of which is left out once to see how well the edge shows the crest.
_SECTORS, _MIN_SECTORS = 8, 4
# Least share of the blur in the edge's width that is told from a smaller one, and limits of the flank's share
# of the step.
_LEAST_RATIO, _LEAST_FLANK, _LARGEST_FLANK = 0.2, 0.02, 0.5


@njit(cache=True, error_model="numpy")
def gaussian_fall(flank: float) -> float:
    """Return the fall of a blurred step where it has come down to a share of the step.

    Parameters
    ----------
    flank : float
        The share that is left, 0 to 1/2.

    Returns
    -------
    float
        Over the step, per width of the blur: the density of a normal distribution at this probability, within
        2 % from 0.05 on.
    """
    p = min(max(flank, _LEAST_FLANK), _LARGEST_FLANK)
    return float((4.0 * p * (1.0 - p)) ** 0.8 / np.sqrt(2.0 * np.pi))


@njit(cache=True, error_model="numpy")
def displacement_over_growth(ratio: float, growth_squared: float) -> float:
    """Return the displacement of a crossing over its growth under more blur: f of the module's description.

    Parameters
    ----------
    ratio : float
        The blur over the width of the edge, not above 1.
    growth_squared : float
        Square of the second blur over the first.
    """
    r2 = min(max(ratio, _LEAST_RATIO), 1.0) ** 2
    return float((1.0 - np.sqrt(1.0 - r2)) / (np.sqrt(1.0 + (growth_squared - 1.0) * r2) - 1.0))


@njit(cache=True, error_model="numpy")
def crest_displacement(
    angles: FloatArray, contrasts: FloatArray, falls: FloatArray, flanks: FloatArray, widths_px: FloatArray,
    radius_px: float, table: FloatArray,
) -> tuple[float, float, float]:  # fmt: skip
    """Compare how far outside of the crest a rim's edge lies with the canonical crater.

    Parameters
    ----------
    angles, contrasts : ndarray, shape (n,)
        Affine angles of the points along the rim, rad, and slope contrasts across it.
    falls : ndarray, shape (n,)
        Fall of the relative brightness outwards, per px.
    flanks : ndarray, shape (n, 2)
        See `ground_level.levels_of_flanks`.
    widths_px : ndarray, shape (n,)
        Standard deviations of the known blur.
    radius_px : float
        Radius of the rim.
    table : ndarray, shape (m, 7)
        See `crest_family.crest_table`.

    Returns
    -------
    factor, factor_sigma : float
        Displacement over that of a canonical crater with the same growth, and its standard deviation.
    family_sigma_px : float
        What the crests of the family that look alike differ in.
    """
    place = np.log(max(radius_px, FIRST_RADIUS_PX) / FIRST_RADIUS_PX)
    place = min(place / np.log(LAST_RADIUS_PX / FIRST_RADIUS_PX), 1.0) * (len(table) - 1)
    i = min(int(place), len(table) - 2)
    row = (1.0 - (place - i)) * table[i] + (place - i) * table[i + 1]
    sums, sectors = np.zeros((_SECTORS, 3)), np.zeros(_SECTORS, np.bool_)
    for j in range(len(angles)):
        s = int(angles[j] / (2.0 * np.pi) * _SECTORS) % _SECTORS
        sectors[s] = True
        sums[s, 0] += contrasts[j] * falls[j] * widths_px[j]
        sums[s, 1] += contrasts[j] * flanks[j, 0]
        sums[s, 2] += contrasts[j] * flanks[j, 1]
    whole = np.array([sums[:, 0].sum(), sums[:, 1].sum(), sums[:, 2].sum()])
    ratio, others, k = _width_ratio(whole, row[FALL]), np.empty(_SECTORS), 0
    for s in range(_SECTORS):
        if sectors[s]:
            others[k] = _width_ratio(whole - sums[s], row[FALL])
            k += 1
    mean_width = np.mean(widths_px)
    if k < _MIN_SECTORS or not np.isfinite(ratio + np.sum(others[:k])):
        return 1.0, row[GAIN] * row[GAIN_SCATTER], row[SCATTER_SHARP] * mean_width
    variance = (k - 1.0) * np.var(others[:k])
    # The ratio is uncertain, and f is steep where it reaches 1: both ends of it tell more than the middle.
    above = displacement_over_growth(ratio + np.sqrt(variance), row[GROWTH_SQUARED]) / row[CANONICAL_RATIO]
    below = displacement_over_growth(ratio - np.sqrt(variance), row[GROWTH_SQUARED]) / row[CANONICAL_RATIO]
    excess, excess2 = 0.5 * (above + below) - 1.0, 0.25 * (above - below) ** 2
    believed = max(1.0 - excess2 / (excess * excess), 0.0) if excess > 0.0 else 0.0
    excess *= believed
    family = np.hypot(row[SCATTER_ROUND], row[SCATTER_SHARP] * excess) * mean_width
    return 1.0 + row[GAIN] * excess, row[GAIN] * np.sqrt(believed * excess2), family


@njit(cache=True, error_model="numpy")
def _width_ratio(sums: FloatArray, fall: float) -> float:
    """Known blur over the width of the edge, from sums (3,) of its fall and flanks; NaN without a step."""
    step = sums[1] - sums[2]
    if not (step > 0.0 and sums[0] > 0.0):
        return np.nan
    return sums[0] / step / (fall * gaussian_fall(-sums[2] / step))
