"""Attitudes of the camera by pairs of rims that are taken for pairs of craters; compiled."""

from typing import NamedTuple

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

# Errors of a hypothesis' geometry beside noise and prior: an ellipse's centre is not the image of the
# crater's (rad), and its area follows from the crater's only for a small crater (logarithm).
CENTRE_ERROR_RAD, LOG_AREA_ERROR = 0.01, 0.15
# Factor on what a wrong position changes in the logarithm of an area: areas fall with the squared range.
AREA_PER_RANGE = 2.0
# Minimum separation of two rims, rad, that counts for the accuracy of the roll that they give.
_MIN_SEPARATION_RAD = 0.05
# Two rims, or two craters, that are nearer to each other, rad, are one: no attitude follows from them.
_LEAST_SEPARATION_RAD = 1e-6
# Twice the sine of a rotation whose axis its matrix does not tell this way: none, or half a turn.
_LEAST_SINE = 1e-9


class Directions(NamedTuple):
    """Directions in the predicted camera frame, and what sizes say.

    Attributes
    ----------
    rays : ndarray, shape (n, 3)
        Unit vectors towards the rims, in the predicted camera frame.
    log_solid : ndarray, shape (n,)
        Logarithms of their solid angles over pi, dimensionless.
    sights : ndarray, shape (m, 3)
        Unit vectors towards the craters, in the predicted camera frame.
    range_m : ndarray, shape (m,)
        Distances of the craters.
    log_solid_of_craters : ndarray, shape (m,)
        The same of the craters.
    """

    rays: FloatArray
    log_solid: FloatArray
    sights: FloatArray
    range_m: FloatArray
    log_solid_of_craters: FloatArray


@njit(cache=True, error_model="numpy")
def costs_of_pairs(
    pairs: IntArray, known: Directions, axes: FloatArray, variances: FloatArray, position_m: float,
    position_sigma_m: float,
) -> FloatArray:  # fmt: skip
    """Compute squared distances of the attitudes of pairs from the predicted one.

    Parameters
    ----------
    pairs : ndarray of int, shape (h, 4)
        Rim and crater, twice.
    known : Directions
    axes : ndarray, shape (3, 3)
        Principal axes of the covariance of the predicted attitude, in the camera frame, as columns.
    variances : ndarray, shape (3,)
        Along these axes of the camera frame, rad^2.
    position_m, position_sigma_m : float
        Largest error of the predicted position, and its standard deviation.

    Returns
    -------
    ndarray, shape (h,)
        inf where separation or sizes of the craters do not agree with those of the rims.
    """
    out = np.empty(len(pairs))
    turn = np.empty(3)
    for h in range(len(pairs)):
        i, m, j, k = pairs[h, 0], pairs[h, 1], pairs[h, 2], pairs[h, 3]
        a, b = known.rays[i], known.rays[j]
        p, q = known.sights[m], known.sights[k]
        out[h] = np.inf
        seen = between = parallax = 0.0
        for d in range(3):
            seen += (a[d] - b[d]) ** 2
            between += (p[d] - q[d]) ** 2
            parallax += (p[d] / known.range_m[m] - q[d] / known.range_m[k]) ** 2
        seen, between, parallax = np.sqrt(seen), np.sqrt(between), np.sqrt(parallax)
        # Two craters in one direction, such as one that the catalogue has twice, give no attitude.
        if m == k or seen <= _LEAST_SEPARATION_RAD or between <= _LEAST_SEPARATION_RAD:
            continue
        nearer_m = min(known.range_m[m], known.range_m[k])
        # A wrong position changes the separation by the difference of the parallaxes, and the ratio of the
        # sizes likewise.
        if np.abs(between - seen) >= position_m * (parallax + between / nearer_m) + 2.0 * CENTRE_ERROR_RAD:
            continue
        off = known.log_solid[i] - known.log_solid[j]
        off -= known.log_solid_of_craters[m] - known.log_solid_of_craters[k]
        if np.abs(off) >= AREA_PER_RANGE * (LOG_AREA_ERROR + position_m * parallax):
            continue
        angle = _turn(a, b, p, q, turn)
        # Two rims close together determine the roll poorly.
        slack = (position_sigma_m / nearer_m) ** 2 + CENTRE_ERROR_RAD**2
        slack /= max(seen, _MIN_SEPARATION_RAD) ** 2
        if angle < 0.0:
            out[h] = angle * angle / (variances.max() + slack)
            continue
        cost = 0.0
        for d in range(3):
            along = axes[0, d] * turn[0] + axes[1, d] * turn[1] + axes[2, d] * turn[2]
            cost += along * along / (variances[d] + slack)
        out[h] = cost
    return out


@njit(cache=True, error_model="numpy")
def _turn(a: FloatArray, b: FloatArray, p: FloatArray, q: FloatArray, out: FloatArray) -> float:
    """Write the rotation vector (3,) from the bisecting triad of a and b to that of p and q; give its angle.

    A half turn has the negative angle, and no vector.
    """
    trace, x, y, z = 0.0, 0.0, 0.0, 0.0
    u, v = np.empty((3, 3)), np.empty((3, 3))
    for sign, row in ((1.0, 0), (-1.0, 1)):
        length_u = length_v = 0.0
        for d in range(3):
            u[row, d], v[row, d] = a[d] + sign * b[d], p[d] + sign * q[d]
            length_u += u[row, d] ** 2
            length_v += v[row, d] ** 2
        for d in range(3):
            u[row, d] /= np.sqrt(length_u)
            v[row, d] /= np.sqrt(length_v)
    for w in (u, v):
        w[2, 0] = w[0, 1] * w[1, 2] - w[0, 2] * w[1, 1]
        w[2, 1] = w[0, 2] * w[1, 0] - w[0, 0] * w[1, 2]
        w[2, 2] = w[0, 0] * w[1, 1] - w[0, 1] * w[1, 0]
    for row in range(3):
        r, s = u[row], v[row]
        trace += r[0] * s[0] + r[1] * s[1] + r[2] * s[2]
        x += r[1] * s[2] - r[2] * s[1]
        y += r[2] * s[0] - r[0] * s[2]
        z += r[0] * s[1] - r[1] * s[0]
    sine2 = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine2, trace - 1.0)
    if sine2 < _LEAST_SINE and trace < 1.0:
        return -angle
    factor = angle / sine2 if sine2 > _LEAST_SINE else 0.5
    out[0], out[1], out[2] = factor * x, factor * y, factor * z
    return angle
