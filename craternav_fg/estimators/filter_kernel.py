"""Kernels of one filter step: rims at a pose, innovations, fusion of measurements, correction of the mean.

Each is a call of some microseconds where numpy would need dozens of calls on small matrices. The innermost
loops run along rows, so that the compiler vectorises them.
"""

import numpy as np

from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.conic import body_columns, camera_pose, chart_and_jacobian, rim_in_camera

# Angle, rad, below which rotations are taken from their series.
_SMALL_ANGLE = 1e-4


@njit(cache=True, error_model="numpy")
def root_of(S: FloatArray, L: FloatArray) -> bool:
    """Factor a covariance by Cholesky.

    Parameters
    ----------
    S : ndarray, shape (n, n)
        Symmetric, in any units; its lower half is read.
    L : ndarray, shape (n, n)
        Its lower half is written, with L L' = S, in the units that follow.

    Returns
    -------
    bool
        False when S is not positive definite.
    """
    for i in range(S.shape[0]):
        for j in range(i + 1):
            total = S[i, j]
            for r in range(j):
                total -= L[i, r] * L[j, r]
            if j < i:
                L[i, j] = total / L[j, j]
            elif total > 0.0:
                L[i, i] = np.sqrt(total)
            else:
                return False
    return True


@njit(cache=True, error_model="numpy")
def whitened_rims(
    gTb: FloatArray, bTc: FloatArray, rows: IntArray, centres: FloatArray, axes: FloatArray,
    charts: FloatArray, covariance: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray, bool]:  # fmt: skip
    """Linearise the ellipse charts of rims at a pose, whitened.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    rows : ndarray of int, shape (n,)
        Each rim's crater.
    centres, axes : ndarray, shapes (c, 3) and (c, 2, 3)
        Rims of all craters in g, m.
    charts, covariance : ndarray, shapes (n, 5) and (n, 5, 5)
        Measured ellipse charts, normalised, and their covariances.

    Returns
    -------
    A : ndarray, shape (n, 5, 6)
        Derivatives in the errors of attitude (in b, rad) and position (in g, m); zero where not visible.
    residual : ndarray, shape (n, 5)
        Measured minus predicted; zero where not visible.
    visible : ndarray of bool, shape (n,)
        Rims that are visible ellipses from the pose.
    sound : bool
        False when the covariance of a visible rim is not positive definite.
    """
    n = rows.shape[0]
    A, residual, visible = np.zeros((n, 5, 6)), np.zeros((n, 5)), np.zeros(n, dtype=np.bool_)
    R, P = camera_pose(gTb, bTc)
    p, c, y = np.empty(3), np.empty((2, 3)), np.empty(5)
    J, H, L = np.empty((5, 6)), np.empty((5, 6)), np.empty((5, 5))
    for k in range(n):
        rim_in_camera(R, P, centres[rows[k]], axes[rows[k]], p, c)
        visible[k] = chart_and_jacobian(p, c, y, J)
        if not visible[k]:
            continue
        if not root_of(covariance[k], L):
            return A, residual, visible, False
        body_columns(J, bTc, H)
        a, e = A[k], residual[k]
        for i in range(5):
            e[i] = charts[k, i] - y[i]
            for j in range(3):
                a[i, j] = H[i, j]
                a[i, 3 + j] = H[i, 3] * gTb[j, 0] + H[i, 4] * gTb[j, 1] + H[i, 5] * gTb[j, 2]
            for r in range(i):
                e[i] -= L[i, r] * e[r]
                for j in range(6):
                    a[i, j] -= L[i, r] * a[r, j]
            e[i] /= L[i, i]
            for j in range(6):
                a[i, j] /= L[i, i]
    return A, residual, visible, True


