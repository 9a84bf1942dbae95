"""From a hypothesis to all rims that agree with it: fit the pose, associate rims and craters anew, repeat."""

import numpy as np

from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.hypothesis import (
    HYPOTHESIS,
    POSITION,
    ROTATION,
    SPHERE,
    project_to_sphere,
)
from craternav_fg.matching.identify.noise import (
    CENTRE_SIGMA_RANGE_PX,
    CHI2_2_MEDIAN,
    fit_axis_noise,
    median,
    shape_scale,
)
from craternav_fg.matching.identify.pose_fit import (
    centre_freedom_taken,
    chart_errors,
    fit_pose,
    pack_rims,
)
from craternav_fg.matching.identify.view import AXIS_SIGMA_PX, View
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import invert

# Rounds of fit and association at most; in the first ones, the noise stays as assumed, and unchanged pairs do
# not end the expansion.
_MAX_ROUNDS = 12
_FIRST_ROUNDS = 2
# Gate on a rim's place, standard deviations of two degrees of freedom: 99.8 % of true rims pass.
_GATE_SIGMAS = 3.5
# Gate on the squared error of a rim's shape, three degrees of freedom: 99.96 % pass.
_SHAPE_GATE2 = 18.0
# The gate on the place never exceeds this, px: a pose so uncertain says nothing about a rim.
_MAX_GATE_PX = 60.0
# Addition to that gate over the rim's radius: an ellipse's centre is not the image of the crater's.
_CENTRE_OFFSET_SHARE = 0.05
# Addition to the gate on the logarithm of the size, and the most that it is.
_GATE_LOG_SIZE, _MAX_GATE_LOG_SIZE = 0.03, 0.6
# Radius of the search for craters around a rim, rad, at most.
_MAX_SEARCH_RAD = 0.5
# A rim that may be as many craters is not associated.
_MAX_CANDIDATES = 256
_LOG_2PI = float(np.log(2.0 * np.pi))
# Natural logarithm of the share of an image's rims that are false, as a prior for each rim: 37 %.
LOG_FALSE = -1.0
# Degrees of freedom that the assumed noise counts for when the noise is estimated from few pairs.
_ASSUMED_FREEDOM = 4.0


@njit(cache=True, error_model="numpy")
def _prediction_variances(view: View, i: int, scale: float, covariance: FloatArray) -> tuple[float, float]:
    """Variances due to an uncertain pose: of a rim's place per coordinate, px^2, and of its relative size."""
    u, v = view.charts[i, 0], view.charts[i, 1]
    # Depth, with the extent on the ground per rad for the distance: equal for a rim seen from above.
    z = scale / np.sqrt(1.0 + u * u + v * v)
    J = np.empty((2, 6))
    J[0, 0], J[0, 1], J[0, 2] = u * v, -(1.0 + u * u), v
    J[1, 0], J[1, 1], J[1, 2] = 1.0 + v * v, -u * v, -u
    J[0, 3], J[0, 4], J[0, 5] = -1.0 / z, 0.0, u / z
    J[1, 3], J[1, 4], J[1, 5] = 0.0, -1.0 / z, v / z
    total = 0.0
    for r in range(2):
        for a in range(6):
            for b in range(6):
                total += J[r, a] * covariance[a, b] * J[r, b]
    return 0.5 * total * view.focal_px**2, covariance[5, 5] / (z * z)


