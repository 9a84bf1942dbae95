"""How much more likely an image is as the view of a pose than as rims by chance, over all poses sought.

Rims by chance: uniform where the image shows ground, of sizes as they are in this image, half of them of
shapes as they are in it, half as craters are that are seen from the pose (a wrong pose is sought where
the foreshortening is right, and other craters are foreshortened alike). Rims at a pose: each
visible crater is found with a probability that is not known (uniform), the rest is by chance. The ratio of
the two, averaged over the poses that were possible before the image was seen (Laplace's approximation at
the best), has the mean 1 over images by chance: it exceeds L with a probability of at most 1 / L.
"""

from math import lgamma

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.ellipse import half_sides_kernel
from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.expand import LOG_FALSE, errors
from craternav_fg.matching.identify.noise import (
    AXIS_LEVELS,
    AXIS_SHARES,
    MEDIAN2,
    likely_shape,
    log_alike,
    median,
    shape_scale,
)
from craternav_fg.matching.identify.view import View
from factors.kernels.conic import chart, rim_in_camera

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_FALSE_SHARES = np.array([0.1, 0.3, 0.6, 0.9])
_SIGMAS = np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
_LN2PI = float(np.log(2.0 * np.pi))
_ROOM = 4096
_SIZE_SLOPE = 2.0
# Least variance of shapes; samples a side of what an image shows.
_ROUNDNESS2 = 0.05**2
_SAMPLES = 12


def log_by_chance(view: View) -> tuple[FloatArray, FloatArray]:
    """Logarithms (n,) of the density of rims' charts among rims by chance, and of that of shapes alone."""
    area = (view.corners[2] - view.corners[0]) * (view.corners[3] - view.corners[1])
    area /= view.fx_px * view.fy_px
    log_size = np.log(view.radius_px)
    q = view.charts[:, 4] - view.charts[:, 2]
    shape2 = q**2 + (view.charts[:, 3] * np.exp(-q)) ** 2
    spread = 0.5 * shape2.mean() + _ROUNDNESS2
    by_size = np.log(_SIZE_SLOPE) - _SIZE_SLOPE * (log_size - log_size.min() + 0.05)
    by_shape = -_LN2PI - np.log(spread) - 0.5 * shape2 / spread - q
    return np.asarray(by_size + by_shape - np.log(area)), np.asarray(by_shape)


