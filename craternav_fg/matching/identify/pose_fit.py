"""Pose of the camera from matched rims: Gauss-Newton on ellipse charts, with a prior on the attitude.

The residuals and their derivatives are those of the smoother's conic-shape factor.
"""

from contextlib import suppress

import numpy as np

from craternav_fg.matching.identify.craters import Craters
from craternav_fg.matching.identify.noise import shape_scale
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray, IntArray
from factors.kernels import packed
from factors.kernels.compiled import njit
from factors.kernels.conic import chart, rim_in_camera
from factors.kernels.gauss_newton import prior_terms, screw, solve
from factors.kernels.robust import HUBER

# Gauss-Newton steps of one fit.
STEPS = 3
# Threshold of the Huber loss on a rim's whitened residual, whose root mean square is 2.2.
_HUBER_THRESHOLD = 4.0
# A step that turns by more (1 rad, squared), or moves by more than the range, has diverged.
_MAX_TURN2 = 1.0
# Squared rotation, rad^2, and translation, m^2, of a step after which no further one is made.
_LAST_TURN2, _LAST_SHIFT2 = 1e-14, 1e-4


@njit(cache=True, error_model="numpy")
def pack_rims(view: View, craters: Craters, match: IntArray, sigma: FloatArray) -> FloatArray:
    """Pack the matched rims for the conic-shape kernels.

    Parameters
    ----------
    view : View
    craters : Craters
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none.
    sigma : ndarray, shape (3,)
        Noise, see `noise`.

    Returns
    -------
    ndarray, shape (packed,)
        See `factors.kernels.packed`.
    """
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
        if not view.traced[i]:
            # Of the errors of both axes, only their mean.
            W[k, 4, 2] = W[k, 4, 4] = np.sqrt(0.5 * W[k, 2, 2] * W[k, 4, 4])
            W[k, 2, 2] = W[k, 3, 3] = 0.0
    bTc = np.zeros((4, 4))
    for r in range(4):
        bTc[r, r] = 1.0
    return packed.pack(bTc, L, A, y, W, HUBER, _HUBER_THRESHOLD)


@njit(cache=True, error_model="numpy")
def normal_equations(
    gTc: FloatArray, data: FloatArray, prior: FloatArray, weight: FloatArray, N: FloatArray, g: FloatArray
) -> bool:
    """Compute the normal equations of rims and prior for the camera's right twist.

    Parameters
    ----------
    gTc : ndarray, shape (4, 4)
    data : ndarray, shape (packed,)
        From `pack_rims`.
    prior, weight : ndarray, shapes (4, 4), (6, 6)
        Pose and information of the prior; without one, `weight` is zero.
    N : ndarray, shape (6, 6)
        Written: information, rad and m.
    g : ndarray, shape (6,)
        Written: gradient of half the cost.

    Returns
    -------
    bool
        Whether they are finite.
    """
    count = (data.shape[0] - packed.HEADER) // packed.CRATER
    out = np.empty((7, 5 * count))
    packed.shape_residuals(gTc, data, True, out)
    if weight[0, 0] > 0.0:
        prior_terms(prior, weight, gTc, N, g)
    else:
        N[:] = 0.0
        g[:] = 0.0
    # One residual after the other: its products do not wait for each other, as the terms of a sum would.
    for k in range(5 * count):
        for a in range(6):
            g[a] += out[a, k] * out[6, k]
            for b in range(a + 1):
                N[a, b] += out[a, k] * out[b, k]
    for a in range(6):
        for b in range(a):
            N[b, a] = N[a, b]
    trace = 0.0
    for a in range(6):
        trace += N[a, a]
    return trace < np.inf


