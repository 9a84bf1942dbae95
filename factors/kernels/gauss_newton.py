"""Parts of a Gauss-Newton iteration on a pose: a small linear solve, a prior, a step.

Written out in loops: numba takes seconds to compile the library's linear algebra.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit


@njit(cache=True, error_model="numpy")
def substitute(L: FloatArray, x: FloatArray) -> None:
    """Solve L L' x = b by forward and back substitution, in place.

    Parameters
    ----------
    L : ndarray, shape (n, n)
        Lower triangular, such as a Cholesky factor; its unknowns may have different units.
    x : ndarray, shape (n,)
        The right-hand side b, in the units that follow from L; overwritten by the solution.
    """
    n = x.shape[0]
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]


@njit(cache=True, error_model="numpy")
def solve(N: FloatArray, g: FloatArray, x: FloatArray) -> None:
    """Solve N x = g by Cholesky decomposition, scaled to a unit diagonal.

    Parameters
    ----------
    N : ndarray, shape (n, n)
        Positive definite, such as a normal matrix; its unknowns may have different units.
    g : ndarray, shape (n,)
        Right-hand side, in the units that follow from N.
    x : ndarray, shape (n,)
        Written: the solution; NaN where N is not positive definite.
    """
    n = g.shape[0]
    L = np.empty((n, n))
    for i in range(n):
        x[i] = g[i] / np.sqrt(N[i, i])
        for j in range(i + 1):
            total = N[i, j] / np.sqrt(N[i, i] * N[j, j])
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
    substitute(L, x)
    for i in range(n):
        x[i] /= np.sqrt(N[i, i])


@njit(cache=True, error_model="numpy")
def _rotation_log(M: FloatArray, w: FloatArray) -> float:
    """Write the logarithm w[:3] of a rotation M (3, 3); return (1 - (t/2) cot(t/2))/t^2, t = |w|."""
    sine2 = 0.0
    for i in range(3):
        w[i] = 0.5 * (M[(i + 2) % 3, (i + 1) % 3] - M[(i + 1) % 3, (i + 2) % 3])
        sine2 += w[i] * w[i]
    sine = np.sqrt(sine2)
    angle = np.arctan2(sine, 0.5 * (M[0, 0] + M[1, 1] + M[2, 2] - 1.0))
    c = 1.0 / 12.0
    if angle > 1e-3:
        c = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / (angle * angle)
    if sine <= 1e-9 and angle > 1.0:
        # Half a turn: the matrix is symmetric, and the axis is a column of M + 1, which is 2 a a'.
        k = 0
        for i in range(1, 3):
            if M[i, i] > M[k, k]:
                k = i
        length = np.sqrt(2.0 * (1.0 + M[k, k]))
        for i in range(3):
            w[i] = angle * (M[i, k] + (1.0 if i == k else 0.0)) / length
        return c
    for i in range(3):
        w[i] *= angle / sine if sine > 1e-9 else 1.0
    return c


@njit(cache=True, error_model="numpy")
def invert(N: FloatArray, out: FloatArray) -> None:
    """Invert a positive definite matrix by Cholesky decomposition, scaled to a unit diagonal.

    Parameters
    ----------
    N : ndarray, shape (n, n)
        Such as an information matrix; its unknowns may have different units.
    out : ndarray, shape (n, n)
        Written: the inverse, such as a covariance; not finite when N is not positive definite.
    """
    unit = np.empty(N.shape[0])
    for a in range(N.shape[0]):
        unit[:] = 0.0
        unit[a] = 1.0
        solve(N, unit, out[a])


@njit(cache=True, error_model="numpy")
def prior_terms(prior: FloatArray, W: FloatArray, pose: FloatArray, N: FloatArray, g: FloatArray) -> float:
    """Write normal matrix and gradient of a prior on a pose.

    Parameters
    ----------
    prior : ndarray, shape (4, 4)
        Mean of the pose gTb.
    W : ndarray, shape (6, 6)
        Inverse covariance of the errors of attitude (rotation vector in b, rad) and position (in g, m).
    pose : ndarray, shape (4, 4)
        Pose gTb at which to linearise.
    N : ndarray, shape (6, 6)
        Written: normal matrix for the body's right twist [w, rho].
    g : ndarray, shape (6,)
        Written: gradient of half the cost in that twist.

    Returns
    -------
    float
        Squared Mahalanobis distance of the pose from the prior.
    """
    e = np.zeros(6)
    D = np.zeros((6, 6))
    M = np.zeros((3, 3))
    for i in range(3):
        e[3 + i] = pose[i, 3] - prior[i, 3]
        for j in range(3):
            D[3 + i, 3 + j] = pose[i, j]
            for k in range(3):
                M[i, j] += prior[k, i] * pose[k, j]
    # The derivative of the rotation's logarithm for a right perturbation.
    c = _rotation_log(M, e)
    angle2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    for i in range(3):
        D[i, i] = 1.0 - c * angle2
        for j in range(3):
            D[i, j] += c * e[i] * e[j]
        D[i, (i + 1) % 3] -= 0.5 * e[(i + 2) % 3]
        D[i, (i + 2) % 3] += 0.5 * e[(i + 1) % 3]
    cost = 0.0
    N[:] = 0.0
    g[:] = 0.0
    for a in range(6):
        for b in range(6):
            cost += e[a] * W[a, b] * e[b]
            for i in range(6):
                g[i] += D[a, i] * W[a, b] * e[b]
                for j in range(6):
                    N[i, j] += D[a, i] * W[a, b] * D[b, j]
    return cost


@njit(cache=True, error_model="numpy")
def move(pose: FloatArray, delta: FloatArray) -> None:
    """Move a pose by a right twist: R exp(w), t + R rho.

    Parameters
    ----------
    pose : ndarray, shape (4, 4)
        Pose of the body in g, m; moved in place.
    delta : ndarray, shape (6,)
        Twist [w, rho] in b, rad and m.
    """
    angle2 = delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2
    angle = np.sqrt(angle2)
    a = np.sin(angle) / angle if angle > 1e-6 else 1.0
    b = (1.0 - np.cos(angle)) / angle2 if angle > 1e-6 else 0.5
    E = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            E[i, j] = b * delta[i] * delta[j]
        E[i, i] += 1.0 - b * angle2
        E[i, (i + 1) % 3] -= a * delta[(i + 2) % 3]
        E[i, (i + 2) % 3] += a * delta[(i + 1) % 3]
    row = np.empty(3)
    for i in range(3):
        for j in range(3):
            row[j] = pose[i, j]
        for j in range(3):
            pose[i, 3] += row[j] * delta[3 + j]
            pose[i, j] = row[0] * E[0, j] + row[1] * E[1, j] + row[2] * E[2, j]


@njit(cache=True, error_model="numpy")
def screw(pose: FloatArray, delta: FloatArray) -> None:
    """Move a pose by the exponential of a right twist; equal to `move` to first order.

    A turn that keeps the view on one place of the ground is a screw: one twist, however far it goes.

    Parameters
    ----------
    pose : ndarray, shape (4, 4)
        Pose of the body in g, m; moved in place.
    delta : ndarray, shape (6,)
        Twist [w, rho] in b, rad and m.
    """
    w, rho = delta[:3], delta[3:]
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = np.sqrt(angle2)
    b = (1.0 - np.cos(angle)) / angle2 if angle > 1e-4 else 0.5
    c = (1.0 - np.sin(angle) / angle) / angle2 if angle > 1e-4 else 1.0 / 6.0
    step = np.empty(6)
    once = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        once[i] = w[j] * rho[k] - w[k] * rho[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        step[i] = w[i]
        step[3 + i] = rho[i] + b * once[i] + c * (w[j] * once[k] - w[k] * once[j])
    move(pose, step)


@njit(cache=True, error_model="numpy")
def screw_between(a: FloatArray, b: FloatArray, delta: FloatArray) -> None:
    """Write the right twist whose `screw` takes one pose to another.

    Parameters
    ----------
    a, b : ndarray, shape (4, 4)
        Poses of the body in g, m.
    delta : ndarray, shape (6,)
        Written: the twist [w, rho] in the body's frame at a, rad and m.
    """
    M = np.zeros((3, 3))
    t = np.zeros(3)
    for i in range(3):
        for k in range(3):
            t[i] += a[k, i] * (b[k, 3] - a[k, 3])
            for j in range(3):
                M[i, j] += a[k, i] * b[k, j]
    c = _rotation_log(M, delta)
    once = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        once[i] = delta[j] * t[k] - delta[k] * t[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        delta[3 + i] = t[i] - 0.5 * once[i] + c * (delta[j] * once[k] - delta[k] * once[j])