@njit(cache=True, error_model="numpy")
def squared_innovations(A: FloatArray, residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """Square the normalised innovations of whitened measurements, each on its own.

    Parameters
    ----------
    A : ndarray, shape (n, m, k)
        Whitened derivatives in the first k entries of the prior's error.
    residual : ndarray, shape (n, m)
        Whitened, measured minus predicted.
    covariance : ndarray, shape (K, K), K >= k
        Covariance of the prior's error.

    Returns
    -------
    ndarray, shape (n,)
        r' (A P A' + I)^-1 r.
    """
    n, m, k = A.shape
    out = np.zeros(n)
    B, S, L, x = np.empty((m, k)), np.empty((m, m)), np.empty((m, m)), np.empty(m)
    for one in range(n):
        for i in range(m):
            for j in range(k):
                B[i, j] = 0.0
            for r in range(k):
                for j in range(k):
                    B[i, j] += A[one, i, r] * covariance[r, j]
        for i in range(m):
            for j in range(i + 1):
                S[i, j] = 1.0 if i == j else 0.0
                for r in range(k):
                    S[i, j] += B[i, r] * A[one, j, r]
        if not root_of(S, L):
            # Only numbers that are not finite: a covariance plus the identity is positive definite.
            out[one] = np.nan
            continue
        for i in range(m):
            x[i] = residual[one, i]
            for r in range(i):
                x[i] -= L[i, r] * x[r]
            x[i] /= L[i, i]
            out[one] += x[i] * x[i]
    return out


@njit(cache=True, error_model="numpy")
def fused(
    covariance: FloatArray, A: FloatArray, residual: FloatArray, prior: float, share: float
) -> tuple[FloatArray, FloatArray, bool]:
    """Add the information of measurements to that of a prior, in the prior's whitened coordinates.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Covariance of the prior L L'.
    A : ndarray, shape (m, k)
        Whitened derivatives in the first k entries of the error state.
    residual : ndarray, shape (m,)
        Whitened, measured minus predicted.
    prior : float
        How often the prior counts.
    share : float
        Weight of the measurements' information.

    Returns
    -------
    delta : ndarray, shape (n,)
        Correction of the prior's mean, in the units of the error state.
    covariance : ndarray, shape (n, n)
        Covariance of the fused estimate.
    sound : bool
        False when the prior's covariance is not positive definite, or a number is not finite.
    """
    n, (m, k) = covariance.shape[0], A.shape
    delta, out = np.zeros(n), np.zeros((n, n))
    # L is lower triangular: the first k states depend on the first k whitened ones only.
    L, root = np.zeros((n, n)), np.zeros((n, n))
    if not root_of(covariance, L):
        return delta, out, False
    N, vector, a = np.zeros((k, k)), np.zeros(k), np.empty(k)
    for row in range(m):
        a[:] = 0.0
        for r in range(k):
            for j in range(r + 1):
                a[j] += A[row, r] * L[r, j]
        for i in range(k):
            vector[i] += share * a[i] * residual[row]
            for j in range(i + 1):
                N[i, j] += share * a[i] * a[j]
    for i in range(k):
        N[i, i] += prior
    C, inverse = np.zeros((k, k)), np.zeros((k, k))
    if not root_of(N, C):
        return delta, out, False
    # The inverse of C, by rows.
    for i in range(k):
        inverse[i, i] = 1.0
        for r in range(i):
            for j in range(r + 1):
                inverse[i, j] -= C[i, r] * inverse[r, j]
        for j in range(i + 1):
            inverse[i, j] /= C[i, i]
    # root root' is the fused covariance: root = L blockdiag(inverse', I / sqrt(prior)).
    for i in range(n):
        for r in range(min(i + 1, k)):
            for j in range(r, k):
                root[i, j] += L[i, r] * inverse[j, r]
        for r in range(k, i + 1):
            root[i, r] = L[i, r] / np.sqrt(prior)
    for j in range(k):
        along = 0.0
        for r in range(j + 1):
            along += inverse[j, r] * vector[r]
        for i in range(n):
            delta[i] += root[i, j] * along
    for r in range(n):
        a = np.ascontiguousarray(root[:, r])
        for i in range(n):
            for j in range(i + 1):
                out[i, j] += a[i] * a[j]
    for i in range(n):
        for j in range(i):
            out[j, i] = out[i, j]
    return delta, out, True


@njit(cache=True, error_model="numpy")
def corrected(gTb: FloatArray, covariance: FloatArray, delta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Correct a pose, and refer a covariance to the corrected attitude.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    covariance : ndarray, shape (n, n)
        Covariance of the error about `delta`, attitude first.
    delta : ndarray, shape (n,)
        Correction: attitude (rotation vector in b), position (in g, m), others.

    Returns
    -------
    gTb : ndarray, shape (4, 4)
    covariance : ndarray, shape (n, n)
        Symmetric.
    """
    n = covariance.shape[0]
    w0, w1, w2 = delta[0], delta[1], delta[2]
    angle2 = w0 * w0 + w1 * w1 + w2 * w2
    if angle2 < _SMALL_ANGLE**2:
        s, c, d = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0
    else:
        angle = np.sqrt(angle2)
        half = np.sin(0.5 * angle) / angle
        s, c, d = np.sin(angle) / angle, 2.0 * half * half, (angle - np.sin(angle)) / (angle2 * angle)
    W = np.array([[0.0, -w2, w1], [w2, 0.0, -w0], [-w1, w0, 0.0]])
    E, J = np.eye(3), np.eye(3)
    for i in range(3):
        for j in range(3):
            W2 = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
            E[i, j] += s * W[i, j] + c * W2
            J[i, j] += d * W2 - c * W[i, j]
    pose, turned, out = gTb.copy(), covariance.copy(), np.empty((n, n))
    for i in range(3):
        pose[i, 3] += delta[3 + i]
        for j in range(3):
            pose[i, j] = gTb[i, 0] * E[0, j] + gTb[i, 1] * E[1, j] + gTb[i, 2] * E[2, j]
        for j in range(n):
            turned[i, j] = (
                J[i, 0] * covariance[0, j] + J[i, 1] * covariance[1, j] + J[i, 2] * covariance[2, j]
            )
    for i in range(n):
        x, y, z = turned[i, 0], turned[i, 1], turned[i, 2]
        for j in range(3):
            turned[i, j] = x * J[j, 0] + y * J[j, 1] + z * J[j, 2]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.5 * (turned[i, j] + turned[j, i])
    return pose, out
