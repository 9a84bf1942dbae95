"""Conic-shape residual of a rim, eq. (19) as printed, with its derivatives.

h is linear in the conic's coefficients q = (A, B, C, D, E, F) and vanishes when q is the image of the rim. It
vanishes as well at (R, -T), (R Rz180, Rz180 T), (R Rx180, (-tx, ty, tz)) and (R Rx180, Rx180 T); the checks
t_z > 0 and p_z > 0 exclude all of these but the ellipse's own half turn (docs/equations.md, "Its other
zeros").
"""

import numpy as np

from factors.arrays import BoolArray, FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import body_columns, camera_pose


@njit(cache=True, error_model="numpy")
def shape(
    R: FloatArray,
    T: FloatArray,
    semi_major: float,
    semi_minor: float,
    q: FloatArray,
    h: FloatArray,
    H: FloatArray,
    D: FloatArray,
) -> None:
    """Write the residual of eq. (19) and its derivatives: zero when the conic is the image of the rim.

    Parameters
    ----------
    R : ndarray, shape (3, 3)
        Rotation `cRl`, from the crater's local frame to the camera.
    T : ndarray, shape (3,)
        Position of the camera in the crater's local frame, m.
    semi_major, semi_minor : float
        Rim semi-axes, m.
    q : ndarray, shape (6,)
        Conic (A, B, C, D, E, F) of eq. (3); h scales with it.
    h : ndarray, shape (5,)
        Written: the residual, rows in m^2, 1, m, m, m^2 (times the unit of q).
    H : ndarray, shape (5, 6)
        Written: derivative for the camera's right twist [w, rho].
    D : ndarray, shape (5, 6)
        Written: derivative in q; h = D q.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (3), (19);
    docs/equations.md.
    """
    a2 = semi_major * semi_major
    b2 = semi_minor * semi_minor
    tx, ty, tz = T[0], T[1], T[2]
    # N_ij = r_i' Q r_j as a linear form in q, for 11, 12, 22, 13, 23, 33.
    L = np.empty((6, 6))
    for k in range(6):
        if k == 0:
            i, j = 0, 0
        elif k == 1:
            i, j = 0, 1
        elif k == 2:
            i, j = 1, 1
        elif k == 3:
            i, j = 0, 2
        elif k == 4:
            i, j = 1, 2
        else:
            i, j = 2, 2
        L[k, 0] = R[0, i] * R[0, j]
        L[k, 1] = 0.5 * (R[0, i] * R[1, j] + R[1, i] * R[0, j])
        L[k, 2] = R[1, i] * R[1, j]
        L[k, 3] = 0.5 * (R[0, i] * R[2, j] + R[2, i] * R[0, j])
        L[k, 4] = 0.5 * (R[1, i] * R[2, j] + R[2, i] * R[1, j])
        L[k, 5] = R[2, i] * R[2, j]
    for k in range(6):
        D[0, k] = a2 * L[0, k] - b2 * L[2, k]
        D[1, k] = L[1, k]
        D[2, k] = tz * L[3, k] + tx * L[0, k]
        D[3, k] = tz * L[4, k] + ty * L[2, k]
        D[4, k] = (a2 - tx * tx) * L[0, k] - ty * ty * L[2, k] + tz * tz * L[5, k]
    N = L @ q
    for r in range(5):
        value = 0.0
        for k in range(6):
            value += D[r, k] * q[k]
        h[r] = value

    # Q r_i, and the gradients of N_ij in w: dr_i = r_i x w, so (Q r_j) x r_i + (Q r_i) x r_j.
    g = np.empty((3, 3))
    for i in range(3):
        g[0, i] = q[0] * R[0, i] + 0.5 * q[1] * R[1, i] + 0.5 * q[3] * R[2, i]
        g[1, i] = 0.5 * q[1] * R[0, i] + q[2] * R[1, i] + 0.5 * q[4] * R[2, i]
        g[2, i] = 0.5 * q[3] * R[0, i] + 0.5 * q[4] * R[1, i] + q[5] * R[2, i]
    for d in range(3):
        e, f = (d + 1) % 3, (d + 2) % 3
        w11 = 2.0 * (g[e, 0] * R[f, 0] - g[f, 0] * R[e, 0])
        w22 = 2.0 * (g[e, 1] * R[f, 1] - g[f, 1] * R[e, 1])
        w33 = 2.0 * (g[e, 2] * R[f, 2] - g[f, 2] * R[e, 2])
        w12 = g[e, 1] * R[f, 0] - g[f, 1] * R[e, 0] + g[e, 0] * R[f, 1] - g[f, 0] * R[e, 1]
        w13 = g[e, 2] * R[f, 0] - g[f, 2] * R[e, 0] + g[e, 0] * R[f, 2] - g[f, 0] * R[e, 2]
        w23 = g[e, 2] * R[f, 1] - g[f, 2] * R[e, 1] + g[e, 1] * R[f, 2] - g[f, 1] * R[e, 2]
        H[0, d] = a2 * w11 - b2 * w22
        H[1, d] = w12
        H[2, d] = tz * w13 + tx * w11
        H[3, d] = tz * w23 + ty * w22
        H[4, d] = (a2 - tx * tx) * w11 - ty * ty * w22 + tz * tz * w33
        # dT = R' rho
        H[0, 3 + d] = 0.0
        H[1, 3 + d] = 0.0
        H[2, 3 + d] = R[d, 2] * N[3] + R[d, 0] * N[0]
        H[3, 3 + d] = R[d, 2] * N[4] + R[d, 1] * N[2]
        H[4, 3 + d] = 2.0 * (tz * R[d, 2] * N[5] - tx * R[d, 0] * N[0] - ty * R[d, 1] * N[2])


