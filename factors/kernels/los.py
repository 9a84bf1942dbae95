"""Line of sight of the true crater centre from its image conic, eqs. (8), (9), (11)."""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit


@njit(cache=True, error_model="numpy")
def _adjugate(q: FloatArray, K: FloatArray) -> None:
    """Write the adjugate of Q = [[A, B/2, D/2], [B/2, C, E/2], [D/2, E/2, F]]."""
    A, B, C, D, E, F = q[0], 0.5 * q[1], q[2], 0.5 * q[3], 0.5 * q[4], q[5]
    K[0, 0] = C * F - E * E
    K[0, 1] = D * E - B * F
    K[0, 2] = B * E - C * D
    K[1, 1] = A * F - D * D
    K[1, 2] = B * D - A * E
    K[2, 2] = A * C - B * B
    K[1, 0], K[2, 0], K[2, 1] = K[0, 1], K[0, 2], K[1, 2]


@njit(cache=True, error_model="numpy")
def line_of_sight(q: FloatArray, n_c: FloatArray) -> FloatArray:
    """Direction to the true crater centre from the image of its rim: K n_c / |K n_c|, K = -4 adj(Q).

    Parameters
    ----------
    q : ndarray, shape (6,)
        Conic (A, B, C, D, E, F), of any sign and scale.
    n_c : ndarray, shape (3,)
        Outward normal of the rim's plane in c, a unit vector.

    Returns
    -------
    ndarray, shape (3,)
        Unit vector in c, from the camera to the crater.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (8), (9), (12);
    docs/equations.md.
    """
    K = np.empty((3, 3))
    _adjugate(q, K)
    d = np.empty(3)
    norm = 0.0
    for i in range(3):
        d[i] = -(K[i, 0] * n_c[0] + K[i, 1] * n_c[1] + K[i, 2] * n_c[2])
        norm += d[i] * d[i]
    return d / np.sqrt(norm)


@njit(cache=True, error_model="numpy")
def line_of_sight_jacobian(q: FloatArray, n_c: FloatArray) -> FloatArray:
    """Jacobian of `line_of_sight` in the conic.

    The adjugate is quadratic, so its derivative is exactly adj(Q + dQ) - adj(Q) - adj(dQ).

    Parameters
    ----------
    q : ndarray, shape (6,)
        Conic (A, B, C, D, E, F), of any sign and scale.
    n_c : ndarray, shape (3,)
        Outward normal of the rim's plane in c, a unit vector.

    Returns
    -------
    ndarray, shape (3, 6)
        Derivatives of the direction in c in the conic's six coefficients.
    """
    K = np.empty((3, 3))
    K1 = np.empty((3, 3))
    K2 = np.empty((3, 3))
    _adjugate(q, K)
    v = -(K @ n_c)
    norm = np.sqrt(np.sum(v * v))
    unit = v / norm
    J = np.empty((3, 6))
    for j in range(6):
        dq = np.zeros(6)
        dq[j] = 1.0
        _adjugate(dq, K1)
        _adjugate(q + dq, K2)
        dv = -((K2 - K - K1) @ n_c)
        J[:, j] = (dv - unit * np.sum(unit * dv)) / norm
    return J


