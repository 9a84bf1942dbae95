"""Levenberg-Marquardt with an orthogonal solver, for equations whose rows differ by orders of magnitude.

Normal equations would square the condition number of eq. (19) without weights, which is 5e7 and more.
"""

from collections.abc import Callable

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.gauss_newton import move

# Takes a pose (4, 4); gives the residual (m,) and its Jacobian (m, 6) for the pose's right twist.
PoseEquations = Callable[[FloatArray], tuple[FloatArray, FloatArray]]

ROTATION, TRANSLATION = slice(0, 3), slice(3, 6)
EVERYTHING = slice(0, 6)
# Far more than a convergent minimisation takes.
_MAX_ITERATIONS = 100
# Relative decrease of the cost at which the minimisation has converged.
_MIN_DECREASE = 1e-12
# Steps below these end the minimisation, whether the cost decreases or not: rounding decides that.
_MIN_STEP_RAD, _MIN_STEP_M = 1e-11, 1e-6
# Damping: initial value, and the value at which the minimisation has failed.
_INITIAL_DAMPING, _MAX_DAMPING = 1e-6, 1e30
# Singular values of the scaled Jacobian below this share of the largest belong to undetermined directions.
_RANK_TOLERANCE = 1e-8
# Largest rotation of a step: beyond, the linearisation does not hold.
_MAX_TURN_RAD = 1.0


def minimise(
    equations: PoseEquations, start: FloatArray, free: slice = EVERYTHING
) -> tuple[FloatArray, bool]:
    """Minimise a sum of squares over a pose.

    Parameters
    ----------
    equations : callable
        Gives residual (m,) and Jacobian (m, 6) at a pose (4, 4), for its right twist [w, rho].
    start : ndarray, shape (4, 4)
        Initial pose gTb or gTc; not changed.
    free : slice
        Coordinates of the twist that are estimated; the others stay.

    Returns
    -------
    pose : ndarray, shape (4, 4)
        Pose in the frames of the initial one.
    converged : bool
    """
    pose = np.array(start, order="C")
    e, J = equations(pose)
    cost = float(e @ e)
    scale = np.zeros(J[:, free].shape[1])
    damping = _INITIAL_DAMPING
    for _ in range(_MAX_ITERATIONS):
        # As in MINPACK: the largest column norm so far.
        scale = np.maximum(scale, np.linalg.norm(J[:, free], axis=0))
        scale[scale == 0.0] = 1.0
        while True:
            step = np.zeros(6)
            step[free] = _damped(J[:, free] / scale, e, damping) / scale
            new_cost = np.inf
            if np.linalg.norm(step[ROTATION]) < _MAX_TURN_RAD:
                candidate = pose.copy()
                move(candidate, step)
                new_e, new_J = equations(candidate)
                new_cost = float(new_e @ new_e)
            turn, shift = np.abs(step[ROTATION]).max(), np.abs(step[TRANSLATION]).max()
            still = turn < _MIN_STEP_RAD and shift < _MIN_STEP_M
            if still or new_cost <= cost:
                break
            damping *= 10.0
            if damping > _MAX_DAMPING:
                return pose, False
        if still:
            return pose, True
        gain = cost - new_cost
        pose, e, J, cost = candidate, new_e, new_J, new_cost
        damping *= 0.1
        if gain <= _MIN_DECREASE * cost:
            return pose, True
    return pose, False


def _damped(A: FloatArray, e: FloatArray, damping: float) -> FloatArray:
    """Step of the damped problem, by an orthogonal decomposition."""
    n = A.shape[1]
    rows = np.vstack([A, np.sqrt(damping) * np.eye(n)])
    return np.asarray(np.linalg.lstsq(rows, np.concatenate([-e, np.zeros(n)]), rcond=None)[0])


def pseudo_inverse(J: FloatArray) -> FloatArray | None:
    """Compute the pseudo-inverse of a Jacobian.

    Parameters
    ----------
    J : ndarray, shape (m, k)
        Columns may have different units.

    Returns
    -------
    ndarray, shape (k, m), or None
        (J'J)^-1 J', in the inverse units; None when a direction is undetermined.
    """
    scale = np.linalg.norm(J, axis=0)
    if not scale.all():
        return None
    U, singular, Vt = np.linalg.svd(J / scale, full_matrices=False)
    if singular[-1] < _RANK_TOLERANCE * singular[0] or len(J) < J.shape[1]:
        return None
    return np.asarray((Vt.T / singular) @ U.T / scale[:, None])
