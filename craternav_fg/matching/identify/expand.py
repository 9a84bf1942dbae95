"""From a hypothesis to all rims that agree with it: the pose by Gauss-Newton on their charts, and back."""

import numpy as np
import numpy.typing as npt
from numba import njit

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
    MEDIAN2,
    SIGMA_RANGE,
    USUAL_SHARE,
    likely_shape,
    median,
    shape_scale,
)
from craternav_fg.matching.identify.view import AXIS_PX, View
from factors.kernels import packed
from factors.kernels.conic import chart, rim_in_camera
from factors.kernels.gauss_newton import prior_terms, screw, solve
from factors.kernels.robust import HUBER

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_ROUNDS = 12
STEPS = 3
_GATE = 3.5
_SHAPE_GATE2 = 18.0
_MOST_PX = 60.0
_HUBER = 4.0
_ROOM = 256
_LN2PI = float(np.log(2.0 * np.pi))
# Of the rims of an image the share that is false, as logarithm: what competes with a crater for a rim.
LOG_FALSE = -1.0
# Degrees of freedom that the noise searched with has, against that which is seen.
_HELD = 4.0


@njit(cache=True, error_model="numpy")
def frame_data(view: View, craters: Craters, match: IntArray, sigma: FloatArray) -> FloatArray:
    """Pack the matched rims for the conic-shape kernel; `sigma` (3,) is the noise."""
    n = 0
    for i in range(match.shape[0]):
        n += match[i] >= 0
    L, A = np.empty((n, 3)), np.empty((n, 2, 3))
    y, W = np.empty((n, 5)), np.zeros((n, 5, 5))
    k = -1
    for i in range(match.shape[0]):
        if match[i] < 0:
            continue
        k += 1
        for r in range(3):
            L[k, r] = craters.centres[match[i], r]
            for a in range(2):
                A[k, a, r] = craters.axes[match[i], a, r]
        for r in range(5):
            y[k, r] = view.charts[i, r]
            W[k, r, r] = view.precision[i, r] / (sigma[0] if r < 2 else shape_scale(view, i, sigma))
    bTc = np.zeros((4, 4))
    for r in range(4):
        bTc[r, r] = 1.0
    return packed.pack(bTc, L, A, y, W, HUBER, _HUBER)


@njit(cache=True, error_model="numpy")
def information(
    gTc: FloatArray, data: FloatArray, prior: FloatArray, weight: FloatArray, N: FloatArray, g: FloatArray
) -> bool:
    """Write normal matrix (6, 6) and gradient (6,) of rims and prior at a pose; false when not finite."""
    count = (data.shape[0] - packed.HEADER) // packed.CRATER
    out = np.empty((7, 5 * count))
    packed.shape_residuals(gTc, data, True, out)
    if weight[0, 0] > 0.0:
        prior_terms(prior, weight, gTc, N, g)
    else:
        N[:] = 0.0
        g[:] = 0.0
    for a in range(6):
        for k in range(5 * count):
            g[a] += out[a, k] * out[6, k]
        for b in range(a + 1):
            total = 0.0
            for k in range(5 * count):
                total += out[a, k] * out[b, k]
            N[a, b] += total
            if a != b:
                N[b, a] += total
    trace = 0.0
    for a in range(6):
        trace += N[a, a]
    return trace < np.inf


@njit(cache=True, error_model="numpy")
def _taken(gTc: FloatArray, data: FloatArray, covariance: FloatArray) -> float:
    """Degrees of freedom that a pose of some covariance takes from the rims' centres."""
    count = (data.shape[0] - packed.HEADER) // packed.CRATER
    out = np.empty((7, 5 * count))
    packed.shape_residuals(gTc, data, True, out)
    total = 0.0
    for k in range(5 * count):
        if k % 5 < 2:
            for a in range(6):
                for b in range(6):
                    total += out[a, k] * covariance[a, b] * out[b, k]
    return total


@njit(cache=True, error_model="numpy")
def covariance_of(N: FloatArray, out: FloatArray) -> None:
    """Write the inverse (6, 6) of an information matrix."""
    unit = np.empty(6)
    for a in range(6):
        unit[:] = 0.0
        unit[a] = 1.0
        solve(N, unit, out[a])


