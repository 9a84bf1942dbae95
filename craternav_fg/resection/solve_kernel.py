"""Maximum-likelihood poses of one image: rims in the ellipse chart, prior, sun's tilt.

Levenberg-Marquardt from many starts, on the normal equations: six unknowns, and three with the attitude
known. Distances between poses are measured in standard deviations, by the information at the better one.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.resection.start_kernel import start_at_attitude, start_pair, starts_of_one
from factors.kernels.gauss_newton import prior_terms, screw, screw_between, solve
from factors.kernels.packed import CRATER, HEADER, pack, shape_residuals
from factors.kernels.robust import NONE
from factors.kernels.sun import sun_tilt, wrap

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Noise, in units of its size, at which a poor prior's problem is solved first, in turn.
NOISE_STEPS = np.array([300.0, 30.0, 3.0])

# A step that promises less than this of the squared norm is the last: 1e-4 of a standard deviation.
_GAIN = 1e-8
# Poses closer than this squared distance are one.
_SAME = 0.04
_FEW_ITERATIONS = 8
_CURVE_ITERATIONS = 4


@njit(cache=True, error_model="numpy")
def normal_equations(
    gTb: FloatArray, bTc: FloatArray, data: FloatArray, prior: FloatArray, prior_weight: FloatArray,
    sun: FloatArray, noise: float, out: FloatArray, N: FloatArray, g: FloatArray,
) -> float:  # fmt: skip
    """Write N (6, 6) and gradient g (6,) of all that is known, for the body's right twist; return the cost.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
    data : ndarray
        The rims, from `packed.pack`, without a loss.
    prior, prior_weight : ndarray, shapes (4, 4), (6, 6)
        As `prior_terms` takes them; a weight of shape (0, 0) is no prior.
    sun : ndarray, shape (7,) or (0,)
        Direction in g, u, v, tilt, standard deviation; or nothing.
    noise : float
        Factor on the standard deviations of rims and sun.
    out : ndarray, shape (7, 5 n)
        Written: as `packed.shape_residuals` does, without `noise`.
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
    """Write a into b; numba takes seconds to compile a slice's assignment."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            b[i, j] = a[i, j]


@njit(cache=True, error_model="numpy")
def minimise(
    gTb: FloatArray, bTc: FloatArray, data: FloatArray, prior: FloatArray, prior_weight: FloatArray,
    sun: FloatArray, noise: float, first: int, iterations: int, N: FloatArray,
) -> tuple[float, bool]:  # fmt: skip
    """Levenberg-Marquardt from gTb, which is moved in place.

    Parameters
    ----------
    gTb, ..., noise
        As in `normal_equations`.
    first : int
        0, or 3 to leave the attitude as it is.
    iterations : int
        Linearisations at most.
    N : ndarray, shape (6, 6)
        Written: information at the pose.

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
    damping = 1e-4
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
        # False for NaN, too.
        if new <= cost * (1.0 + 1e-14):
            _copy(trial, gTb)
            _copy(trial_N, N)
            for i in range(6):
                g[i] = trial_g[i]
            cost = new
            damping = max(0.1 * damping, 1e-9)
            if gain < _GAIN:
                return cost, True
        else:
            # Rounding decides whether so short a step goes down.
            if gain < _GAIN:
                return cost, True
            damping *= 10.0
            if damping > 1e8:
                break
    return cost, False


@njit(cache=True, error_model="numpy")
def invert(N: FloatArray, first: int, covariance: FloatArray) -> float:
    """Write the inverse of N (6, 6) from the coordinate `first` on, zero before; return ln det N there.

    NaN when N is not positive definite.
    """
    n = 6 - first
    L = np.zeros((n, n))
    log = 0.0
    for i in range(n):
        for j in range(i + 1):
            # Scaled to a unit diagonal: radians and metres differ by six orders of magnitude.
            total = N[first + i, first + j] / np.sqrt(N[first + i, first + i] * N[first + j, first + j])
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
        log += 2.0 * np.log(L[i, i]) + np.log(N[first + i, first + i])
    covariance[:] = 0.0
    for c in range(n):
        x = covariance[first + c, first:]
        x[c] = 1.0
        for i in range(c, n):
            for k in range(c, i):
                x[i] -= L[i, k] * x[k]
            x[i] /= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                x[i] -= L[k, i] * x[k]
            x[i] /= L[i, i]
        for i in range(n):
            x[i] /= np.sqrt(N[first + i, first + i] * N[first + c, first + c])
    return log


@njit(cache=True, error_model="numpy")
def distance2(a: FloatArray, b: FloatArray, N: FloatArray) -> float:
    """Squared distance of two poses in the information N (6, 6) at a, for a's right twist."""
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
    """Poses (k, 4, 4) in closed form: of a known attitude, or both planes of each of the `reference` rims."""
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
    """Poses (k, 4, 4) that show a single rim as it is, the best in this among their neighbours first of all.

    They lie on a curve, narrow and bent, on which minimising all at once creeps: so the rim alone decides
    first. Prior and sun then choose on the curve, and every eighth angle starts all the same, for minima
    beside it that a vague prior leaves; without them every fourth is a sample of it.
    """
    poses = starts_of_one(rolls, bTc, centres[0], axes[0], charts[0])
    total = poses.shape[0]
    costs = np.empty(total)
    out, N, g = np.empty((7, 5)), np.empty((6, 6)), np.empty(6)
    nothing = np.empty((0, 0))
    # A variable: of a constant numba would compile `minimise` once more.
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
            # The two planes take turns.
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
    """All distinct local minima that the starts lead to, the cheapest first.

    Parameters
    ----------
    bTc, prior, prior_weight, sun
        As in `normal_equations`.
    centres, axes, charts, W : ndarray, shapes (n, 3), (n, 2, 3), (n, 5), (n, 5, 5)
        As `MatchedRims` has them, W its whitening.
    attitude : ndarray, shape (3, 3) or (0, 0)
        gRb where it is known.
    first : int
        As in `minimise`.
    reference : ndarray of int
        Rims whose planes starts are made of.
    rolls : int
        Steps of the angle that a single rim leaves free.
    iterations : int
        Of each minimisation.
    window : float
        Minima whose cost exceeds the least by more are not finished.

    Returns
    -------
    gTb : ndarray, shape (k, 4, 4)
    cost : ndarray, shape (k,)
    N : ndarray, shape (k, 6, 6)
        Information.
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
        for noise in NOISE_STEPS:
            minimise(
                poses[count], bTc, data, prior, prior_weight, sun, noise, first, iterations, N[count],
            )  # fmt: skip
    few = min(_FEW_ITERATIONS, iterations)
    # A first look at all of them tells which are worth finishing.
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
    """Order of the first `count` values, by insertion: few, and numba takes seconds to compile a sort."""
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
    """Whether pose k is one of those that were found."""
    known = False
    for f in range(found):
        known = known or distance2(poses[kept[f]], poses[k], N[kept[f]]) < _SAME
    return known
