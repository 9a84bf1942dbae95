"""Evidence of a pose from the image itself: whether it looks like craters where the pose predicts them.

Rims that were detected and matched are evidence already (`evidence`). Here count the other craters that the
pose predicts: too worn, too smeared or too small to be detected, but visible to one who knows where to look.
An unknown share of them is seen, possibly none, and the sun may be on either side: a right answer loses a
factor of 4 at most. Over images of other places the ratio has the mean 1, as the evidence of the rims has.
"""

import numpy as np

from craternav_fg.catalogs.sphere_index import SphereIndex
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.evidence import visible_craters
from craternav_fg.matching.identify.view import View
from craternav_fg.vision.shading_maps import LEAST_RADIUS_PX, ShadingMaps, shading_density
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import invert

# Shares of the predicted craters that are seen, all equally probable.
_SEEN_SHARES = np.array([0.0, 0.3, 0.6, 0.9])
# Predicted places are off by at most so many standard deviations of the pose's error and, for the map's, by
# this share of the radius.
_ERROR_SIGMAS, _ERROR_SHARE = 1.0, 0.15
# Largest craters that are asked at most.
_MOST_ASKED = 400
# Of two craters closer than this share of the larger radius, one is asked: the answers are the same.
_SAME_SHARE = 0.7


@njit(cache=True, error_model="numpy")
def log_shading(
    view: View, index: SphereIndex, craters: Craters, gTc: FloatArray, match: IntArray, N: FloatArray,
    maps: ShadingMaps,
) -> float:  # fmt: skip
    """Compute how much more probable the image's shading is at a pose than by chance.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    gTc : ndarray, shape (4, 4)
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none.
    N : ndarray, shape (6, 6)
        Information of the pose for its right twist, rad and m.
    maps : ShadingMaps
        Of the image without distortion.

    Returns
    -------
    float
        Natural logarithm of the ratio, at least -ln 4.
    """
    if not maps.first.shape[1]:
        return 0.0
    n = match.shape[0]
    sphere, pairs = 0.0, 0
    for i in range(n):
        if match[i] >= 0:
            c = craters.centres[match[i]]
            sphere += np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
            pairs += 1
    rows, circles = visible_craters(view, index, craters, gTc, sphere / pairs, LEAST_RADIUS_PX)
    count = rows.shape[0]
    # Circles that are explained: of matched rims, and of craters already asked.
    known = np.empty((pairs + count, 3))
    for i in range(n):
        if match[i] >= 0:
            pairs -= 1
            known[pairs, 0], known[pairs, 1] = view.points_px[i, 0], view.points_px[i, 1]
            known[pairs, 2] = view.radius_px[i]
            for k in range(count):
                if rows[k] == match[i]:
                    rows[k] = -1
    taken = known.shape[0] - count
    covariance = np.empty((6, 6))
    invert(N, covariance)
    log_ratio = np.zeros((2, _SEEN_SHARES.shape[0]))
    for k in np.argsort(-circles[:, 2])[:_MOST_ASKED]:
        if rows[k] < 0 or _is_known(circles[k], known, taken):
            continue
        known[taken] = circles[k]
        taken += 1
        depth = 0.0
        for r in range(3):
            depth += gTc[r, 2] * (craters.centres[rows[k], r] - gTc[r, 3])
        error_px = _ERROR_SIGMAS * np.sqrt(_place_variance(view, circles[k], depth, covariance))
        error_px = np.hypot(error_px, _ERROR_SHARE * circles[k, 2])
        for side in range(2):
            density = shading_density(maps, side, circles[k, 0], circles[k, 1], circles[k, 2], error_px)
            for s in range(_SEEN_SHARES.shape[0]):
                log_ratio[side, s] += np.log(1.0 + _SEEN_SHARES[s] * (density - 1.0))
    most = log_ratio.max()
    return float(most + np.log(np.exp(log_ratio - most).mean()))


@njit(cache=True, error_model="numpy")
def _is_known(circle: FloatArray, known: FloatArray, count: int) -> bool:
    """Whether a circle (3,) is close to one of the first `count` of others (m, 3)."""
    for k in range(count):
        near = _SAME_SHARE * max(circle[2], known[k, 2])
        if (circle[0] - known[k, 0]) ** 2 + (circle[1] - known[k, 1]) ** 2 < near * near:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _place_variance(view: View, circle: FloatArray, depth_m: float, covariance: FloatArray) -> float:
    """Variance of a predicted centre per coordinate, px^2."""
    u = (circle[0] - view.principal_px[0]) / view.fx_px
    v = (circle[1] - view.principal_px[1]) / view.fy_px
    J = np.zeros((2, 6))
    J[0, 0], J[0, 1], J[0, 2] = u * v, -(1.0 + u * u), v
    J[1, 0], J[1, 1], J[1, 2] = 1.0 + v * v, -u * v, -u
    J[0, 3], J[0, 5] = -1.0 / depth_m, u / depth_m
    J[1, 4], J[1, 5] = -1.0 / depth_m, v / depth_m
    total = 0.0
    for r in range(2):
        for a in range(6):
            for b in range(6):
                total += J[r, a] * covariance[a, b] * J[r, b]
    return 0.5 * total * view.focal_px**2