@njit(cache=True, error_model="numpy")
def shape_jacobian(
    gTb: FloatArray,
    bTc: FloatArray,
    centres: FloatArray,
    gRl: FloatArray,
    semi_axes: FloatArray,
    conics: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Residuals of eq. (19) of several rims at a pose, and their derivatives.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres : ndarray, shape (n, 3)
        Rim centres in g, m.
    gRl : ndarray, shape (n, 3, 3)
        Attitudes of the crater-local frames.
    semi_axes : ndarray, shape (n, 2)
        a and b, m.
    conics : ndarray, shape (n, 6)
        Measured conics (A, B, C, D, E, F), of any sign and scale.

    Returns
    -------
    h : ndarray, shape (n, 5)
        Residuals, see `shape`.
    H : ndarray, shape (n, 5, 6)
        Derivatives in the body's right twist [w, rho].
    D : ndarray, shape (n, 5, 6)
        Derivatives in the conic's coefficients.
    in_front : ndarray of bool, shape (n,)
        Camera above the rim's plane and rim centre in front of the camera: elsewhere zeros of h are no poses.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (19); docs/equations.md.
    """
    n = centres.shape[0]
    h = np.empty((n, 5))
    H = np.empty((n, 5, 6))
    D = np.empty((n, 5, 6))
    in_front = np.zeros(n, dtype=np.bool_)
    gRc, P = camera_pose(gTb, bTc)
    R = np.empty((3, 3))
    T = np.empty(3)
    Jc = np.empty((5, 6))
    for k in range(n):
        for i in range(3):
            T[i] = 0.0
            for j in range(3):
                T[i] += gRl[k, j, i] * (P[j] - centres[k, j])
                R[i, j] = gRc[0, i] * gRl[k, 0, j] + gRc[1, i] * gRl[k, 1, j] + gRc[2, i] * gRl[k, 2, j]
        shape(R, T, semi_axes[k, 0], semi_axes[k, 1], conics[k], h[k], Jc, D[k])
        body_columns(Jc, bTc, H[k])
        p_z = -(R[2, 0] * T[0] + R[2, 1] * T[1] + R[2, 2] * T[2])
        in_front[k] = T[2] > 0.0 and p_z > 0.0
    return h, H, D, in_front