@njit(cache=True, error_model="numpy")
def associate(
    view: View, index: SphereIndex, craters: Craters, gTc: FloatArray, sphere: float, covariance: FloatArray,
    sigma: FloatArray, chance: FloatArray, match: IntArray, weight: FloatArray,
) -> int:  # fmt: skip
    """Associate rims with craters at an uncertain pose.

    A rim is associated with a crater when that is more probable than all other craters nearby together, and
    than that the rim is false. Where the pose is so uncertain that several craters are possible, it stays
    without one.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    gTc : ndarray, shape (4, 4)
    sphere : float
        Radius of the sphere on which the craters lie, m.
    covariance : ndarray, shape (6, 6)
        Covariance of the pose, for its right twist in c, rad and m.
    sigma : ndarray, shape (3,)
        Noise, see `noise`.
    chance : ndarray, shape (n,)
        Logarithm of the density of each rim's chart if it is false, from `chance.log_by_chance`.
    match : ndarray of int, shape (n,)
        Written: row of each rim's crater, -1 for none.
    weight : ndarray, shape (n,)
        Written: logarithm of the ratio of the rim's densities at its crater and if it is false.

    Returns
    -------
    int
        Number of associated rims.
    """
    n = match.shape[0]
    pose = np.empty(HYPOTHESIS)
    R, P = np.empty((3, 3)), np.empty(3)
    for r in range(3):
        P[r] = pose[POSITION + r] = gTc[r, 3]
        for c in range(3):
            R[r, c] = pose[ROTATION + 3 * r + c] = gTc[r, c]
    pose[SPHERE] = sphere
    X = np.empty(3)
    e = np.empty(5)
    found = np.empty(_MAX_CANDIDATES, dtype=np.int64)
    pairs = 0
    total = view.quality.sum()
    for i in range(n):
        match[i] = -1
        weight[i] = -np.inf
        seen, size, scale = project_to_sphere(view, i, pose, X)
        if not seen:
            continue
        place2, size2 = _prediction_variances(view, i, scale, covariance)
        unit2 = 1.0 + (view.centre_share * view.radius_px[i]) ** 2
        place_px = np.sqrt(sigma[0] ** 2 * unit2 + place2)
        gate_px = min(_GATE_SIGMAS * place_px, _MAX_GATE_PX) + _CENTRE_OFFSET_SHARE * view.radius_px[i]
        shape2 = shape_scale(view, i, sigma) ** 2
        share2 = shape2 * (AXIS_SIGMA_PX / view.radius_px[i]) ** 2 + size2
        slack = min(_GATE_SIGMAS * np.sqrt(share2) + _GATE_LOG_SIZE, _MAX_GATE_LOG_SIZE)
        angle = gate_px * scale / (view.focal_px * sphere)
        count = within(
            index, X[0], X[1], X[2], min(angle, _MAX_SEARCH_RAD), size - slack, size + slack, found
        )
        if count == _MAX_CANDIDATES:
            continue
        place_var, size_var = sigma[0] ** 2 + place2 / unit2, shape2 + size2 * view.radius_px[i] ** 2
        density = -2.5 * _LOG_2PI - np.log(place_var) - 0.5 * np.log(size_var) - np.log(shape2)
        for r in range(5):
            density += np.log(view.precision[i, r])
        # Relative to a rim that is false.
        density -= np.log(total / view.quality[i]) + chance[i] + LOG_FALSE
        rest = 1.0
        for k in range(count):
            if not chart_errors(view, i, craters, found[k], R, P, e):
                continue
            place = (e[0] * e[0] + e[1] * e[1]) / place_var
            shape = (e[2] * e[2] + e[3] * e[3] + e[4] * e[4]) / size_var
            if not (place < _GATE_SIGMAS * _GATE_SIGMAS and shape < _SHAPE_GATE2):
                continue
            value = density - 0.5 * (place + shape)
            if value > weight[i]:
                rest += np.exp(weight[i])
                weight[i] = value
                match[i] = found[k]
            else:
                rest += np.exp(value)
        if match[i] >= 0 and weight[i] < np.log(rest):
            match[i] = -1
    # Of two rims with one crater, the better keeps it.
    for i in range(n):
        for j in range(i):
            if match[i] >= 0 and match[i] == match[j]:
                match[i if weight[i] <= weight[j] else j] = -1
    for i in range(n):
        pairs += match[i] >= 0
    return pairs


