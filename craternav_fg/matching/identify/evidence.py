"""Evidence of a pose: how much more probable the image is as a view from it than as a set of false rims.

From a pose, each visible crater is found with an unknown probability (uniform prior), and all other rims are
false (see `chance`). Where the detector states how likely each rim is a crater's, rims of craters are more
frequent among the likely ones in proportion, and false rims are as frequent among all. The ratio of the two
densities is averaged over the poses that were possible before the image was seen, by Laplace's approximation
at the best one. Over images of false rims the ratio has the mean 1, so by Markov's inequality it exceeds L
with a probability of at most 1 / L.
"""

from math import lgamma

import numpy as np

from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.ellipse import half_sides_kernel
from craternav_fg.matching.identify.chance import chance_at, ground_direction
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.expand import LOG_FALSE
from craternav_fg.matching.identify.noise import (
    AXIS_LEVELS,
    AXIS_SHARES,
    fit_axis_noise,
    log_axis_prior,
    shape_scale,
)
from craternav_fg.matching.identify.pose_fit import chart_errors
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.conic import chart, rim_in_camera

# Shares of false rims that are considered, all equally probable.
_FALSE_SHARES = np.array([0.1, 0.3, 0.6, 0.9])
# Noise levels of the centres that are considered, px, all equally probable.
_CENTRE_LEVELS_PX = np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
_LOG_2PI = float(np.log(2.0 * np.pi))
# Initial room for visible craters; enlarged as needed.
_INITIAL_ROOM = 4096
# The cap of the ground that is searched for visible craters is enlarged by this, and at most so large, rad.
_REACH_FACTOR, _MAX_REACH_RAD = 1.02, 1.5
# Margin of the logarithm of the smallest angular size, before sizes in the image are computed.
_LOG_ANGLE_MARGIN = 0.05
# No crater is larger: e^30 m.
_MAX_LOG_SIZE = 30.0


@njit(cache=True, error_model="numpy")
def visible_craters(
    view: View, index: SphereIndex, craters: Craters, gTc: FloatArray, sphere: float, least_px: float
) -> tuple[IntArray, FloatArray]:
    """Find the craters whose whole rims lie in the image.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    gTc : ndarray, shape (4, 4)
    sphere : float
        Radius of the ground, m.
    least_px : float
        Smallest mean radius in the image.

    Returns
    -------
    rows : ndarray of int, shape (m,)
        A few craters just behind the horizon may be among them.
    circles_px : ndarray, shape (m, 3)
        Centres x and y, px without distortion, and mean radii.
    """
    left, top = view.bounds_px[0], view.bounds_px[1]
    right, bottom = view.bounds_px[2], view.bounds_px[3]
    R, P = np.empty((3, 3)), np.empty(3)
    range2 = 0.0
    for r in range(3):
        P[r] = gTc[r, 3]
        range2 += P[r] * P[r]
        for c in range(3):
            R[r, c] = gTc[r, c]
    range_m = np.sqrt(range2)
    horizon = np.arccos(min(sphere / range_m, 1.0))
    # A cap around the ground at the image's middle that reaches to its farthest corner.
    middle = np.empty(3)
    corner = np.empty(3)
    reach, stretch = 0.0, 0.0
    if not ground_direction(view, R, P, range_m, sphere, 0.5 * (left + right), 0.5 * (top + bottom), middle):
        for r in range(3):
            middle[r] = P[r] / range_m
        reach = horizon
    for k in range(4):
        x, y = left if k % 2 == 0 else right, top if k < 2 else bottom
        u, v = (x - view.principal_px[0]) / view.fx_px, (y - view.principal_px[1]) / view.fy_px
        stretch = max(stretch, 0.75 * np.log(1.0 + u * u + v * v))
        if ground_direction(view, R, P, range_m, sphere, x, y, corner):
            cos = middle[0] * corner[0] + middle[1] * corner[1] + middle[2] * corner[2]
            reach = max(reach, np.arccos(min(max(cos, -1.0), 1.0)))
        else:
            reach = 2.0 * horizon
    if reach > horizon:
        # The cap within the horizon is smaller, and holds all that is seen.
        reach = horizon
        for r in range(3):
            middle[r] = P[r] / range_m
    reach = min(_REACH_FACTOR * reach, _MAX_REACH_RAD)
    least_angle = np.log(least_px / view.focal_px) - stretch - _LOG_ANGLE_MARGIN
    least = np.log(max(range_m - sphere, 1.0)) + least_angle
    found = np.empty(_INITIAL_ROOM, dtype=np.int64)
    count = within(index, middle[0], middle[1], middle[2], reach, least, _MAX_LOG_SIZE, found)
    while count == found.shape[0]:
        found = np.empty(4 * count, dtype=np.int64)
        count = within(index, middle[0], middle[1], middle[2], reach, least, _MAX_LOG_SIZE, found)
    p, axes_c, y5 = np.empty(3), np.empty((2, 3)), np.empty(5)
    rows, circles = np.empty(count, dtype=np.int64), np.empty((count, 3))
    total = 0
    for k in range(count):
        # Most of the distant ones are too small, however they are oriented.
        distance2 = 0.0
        for r in range(3):
            distance2 += (craters.centres[found[k], r] - P[r]) ** 2
        if craters.log_size[found[k]] - 0.5 * np.log(distance2) < least_angle:
            continue
        rim_in_camera(R, P, craters.centres[found[k]], craters.axes[found[k]], p, axes_c)
        if not chart(p, axes_c, y5):
            continue
        log_radius = 0.5 * (y5[2] + y5[4]) + np.log(view.focal_px)
        if log_radius < np.log(least_px):
            continue
        half_x, half_y = half_sides_kernel(y5[2], y5[3], y5[4])
        half_x *= view.fx_px
        half_y *= view.fy_px
        x = view.principal_px[0] + view.fx_px * y5[0]
        y = view.principal_px[1] + view.fy_px * y5[1]
        if x - half_x > left and x + half_x < right and y - half_y > top and y + half_y < bottom:
            rows[total] = found[k]
            circles[total, 0], circles[total, 1], circles[total, 2] = x, y, np.exp(log_radius)
            total += 1
    return rows[:total].copy(), circles[:total].copy()


