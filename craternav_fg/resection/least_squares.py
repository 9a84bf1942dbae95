"""Levenberg-Marquardt with QR, for equations whose rows differ by many orders of magnitude.

Normal equations would square the condition of eq. (19) as printed, 5e7 and more.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from factors.kernels.gauss_newton import move

FloatArray = npt.NDArray[np.float64]
# Pose -> residual (m,), Jacobian (m, 6) for the pose's right twist.
PoseEquations = Callable[[FloatArray], tuple[FloatArray, FloatArray]]

ROTATION, TRANSLATION = slice(0, 3), slice(3, 6)
EVERYTHING = slice(0, 6)
_ITERATIONS = 100
_TOLERANCE = 1e-12
# Steps below these (rad, m) are the end, whether they go down or not: rounding decides that.
_STILL_RAD, _STILL_M = 1e-11, 1e-6
_HOPELESS = 1e30
# Of the largest, below which a singular value of the scaled Jacobian is a free direction.
_RANK_TOLERANCE = 1e-8
# A step that turns the pose further has left what the linearisation knows.
_MAX_TURN_RAD = 1.0


def minimise(
    equations: PoseEquations, start: FloatArray, free: slice = EVERYTHING
) -> tuple[FloatArray, bool]:
    """Minimise a sum of squares over a pose.

    Parameters
    ----------
    equations : callable
        Gives residual (m,) and Jacobian (m, 6) at a pose (4, 4).
    start : ndarray, shape (4, 4)
        Not changed.
    free : slice
        Columns of the twist [w, rho] that move; the others stay.

    Returns
    -------
    pose : ndarray, shape (4, 4)
    converged : bool
    """
    pose = np.array(start, order="C")
    e, J = equations(pose)
    cost = float(e @ e)
    scale = np.zeros(J[:, free].shape[1])
    damping = 1e-6
    for _ in range(_ITERATIONS):
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
            still = np.abs(step[ROTATION]).max() < _STILL_RAD and np.abs(step[TRANSLATION]).max() < _STILL_M
            if still or new_cost <= cost:
                break
            damping *= 10.0
            if damping > _HOPELESS:
                return pose, False
        if still:
            return pose, True
        gain = cost - new_cost
        pose, e, J, cost = candidate, new_e, new_J, new_cost
        damping *= 0.1
        if gain <= _TOLERANCE * cost:
            return pose, True
    return pose, False


def _damped(A: FloatArray, e: FloatArray, damping: float) -> FloatArray:
    n = A.shape[1]
    rows = np.vstack([A, np.sqrt(damping) * np.eye(n)])
    return np.asarray(np.linalg.lstsq(rows, np.concatenate([-e, np.zeros(n)]), rcond=None)[0])


def pseudo_inverse(J: FloatArray) -> FloatArray | None:
    """(J'J)^-1 J' (k, m) of a Jacobian (m, k); None where it leaves a direction free."""
    scale = np.linalg.norm(J, axis=0)
    if not scale.all():
        return None
    U, singular, Vt = np.linalg.svd(J / scale, full_matrices=False)
    if singular[-1] < _RANK_TOLERANCE * singular[0] or len(J) < J.shape[1]:
        return None
    return np.asarray((Vt.T / singular) @ U.T / scale[:, None])
