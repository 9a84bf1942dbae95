"""Kernels of the maximum-likelihood solver: rims in the ellipse chart, prior, sun's tilt.

Levenberg-Marquardt on the normal equations, from many initial poses, for six unknowns, or three with an exact
attitude. Distances between poses are measured in standard deviations, by the information at the better one.
"""

import numpy as np

from craternav_fg.resection.start_kernel import start_at_attitude, start_pair, starts_of_one
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import prior_terms, screw, screw_between, solve, substitute
from factors.kernels.packed import CRATER, HEADER, pack, shape_residuals
from factors.kernels.robust import NONE
from factors.kernels.sun import sun_tilt, wrap

# Factors on the noise with which the problem is solved in turn, before the noise itself, from a prior's pose:
# with so much noise the prior prevails, and the minimum is near it.
_NOISE_FACTORS = np.array([300.0, 30.0, 3.0])

# A step that is predicted to lower the cost by less is the last: it is below 1e-4 standard deviations.
_MIN_GAIN = 1e-8
# Relative increase of the cost that is only rounding.
_ROUNDING = 1e-14
# Damping of Levenberg-Marquardt: initial, least and most value.
_INITIAL_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-4, 1e-9, 1e8
# Squared distance, in standard deviations, within which two poses are one: 0.2 standard deviations.
_SAME_DISTANCE2 = 0.04
# Iterations after which a minimisation is judged promising or not.
_FIRST_ITERATIONS = 8
# Iterations by which poses are moved onto the curve that a single rim leaves.
_CURVE_ITERATIONS = 4


@njit(cache=True, error_model="numpy")
def normal_equations(
    gTb: FloatArray, bTc: FloatArray, data: FloatArray, prior: FloatArray, prior_weight: FloatArray,
    sun: FloatArray, noise: float, out: FloatArray, N: FloatArray, g: FloatArray,
) -> float:  # fmt: skip
    """Compute the normal equations of rims, prior and sun for the body's right twist [w, rho].

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Poses.
    data : ndarray, shape (packed,)
        The rims, from `packed.pack`, without a loss.
    prior : ndarray, shape (4, 4)
        Pose gTb of the prior.
    prior_weight : ndarray, shape (6, 6) or (0, 0)
        See `ResectionProblem.prior_arrays`.
    sun : ndarray, shape (7,) or (0,)
        See `ResectionProblem.sun_array`.
    noise : float
        Factor on the standard deviations of rims and sun.
    out : ndarray, shape (7, 5 n)
        Written: Jacobian and residuals as by `packed.shape_residuals`, without `noise`.
    N : ndarray, shape (6, 6)
        Written: information, rad and m in b.
    g : ndarray, shape (6,)
        Written: gradient of half the cost, per rad and m in b.

    Returns
    -------
    float
        Cost: squared norm of all whitened residuals.
    """
    cost = 0.0
    if prior_weight.shape[0]:
        cost = prior_terms(prior, prior_weight, gTb, N, g)
    else:
        N[:] = 0.0
        g[:] = 0.0
    shape_residuals(gTb, data, True, out)
    weight = 1.0 / (noise * noise)
    rows = out.shape[1]
    total = 0.0
    for r in range(rows):
        total += out[6, r] * out[6, r]
    cost += weight * total
    for i in range(6):
        total = 0.0
        for r in range(rows):
            total += out[i, r] * out[6, r]
        g[i] += weight * total
        for j in range(i + 1):
            total = 0.0
            for r in range(rows):
                total += out[i, r] * out[j, r]
            N[i, j] += weight * total
            if j < i:
                N[j, i] = N[i, j]
    if sun.shape[0]:
        Js = np.empty((1, 6))
        tilt, strength = sun_tilt(gTb, bTc, sun[:3], sun[3], sun[4], Js)
        if strength > 0.0:
            weight /= sun[6] * sun[6]
            off = wrap(tilt - sun[5])
            cost += weight * off * off
            for i in range(6):
                g[i] += weight * Js[0, i] * off
                for j in range(6):
                    N[i, j] += weight * Js[0, i] * Js[0, j]
    return cost


