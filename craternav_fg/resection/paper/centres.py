"""Pose from the centres of image ellipses alone (PCCI): the position by eq. (10), then the attitude."""

from functools import partial

import numpy as np

from craternav_fg import frames
from craternav_fg.resection.least_squares import EVERYTHING, ROTATION, TRANSLATION, minimise, pseudo_inverse
from craternav_fg.resection.paper import equations
from craternav_fg.resection.paper.equations import PaperRims
from factors.arrays import FloatArray


def centre_pose(seen: PaperRims, start: FloatArray, free: slice = EVERYTHING) -> tuple[FloatArray, bool]:
    """Estimate the position by eq. (10), then the attitude that turns the image centres onto the craters.

    Parameters
    ----------
    seen : PaperRims
    start : ndarray, shape (4, 4)
        Initial pose of the camera gTc.
    free : slice
        `EVERYTHING`, or `TRANSLATION` to keep the attitude of the start.

    Returns
    -------
    gTc : ndarray, shape (4, 4)
    converged : bool

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (10); docs/equations.md.
    """
    gTc, converged = minimise(partial(_angles_of_pose, seen), start, TRANSLATION)
    if free == EVERYTHING:
        gTc = frames.pose(_attitude(seen, gTc[:3, 3]), gTc[:3, 3])
    return gTc, converged


def centre_covariance(seen: PaperRims, gTc: FloatArray, free: slice = EVERYTHING) -> FloatArray | None:
    """Compute the covariance of `centre_pose` due to the charts' noise.

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        The estimate.
    free : slice
        As in `centre_pose`.

    Returns
    -------
    ndarray, shape (6, 6), or None
        For the camera's right twist [w, rho], rad and m; None when position or attitude is undetermined.
    """
    n = len(seen.rims)
    _, J = _angles_of_pose(seen, gTc)
    inverse = pseudo_inverse(J[:, TRANSLATION])
    if inverse is None:
        return None
    # Derivative of the twist in the 3 n measured directions: the position first, then the attitude given it.
    twist = np.zeros((6, 3 * n))
    twist[TRANSLATION] = -inverse @ np.concatenate(list(equations.angle_slopes(seen)), axis=1)
    if free == EVERYTHING:
        p = (seen.rims.centres - gTc[:3, 3]) @ gTc[:3, :3]
        turn = frames.cross_matrix(p / np.linalg.norm(p, axis=1, keepdims=True)).reshape(3 * n, 3)
        inverse = pseudo_inverse(turn)
        if inverse is None:
            return None
        _, J_lines = equations.lines_of_sight(seen, gTc)
        shift = J_lines[:, :, TRANSLATION].reshape(3 * n, 3) @ twist[TRANSLATION]
        twist[ROTATION] = inverse @ (np.eye(3 * n) - shift)
    v = seen.image_centres
    length = np.sqrt(1.0 + np.sum(seen.rims.chart[:, :2] ** 2, axis=1))
    slopes = np.zeros((n, 3, 5))
    slopes[:, :, :2] = (np.eye(3)[:, :2] - v[:, :, None] * v[:, None, :2]) / length[:, None, None]
    gains = np.einsum("ink,nkj->nij", twist.reshape(6, n, 3), slopes)
    return np.asarray(np.einsum("nij,njk,nlk->il", gains, seen.rims.covariance, gains))


def _angles_of_pose(seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residual (m,) of the angles and its Jacobian (m, 6) for the camera's right twist."""
    e, J = equations.angles(seen, gTc[:3, 3])
    return e, np.concatenate([np.zeros_like(J), J @ gTc[:3, :3]], axis=1)


def _attitude(seen: PaperRims, position: FloatArray) -> FloatArray:
    """Rotation gRc (3, 3) that turns the image centres onto the craters best (Wahba's problem)."""
    d = seen.rims.centres - position
    U, _, Vt = np.linalg.svd((d / np.linalg.norm(d, axis=1, keepdims=True)).T @ seen.image_centres)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt)