@njit(cache=True, error_model="numpy")
def los_residual(
    p: FloatArray, n_c: FloatArray, q: FloatArray, basis: FloatArray, e: FloatArray, J: FloatArray
) -> None:
    """Write the line-of-sight residual of one crater: e = basis' (p/|p| - K n_c/|K n_c|), eq. (11).

    Parameters
    ----------
    p : ndarray, shape (3,)
        Crater centre in c, m.
    n_c : ndarray, shape (3,)
        Outward normal of the rim's plane in c, a unit vector.
    q : ndarray, shape (6,)
        Measured conic, of any sign and scale.
    basis : ndarray, shape (3, 2)
        Orthonormal tangents in c at the measured direction.
    e : ndarray, shape (2,)
        Written: the residual, rad.
    J : ndarray, shape (2, 6)
        Written: derivatives in the camera's right twist [w, rho].

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (11); docs/equations.md.
    """
    K = np.empty((3, 3))
    _adjugate(q, K)
    v = -(K @ n_c)
    vn = np.sqrt(np.sum(v * v))
    pn = np.sqrt(np.sum(p * p))
    vu = v / vn
    pu = p / pn
    for r in range(2):
        e[r] = 0.0
        for i in range(3):
            e[r] += basis[i, r] * (pu[i] - vu[i])
    dp = np.empty(3)
    dn = np.empty(3)
    for d in range(6):
        dp[:] = 0.0
        dn[:] = 0.0
        if d < 3:
            i, j = (d + 1) % 3, (d + 2) % 3
            dp[i], dp[j] = p[j], -p[i]
            dn[i], dn[j] = n_c[j], -n_c[i]
        else:
            dp[d - 3] = -1.0
        dv = -(K @ dn)
        along_p = np.sum(pu * dp)
        along_v = np.sum(vu * dv)
        for r in range(2):
            J[r, d] = 0.0
            for i in range(3):
                J[r, d] += basis[i, r] * ((dp[i] - pu[i] * along_p) / pn - (dv[i] - vu[i] * along_v) / vn)


@njit(cache=True, error_model="numpy")
def lines_of_sight(
    gTc: FloatArray, centres: FloatArray, normals: FloatArray, conics: FloatArray, sign: float
) -> tuple[FloatArray, FloatArray]:
    """Residuals of craters without the choice of tangents: sign p/|p| - K n_c/|K n_c|, eq. (11).

    Parameters
    ----------
    gTc : ndarray, shape (4, 4)
        Pose of the camera.
    centres : ndarray, shape (n, 3)
        In g, m.
    normals : ndarray, shape (n, 3)
        Outward normals of the rims' planes in g, unit vectors.
    conics : ndarray, shape (n, 6)
        Measured conics, of any sign and scale.
    sign : float
        1, or -1 as printed.

    Returns
    -------
    e : ndarray, shape (n, 3)
        Differences of unit vectors in c.
    J : ndarray, shape (n, 3, 6)
        Derivatives in the camera's right twist [w, rho], per rad and m in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (11); docs/equations.md.
    """
    n = len(centres)
    e = np.empty((n, 3))
    J = np.empty((n, 3, 6))
    K = np.empty((3, 3))
    p, n_c, v = np.empty(3), np.empty(3), np.empty(3)
    dp, dn, dv = np.empty(3), np.empty(3), np.empty(3)
    for crater in range(n):
        _adjugate(conics[crater], K)
        for i in range(3):
            p[i] = n_c[i] = 0.0
            for j in range(3):
                p[i] += gTc[j, i] * (centres[crater, j] - gTc[j, 3])
                n_c[i] += gTc[j, i] * normals[crater, j]
        for i in range(3):
            v[i] = -(K[i, 0] * n_c[0] + K[i, 1] * n_c[1] + K[i, 2] * n_c[2])
        pn = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        vn = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        for i in range(3):
            e[crater, i] = sign * p[i] / pn - v[i] / vn
        for d in range(6):
            dp[:] = 0.0
            dn[:] = 0.0
            if d < 3:
                i, j = (d + 1) % 3, (d + 2) % 3
                dp[i], dp[j] = p[j], -p[i]
                dn[i], dn[j] = n_c[j], -n_c[i]
            else:
                dp[d - 3] = -1.0
            along_p = along_v = 0.0
            for i in range(3):
                dv[i] = -(K[i, 0] * dn[0] + K[i, 1] * dn[1] + K[i, 2] * dn[2])
                along_p += p[i] * dp[i]
                along_v += v[i] * dv[i]
            for i in range(3):
                of_centre = (dp[i] - p[i] * along_p / (pn * pn)) / pn
                J[crater, i, d] = sign * of_centre - (dv[i] - v[i] * along_v / (vn * vn)) / vn
    return e, J
