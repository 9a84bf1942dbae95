"""From a hypothesis to all rims that agree with it: the pose by Gauss-Newton on their charts, and back."""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.matching.identify_grid import Grid, within
from craternav_fg.matching.identify_pose import CRATERS, HYPOTHESIS, POSITION, RIMS, ROTATION, SPHERE, seat
from craternav_fg.matching.identify_view import View
from factors.kernels import packed
from factors.kernels.conic import chart, rim_in_camera
from factors.kernels.gauss_newton import prior_terms, screw, solve
from factors.kernels.robust import HUBER

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_ROUNDS = 12
_STEPS = 3
_GATE = 3.5
_SHAPE_GATE2 = 18.0
_MOST_PX = 60.0
_SIGMA_RANGE = (0.25, 8.0)
# Medians of chi-squares of 2 and 3 degrees of freedom.
_MEDIAN2, _MEDIAN3 = 1.386, 2.366
_HUBER = 4.0
_ROOM = 256
_SETTLINGS = 3
# Degrees of freedom that the noise of one kind of error takes from both.
_BORROWED = 4.0
# A noise that leaves an error no weight, px.
_UNUSED = 1e6


@njit(cache=True, error_model="numpy")
def frame_data(
    view: View, centres: FloatArray, axes: FloatArray, match: IntArray, sigma: FloatArray
) -> FloatArray:
    """Pack the matched rims for the conic-shape kernel; `sigma` (2,) scales errors of centre and shape."""
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
            L[k, r] = centres[match[i], r]
            for a in range(2):
                A[k, a, r] = axes[match[i], a, r]
        for r in range(5):
            y[k, r] = view.charts[i, r]
            W[k, r, r] = view.precision[i, r] / (sigma[0] if r < 2 else sigma[1])
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
    view: View, i: int, crater: int, centres: FloatArray, axes: FloatArray, R: FloatArray, P: FloatArray,
    e: FloatArray,
) -> bool:  # fmt: skip
    """Write a rim's errors (5,), measured less predicted, over those at 1 px noise; false when unseen."""
    p, c = np.empty(3), np.empty((2, 3))
    rim_in_camera(R, P, centres[crater], axes[crater], p, c)
    if not chart(p, c, e):
        return False
    for r in range(5):
        e[r] = (view.charts[i, r] - e[r]) * view.precision[i, r]
    return True


@njit(cache=True, error_model="numpy")
def rematch(
    view: View, grid: Grid, centres: FloatArray, axes: FloatArray, gTc: FloatArray, sphere: float,
    covariance: FloatArray, sigma: FloatArray, match: IntArray, d2: FloatArray,
) -> int:  # fmt: skip
    """Write each rim's crater (n,), -1 of none, at a pose of some covariance; give the number of pairs."""
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
        d2[i] = np.inf
        seen, size, distance = seat(view, i, pose, X)
        if not seen:
            continue
        place2, size2 = _spread_px(view, i, distance, covariance)
        doubt_px = np.sqrt(sigma[0] ** 2 + (0.01 * view.radius_px[i]) ** 2 + place2)
        # An ellipse's centre is not the image of the crater's.
        gate_px = min(_GATE * doubt_px, _MOST_PX) + 0.05 * view.radius_px[i]
        share2 = (0.5 * sigma[1] / view.radius_px[i]) ** 2 + 0.02**2 + size2
        slack = min(_GATE * np.sqrt(share2) + 0.03, 0.6)
        angle = gate_px * distance / (view.focal_px * sphere)
        count = within(grid, X[0], X[1], X[2], min(angle, 0.5), size - slack, size + slack, found)
        for k in range(count):
            if not errors(view, i, found[k], centres, axes, R, P, e):
                continue
            place = (e[0] * e[0] + e[1] * e[1]) / (sigma[0] ** 2 + place2)
            shape = (e[2] * e[2] + e[3] * e[3] + e[4] * e[4]) / (
                sigma[1] ** 2 + size2 * view.radius_px[i] ** 2
            )
            if place < _GATE * _GATE and shape < _SHAPE_GATE2 and place + shape < d2[i]:
                d2[i] = place + shape
                match[i] = found[k]
    # Of two rims at one crater the better keeps it.
    for i in range(n):
        for j in range(i):
            if match[i] >= 0 and match[i] == match[j]:
                match[i if d2[i] >= d2[j] else j] = -1
    for i in range(n):
        pairs += match[i] >= 0
    return pairs


@njit(cache=True, error_model="numpy")
def _median(values: FloatArray, count: int) -> float:
    """Give the median of the first `count` values, which are put in order: numpy's compiles for seconds."""
    for i in range(1, count):
        value = values[i]
        j = i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@njit(cache=True, error_model="numpy")
def squares(
    view: View, centres: FloatArray, axes: FloatArray, gTc: FloatArray, match: IntArray, place: FloatArray,
    shape: FloatArray,
) -> int:  # fmt: skip
    """Write the squared errors of the pairs' centres and shapes, over those at 1 px; give their number."""
    R, P = np.empty((3, 3)), np.empty(3)
    for r in range(3):
        P[r] = gTc[r, 3]
        for c in range(3):
            R[r, c] = gTc[r, c]
    e = np.empty(5)
    count = 0
    for i in range(match.shape[0]):
        if match[i] >= 0 and errors(view, i, match[i], centres, axes, R, P, e):
            place[count] = e[0] * e[0] + e[1] * e[1]
            shape[count] = e[2] * e[2] + e[3] * e[3] + e[4] * e[4]
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def estimate_sigma(
    view: View, centres: FloatArray, axes: FloatArray, gTc: FloatArray, match: IntArray, sigma: FloatArray
) -> None:
    """Write the noise (2,) of centres and shapes, px, that the pairs show: from medians."""
    n = match.shape[0]
    place, shape = np.empty(n), np.empty(n)
    count = squares(view, centres, axes, gTc, match, place, shape)
    if count:
        # What the pose has adapted to of the noise.
        share = 5.0 * count / max(5.0 * count - 6.0, 1.0)
        least, most = _SIGMA_RANGE
        sigma[0] = min(max(np.sqrt(_median(place, count) / _MEDIAN2 * share), least), most)
        sigma[1] = min(max(np.sqrt(_median(shape, count) / _MEDIAN3 * share), least), most)


