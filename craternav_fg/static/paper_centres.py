"""Position from the angles between craters, eq. (10), and the attitude that goes with it (PCCI)."""

from functools import partial

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.static import paper_equations as equations
from craternav_fg.static.least_squares import (
    EVERYTHING,
    ROTATION,
    TRANSLATION,
    minimise,
    pseudo_inverse,
)
from craternav_fg.static.paper_equations import PaperRims

FloatArray = npt.NDArray[np.float64]

_REFINEMENTS = 50
_REFINED_M = 1e-3


def centre_pose(
    seen: PaperRims, start: FloatArray, free: slice = EVERYTHING, *, refine: bool = False
) -> tuple[FloatArray, bool]:
    """Position from eq. (10), then the attitude that turns the measured directions onto the craters.

    Parameters
    ----------
    seen : PaperRims
    start : ndarray, shape (4, 4)
        Pose of the camera gTc.
    free : slice
        `TRANSLATION` keeps the attitude of the start.
    refine : bool
        Replace the image ellipses' centres by the craters', eq. (9), until the position stays.

    Returns
    -------
    gTc : ndarray, shape (4, 4)
    converged : bool
    """
    v = seen.image_centres
    gTc = start
    for _ in range(_REFINEMENTS if refine else 1):
        before = gTc[:3, 3]
        gTc, converged = minimise(partial(_angles_of_pose, seen, v), gTc, TRANSLATION)
        if free == EVERYTHING:
            gTc = frames.pose(_attitude(seen, v, gTc[:3, 3]), gTc[:3, 3])
        if not refine:
            return gTc, converged
        v = seen.true_centres(gTc[:3, :3])
        if converged and np.linalg.norm(gTc[:3, 3] - before) < _REFINED_M:
            return gTc, True
    return gTc, False


def centre_covariance(
    seen: PaperRims, gTc: FloatArray, free: slice = EVERYTHING, *, refined: bool = False
) -> FloatArray | None:
    """Covariance (6, 6) of what `centre_pose` gives, for the camera's right twist, by the charts' noise.

    None where the position or the attitude is not determined.
    """
    R = gTc[:3, :3]
    n = len(seen.rims)
    directions = seen.true_centres(R) if refined else seen.image_centres
    _, J = _angles_of_pose(seen, directions, gTc)
    inverse = pseudo_inverse(J[:, TRANSLATION])
    if inverse is None:
        return None
    # Twist from the measured directions, all 3 n of them: position first, then the attitude at it.
    twist = np.zeros((6, 3 * n))
    twist[TRANSLATION] = -inverse @ np.concatenate(list(equations.angle_slopes(seen, directions)), axis=1)
    _, J_lines = equations.lines_of_sight(seen, gTc)
    p = (seen.rims.centres - gTc[:3, 3]) @ R
    turn = equations.cross(p / np.linalg.norm(p, axis=1, keepdims=True))
    if free == EVERYTHING:
        inverse = pseudo_inverse(turn.reshape(3 * n, 3))
        if inverse is None:
            return None
        twist[ROTATION] = inverse @ (
            np.eye(3 * n) - J_lines.reshape(3 * n, 6)[:, TRANSLATION] @ twist[TRANSLATION]
        )
    if refined:
        # The directions themselves turn with the attitude that they give.
        slopes = equations.line_slopes(seen, R)
        follow = (turn - J_lines[:, :, ROTATION]).reshape(3 * n, 3)
        twist = twist @ np.linalg.inv(np.eye(3 * n) - follow @ twist[ROTATION])
    else:
        v = directions
        length = np.sqrt(1.0 + np.sum(seen.rims.chart[:, :2] ** 2, axis=1))
        slopes = np.zeros((n, 3, 5))
        slopes[:, :, :2] = (np.eye(3)[:, :2] - v[:, :, None] * v[:, None, :2]) / length[:, None, None]
    gains = np.einsum("ink,nkj->nij", twist.reshape(6, n, 3), slopes)
    return np.asarray(np.einsum("nij,njk,nlk->il", gains, seen.rims.covariance, gains))


def _angles_of_pose(seen: PaperRims, v: FloatArray, gTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    e, J = equations.angles(seen, v, gTc[:3, 3])
    return e, np.concatenate([np.zeros_like(J), J @ gTc[:3, :3]], axis=1)


def _attitude(seen: PaperRims, v: FloatArray, position: FloatArray) -> FloatArray:
    """Rotation gRc (3, 3) that brings directions v in c nearest to those of the craters (Wahba's problem)."""
    d = seen.rims.centres - position
    U, _, Vt = np.linalg.svd((d / np.linalg.norm(d, axis=1, keepdims=True)).T @ v)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt)
