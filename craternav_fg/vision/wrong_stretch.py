"""A stretch of a rim that is something else: a neighbouring crater's rim, a shadow's edge; compiled.

A redescending loss leaves a stretch out that lies far off the ellipse. One that lies near drags the ellipse
along instead, and what is left of its offset looks like an outline that is a little irregular. So each
stretch is tried with an offset of its own beside the ellipse, and the one that explains most is fitted
robustly. The ellipse moves by what the stretch had moved it. If the offset is beyond what an irregular
outline shows by chance, that move is an error that the ellipse may have: which of the two is right, the rim
does not tell.
"""

import numpy as np

from craternav_fg.vision.dense_kernel import factorised, ordered, solved
from craternav_fg.vision.ellipse_distance import distance_of
from craternav_fg.vision.robust_scale import MAD_TO_SIGMA
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Lengths of the stretches that are tried, as shares of the points.
_LENGTHS = (0.16, 0.22, 0.28, 0.34, 0.4)
# Squared offset over its variance that the best of all stretches reaches by chance on one rim in ten whose
# outline is smooth.
_CHANCE_OFFSET2 = 8.0
# An outline's deviation has about so many independent values along the rim, see `ellipse_kernel`.
_INDEPENDENT_VALUES = 12.0
# Iterations of the robust fit, and its scale in standard deviations.
_ITERATIONS, _SCALE_SIGMAS = 5, 2.5
# Unknowns: the ellipse, the reference brightness, the offset.
_BRIGHTNESS, _OFFSET, _UNKNOWNS = 5, 6, 7


@njit(cache=True, error_model="numpy")
def move_without_stretch(
    points: FloatArray, ratio: FloatArray, motion: FloatArray, brightness_sigma: float, y: FloatArray,
    min_scatter: float,
) -> FloatArray:  # fmt: skip
    """Compute how far an ellipse may have been moved by a stretch of points that is not the rim's.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Edge points, px, in their order along the rim.
    ratio, motion, brightness_sigma
        See `ellipse_kernel.fit`: shapes (n,), (n, 2).
    y : ndarray, shape (5,)
        Fitted chart in pixels.
    min_scatter : float
        Lower bound of the points' standard deviation, px.

    Returns
    -------
    ndarray, shape (5,)
        Root of the covariance of that move; zero where no stretch stands out.
    """
    count = len(points)
    out = np.zeros(5)
    free = min(float(count), _INDEPENDENT_VALUES) - _UNKNOWNS
    if free < 1.0:
        return out
    rows, d = np.zeros((count, _UNKNOWNS)), np.empty(count)
    n, w = np.empty(2), np.empty(5)
    ea, es = np.exp(y[2]), np.exp(y[4])
    for i in range(count):
        each = 1.0 / ratio[i]
        d[i] = each * distance_of(points[i, 0], points[i, 1], y, ea, es, n, w)
        for j in range(5):
            rows[i, j] = each * w[j]
        rows[i, _BRIGHTNESS] = -each * (n[0] * motion[i, 0] + n[1] * motion[i, 1])
    # Weights of mean 1, so that residuals are in pixels.
    mean = np.sqrt(np.mean(1.0 / (ratio * ratio)))
    rows /= mean
    d /= mean
    scatter = max(MAD_TO_SIGMA * ordered(np.abs(d))[count // 2], min_scatter)
    prior = (scatter / brightness_sigma) ** 2
    first, length = _best_stretch(rows, d, ratio, prior, mean)
    if length == 0:
        return out
    for i in range(first, first + length):
        rows[i % count, _OFFSET] = 1.0 / (ratio[i % count] * mean)
    move, r = np.zeros(_UNKNOWNS), d.copy()
    L = np.zeros((_UNKNOWNS, _UNKNOWNS))
    for _ in range(_ITERATIONS):
        scatter = max(MAD_TO_SIGMA * ordered(np.abs(r))[count // 2], min_scatter)
        weight = 1.0 / (1.0 + (r / (_SCALE_SIGMAS * scatter)) ** 2)
        N = rows.T @ (rows * weight.reshape(-1, 1))
        N[_BRIGHTNESS, _BRIGHTNESS] += (scatter / brightness_sigma) ** 2
        if not factorised(N, L):
            return out
        move = solved(L, -(rows.T @ (weight * d)))
        r = d + rows @ move
    scatter = max(MAD_TO_SIGMA * ordered(np.abs(r))[count // 2], min_scatter)
    N = rows.T @ rows
    N[_BRIGHTNESS, _BRIGHTNESS] += (scatter / brightness_sigma) ** 2
    if not factorised(N, L):
        return out
    unit = np.zeros(_UNKNOWNS)
    unit[_OFFSET] = 1.0
    # Neighbouring points err alike: the offset is as uncertain as that of few independent values.
    independent = min(float(count), _INDEPENDENT_VALUES)
    variance = scatter**2 * solved(L, unit)[_OFFSET] * count / independent * independent / free
    beyond = 1.0 - _CHANCE_OFFSET2 * variance / max(move[_OFFSET] ** 2, 1e-300)
    if beyond > 0.0:
        out[:] = np.sqrt(beyond) * move[:5]
    return out


@njit(cache=True, error_model="numpy")
def _best_stretch(
    rows: FloatArray, d: FloatArray, ratio: FloatArray, prior: float, mean: float
) -> tuple[int, int]:
    """First point and number of points of the stretch whose offset explains most of residuals d (n,)."""
    count, fitted = len(d), _OFFSET
    A = np.ascontiguousarray(rows[:, :fitted])
    N = A.T @ A
    N[_BRIGHTNESS, _BRIGHTNESS] += prior
    L = np.zeros((fitted, fitted))
    if not factorised(N, L):
        return 0, 0
    left = d - A @ solved(L, A.T @ d)
    # Sums over the first points, twice around the rim: those of a stretch are differences.
    sums = np.zeros((2 * count + 1, fitted + 2))
    for i in range(2 * count):
        k = i % count
        each = 1.0 / (ratio[k] * mean)
        for j in range(fitted):
            sums[i + 1, j] = sums[i, j] + each * A[k, j]
        sums[i + 1, fitted] = sums[i, fitted] + each * left[k]
        sums[i + 1, fitted + 1] = sums[i, fitted + 1] + each * each
    best, first, length = 0.0, 0, 0
    for share in _LENGTHS:
        some = int(share * count + 0.5)
        for i in range(count):
            part = sums[i + some] - sums[i]
            own = part[fitted + 1] - part[:fitted] @ solved(L, part[:fitted])
            explained = part[fitted] ** 2 / max(own, 1e-9 * part[fitted + 1])
            if explained > best:
                best, first, length = explained, i, some
    return first, length
