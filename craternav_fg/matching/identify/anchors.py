"""Hypotheses of the position from single rims, the attitude known: every crater is tried for some rims.

With the attitude, a crater's size and where a rim lies give the position; the rim's shape must then be right.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.catalogs.sphere_index import SphereIndex
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.expand import errors
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    HYPOTHESIS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
    axis_share,
    keep,
    support,
)
from craternav_fg.matching.identify.noise import USUAL_SHARE, shape_scale
from craternav_fg.matching.identify.view import View

FloatArray = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

_SHAPE_GATE2 = 16.0
# Rims that may be asked in vain.
_PATIENCE = 4
_LEAST_COS = 0.15
# Of a rim's shape, what a wrong attitude changes, per radian.
_SHEAR = 1.0


@njit(cache=True, error_model="numpy")
def anchor_search(
    view: View, index: SphereIndex, craters: Craters, anchors: Int32Array, order: Int32Array,
    attitude: FloatArray, attitude_sigma: float, sigma: float, least_m: float, most_m: float,
    best: FloatArray,
) -> int:  # fmt: skip
    """Try every crater for some rims and keep the best hypotheses; give the number that was judged.

    Parameters
    ----------
    view : View
    index, craters
        Of the catalogue.
    anchors : ndarray of int32
        The rims.
    order : ndarray of int32, shape (n, k)
        See `identify_triples.image_order`.
    attitude : ndarray, shape (3, 3)
        gRc.
    attitude_sigma : float
        Per axis, rad.
    sigma : float
        Noise, px.
    least_m, most_m : float
        Altitudes.
    best : ndarray, shape (k, HYPOTHESIS)
        Kept here.
    """
    g = np.empty(3)
    P = np.empty(3)
    e = np.empty(5)
    pose = np.empty(HYPOTHESIS)
    judged = 0
    # Of three pairs two are others': few rims leave little room for misses.
    patience = min(max(order.shape[1] - 2, 1), _PATIENCE)
    for i in anchors:
        d = view.directions[i]
        for r in range(3):
            g[r] = attitude[r, 0] * d[0] + attitude[r, 1] * d[1] + attitude[r, 2] * d[2]
        lever = 3.0 * np.hypot(axis_share(view, i, sigma), attitude_sigma)
        slack2 = (_SHEAR * attitude_sigma) ** 2
        scale = shape_scale(view, i, np.array([sigma, sigma, USUAL_SHARE]))
        for crater in range(craters.centres.shape[0]):
            toward, sphere2 = 0.0, 0.0
            for r in range(3):
                toward -= g[r] * craters.centres[crater, r]
                sphere2 += craters.centres[crater, r] ** 2
            if not (toward > 0.0 and toward * toward > _LEAST_COS * _LEAST_COS * sphere2):
                continue
            sphere = np.sqrt(sphere2)
            cos = toward / sphere
            distance = np.exp(craters.log_size[crater] - view.log_angle[i]) * np.sqrt(cos)
            range2 = 0.0
            for r in range(3):
                P[r] = craters.centres[crater, r] - distance * g[r]
                range2 += P[r] * P[r]
            altitude = np.sqrt(range2) - sphere
            if not least_m < altitude < most_m:
                continue
            if not errors(view, i, craters, crater, attitude, P, e):
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
            judged += 1
            pose[SCORE] = (
                support(view, index, craters, order[i], pose, np.inf, lever, sigma, 14, patience)
                - 0.5 * shape2
            )
            if pose[SCORE] > best[:, SCORE].min():
                keep(pose, best)
    return judged
