"""Crater centres and lines of sight of a frame, whitened and robust per crater.

Every kernel writes the residual e and, when `linearise` is set, the Jacobian J for the body's right twist
[w, rho]. `validity` says what is written for a crater that the pose cannot see.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import camera_pose
from factors.kernels.los import los_residual
from factors.kernels.validity import unseen, whiten


@njit(cache=True, error_model="numpy")
def centre_residuals(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, points: FloatArray,
    whitening: FloatArray, kind: int, scale: float, linearise: bool, e: FloatArray, J: FloatArray,
) -> None:  # fmt: skip
    """Crater centres as points: zero when the image of each centre is the centre of the image ellipse.

    That is the assumption of centre-based methods, eq. (10). Perspective shifts the one from the other.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres : ndarray, shape (n, 3)
        Crater centres in g, m.
    points : ndarray, shape (n, 2)
        Centres of the image ellipses, normalised.
    whitening : ndarray, shape (n, 2, 2)
        Lower triangular W with W S W' = 1.
    kind, scale : int, float
        Loss, see `robust`.
    linearise : bool
        Whether J is written.
    e, J : ndarray, shape (2 n,), (2 n, 6)
        Written.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (10); docs/equations.md.
    """
    R, P = camera_pose(gTb, bTc)
    p = np.empty(3)
    raw = np.empty(2)
    Jc = np.zeros((2, 6))
    for i in range(centres.shape[0]):
        for k in range(3):
            p[k] = 0.0
            for j in range(3):
                p[k] += R[j, k] * (centres[i, j] - P[j])
        ei, Ji = e[2 * i : 2 * i + 2], J[2 * i : 2 * i + 2]
        if not p[2] > 0.0:
            unseen(ei, Ji, kind, scale, linearise)
            continue
        u = p[0] / p[2]
        v = p[1] / p[2]
        raw[0] = u - points[i, 0]
        raw[1] = v - points[i, 1]
        # d(u, v) = [[1, 0, -u], [0, 1, -v]] / p_z ([p]x w - rho)
        Jc[0, 0], Jc[0, 1], Jc[0, 2] = u * v, -1.0 - u * u, v
        Jc[1, 0], Jc[1, 1], Jc[1, 2] = 1.0 + v * v, -u * v, -u
        Jc[0, 3], Jc[0, 5] = -1.0 / p[2], u / p[2]
        Jc[1, 4], Jc[1, 5] = -1.0 / p[2], v / p[2]
        whiten(raw, Jc, whitening[i], bTc, ei, Ji, kind, scale, linearise)


@njit(cache=True, error_model="numpy")
def los_residuals(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, normals: FloatArray, conics: FloatArray,
    bases: FloatArray, whitening: FloatArray, kind: int, scale: float, linearise: bool,
    e: FloatArray, J: FloatArray,
) -> None:  # fmt: skip
    """Lines of sight, eq. (11): zero when K n_c points to the centre of every crater.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres, normals : ndarray, shape (n, 3)
        Crater centres, m, and outward unit normals, in g.
    conics : ndarray, shape (n, 6)
        Measured conics, of any sign and scale.
    bases : ndarray, shape (n, 3, 2)
        Orthonormal tangents in c at the measured directions.
    whitening : ndarray, shape (n, 2, 2)
        Lower triangular W with W S W' = 1.
    kind, scale : int, float
        Loss, see `robust`.
    linearise : bool
        Whether J is written.
    e, J : ndarray, shape (2 n,), (2 n, 6)
        Written.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (8), (11);
    docs/equations.md.
    """
    R, P = camera_pose(gTb, bTc)
    p = np.empty(3)
    n_c = np.empty(3)
    raw = np.empty(2)
    Jc = np.empty((2, 6))
    for i in range(centres.shape[0]):
        for k in range(3):
            p[k] = 0.0
            n_c[k] = 0.0
            for j in range(3):
                p[k] += R[j, k] * (centres[i, j] - P[j])
                n_c[k] += R[j, k] * normals[i, j]
        ei, Ji = e[2 * i : 2 * i + 2], J[2 * i : 2 * i + 2]
        if not (p[2] > 0.0 and p[0] * n_c[0] + p[1] * n_c[1] + p[2] * n_c[2] < 0.0):
            unseen(ei, Ji, kind, scale, linearise)
            continue
        los_residual(p, n_c, conics[i], bases[i], raw, Jc)
        whiten(raw, Jc, whitening[i], bTc, ei, Ji, kind, scale, linearise)