@njit(cache=True, error_model="numpy")
def log_evidence(
    view: View, index: SphereIndex, craters: Craters, gTc: FloatArray, match: IntArray, N: FloatArray,
    chance: FloatArray, shape_chance: FloatArray, log_prior: float,
) -> float:  # fmt: skip
    """Compute the evidence of a pose.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    gTc : ndarray, shape (4, 4)
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none. Changed: rims that chance explains better lose theirs.
    N : ndarray, shape (6, 6)
        Information of the pose for its right twist, rad and m.
    chance, shape_chance : ndarray, shape (n,)
        From `log_by_chance`.
    log_prior : float
        Natural logarithm of the density of the pose before the image was seen, per rad^3 m^3.

    Returns
    -------
    float
        Natural logarithm of the ratio; -inf without any matched rim.
    """
    n = match.shape[0]
    R, P = np.empty((3, 3)), np.empty(3)
    for r in range(3):
        P[r] = gTc[r, 3]
        for c in range(3):
            R[r, c] = gTc[r, c]
    e = np.empty(5)
    place, shape, rest = np.zeros(n), np.zeros(n), np.zeros(n)
    matched_shape, radius = np.empty(n), np.empty(n)
    sphere = 0.0
    pairs = 0
    for i in range(n):
        if match[i] < 0:
            continue
        if not chart_errors(view, i, craters, match[i], R, P, e):
            match[i] = -1
            continue
        place[i] = e[0] * e[0] + e[1] * e[1]
        shape[i] = e[2] * e[2] + e[3] * e[3] + e[4] * e[4]
        rest[i] = -2.5 * _LOG_2PI - np.log(view.quality.sum() / view.quality[i])
        for r in range(5):
            rest[i] += np.log(view.precision[i, r])
        c = craters.centres[match[i]]
        sphere += np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
        pairs += 1
    if not pairs:
        return -np.inf
    sphere /= pairs
    here = np.empty(n)
    chance_at(view, R, P, sphere, chance, shape_chance, here)
    for i in range(n):
        rest[i] -= here[i]
    # Rims that are improbable at the most probable noise lose their craters.
    centre_px = _centre_noise(place, match)
    sigma = np.empty(3)
    count = 0
    for i in range(n):
        if match[i] >= 0:
            matched_shape[count], radius[count] = shape[i], view.radius_px[i]
            count += 1
    fit_axis_noise(matched_shape, radius, count, 1.0, centre_px, sigma)
    total = 0.0
    smallest = np.inf
    for i in range(n):
        if match[i] < 0:
            continue
        scale = shape_scale(view, i, sigma)
        term = rest[i] - 0.5 * place[i] / centre_px**2 - 0.5 * shape[i] / scale**2
        term -= 2.0 * np.log(centre_px) + 3.0 * np.log(scale)
        if term < LOG_FALSE:
            match[i] = -1
            pairs -= 1
        else:
            total += rest[i]
            smallest = min(smallest, view.radius_px[i])
    if not pairs:
        return -np.inf
    total += _log_over_noise(view, match, place, shape)
    # The probability that `pairs` of the visible craters are found, whichever the share of those found.
    rows, _ = visible_craters(view, index, craters, gTc, sphere, smallest)
    seen = max(len(rows), pairs)
    total += lgamma(pairs + 1.0) + lgamma(seen - pairs + 1.0) - lgamma(seen + 2.0)
    clutter = (1.0 - _FALSE_SHARES) * n + (n - pairs) * np.log(_FALSE_SHARES)
    total += clutter.max() + np.log(np.exp(clutter - clutter.max()).mean())
    return total + log_prior + 3.0 * _LOG_2PI - 0.5 * _log_det(N)


