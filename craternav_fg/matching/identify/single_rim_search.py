"""Hypotheses of the position from single rims, with the attitude known: every crater is tried for a rim.

With a known attitude, the size of a crater and the direction of a rim give the position. The shape of the rim
then decides whether the hypothesis is kept.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.sphere_index import SphereIndex
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    HYPOTHESIS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
    PoseLimits,
    keep,
    size_sigma,
    support,
)
from craternav_fg.matching.identify.noise import shape_scale
from craternav_fg.matching.identify.pose_fit import chart_errors
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

Int32Array = npt.NDArray[np.int32]

# Gate on the squared error of a rim's shape, three degrees of freedom: 99.9 % of true rims pass.
_SHAPE_GATE2 = 16.0
# Other rims after which a hypothesis with a score that is not positive is given up, at most.
_MAX_PATIENCE = 4
# Least cosine of the angle between a line of sight and the vertical.
_MIN_COS_SLANT = 0.15
# Change of a rim's shape per rad of error of the attitude, in the chart's units: of order one.
_SHAPE_PER_RAD = 1.0
# Gate on places predicted for other rims, in standard deviations of size and attitude.
_LEVER_SIGMAS = 3.0


@njit(cache=True, error_model="numpy")
def search_single_rims(
    view: View, index: SphereIndex, craters: Craters, rims: Int32Array, order: Int32Array,
    attitude_sigma: float, sigma: float, limits: PoseLimits, best: FloatArray,
) -> None:  # fmt: skip
    """Try every crater for some rims and keep the best hypotheses.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    rims : ndarray of int32, shape (m,)
        Rows of the rims that are tried.
    order : ndarray of int32, shape (n, k)
        See `triple_search.image_order`.
    attitude_sigma : float
        Standard deviation of the known attitude about each axis, rad.
    sigma : float
        Noise of the centres, px.
    limits : PoseLimits
        With a known attitude.
    best : ndarray, shape (h, HYPOTHESIS)
        Changed: the best hypothetical poses.
    """
    attitude = limits.attitude
    g = np.empty(3)
    P = np.empty(3)
    e = np.empty(5)
    pose = np.empty(HYPOTHESIS)
    # Few rims leave fewer others to score by.
    patience = min(max(order.shape[1] - 2, 1), _MAX_PATIENCE)
    for i in rims:
        d = view.directions[i]
        for r in range(3):
            g[r] = attitude[r, 0] * d[0] + attitude[r, 1] * d[1] + attitude[r, 2] * d[2]
        lever = _LEVER_SIGMAS * np.hypot(size_sigma(view, i, sigma), attitude_sigma)
        slack2 = (_SHAPE_PER_RAD * attitude_sigma) ** 2
        scale = shape_scale(view, i, np.array([sigma, sigma, view.size_share]))
        for crater in range(craters.centres.shape[0]):
            toward, sphere2 = 0.0, 0.0
            for r in range(3):
                toward -= g[r] * craters.centres[crater, r]
                sphere2 += craters.centres[crater, r] ** 2
            if not (toward > 0.0 and toward * toward > _MIN_COS_SLANT * _MIN_COS_SLANT * sphere2):
                continue
            sphere = np.sqrt(sphere2)
            distance = np.exp(craters.log_size[crater] - view.log_angle[i]) * np.sqrt(toward / sphere)
            range2 = 0.0
            for r in range(3):
                P[r] = craters.centres[crater, r] - distance * g[r]
                range2 += P[r] * P[r]
            altitude = np.sqrt(range2) - sphere
            if not limits.min_altitude_m < altitude < limits.max_altitude_m:
                continue
            if not chart_errors(view, i, craters, crater, attitude, P, e):
                continue
            shape2 = 0.0
            for r in range(2, 5):
                shape2 += e[r] ** 2 / (scale * scale + slack2 * view.precision[i, r] ** 2)
            if shape2 > _SHAPE_GATE2:
                continue
            for r in range(3):
                pose[POSITION + r] = P[r]
                for c in range(3):
                    pose[ROTATION + 3 * r + c] = attitude[r, c]
            pose[SPHERE] = sphere
            for k in range(3):
                pose[RIMS + k] = -1.0
            pose[RIMS], pose[CRATERS] = i, crater
            score = support(view, index, craters, order[i], pose, np.inf, lever, sigma, patience, 1.0)
            pose[SCORE] = score - 0.5 * shape2
            if pose[SCORE] > best[:, SCORE].min():
                keep(pose, best)
