"""How rims err, and what those of an image tell of it.

Noise is an array (3,): of each coordinate of a centre, px; of the axes, over `AXIS_PX`; and of the axes as a
share of them. Errors of the axes are of a size in pixels where blur makes them, and a share of the axes where
maps, shapes, or what still passes for a rim do; which of the two, the rims of an image tell.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.matching.identify.view import AXIS_PX, View

FloatArray = npt.NDArray[np.float64]

SIGMA_RANGE = (0.25, 8.0)
# Error of the axes, as a share, before any is known.
USUAL_SHARE = 0.02
# Median of a chi-square of 2 degrees of freedom.
MEDIAN2 = 1.386
# Noise of axes over `AXIS_PX`, px; and as a share of the axes.
AXIS_LEVELS = 0.25 * 2.0 ** np.arange(0.0, 5.5, 0.5)
AXIS_SHARES = np.array([0.01, 0.02, 0.04, 0.08, 0.12])
# How far apart in its logarithm the noise of axes may be from that of centres.
_ALIKE = 0.7
# Degrees of freedom of errors with long tails.
_TAIL = 5.0


@njit(cache=True, error_model="numpy")
def shape_scale(view: View, i: int, sigma: FloatArray) -> float:
    """Give the standard deviation of a rim's shape over that at 1 px, from the noise (3,)."""
    return np.sqrt(sigma[1] ** 2 + (sigma[2] * view.radius_px[i] / AXIS_PX) ** 2)


@njit(cache=True, error_model="numpy")
def median(values: FloatArray, count: int) -> float:
    """Give the median of the first `count` values, which are put in order: numpy's compiles for seconds."""
    for i in range(1, count):
        value = values[i]
        j = i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@njit(cache=True, error_model="numpy")
def log_alike(size: float, noise: float) -> float:
    """Logarithm of how probable a noise of axes is beside one of centres, both px at `AXIS_PX`, 1."""
    return -np.log1p((np.log(size / noise) / _ALIKE) ** 2)


@njit(cache=True, error_model="numpy")
def likely_shape(
    d2: FloatArray, radius: FloatArray, count: int, left: float, noise: float, sigma: FloatArray
) -> None:
    """Write the most probable noise of shapes, sigma[1:], of pairs whose errors have long tails.

    Parameters
    ----------
    d2, radius : ndarray
        Squared errors (count,) over those at 1 px; mean radii, px.
    count : int
    left : float
        Share of their freedom that the pose has left.
    noise : float
        Of the centres, px: that of shapes is thought to be alike.
    sigma : ndarray, shape (3,)
        Its last two are written.
    """
    best = -np.inf
    for size in AXIS_LEVELS:
        for share in AXIS_SHARES:
            total = log_alike(size, noise)
            for k in range(count):
                scale2 = size * size + (share * radius[k] / AXIS_PX) ** 2
                total -= 0.5 * (_TAIL + 3.0) * np.log1p(d2[k] / (_TAIL * scale2))
                total -= 1.5 * left * np.log(scale2)
            if total > best:
                best = total
                sigma[1], sigma[2] = size, share