@njit(cache=True, error_model="numpy")
def refine(
    gTc: FloatArray, data: FloatArray, prior: FloatArray, weight: FloatArray, steps: int, N: FloatArray
) -> bool:
    """Move a pose to the rims in a few Gauss-Newton steps, in place; N is of the last step."""
    g = np.empty(6)
    step = np.empty(6)
    range_m = np.sqrt(gTc[0, 3] ** 2 + gTc[1, 3] ** 2 + gTc[2, 3] ** 2)
    for k in range(steps + 1):
        if not information(gTc, data, prior, weight, N, g):
            return False
        if k == steps:
            break
        solve(N, g, step)
        turn = 0.0
        shift = 0.0
        for a in range(3):
            turn += step[a] ** 2
            shift += step[3 + a] ** 2
        if not (turn < 1.0 and shift < range_m * range_m):
            return False
        for a in range(6):
            step[a] = -step[a]
        screw(gTc, step)
        if turn < 1e-14 and shift < 1e-4:
            break
    return True


@njit(cache=True, error_model="numpy")
def _spread_px(view: View, i: int, distance: float, covariance: FloatArray) -> tuple[float, float]:
    """Variance of where a pose puts what a rim shows, px^2 a coordinate, and of its relative size."""
    u, v = view.charts[i, 0], view.charts[i, 1]
    z = distance / np.sqrt(1.0 + u * u + v * v)
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
def errors(
    view: View, i: int, craters: Craters, crater: int, R: FloatArray, P: FloatArray,
    e: FloatArray,
) -> bool:  # fmt: skip
    """Write a rim's errors (5,), measured less predicted, over those at 1 px noise; false when unseen."""
    p, c = np.empty(3), np.empty((2, 3))
    rim_in_camera(R, P, craters.centres[crater], craters.axes[crater], p, c)
    if not chart(p, c, e):
        return False
    for r in range(5):
        e[r] = (view.charts[i, r] - e[r]) * view.precision[i, r]
    return True


@njit(cache=True, error_model="numpy")
def rematch(
    view: View, index: SphereIndex, craters: Craters, gTc: FloatArray, sphere: float,
    covariance: FloatArray, sigma: FloatArray, chance: FloatArray, match: IntArray, weight: FloatArray,
) -> int:  # fmt: skip
    """Write each rim's crater (n,), -1 of none, at a pose of some covariance; give the number of pairs.

    A rim has a crater when that is more probable than all others around, and than that the rim is false:
    where the pose is so uncertain that any of several craters may be the rim's, none is.

    Parameters
    ----------
    view : View
    index, craters
        Of the catalogue.
    gTc, sphere, covariance
        Pose of the camera, radius of the ground there, covariance of the pose.
    sigma : ndarray, shape (3,)
        Noise, as `identify_noise` has it.
    chance : ndarray, shape (n,)
        Logarithm of each rim's density among rims by chance, from `identify_evidence.log_by_chance`.
    match : ndarray of int, shape (n,)
        Written.
    weight : ndarray, shape (n,)
        Written: logarithm of the density of each rim at its crater.
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
    found = np.empty(_ROOM, dtype=np.int64)
    pairs = 0
    for i in range(n):
        match[i] = -1
        weight[i] = -np.inf
        seen, size, distance = project_to_sphere(view, i, pose, X)
        if not seen:
            continue
        place2, size2 = _spread_px(view, i, distance, covariance)
        doubt_px = np.sqrt(sigma[0] ** 2 + (0.01 * view.radius_px[i]) ** 2 + place2)
        # An ellipse's centre is not the image of the crater's.
        gate_px = min(_GATE * doubt_px, _MOST_PX) + 0.05 * view.radius_px[i]
        shape2 = shape_scale(view, i, sigma) ** 2
        share2 = shape2 * (AXIS_PX / view.radius_px[i]) ** 2 + size2
        slack = min(_GATE * np.sqrt(share2) + 0.03, 0.6)
        angle = gate_px * distance / (view.focal_px * sphere)
        count = within(index, X[0], X[1], X[2], min(angle, 0.5), size - slack, size + slack, found)
        if count == _ROOM:
            continue
        place_var, size_var = sigma[0] ** 2 + place2, shape2 + size2 * view.radius_px[i] ** 2
        density = -2.5 * _LN2PI - np.log(place_var) - 0.5 * np.log(size_var) - np.log(shape2)
        for r in range(5):
            density += np.log(view.precision[i, r])
        # Relative to a rim that is false.
        density -= np.log(n) + chance[i] + LOG_FALSE
        rest = 1.0
        for k in range(count):
            if not errors(view, i, craters, found[k], R, P, e):
                continue
            place = (e[0] * e[0] + e[1] * e[1]) / place_var
            shape = (e[2] * e[2] + e[3] * e[3] + e[4] * e[4]) / size_var
            if not (place < _GATE * _GATE and shape < _SHAPE_GATE2):
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
    # Of two rims at one crater the better keeps it.
    for i in range(n):
        for j in range(i):
            if match[i] >= 0 and match[i] == match[j]:
                match[i if weight[i] <= weight[j] else j] = -1
    for i in range(n):
        pairs += match[i] >= 0
    return pairs


@njit(cache=True, error_model="numpy")
def estimate_sigma(
    view: View, craters: Craters, gTc: FloatArray, match: IntArray, noise: float,
    places: float, shapes: float, sigma: FloatArray,
) -> None:  # fmt: skip
    """Write the noise (3,) that the pairs show: of centres by the median, of shapes as is most probable.

    Parameters
    ----------
    view, craters, gTc, match
        Rims; craters; pose.
    noise : float
        What few pairs are held against, px.
    places, shapes : float
        Degrees of freedom that the pose takes from centres and from shapes.
    sigma : ndarray, shape (3,)
        Written, as `identify_noise` has it.
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
        if match[i] >= 0 and errors(view, i, craters, match[i], R, P, e):
            place[count] = e[0] * e[0] + e[1] * e[1]
            shape[count] = e[2] * e[2] + e[3] * e[3] + e[4] * e[4]
            radius[count] = view.radius_px[i]
            count += 1
    if not count:
        return
    least, most = SIGMA_RANGE
    left = max(2.0 * count - places, 0.0)
    square = 2.0 * count * median(place, count) / MEDIAN2 + _HELD * noise * noise
    sigma[0] = min(max(np.sqrt(square / (left + _HELD)), least), most)
    left = max(1.0 - shapes / (3.0 * count), 0.0)
    likely_shape(shape, radius, count, left, sigma[0], sigma)


