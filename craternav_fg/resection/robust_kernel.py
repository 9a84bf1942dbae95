"""Kernels of the robust solver: rims that agree on a pose, found from minimal sets (RANSAC)."""

import numpy as np

from craternav_fg.resection.solve_kernel import minimise
from craternav_fg.resection.start_kernel import start_at_attitude, start_pair
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import invert, solve
from factors.kernels.packed import CRATER, HEADER, pack, shape_residuals
from factors.kernels.robust import NONE

# Rounds of fit and selection per minimal set, and linearisations of a fit.
_ROUNDS = 4
_ITERATIONS = 8
# Logarithm of the probability to have missed the right minimal set, at which the search ends.
_LOG_MISS = np.log(1e-9)


@njit(cache=True, error_model="numpy")
def distances2(
    gTb: FloatArray, N: FloatArray, first: int, members: BoolArray, data: FloatArray
) -> FloatArray:  # fmt: skip
    """Compute squared Mahalanobis distances of rims from a pose that was fitted to some of them.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        The pose.
    N : ndarray, shape (6, 6)
        Its information, rad and m in b.
    first : int
        First of its coordinates that was estimated.
    members : ndarray of bool, shape (n,)
        Rims to which it was fitted: theirs is the squared norm of the residual; that of others includes the
        pose's uncertainty.
    data : ndarray, shape (packed,)
        The rims, from `packed.pack`.

    Returns
    -------
    ndarray, shape (n,)
        Numbers of five degrees of freedom; inf where they are undefined.
    """
    n = (data.shape[0] - HEADER) // CRATER
    free = 6 - first
    out = np.empty(n)
    rows = np.empty((7, 5 * n))
    shape_residuals(gTb, data, True, rows)
    covariance, x = np.empty((free, free)), np.empty(free)
    invert(N[first:, first:].copy(), covariance)
    S, y = np.empty((5, 5)), np.empty(5)
    for k in range(n):
        H, r = rows[first:6, 5 * k : 5 * k + 5], rows[6, 5 * k : 5 * k + 5]
        out[k] = 0.0
        if members[k]:
            for a in range(5):
                out[k] += r[a] * r[a]
            continue
        for a in range(5):
            for i in range(free):
                x[i] = 0.0
                for j in range(free):
                    x[i] += covariance[i, j] * H[j, a]
            for b in range(a + 1):
                S[a, b] = 1.0 if a == b else 0.0
                for i in range(free):
                    S[a, b] += x[i] * H[i, b]
                S[b, a] = S[a, b]
        solve(S, r, y)
        for a in range(5):
            out[k] += r[a] * y[a]
        # A pose that its members do not determine tells nothing about the others.
        if not np.isfinite(out[k]):
            out[k] = np.inf
    return out


@njit(cache=True, error_model="numpy")
def _subset(data: FloatArray, members: BoolArray) -> FloatArray:
    """Select the packed data of some rims, a mask (n,)."""
    out = np.empty(data.shape[0])
    for k in range(HEADER):
        out[k] = data[k]
    end = HEADER
    for m in range(members.shape[0]):
        if members[m]:
            for k in range(CRATER):
                out[end + k] = data[HEADER + CRATER * m + k]
            end += CRATER
    return out[:end]


@njit(cache=True, error_model="numpy")
def consensus(
    bTc: FloatArray, centres: FloatArray, axes: FloatArray, charts: FloatArray, W: FloatArray,
    prior: FloatArray, prior_weight: FloatArray, sun: FloatArray, attitude: FloatArray, first: int,
    seeds: IntArray, gate: float,
) -> tuple[BoolArray, float]:  # fmt: skip
    """Find the rims that agree on one pose.

    Parameters
    ----------
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes, charts : ndarray, shapes (n, 3), (n, 2, 3), (n, 5)
        See `MatchedRims`.
    W : ndarray, shape (n, 5, 5)
        Whitening of the charts, see `MatchedRims`.
    prior, prior_weight : ndarray, shapes (4, 4), (6, 6) or (0, 0)
        As in `solve_kernel.normal_equations`.
    sun : ndarray, shape (7,) or (0,)
        As in `solve_kernel.normal_equations`.
    attitude : ndarray, shape (3, 3) or (0, 0)
        Known rotation gRb; empty when it is unknown.
    first : int
        As in `solve_kernel.minimise`.
    seeds : ndarray of int, shape (m, 2)
        Minimal sets: the rim whose plane is used, and the rim whose centre is. With a known attitude the
        first rim is enough.
    gate : float
        Squared distance above which a rim does not agree.

    Returns
    -------
    members : ndarray of bool, shape (n,)
        The rims that agree.
    score : float
        Sum of the squared distances, each at most the gate.
    """
    n = charts.shape[0]
    known = attitude.shape[0] > 0
    starts = np.empty((1 if known else 2, 4, 4))
    best = np.zeros(n, dtype=np.bool_)
    least, share, agreeing = np.inf, 0.0, 0
    N = np.empty((6, 6))
    data = pack(bTc, centres, axes, charts, W, NONE, 1.0)
    # Not a constant: numba would compile `minimise` once more for it.
    iterations = min(_ITERATIONS, 1 + seeds.shape[0] * _ITERATIONS)
    for s in range(seeds.shape[0]):
        i = seeds[s, 0]
        if known:
            start_at_attitude(attitude, bTc, centres[i], axes[i], charts[i], starts[0])
        else:
            start_pair(i, seeds[s, 1:], bTc, centres, axes, charts, starts)
        for t in range(starts.shape[0]):
            gTb = starts[t]
            members = np.zeros(n, dtype=np.bool_)
            members[i] = True
            members[seeds[s, 1]] = True
            score = np.inf
            for _ in range(_ROUNDS):
                minimise(
                    gTb, bTc, _subset(data, members), prior, prior_weight, sun, 1.0, first, iterations, N
                )
                d2 = distances2(gTb, N, first, members, data)
                score = 0.0
                changed = False
                agreeing = 0
                for k in range(n):
                    score += min(d2[k], gate)
                    agrees = d2[k] < gate
                    changed = changed or agrees != members[k]
                    members[k] = agrees
                    agreeing += agrees
                if not changed or agreeing == 0:
                    break
            if score < least:
                least = score
                share = agreeing / n
                for k in range(n):
                    best[k] = members[k]
        # The probability that no set so far had true matches only, if as many are true as agree.
        if share == 1.0 or (s + 1) * np.log(1.0 - share * share) < _LOG_MISS:
            break
    return best, least