@njit(cache=True, error_model="numpy")
def _copy(a: FloatArray, b: FloatArray) -> None:
    """Copy a matrix a into b; numba takes seconds to compile a slice's assignment."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            b[i, j] = a[i, j]


@njit(cache=True, error_model="numpy")
def minimise(
    gTb: FloatArray, bTc: FloatArray, data: FloatArray, prior: FloatArray, prior_weight: FloatArray,
    sun: FloatArray, noise: float, first: int, iterations: int, N: FloatArray,
) -> tuple[float, bool]:  # fmt: skip
    """Minimise the cost by Levenberg-Marquardt.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Initial pose; moved in place.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    data : ndarray, shape (packed,)
        As in `normal_equations`.
    prior, prior_weight : ndarray, shapes (4, 4), (6, 6) or (0, 0)
        As in `normal_equations`.
    sun : ndarray, shape (7,) or (0,)
        As in `normal_equations`.
    noise : float
        As in `normal_equations`.
    first : int
        First coordinate that moves: 0, or 3 to keep the attitude.
    iterations : int
        Largest number of linearisations.
    N : ndarray, shape (6, 6)
        Written: information at the pose, rad and m in b.

    Returns
    -------
    cost : float
    converged : bool
    """
    out = np.empty((7, 5 * ((data.shape[0] - HEADER) // CRATER)))
    g, step = np.empty(6), np.zeros(6)
    trial_N, trial_g = np.empty((6, 6)), np.empty(6)
    damped = np.empty((6 - first, 6 - first))
    trial = np.empty((4, 4))
    cost = normal_equations(gTb, bTc, data, prior, prior_weight, sun, noise, out, N, g)
    damping = _INITIAL_DAMPING
    for _ in range(iterations):
        for i in range(first, 6):
            for j in range(first, 6):
                damped[i - first, j - first] = N[i, j]
            damped[i - first, i - first] *= 1.0 + damping
        solve(damped, g[first:], step[first:])
        gain = 0.0
        for i in range(first, 6):
            gain += step[i] * g[i]
            step[i] = -step[i]
        _copy(gTb, trial)
        screw(trial, step)
        new = normal_equations(trial, bTc, data, prior, prior_weight, sun, noise, out, trial_N, trial_g)
        # Also false for NaN.
        if new <= cost * (1.0 + _ROUNDING):
            _copy(trial, gTb)
            _copy(trial_N, N)
            for i in range(6):
                g[i] = trial_g[i]
            cost = new
            damping = max(0.1 * damping, _MIN_DAMPING)
            if gain < _MIN_GAIN:
                return cost, True
        else:
            # Of so short a step, rounding decides whether it goes down.
            if gain < _MIN_GAIN:
                return cost, True
            damping *= 10.0
            if damping > _MAX_DAMPING:
                break
    return cost, False


@njit(cache=True, error_model="numpy")
def covariance_and_log_det(N: FloatArray, first: int, covariance: FloatArray) -> float:
    """Invert an information matrix.

    Parameters
    ----------
    N : ndarray, shape (6, 6)
        Information, rad and m in b.
    first : int
        First coordinate that is estimated; the others are exact.
    covariance : ndarray, shape (6, 6)
        Written: the inverse of the estimated part, zero in the other rows and columns.

    Returns
    -------
    float
        Natural logarithm of the determinant of the estimated part; NaN, as the covariance, when it is not
        positive definite.
    """
    n = 6 - first
    L = np.zeros((n, n))
    log = 0.0
    for i in range(n):
        for j in range(i + 1):
            # Scaled to a unit diagonal: radians and metres differ by orders of magnitude.
            total = N[first + i, first + j] / np.sqrt(N[first + i, first + i] * N[first + j, first + j])
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
        log += 2.0 * np.log(L[i, i]) + np.log(N[first + i, first + i])
    covariance[:] = 0.0
    for c in range(n):
        x = covariance[first + c, first:]
        x[c] = 1.0
        substitute(L, x)
        for i in range(n):
            x[i] /= np.sqrt(N[first + i, first + i] * N[first + c, first + c])
    return log


@njit(cache=True, error_model="numpy")
def squared_distance(a: FloatArray, b: FloatArray, N: FloatArray) -> float:
    """Compute the squared distance of two poses in standard deviations.

    Parameters
    ----------
    a, b : ndarray, shape (4, 4)
        Poses gTb.
    N : ndarray, shape (6, 6)
        Information at a for its right twist in b, rad and m.

    Returns
    -------
    float
    """
    delta = np.empty(6)
    screw_between(a, b, delta)
    total = 0.0
    for i in range(6):
        for j in range(6):
            total += delta[i] * N[i, j] * delta[j]
    return total


@njit(cache=True, error_model="numpy")
def all_starts(
    bTc: FloatArray, centres: FloatArray, axes: FloatArray, charts: FloatArray, attitude: FloatArray,
    reference: IntArray,
) -> FloatArray:  # fmt: skip
    """Make initial poses in closed form from several rims.

    Parameters
    ----------
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes, charts : ndarray, shapes (n, 3), (n, 2, 3), (n, 5)
        See `MatchedRims`.
    attitude : ndarray, shape (3, 3) or (0, 0)
        Known rotation gRb; empty when it is unknown.
    reference : ndarray of int, shape (r,)
        Rims from which poses are made: with a known attitude one each, else the two of each rim's plane.

    Returns
    -------
    ndarray, shape (k, 4, 4)
        Poses gTb.
    """
    n = charts.shape[0]
    if attitude.shape[0]:
        out = np.empty((len(reference), 4, 4))
        for k, i in enumerate(reference):
            start_at_attitude(attitude, bTc, centres[i], axes[i], charts[i], out[k])
        return out
    out = np.empty((2 * len(reference), 4, 4))
    everybody = np.arange(n)
    for k, i in enumerate(reference):
        start_pair(i, everybody, bTc, centres, axes, charts, out[2 * k : 2 * k + 2])
    return out


@njit(cache=True, error_model="numpy")
def starts_on_curve(
    bTc: FloatArray, centres: FloatArray, axes: FloatArray, charts: FloatArray, data: FloatArray,
    prior: FloatArray, prior_weight: FloatArray, sun: FloatArray, first: int, rolls: int,
) -> FloatArray:  # fmt: skip
    """Make initial poses from a single rim, which determines a pose up to a curve.

    The curve is narrow and bent: a minimisation that includes prior and sun would follow it in tiny steps. So
    poses all along it are first fitted to the rim alone. With prior or sun, those are kept whose cost is
    lower than their neighbours', and every eighth one for minima beside the curve. Without, every fourth is
    kept as a sample of the curve.

    Parameters
    ----------
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes, charts : ndarray, shapes (1, 3), (1, 2, 3), (1, 5)
        See `MatchedRims`.
    data : ndarray, shape (packed,)
        As in `normal_equations`.
    prior, prior_weight : ndarray, shapes (4, 4), (6, 6) or (0, 0)
        As in `normal_equations`.
    sun : ndarray, shape (7,) or (0,)
        As in `normal_equations`.
    first : int
        As in `minimise`.
    rolls : int
        Steps of the rotation about the rim's normal; two poses each.

    Returns
    -------
    ndarray, shape (k, 4, 4)
        Poses gTb.
    """
    poses = starts_of_one(rolls, bTc, centres[0], axes[0], charts[0])
    total = poses.shape[0]
    costs = np.empty(total)
    out, N, g = np.empty((7, 5)), np.empty((6, 6)), np.empty(6)
    nothing = np.empty((0, 0))
    # Not a constant: numba would compile `minimise` once more for it.
    iterations = min(_CURVE_ITERATIONS, total)
    for k in range(total):
        minimise(
            poses[k], bTc, data, prior, nothing, sun[:0], 1.0, first, iterations, N
        )  # fmt: skip
        costs[k] = normal_equations(poses[k], bTc, data, prior, prior_weight, sun, 1.0, out, N, g)
    chosen = np.empty((total, 4, 4))
    count = 0
    for k in range(total):
        if prior_weight.shape[0] + sun.shape[0]:
            # Poses of the two planes alternate.
            best = costs[k] <= costs[(k + 2) % total] and costs[k] <= costs[(k - 2) % total]
            best = best or k % 16 < 2
        else:
            best = k % 8 < 2
        if best:
            _copy(poses[k], chosen[count])
            count += 1
    return chosen[:count]


@njit(cache=True, error_model="numpy")
def solutions(
    bTc: FloatArray, centres: FloatArray, axes: FloatArray, charts: FloatArray, W: FloatArray,
    prior: FloatArray, prior_weight: FloatArray, sun: FloatArray, attitude: FloatArray, first: int,
    reference: IntArray, rolls: int, iterations: int, window: float,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:  # fmt: skip
    """Find the distinct local minima that the initial poses lead to.

    Parameters
    ----------
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes, charts : ndarray, shapes (n, 3), (n, 2, 3), (n, 5)
        See `MatchedRims`.
    W : ndarray, shape (n, 5, 5)
        Whitening of the charts, see `MatchedRims`.
    prior, prior_weight : ndarray, shapes (4, 4), (6, 6) or (0, 0)
        As in `normal_equations`.
    sun : ndarray, shape (7,) or (0,)
        As in `normal_equations`.
    attitude : ndarray, shape (3, 3) or (0, 0)
        Known rotation gRb; empty when it is unknown.
    first : int
        As in `minimise`.
    reference : ndarray of int, shape (r,)
        Rims from which initial poses are made.
    rolls : int
        Steps of the rotation about its normal that a single rim leaves free.
    iterations : int
        Largest number of linearisations of each minimisation.
    window : float
        Minima whose cost exceeds the least by more are not pursued.

    Returns
    -------
    gTb : ndarray, shape (k, 4, 4)
        Poses, lowest cost first.
    cost : ndarray, shape (k,)
        Squared norms of the whitened residuals.
    N : ndarray, shape (k, 6, 6)
        Information, rad and m in b.
    converged : ndarray of bool, shape (k,)
    """
    data = pack(bTc, centres, axes, charts, W, NONE, 1.0)
    if charts.shape[0] == 1 and not attitude.shape[0]:
        starts = starts_on_curve(bTc, centres, axes, charts, data, prior, prior_weight, sun, first, rolls)
    else:
        starts = all_starts(bTc, centres, axes, charts, attitude, reference)
    count = starts.shape[0]
    annealed = prior_weight.shape[0] > 0 and not attitude.shape[0]
    total = count + 1 if annealed else count
    poses = np.empty((total, 4, 4))
    for k in range(count):
        _copy(starts[k], poses[k])
    costs = np.empty(total)
    N = np.empty((total, 6, 6))
    converged = np.zeros(total, dtype=np.bool_)
    if annealed:
        _copy(prior, poses[count])
        for noise in _NOISE_FACTORS:
            minimise(
                poses[count], bTc, data, prior, prior_weight, sun, noise, first, iterations, N[count],
            )  # fmt: skip
    few = min(_FIRST_ITERATIONS, iterations)
    # A few iterations of all of them show which ones to finish.
    for k in range(total):
        costs[k], converged[k] = minimise(
            poses[k], bTc, data, prior, prior_weight, sun, 1.0, first, few, N[k],
        )  # fmt: skip
        if not costs[k] >= 0.0:
            costs[k] = np.inf
    kept = np.empty(total, dtype=np.int64)
    found = 0
    least = np.inf
    for k in _ascending(costs, total):
        if _known(poses, N, kept, found, k):
            continue
        if not converged[k] and costs[k] < np.inf:
            costs[k], converged[k] = minimise(
                poses[k], bTc, data, prior, prior_weight, sun, 1.0, first, iterations, N[k],
            )  # fmt: skip
            if _known(poses, N, kept, found, k):
                continue
        if costs[k] > least + window:
            continue
        least = min(least, costs[k])
        kept[found] = k
        found += 1
    final = np.empty(found)
    for f in range(found):
        final[f] = costs[kept[f]]
    out, out_costs = np.empty((found, 4, 4)), np.empty(found)
    out_N, out_converged = np.empty((found, 6, 6)), np.empty(found, dtype=np.bool_)
    for row, f in enumerate(_ascending(final, found)):
        k = kept[f]
        _copy(poses[k], out[row])
        _copy(N[k], out_N[row])
        out_costs[row], out_converged[row] = costs[k], converged[k]
    return out, out_costs, out_N, out_converged


@njit(cache=True, error_model="numpy")
def _ascending(values: FloatArray, count: int) -> IntArray:
    """Sort the first `count` values and return their indices; numba takes seconds to compile a sort."""
    order = np.empty(count, dtype=np.int64)
    for i in range(count):
        j = i
        while j > 0 and values[order[j - 1]] > values[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    return order


@njit(cache=True, error_model="numpy")
def _known(poses: FloatArray, N: FloatArray, kept: IntArray, found: int, k: int) -> bool:
    """Whether pose k repeats one of the first `found` poses that were kept."""
    known = False
    for f in range(found):
        known = known or squared_distance(poses[kept[f]], poses[k], N[kept[f]]) < _SAME_DISTANCE2
    return known
