"""Score of a pose: how improbable it is that chance puts as many rims on craters."""

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from craternav_fg.camera import Camera
from craternav_fg.ellipse import half_sides, pixel_chart, semi_minor_bound
from factors.arrays import FloatArray

# A rim agrees with a crater when its centre is within these of the predicted one, added: px, and semi-minor
# axes; and the other elements of its chart within the third.
_CENTRE_PX, _CENTRE_SHARE, _SHAPE = 3.0, 0.1, 0.12
# Factors on these tolerances that are tried: tighter ones separate better when the pose is good.
_TIGHTER = (1.0, 0.5, 0.25)
# Share of craters of about a rim's size whose size and shape agree with the rim by chance, for a factor of 1.
_SHAPE_CHANCE = 0.15
# Fewest craters in view that must be found.
_MIN_FOUND = 3


def log10_improbability(
    charts: FloatArray, rims_px: FloatArray, camera: Camera, tried: int, least_px: Sequence[float],
    min_found_share: float,
) -> float:  # fmt: skip
    """Score a pose by the craters that it predicts.

    Parameters
    ----------
    charts : ndarray, shape (m, 5)
        Predicted charts of the visible craters in normalised image coordinates.
    rims_px : ndarray, shape (n, 5)
        Charts of the detected rims in pixels.
    camera : Camera
        Without distortion.
    tried : int
        Number of poses that were tried.
    least_px : sequence of float
        Semi-minor axes from which on craters are expected to be found; the one with the best score counts.
    min_found_share : float
        Minimum share of the expected craters that must be found.

    Returns
    -------
    float
        Minus the decimal logarithm of the expected number of poses, among all tried, that explain as many
        rims by chance; -inf when too few of the expected craters were found.
    """
    charts = pixel_chart(charts, camera)
    half = half_sides(charts)
    whole = camera.contains(charts[:, :2] - half) & camera.contains(charts[:, :2] + half)
    charts = charts[whole]
    minor = semi_minor_bound(charts)
    off_px = np.linalg.norm(charts[:, None, :2] - rims_px[None, :, :2], axis=-1)
    off_shape = np.abs(charts[:, None, 2:] - rims_px[None, :, 2:]).max(axis=-1)
    reach_px = _CENTRE_PX + _CENTRE_SHARE * minor
    misfit = np.maximum(off_px / reach_px[:, None], off_shape / _SHAPE).min(axis=1)
    share = len(rims_px) * np.pi * reach_px**2 / (camera.width_px * camera.height_px)
    tests = len(_TIGHTER) * len(least_px)
    best = -np.inf
    for least in least_px:
        large = minor >= least
        expected = int(np.count_nonzero(large))
        if np.count_nonzero(misfit[large] < 1.0) < max(_MIN_FOUND, min_found_share * expected):
            continue
        for factor in _TIGHTER:
            # The first two rims made the pose and do not confirm it.
            confirming = int(np.count_nonzero(misfit[large] < factor)) - 2
            if confirming < 1:
                continue
            chance = min(1.0, float(np.mean(share[large])) * _SHAPE_CHANCE * factor**5)
            ways = _log10_choose(expected - 2, confirming)
            best = max(best, -(np.log10(tried * tests) + ways + confirming * np.log10(chance)))
    return best


def _log10_choose(n: int, k: int) -> float:
    """Decimal logarithm of the binomial coefficient."""
    return float((gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)) / np.log(10.0))