@njit(cache=True, error_model="numpy")
def fit_pose(gTc: FloatArray, data: FloatArray, prior: FloatArray, weight: FloatArray, N: FloatArray) -> bool:
    """Fit a pose to matched rims and a prior by a few Gauss-Newton steps.

    Parameters
    ----------
    gTc : ndarray, shape (4, 4)
        Moved in place.
    data : ndarray, shape (packed,)
        From `pack_rims`.
    prior, weight : ndarray, shapes (4, 4), (6, 6)
        As in `normal_equations`.
    N : ndarray, shape (6, 6)
        Written: information at the last linearisation.

    Returns
    -------
    bool
        False when it diverged.
    """
    g = np.empty(6)
    step = np.empty(6)
    range_m = np.sqrt(gTc[0, 3] ** 2 + gTc[1, 3] ** 2 + gTc[2, 3] ** 2)
    for k in range(STEPS + 1):
        if not normal_equations(gTc, data, prior, weight, N, g):
            return False
        if k == STEPS:
            break
        solve(N, g, step)
        turn2 = 0.0
        shift2 = 0.0
        for a in range(3):
            turn2 += step[a] ** 2
            shift2 += step[3 + a] ** 2
        if not (turn2 < _MAX_TURN2 and shift2 < range_m * range_m):
            return False
        for a in range(6):
            step[a] = -step[a]
        screw(gTc, step)
        if turn2 < _LAST_TURN2 and shift2 < _LAST_SHIFT2:
            break
    return True


@njit(cache=True, error_model="numpy")
def centre_freedom_taken(gTc: FloatArray, data: FloatArray, covariance: FloatArray) -> float:
    """Degrees of freedom that the fit of the pose takes from the residuals of the rims' centres.

    Parameters
    ----------
    gTc : ndarray, shape (4, 4)
    data : ndarray, shape (packed,)
        From `pack_rims`.
    covariance : ndarray, shape (6, 6)
        Covariance of the pose.
    """
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


def shifts_without(
    gTc: FloatArray, data: FloatArray, N: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute how far each rim pulls the fit of a pose.

    Parameters
    ----------
    gTc : ndarray, shape (4, 4)
    data : ndarray, shape (packed,)
        From `pack_rims`, of m rims.
    N : ndarray, shape (6, 6)
        Information of the pose, rad and m.

    Returns
    -------
    shifts : ndarray, shape (m, 6)
        Shift of the pose without each rim, as right twist [w, rho], rad and m; 0 where the others do not
        determine the pose.
    squares, expected : ndarray, shape (m,)
        Its square in standard deviations of the pose, and what that is on average if no rim is wrong.
    """
    count = (data.shape[0] - packed.HEADER) // packed.CRATER
    out = np.empty((7, 5 * count))
    packed.shape_residuals(gTc, data, True, out)
    rows = out.reshape(7, count, 5)
    each = np.einsum("akr,bkr->kab", rows[:6], rows)
    solved = np.zeros((count, 6, 7))
    try:
        solved = np.linalg.solve(N - each[:, :, :6], each)
    except np.linalg.LinAlgError:
        for k in range(count):
            with suppress(np.linalg.LinAlgError):
                solved[k] = np.linalg.solve(N - each[k, :, :6], each[k])
    shifts, expected = solved[:, :, 6], np.trace(solved[:, :, :6], axis1=1, axis2=2)
    return shifts, np.einsum("ka,ab,kb->k", shifts, N, shifts), expected


@njit(cache=True, error_model="numpy")
def chart_errors(
    view: View, i: int, craters: Craters, crater: int, R: FloatArray, P: FloatArray, e: FloatArray
) -> bool:
    """Compare a rim with the image of a crater.

    Parameters
    ----------
    view : View
    i : int
        The rim.
    craters : Craters
    crater : int
        Row of the crater.
    R : ndarray, shape (3, 3)
        Rotation gRc.
    P : ndarray, shape (3,)
        gPc, m.
    e : ndarray, shape (5,)
        Written: measured less predicted chart, over the standard deviations at a noise of 1 px.

    Returns
    -------
    bool
        False when the crater is not visible as an ellipse.
    """
    p, c = np.empty(3), np.empty((2, 3))
    rim_in_camera(R, P, craters.centres[crater], craters.axes[crater], p, c)
    if not chart(p, c, e):
        return False
    for r in range(5):
        e[r] = (view.charts[i, r] - e[r]) * view.precision[i, r]
    return True