@njit(cache=True, error_model="numpy")
def _centre_noise(d2: FloatArray, match: IntArray) -> float:
    """Most probable noise of the centres, px, of squared errors (n,) at 1 px."""
    best, value = _CENTRE_LEVELS_PX[0], -np.inf
    for s in _CENTRE_LEVELS_PX:
        total = 0.0
        for i in range(match.shape[0]):
            if match[i] >= 0:
                total -= 0.5 * d2[i] / (s * s) + 2.0 * np.log(s)
        if total > value:
            best, value = s, total
    return best


@njit(cache=True, error_model="numpy")
def _log_over_noise(view: View, match: IntArray, place: FloatArray, shape: FloatArray) -> float:
    """Average the density of the errors of matched rims over the unknown noise, but for constants.

    Parameters
    ----------
    view : View
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none.
    place, shape : ndarray, shape (n,)
        Squared errors at a noise of 1 px: two and three degrees of freedom.

    Returns
    -------
    float
        Natural logarithm.
    """
    sigma = np.empty(3)
    best, total, weights = -np.inf, 0.0, 0.0
    for centre_px in _CENTRE_LEVELS_PX:
        of_places = 0.0
        for i in range(match.shape[0]):
            if match[i] >= 0:
                of_places -= 0.5 * place[i] / centre_px**2 + 2.0 * np.log(centre_px)
        for size in AXIS_LEVELS:
            prior = log_axis_prior(size, centre_px)
            for share in AXIS_SHARES:
                sigma[0], sigma[1], sigma[2] = centre_px, size, share
                value = of_places + prior
                for i in range(match.shape[0]):
                    if match[i] >= 0:
                        scale = shape_scale(view, i, sigma)
                        value -= 0.5 * shape[i] / scale**2 + 3.0 * np.log(scale)
                weights += np.exp(prior)
                if value > best:
                    total, best = total * np.exp(best - value) + 1.0, value
                else:
                    total += np.exp(value - best)
    return float(best + np.log(total / weights))


@njit(cache=True, error_model="numpy")
def _log_det(N: FloatArray) -> float:
    """Natural logarithm of the determinant of a positive definite matrix (6, 6)."""
    L = np.zeros((6, 6))
    total = 0.0
    for i in range(6):
        for j in range(i + 1):
            value = N[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = np.sqrt(value)
                total += 2.0 * np.log(L[i, i])
            else:
                L[i, j] = value / L[j, j]
    return total