def settle(
    view: View, centres: FloatArray, axes: FloatArray, prior: FloatArray, weight: FloatArray, gTc: FloatArray,
    match: IntArray, sigma: FloatArray,
) -> FloatArray:  # fmt: skip
    """Give the covariance (6, 6) of a pose, for its right twist; pose and noise come to agree, in place.

    Of few rims' centres the pose takes up nearly all errors: each kind is held against the freedom that is
    left to it, and borrows from the other where that is little. The noise being estimated, the pose is
    distributed as Student's t.

    Parameters
    ----------
    view, centres, axes
        Rims; craters.
    prior, weight, gTc, match, sigma
        As in `grow`.
    """
    n = len(match)
    place, shape = np.empty(n), np.empty(n)
    N, part, g = np.empty((6, 6)), np.empty((6, 6)), np.empty(6)
    freedom = 1.0
    for _ in range(_SETTLINGS):
        refine(gTc, frame_data(view, centres, axes, match, sigma), prior, weight, _STEPS, N)
        alone = frame_data(view, centres, axes, match, np.array([sigma[0], _UNUSED]))
        information(gTc, alone, prior, np.zeros((6, 6)), part, g)
        taken = float(np.trace(np.linalg.solve(N, part)))
        count = squares(view, centres, axes, gTc, match, place, shape)
        left = max(2.0 * count - taken, 0.0), max(3.0 * count - max(6.0 - taken, 0.0), 1.0)
        sums = place[:count].sum(), shape[:count].sum()
        freedom = left[0] + left[1]
        for k in range(2):
            borrowed = _BORROWED * (sums[0] + sums[1]) / freedom
            sigma[k] = np.clip(np.sqrt((sums[k] + borrowed) / (left[k] + _BORROWED)), *_SIGMA_RANGE)
    refine(gTc, frame_data(view, centres, axes, match, sigma), prior, weight, _STEPS, N)
    covariance = np.empty((6, 6))
    covariance_of(N, covariance)
    return covariance * freedom / max(freedom - 2.0, 1.0)


@njit(cache=True, error_model="numpy")
def grow(
    view: View, grid: Grid, centres: FloatArray, axes: FloatArray, pose: FloatArray,
    noise: float, prior: FloatArray, weight: FloatArray, gTc: FloatArray, match: IntArray, N: FloatArray,
    sigma: FloatArray,
) -> int:  # fmt: skip
    """Grow a hypothesis until its pairs no longer change; give their number, 0 when it came to nothing.

    Parameters
    ----------
    view, grid, centres, axes
        Rims; craters.
    pose : ndarray, shape (HYPOTHESIS,)
        Where to begin.
    noise : float
        First guess, px.
    prior, weight : ndarray, shape (4, 4), (6, 6)
        Known attitude; without any, `weight` is zero.
    gTc, match, N, sigma : ndarray, shape (4, 4), (n,), (6, 6), (2,)
        Written: pose, each rim's crater, information, noise.
    """
    for r in range(3):
        gTc[r, 3] = pose[POSITION + r]
        gTc[3, r] = 0.0
        for c in range(3):
            gTc[r, c] = pose[ROTATION + 3 * r + c]
    gTc[3, 3] = 1.0
    n = match.shape[0]
    for i in range(n):
        match[i] = -1
    used = 0
    for k in range(3):
        if pose[RIMS + k] >= 0.0:
            match[int(pose[RIMS + k])] = int(pose[CRATERS + k])
            used += 1
    sigma[:] = noise
    covariance = np.empty((6, 6))
    before = np.empty(n, dtype=np.int64)
    d2 = np.empty(n)
    pairs = used
    for turn in range(_ROUNDS):
        data = frame_data(view, centres, axes, match, sigma)
        if not refine(gTc, data, prior, weight, _STEPS, N):
            return 0
        covariance_of(N, covariance)
        for a in range(6):
            if not 0.0 < covariance[a, a] < np.inf:
                return 0
        if turn > 1 and pairs > 3:
            estimate_sigma(view, centres, axes, gTc, match, sigma)
        sphere = 0.0
        for i in range(n):
            before[i] = match[i]
            if match[i] >= 0:
                c = match[i]
                sphere += np.sqrt(centres[c, 0] ** 2 + centres[c, 1] ** 2 + centres[c, 2] ** 2) / pairs
        pairs = rematch(view, grid, centres, axes, gTc, sphere, covariance, sigma, match, d2)
        if pairs < used or pairs < 2:
            return 0
        same = True
        for i in range(n):
            same = same and match[i] == before[i]
        if same and turn > 2:
            break
    data = frame_data(view, centres, axes, match, sigma)
    if not refine(gTc, data, prior, weight, _STEPS, N):
        return 0
    return pairs
