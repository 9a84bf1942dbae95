"""Rims that are suspiciously large for their image: craters are the more numerous the smaller they are.

Detectors take shadows, ridges and mountains for rims, and many of those are larger than most craters in view.
A large rim measures best, so hypotheses would be formed from such rims first.
"""

import numpy as np

from craternav_fg.matching.identify.chance import LOG_SIZE_MARGIN, SIZE_EXPONENT
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

# Steps of expectation maximisation.
_STEPS = 20
# Least standard deviation of the logarithm of the sizes in excess.
_MIN_SPREAD = 0.1
# Least gain of the log-likelihood by an excess, for its three parameters.
_MIN_GAIN = 5.0
# Exponents of the power law that are considered: cumulative numbers of craters, over what an image shows.
_MIN_EXPONENT, _MAX_EXPONENT = 1.0, 3.0
_ROOT_2PI = float(np.sqrt(2.0 * np.pi))
# Fewest rims that must be left.
_MIN_RIMS = 5


def plausible_rims(view: View) -> IntArray:
    """Select the rims whose sizes craters explain.

    Craters follow the power law of `chance`. An excess of rims is normal in the logarithm of the size; share,
    mean and spread are the most probable ones.

    Parameters
    ----------
    view : View

    Returns
    -------
    ndarray of int, shape (m,)
        Rows of the rims; all of them unless an excess is significant.
    """
    above = np.log(view.radius_px / view.radius_px.min()) + LOG_SIZE_MARGIN
    weight = np.empty(len(above))
    if _separate(above, weight) < _MIN_GAIN:
        return np.arange(len(above))
    # As many as are no excess: those that are least probably in it.
    kept = np.sort(np.argsort(weight)[: round(np.sum(1.0 - weight))])
    return kept if len(kept) >= _MIN_RIMS else np.arange(len(above))


@njit(cache=True, error_model="numpy")
def _separate(above: FloatArray, weight: FloatArray) -> float:
    """Fit power law and excess to the sizes by expectation maximisation.

    Parameters
    ----------
    above : ndarray, shape (n,)
        Logarithms of the sizes, over a little less than the smallest.
    weight : ndarray, shape (n,)
        Written: probability of each rim to be in excess.

    Returns
    -------
    float
        Gain of the log-likelihood over that of the most probable power law alone.
    """
    n = above.shape[0]
    total, square = 0.0, 0.0
    for x in above:
        total += x
        square += x * x
    middle = total / n
    alone = min(max(1.0 / middle, _MIN_EXPONENT), _MAX_EXPONENT)
    spread = max(np.sqrt(max(square / n - middle * middle, 0.0)), _MIN_SPREAD)
    mean, share, exponent = middle + 0.5 * spread, 0.5, SIZE_EXPONENT
    gain = 0.0
    for _ in range(_STEPS):
        gain, excess, first, second = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            x = above[i]
            density = share * np.exp(-0.5 * ((x - mean) / spread) ** 2) / (_ROOT_2PI * spread)
            both = density + (1.0 - share) * exponent * np.exp(-exponent * x)
            weight[i] = density / both
            excess += weight[i]
            first += weight[i] * x
            second += weight[i] * x * x
            gain += np.log(both / alone) + alone * x
        if not 0.0 < excess < n:
            break
        share = excess / n
        mean = first / excess
        spread = max(np.sqrt(max(second / excess - mean * mean, 0.0)), _MIN_SPREAD)
        exponent = min(max((n - excess) / (total - first), _MIN_EXPONENT), _MAX_EXPONENT)
    return gain