@njit(cache=True, error_model="numpy")
def chance_at(
    view: View, R: FloatArray, P: FloatArray, sphere: float, chance: FloatArray, shape_chance: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Write the logarithms (n,) of the density of each rim's chart among rims by chance, seen from a pose.

    Parameters
    ----------
    view : View
    R, P : ndarray, shape (3, 3), (3,)
        gRc and the camera's position, m.
    sphere : float
        Radius of the ground, m.
    chance, shape_chance : ndarray, shape (n,)
        From `log_by_chance`.
    out : ndarray, shape (n,)
        Written.
    """
    n = chance.shape[0]
    range_m = np.sqrt(P[0] ** 2 + P[1] ** 2 + P[2] ** 2)
    ground = np.empty(3)
    shown = 0
    for i in range(_SAMPLES):
        for j in range(_SAMPLES):
            x = view.corners[0] + (i + 0.5) / _SAMPLES * (view.corners[2] - view.corners[0])
            y = view.corners[1] + (j + 0.5) / _SAMPLES * (view.corners[3] - view.corners[1])
            shown += _ground(R, P, range_m, sphere, x, y, view, ground)
    log_share = np.log(max(shown, 1) / _SAMPLES**2)
    up, p, c, y5 = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty(5)
    circle = np.empty((2, 3))
    stretch, apart2, ordered = np.empty(n), np.full(n, np.inf), np.empty(n)
    seen = 0
    for i in range(n):
        x, y = view.points_px[i, 0], view.points_px[i, 1]
        if not _ground(R, P, range_m, sphere, x, y, view, up):
            continue
        # A small circle there: any two directions along the ground.
        k = 0 if abs(up[0]) < 0.7 else 1
        length2 = 1.0 - up[k] * up[k]
        for r in range(3):
            circle[0, r] = ((1.0 if r == k else 0.0) - up[k] * up[r]) / np.sqrt(length2)
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            circle[1, r] = up[s] * circle[0, t] - up[t] * circle[0, s]
        for r in range(3):
            up[r] *= sphere
        rim_in_camera(R, P, up, circle, p, c)
        if not chart(p, c, y5):
            continue
        stretch[i] = y5[4] - y5[2]
        along = view.charts[i, 4] - view.charts[i, 2] - stretch[i]
        lean = (view.charts[i, 3] - y5[3]) * np.exp(-stretch[i])
        apart2[i] = ordered[seen] = along * along + lean * lean
        seen += 1
    spread = _ROUNDNESS2 + (median(ordered, seen) / MEDIAN2 if seen else 0.0)
    for i in range(n):
        out[i] = chance[i] - log_share
        if apart2[i] < np.inf:
            likewise = -_LN2PI - np.log(spread) - 0.5 * apart2[i] / spread - stretch[i]
            out[i] += np.log(0.5 + 0.5 * np.exp(likewise - shape_chance[i]))


@njit(cache=True, error_model="numpy")
def visible(
    view: View,
    index: SphereIndex,
    craters: Craters,
    gTc: FloatArray,
    sphere: float,
    least_px: float,
) -> int:
    """Craters whose whole rims lie in the image, of at least a mean radius in px."""
    R, P = np.empty((3, 3)), np.empty(3)
    range2 = 0.0
    for r in range(3):
        P[r] = gTc[r, 3]
        range2 += P[r] * P[r]
        for c in range(3):
            R[r, c] = gTc[r, c]
    range_m = np.sqrt(range2)
    horizon = np.arccos(min(sphere / range_m, 1.0))
    # The middle of the rims and the farthest corner bound what is seen.
    middle = np.empty(3)
    corner = np.empty(3)
    reach, stretch = 0.0, 0.0
    if not _ground(R, P, range_m, sphere, 0.5 * (view.corners[0] + view.corners[2]),
                   0.5 * (view.corners[1] + view.corners[3]), view, middle):  # fmt: skip
        for r in range(3):
            middle[r] = P[r] / range_m
        reach = horizon
    for k in range(4):
        x, y = view.corners[0 if k % 2 == 0 else 2], view.corners[1 if k < 2 else 3]
        u, v = (x - view.middle_px[0]) / view.fx_px, (y - view.middle_px[1]) / view.fy_px
        stretch = max(stretch, 0.75 * np.log(1.0 + u * u + v * v))
        if _ground(R, P, range_m, sphere, x, y, view, corner):
            cos = middle[0] * corner[0] + middle[1] * corner[1] + middle[2] * corner[2]
            reach = max(reach, np.arccos(min(max(cos, -1.0), 1.0)))
        else:
            reach = 2.0 * horizon
    if reach > horizon:
        # Around the point below, less can be seen than around another.
        reach = horizon
        for r in range(3):
            middle[r] = P[r] / range_m
    reach = min(1.02 * reach, 1.5)
    least_angle = np.log(least_px / view.focal_px) - stretch - 0.05
    least = np.log(max(range_m - sphere, 1.0)) + least_angle
    found = np.empty(_ROOM, dtype=np.int64)
    count = within(index, middle[0], middle[1], middle[2], reach, least, 30.0, found)
    while count == found.shape[0]:
        found = np.empty(4 * count, dtype=np.int64)
        count = within(index, middle[0], middle[1], middle[2], reach, least, 30.0, found)
    p, axes_c, y5 = np.empty(3), np.empty((2, 3)), np.empty(5)
    total = 0
    for k in range(count):
        # Of the far ones most are too small, however they lie.
        distance2 = 0.0
        for r in range(3):
            distance2 += (craters.centres[found[k], r] - P[r]) ** 2
        if craters.log_size[found[k]] - 0.5 * np.log(distance2) < least_angle:
            continue
        rim_in_camera(R, P, craters.centres[found[k]], craters.axes[found[k]], p, axes_c)
        if not chart(p, axes_c, y5):
            continue
        if 0.5 * (y5[2] + y5[4]) + np.log(view.focal_px) < np.log(least_px):
            continue
        half_x, half_y = half_sides_kernel(y5[2], y5[3], y5[4])
        half_x *= view.fx_px
        half_y *= view.fy_px
        x = view.middle_px[0] + view.fx_px * y5[0]
        y = view.middle_px[1] + view.fy_px * y5[1]
        total += (
            x - half_x > view.corners[0] and x + half_x < view.corners[2]
            and y - half_y > view.corners[1] and y + half_y < view.corners[3]
        )  # fmt: skip
    return total


@njit(cache=True, error_model="numpy")
def _ground(
    R: FloatArray,
    P: FloatArray,
    range_m: float,
    sphere: float,
    x: float,
    y: float,
    view: View,
    out: FloatArray,
) -> bool:
    """Write the unit vector (3,) to what a pixel shows; false when that is the sky."""
    u, v = (x - view.middle_px[0]) / view.fx_px, (y - view.middle_px[1]) / view.fy_px
    length = np.sqrt(1.0 + u * u + v * v)
    g = np.empty(3)
    along = 0.0
    for r in range(3):
        g[r] = (R[r, 0] * u + R[r, 1] * v + R[r, 2]) / length
        along -= g[r] * P[r]
    under = along * along - (range_m * range_m - sphere * sphere)
    if not (along > 0.0 and under > 0.0):
        return False
    distance = along - np.sqrt(under)
    for r in range(3):
        out[r] = (P[r] + distance * g[r]) / sphere
    return True


@njit(cache=True, error_model="numpy")
def log_evidence(
    view: View, index: SphereIndex, craters: Craters, gTc: FloatArray, match: IntArray,
    N: FloatArray, chance: FloatArray, shape_chance: FloatArray, log_prior: float,
) -> tuple[float, int]:  # fmt: skip
    """Logarithm of the ratio; pairs that chance explains better are undone, in place.

    Parameters
    ----------
    view : View
    index, craters
        Of the catalogue.
    gTc, match, N
        From `expand_inliers`.
    chance, shape_chance : ndarray, shape (n,)
        From `log_by_chance`.
    log_prior : float
        Logarithm of the density of the pose before the image was seen, per rad^3 m^3.

    Returns
    -------
    log_ratio : float
    visible : int
        Craters that should be seen.
    """
    n = match.shape[0]
    R, P = np.empty((3, 3)), np.empty(3)
    for r in range(3):
        P[r] = gTc[r, 3]
        for c in range(3):
            R[r, c] = gTc[r, c]
    e = np.empty(5)
    place, shape, rest = np.zeros(n), np.zeros(n), np.zeros(n)
    known, radius = np.empty(n), np.empty(n)
    sphere = 0.0
    pairs = 0
    for i in range(n):
        if match[i] < 0:
            continue
        if not errors(view, i, craters, match[i], R, P, e):
            match[i] = -1
            continue
        place[i] = e[0] * e[0] + e[1] * e[1]
        shape[i] = e[2] * e[2] + e[3] * e[3] + e[4] * e[4]
        rest[i] = -2.5 * _LN2PI - np.log(n)
        for r in range(5):
            rest[i] += np.log(view.precision[i, r])
        c = craters.centres[match[i]]
        sphere += np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
        pairs += 1
    if not pairs:
        return -np.inf, 0
    sphere /= pairs
    here = np.empty(n)
    chance_at(view, R, P, sphere, chance, shape_chance, here)
    for i in range(n):
        rest[i] -= here[i]
    # The noise is not known, either: each level for centres is as likely as the next, and so are shares.
    s_place = _level(place, match)
    sigma = np.empty(3)
    count = 0
    for i in range(n):
        if match[i] >= 0:
            known[count], radius[count] = shape[i], view.radius_px[i]
            count += 1
    likely_shape(known, radius, count, 1.0, s_place, sigma)
    levels = 0.0
    for size in AXIS_LEVELS:
        levels += np.exp(log_alike(size, s_place))
    total = log_alike(sigma[1], s_place) - np.log(_SIGMAS.shape[0] * levels * AXIS_SHARES.shape[0])
    smallest = np.inf
    for i in range(n):
        if match[i] < 0:
            continue
        scale = shape_scale(view, i, sigma)
        term = rest[i] - 0.5 * place[i] / s_place**2 - 0.5 * shape[i] / scale**2
        term -= 2.0 * np.log(s_place) + 3.0 * np.log(scale)
        if term < LOG_FALSE:
            match[i] = -1
            pairs -= 1
        else:
            total += term
            smallest = min(smallest, view.radius_px[i])
    if not pairs:
        return -np.inf, 0
    seen = max(visible(view, index, craters, gTc, sphere, smallest), pairs)
    total += lgamma(pairs + 1.0) + lgamma(seen - pairs + 1.0) - lgamma(seen + 2.0)
    clutter = -np.inf
    for f in _FALSE_SHARES:
        clutter = max(clutter, (1.0 - f) * n + (n - pairs) * np.log(f))
    total += clutter - np.log(_FALSE_SHARES.shape[0])
    return total + log_prior + 3.0 * _LN2PI - 0.5 * _log_det(N), seen


@njit(cache=True, error_model="numpy")
def _level(d2: FloatArray, match: IntArray) -> float:
    """Give the noise of centres, px, that explains squared errors best."""
    best, value = _SIGMAS[0], -np.inf
    for s in _SIGMAS:
        total = 0.0
        for i in range(match.shape[0]):
            if match[i] >= 0:
                total -= 0.5 * d2[i] / (s * s) + 2.0 * np.log(s)
        if total > value:
            best, value = s, total
    return best


@njit(cache=True, error_model="numpy")
def _log_det(N: FloatArray) -> float:
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