@njit(cache=True, error_model="numpy")
def estimate_noise(
    view: View, craters: Craters, gTc: FloatArray, match: IntArray, assumed: float, places: float,
    shapes: float, sigma: FloatArray,
) -> None:  # fmt: skip
    """Estimate the noise from the residuals of matched rims: centres by the median, axes by their posterior.

    Parameters
    ----------
    view : View
    craters : Craters
    gTc : ndarray, shape (4, 4)
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none.
    assumed : float
        Noise of the centres, px, with which the search began: it counts as `_ASSUMED_FREEDOM` residuals.
    places, shapes : float
        Degrees of freedom that the fit of the pose takes from centres and from shapes.
    sigma : ndarray, shape (3,)
        Written: noise, see `noise`.
    """
    n = match.shape[0]
    place, shape, radius = np.empty(n), np.empty(n), np.empty(n)
    R, P = np.empty((3, 3)), np.empty(3)
    for r in range(3):
        P[r] = gTc[r, 3]
        for c in range(3):
            R[r, c] = gTc[r, c]
    e = np.empty(5)
    count = 0
    for i in range(n):
        if match[i] >= 0 and chart_errors(view, i, craters, match[i], R, P, e):
            place[count] = e[0] * e[0] + e[1] * e[1]
            shape[count] = e[2] * e[2] + e[3] * e[3] + e[4] * e[4]
            radius[count] = view.radius_px[i]
            count += 1
    if not count:
        return
    least, most = CENTRE_SIGMA_RANGE_PX
    left = max(2.0 * count - places, 0.0)
    square = 2.0 * count * median(place, count) / CHI2_2_MEDIAN + _ASSUMED_FREEDOM * assumed * assumed
    sigma[0] = min(max(np.sqrt(square / (left + _ASSUMED_FREEDOM)), least), most)
    left = max(1.0 - shapes / (3.0 * count), 0.0)
    fit_axis_noise(shape, radius, count, left, sigma[0], sigma)


@njit(cache=True, error_model="numpy")
def expand_inliers(
    view: View, index: SphereIndex, craters: Craters, noise: float, chance: FloatArray, prior: FloatArray,
    weight: FloatArray, gTc: FloatArray, match: IntArray, N: FloatArray, sigma: FloatArray,
) -> int:  # fmt: skip
    """Fit the pose and associate rims anew, in turn, until the pairs no longer change.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    noise : float
        Assumed noise of the centres, px.
    chance : ndarray, shape (n,)
        Logarithm of the density of each rim's chart if it is false, from `chance.log_by_chance`.
    prior, weight : ndarray, shapes (4, 4), (6, 6)
        Known attitude as pose and information; without one, `weight` is zero.
    gTc : ndarray, shape (4, 4)
        Initial pose of the camera; written: the pose.
    match : ndarray of int, shape (n,)
        Initial row of each rim's crater, -1 for none; written: the association.
    N : ndarray, shape (6, 6)
        Written: information of the pose for its right twist in c, rad and m.
    sigma : ndarray, shape (3,)
        Written: noise, see `noise`.

    Returns
    -------
    int
        Number of associated rims; 0 when the fit failed or too few rims agreed.
    """
    n = match.shape[0]
    used = 0
    for i in range(n):
        used += match[i] >= 0
    sigma[0] = sigma[1] = noise
    sigma[2] = view.size_share
    covariance = np.empty((6, 6))
    before = np.empty(n, dtype=np.int64)
    ratio = np.empty(n)
    pairs = used
    for turn in range(_MAX_ROUNDS):
        data = pack_rims(view, craters, match, sigma)
        if not fit_pose(gTc, data, prior, weight, N):
            return 0
        invert(N, covariance)
        for a in range(6):
            if not 0.0 < covariance[a, a] < np.inf:
                return 0
        if turn >= _FIRST_ROUNDS and pairs > 3:
            places = centre_freedom_taken(gTc, data, covariance)
            estimate_noise(view, craters, gTc, match, noise, places, 6.0 - places, sigma)
        sphere = 0.0
        for i in range(n):
            before[i] = match[i]
            if match[i] >= 0:
                c = craters.centres[match[i]]
                sphere += np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2) / pairs
        pairs = associate(view, index, craters, gTc, sphere, covariance, sigma, chance, match, ratio)
        if pairs < min(used, 3) or pairs < 2:
            return 0
        same = True
        for i in range(n):
            same = same and match[i] == before[i]
        if same and turn > _FIRST_ROUNDS:
            break
    data = pack_rims(view, craters, match, sigma)
    if not fit_pose(gTc, data, prior, weight, N):
        return 0
    return pairs