@njit(cache=True, error_model="numpy")
def expand_inliers(
    view: View, index: SphereIndex, craters: Craters, noise: float, chance: FloatArray,
    prior: FloatArray, weight: FloatArray, gTc: FloatArray, match: IntArray, N: FloatArray, sigma: FloatArray,
) -> int:  # fmt: skip
    """Grow a pose from some pairs until these no longer change; give their number, 0 when it came to nothing.

    Parameters
    ----------
    view : View
    index, craters
        Of the catalogue.
    noise : float
        First guess, px.
    chance : ndarray, shape (n,)
        Logarithm of each rim's density among rims by chance, from `identify_evidence.log_by_chance`.
    prior, weight : ndarray, shape (4, 4), (6, 6)
        Known attitude; without any, `weight` is zero.
    gTc, match : ndarray, shape (4, 4), (n,)
        Where to begin, the pose and each rim's crater; written.
    N, sigma : ndarray, shape (6, 6), (3,)
        Written: information, noise as `identify_noise` has it.
    """
    n = match.shape[0]
    used = 0
    for i in range(n):
        used += match[i] >= 0
    sigma[0] = sigma[1] = noise
    sigma[2] = USUAL_SHARE
    covariance = np.empty((6, 6))
    before = np.empty(n, dtype=np.int64)
    likely = np.empty(n)
    pairs = used
    for turn in range(_ROUNDS):
        data = frame_data(view, craters, match, sigma)
        if not refine(gTc, data, prior, weight, STEPS, N):
            return 0
        covariance_of(N, covariance)
        for a in range(6):
            if not 0.0 < covariance[a, a] < np.inf:
                return 0
        if turn > 1 and pairs > 3:
            places = _taken(gTc, data, covariance)
            estimate_sigma(view, craters, gTc, match, noise, places, 6.0 - places, sigma)
        sphere = 0.0
        for i in range(n):
            before[i] = match[i]
            if match[i] >= 0:
                c = craters.centres[match[i]]
                sphere += np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2) / pairs
        pairs = rematch(view, index, craters, gTc, sphere, covariance, sigma, chance, match, likely)
        if pairs < min(used, 3) or pairs < 2:
            return 0
        same = True
        for i in range(n):
            same = same and match[i] == before[i]
        if same and turn > 2:
            break
    data = frame_data(view, craters, match, sigma)
    if not refine(gTc, data, prior, weight, STEPS, N):
        return 0
    return pairs
