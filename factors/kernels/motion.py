"""Motion without an accelerometer: transition of the state, its derivative and the noise it adds.

The state is pose gTb, velocity gV relative to g, and two vectors in b in the places of the IMU's biases.
Without an IMU the gyro reads a constant, and less its bias that is the angular velocity: w = gyro - bias.
The accelerometer's bias is minus the acceleration where a model has one.

    gRb' = gRb [w]x - [spin]x gRb,   gP' = gV,   gV' = a,

    COAST               a = gravity(P) - 2 spin x V - spin x (spin x P)
    WHITE_ACCELERATION  a = (gRb w - spin) x V           velocity constant in b
    WHITE_JERK          a = the same - gRb ba            acceleration constant in b

Order of the error state, 15: attitude (rotation vector in b), position and velocity (in g), gyro bias,
accelerometer bias (in b); as `strapdown` without the angular velocity. All equations are integrated by the
classical Runge-Kutta method, the rotation in closed form.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

COAST, WHITE_ACCELERATION, WHITE_JERK = 0, 1, 2
SIZE = 15

# Longest step, s, and largest turn in a step, rad: an orbit of 100 km is then followed to 1e-6 m in an hour.
_LONGEST_STEP_S, _LARGEST_TURN_RAD = 5.0, 0.05
# Steps of an interval with white jerk at the least: its noise grows with the fifth power of the time.
_JERK_STEPS = 10
# Step of the central differences of a gravity field, as a share of the radius.
_DIFFERENCE_SHARE = 1e-4


@njit(cache=True, error_model="numpy")
def gravity(
    P: FloatArray, mu: float, radius: float, C: FloatArray, S: FloatArray, out: FloatArray
) -> None:  # fmt: skip
    """Compute the gravity of a spherical-harmonics field by Cunningham's recursion.

    Parameters
    ----------
    P : ndarray, shape (3,)
        Position in g, m.
    mu : float
        Gravitational parameter, m^3/s^2.
    radius : float
        Reference radius of the coefficients, m.
    C, S : ndarray, shape (n + 1, n + 1)
        Unnormalised coefficients by degree and order, dimensionless; C[0, 0] = 1.
    out : ndarray, shape (3,)
        Written: acceleration in g, m/s^2.

    References
    ----------
    Montenbruck, O., Gill, E. (2000), Satellite Orbits, section 3.2.4.
    """
    r2 = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    top = C.shape[0] - 1
    if top < 1:
        k = -mu / (r2 * np.sqrt(r2))
        for i in range(3):
            out[i] = k * P[i]
        return
    x, y, z, rho = radius * P[0] / r2, radius * P[1] / r2, radius * P[2] / r2, radius * radius / r2
    V, W = np.zeros((top + 2, top + 2)), np.zeros((top + 2, top + 2))
    V[0, 0] = radius / np.sqrt(r2)
    for m in range(top + 2):
        if m > 0:
            V[m, m] = (2 * m - 1) * (x * V[m - 1, m - 1] - y * W[m - 1, m - 1])
            W[m, m] = (2 * m - 1) * (x * W[m - 1, m - 1] + y * V[m - 1, m - 1])
        for n in range(m + 1, top + 2):
            V[n, m] = (2 * n - 1) * z * V[n - 1, m] / (n - m)
            W[n, m] = (2 * n - 1) * z * W[n - 1, m] / (n - m)
            if n > m + 1:
                V[n, m] -= (n + m - 1) * rho * V[n - 2, m] / (n - m)
                W[n, m] -= (n + m - 1) * rho * W[n - 2, m] / (n - m)
    ax, ay, az = 0.0, 0.0, 0.0
    for n in range(top + 1):
        ax -= C[n, 0] * V[n + 1, 1]
        ay -= C[n, 0] * W[n + 1, 1]
        az -= (n + 1) * C[n, 0] * V[n + 1, 0]
        for m in range(1, n + 1):
            c, s = C[n, m], S[n, m]
            f = 0.5 * (n - m + 1) * (n - m + 2)
            ax -= 0.5 * (c * V[n + 1, m + 1] + s * W[n + 1, m + 1])
            ax += f * (c * V[n + 1, m - 1] + s * W[n + 1, m - 1])
            ay -= 0.5 * (c * W[n + 1, m + 1] - s * V[n + 1, m + 1])
            ay -= f * (c * W[n + 1, m - 1] - s * V[n + 1, m - 1])
            az -= (n - m + 1) * (c * V[n + 1, m] + s * W[n + 1, m])
    k = mu / (radius * radius)
    out[0], out[1], out[2] = k * ax, k * ay, k * az


@njit(cache=True, error_model="numpy")
def _gravity_gradient(
    P: FloatArray, mu: float, radius: float, C: FloatArray, S: FloatArray, out: FloatArray
) -> None:  # fmt: skip
    """Write the derivative (3, 3) of `gravity` in the position."""
    r2 = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    r = np.sqrt(r2)
    if C.shape[0] < 2:
        k = mu / (r2 * r)
        for i in range(3):
            for j in range(3):
                out[i, j] = 3.0 * k * P[i] * P[j] / r2 - (k if i == j else 0.0)
        return
    step = _DIFFERENCE_SHARE * r
    ahead, behind, X = np.empty(3), np.empty(3), P.copy()
    for j in range(3):
        X[j] = P[j] + step
        gravity(X, mu, radius, C, S, ahead)
        X[j] = P[j] - step
        gravity(X, mu, radius, C, S, behind)
        X[j] = P[j]
        for i in range(3):
            out[i, j] = (ahead[i] - behind[i]) / (2.0 * step)


@njit(cache=True, error_model="numpy")
def _rotation(w: FloatArray, t: float) -> FloatArray:
    """Rotation matrix (3, 3) of the rotation vector w t, rad."""
    a, b, c = w[0] * t, w[1] * t, w[2] * t
    t2 = a * a + b * b + c * c
    if t2 > 1e-8:
        angle = np.sqrt(t2)
        s, k = np.sin(angle) / angle, (1.0 - np.cos(angle)) / t2
    else:
        s, k = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0
    E = np.empty((3, 3))
    E[0, 0], E[1, 1], E[2, 2] = (
        1.0 - k * (b * b + c * c),
        1.0 - k * (a * a + c * c),
        1.0 - k * (a * a + b * b),
    )
    E[0, 1], E[1, 0] = k * a * b - s * c, k * a * b + s * c
    E[0, 2], E[2, 0] = k * a * c + s * b, k * a * c - s * b
    E[1, 2], E[2, 1] = k * b * c - s * a, k * b * c + s * a
    return E


@njit(cache=True, error_model="numpy")
def _cross_matrix(a: FloatArray) -> FloatArray:
    """Matrix (3, 3) of the cross product with a vector."""
    K = np.zeros((3, 3))
    K[0, 1], K[0, 2], K[1, 2] = -a[2], a[1], -a[0]
    K[1, 0], K[2, 0], K[2, 1] = a[2], -a[1], a[0]
    return K


@njit(cache=True, error_model="numpy")
def _acceleration(
    kind: int, R: FloatArray, P: FloatArray, V: FloatArray, w: FloatArray, a_b: FloatArray,
    mu: float, spin: FloatArray, radius: float, C: FloatArray, S: FloatArray,
) -> FloatArray:  # fmt: skip
    """Compute the derivative (3,) of the velocity."""
    out = np.empty(3)
    if kind == COAST:
        gravity(P, mu, radius, C, S, out)
        u = 2.0 * V + np.cross(spin, P)
        return out - np.cross(spin, u)
    turn = R @ w - spin
    out[:] = np.cross(turn, V)
    if kind == WHITE_JERK:
        out += R @ a_b
    return out


@njit(cache=True, error_model="numpy")
def gyro_entry(kind: int, R: FloatArray, V: FloatArray) -> FloatArray:
    """Differentiate the error state's rate by the error of the gyro's bias, and so by the gyro's noise.

    Parameters
    ----------
    kind : int
        `COAST`, `WHITE_ACCELERATION` or `WHITE_JERK`.
    R : ndarray, shape (3, 3)
        Attitude gRb.
    V : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.

    Returns
    -------
    ndarray, shape (15, 3)
        A velocity that is constant in b is turned by what turns b.
    """
    out = np.zeros((SIZE, 3))
    for i in range(3):
        out[i, i] = -1.0
    if kind != COAST:
        out[6:9] = _cross_matrix(V) @ R
    return out


@njit(cache=True, error_model="numpy")
def _derivative(
    kind: int, R: FloatArray, P: FloatArray, V: FloatArray, w: FloatArray, a_b: FloatArray,
    mu: float, spin: FloatArray, radius: float, C: FloatArray, S: FloatArray, A: FloatArray,
) -> None:  # fmt: skip
    """Write the derivative A (15, 15) of the error state's rate in the error state."""
    A[:] = 0.0
    A[0:3, 0:3] = -_cross_matrix(w)
    A[:, 9:12] = gyro_entry(kind, R, V)
    for i in range(3):
        A[3 + i, 6 + i] = 1.0
    if kind == COAST:
        G = np.empty((3, 3))
        _gravity_gradient(P, mu, radius, C, S, G)
        K = _cross_matrix(spin)
        A[6:9, 3:6] = G - K @ K
        A[6:9, 6:9] = -2.0 * K
        return
    A[6:9, 0:3] = (_cross_matrix(V) @ R) @ _cross_matrix(w)
    A[6:9, 6:9] = _cross_matrix(R @ w - spin)
    if kind == WHITE_JERK:
        A[6:9, 0:3] -= R @ _cross_matrix(a_b)
        A[6:9, 12:15] = -R


@njit(cache=True, error_model="numpy")
def _white_noise(A: FloatArray, noise: FloatArray, L: FloatArray) -> None:
    """Write the density L (15, 15) of the noise that the error state's rate has, see `_derivative` for A.

    The noise of the angular velocity enters wherever the gyro's bias does, see `gyro_entry`.
    """
    L[:] = 0.0
    for i in range(9):
        for j in range(9):
            for k in range(9, 12):
                L[i, j] += noise[0] ** 2 * A[i, k] * A[j, k]
    for i in range(3):
        L[6 + i, 6 + i] += noise[1] ** 2
        L[9 + i, 9 + i], L[12 + i, 12 + i] = noise[2] ** 2, noise[3] ** 2


@njit(cache=True, error_model="numpy")
def _step(
    kind: int, h: float, R: FloatArray, P: FloatArray, V: FloatArray, w: FloatArray, a_b: FloatArray,
    mu: float, spin: FloatArray, radius: float, C: FloatArray, S: FloatArray, noise: FloatArray,
    F: FloatArray, Q: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Do one Runge-Kutta step of the state, of the transition F and of the noise Q (15, 15)."""
    half = 0.5 * h
    R2 = _rotation(spin, -half) @ R @ _rotation(w, half)
    R4 = _rotation(spin, -h) @ R @ _rotation(w, h)
    a1 = _acceleration(kind, R, P, V, w, a_b, mu, spin, radius, C, S)
    P2, V2 = P + half * V, V + half * a1
    a2 = _acceleration(kind, R2, P2, V2, w, a_b, mu, spin, radius, C, S)
    P3, V3 = P + half * V2, V + half * a2
    a3 = _acceleration(kind, R2, P3, V3, w, a_b, mu, spin, radius, C, S)
    P4, V4 = P + h * V3, V + h * a3
    a4 = _acceleration(kind, R4, P4, V4, w, a_b, mu, spin, radius, C, S)
    P1 = P + h / 6.0 * (V + 2.0 * V2 + 2.0 * V3 + V4)
    V1 = V + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

    A1, A2, A4 = np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    _derivative(kind, R, P, V, w, a_b, mu, spin, radius, C, S, A1)
    _derivative(kind, R2, P3, V3, w, a_b, mu, spin, radius, C, S, A2)
    _derivative(kind, R4, P1, V1, w, a_b, mu, spin, radius, C, S, A4)
    k1 = A1 @ F
    k2 = A2 @ (F + half * k1)
    k3 = A2 @ (F + half * k2)
    k4 = A4 @ (F + h * k3)
    F1 = F + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    # Q' = A Q + Q A' + L, with L the densities squared.
    L1, L2, L4 = np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    _white_noise(A1, noise, L1)
    _white_noise(A2, noise, L2)
    _white_noise(A4, noise, L4)
    m1 = A1 @ Q
    m1 = m1 + m1.T + L1
    m2 = A2 @ (Q + half * m1)
    m2 = m2 + m2.T + L2
    m3 = A2 @ (Q + half * m2)
    m3 = m3 + m3.T + L2
    m4 = A4 @ (Q + h * m3)
    m4 = m4 + m4.T + L4
    Q1 = Q + h / 6.0 * (m1 + 2.0 * m2 + 2.0 * m3 + m4)
    return R4, P1, V1, F1, 0.5 * (Q1 + Q1.T)


@njit(cache=True, error_model="numpy")
def transition(
    kind: int, gTb: FloatArray, gV: FloatArray, bias: FloatArray, dt_s: FloatArray, gyro: FloatArray,
    mu: float, spin: FloatArray, radius: float, C: FloatArray, S: FloatArray, noise: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Propagate a state through rows of a gyro's log, with its derivative and the noise that is added.

    Parameters
    ----------
    kind : int
        `COAST`, `WHITE_ACCELERATION` or `WHITE_JERK`.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    bias : ndarray, shape (6,)
        Gyro (rad/s), accelerometer (m/s^2), in b.
    dt_s : ndarray, shape (m,)
        Durations of the rows, m >= 1.
    gyro : ndarray, shape (m, 3)
        Inertial angular velocity in b, rad/s; without a gyro, the constant to which the bias refers.
    mu : float
        Gravitational parameter, m^3/s^2.
    spin : ndarray, shape (3,)
        Angular velocity of g, in g, rad/s.
    radius : float
        Reference radius of the gravity field, m.
    C, S : ndarray, shape (n + 1, n + 1)
        Its coefficients, see `gravity`; of shape (1, 1) for a point mass.
    noise : ndarray, shape (4,)
        Densities of the angular velocity (rad/s/sqrt(Hz)) and the acceleration (m/s^2/sqrt(Hz)), then of the
        random walks of gyro and accelerometer bias (rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)).

    Returns
    -------
    gTb : ndarray, shape (4, 4)
        In g, m.
    gV : ndarray, shape (3,)
        In g, m/s.
    F : ndarray, shape (15, 15)
        Error after = F error before + noise, rad, m, s.
    Q : ndarray, shape (15, 15)
        Covariance of that noise, rad, m, s.
    """
    R, P, V = gTb[:3, :3].copy(), gTb[:3, 3].copy(), gV.copy()
    F, Q = np.eye(SIZE), np.zeros((SIZE, SIZE))
    a_b = -bias[3:].copy()
    for k in range(dt_s.shape[0]):
        w = gyro[k] - bias[:3]
        length_s = abs(dt_s[k])
        turn = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * length_s
        steps = max(int(np.ceil(length_s / _LONGEST_STEP_S)), int(np.ceil(turn / _LARGEST_TURN_RAD)), 1)
        if kind == WHITE_JERK and dt_s.shape[0] < _JERK_STEPS:
            steps = max(steps, _JERK_STEPS)
        h = dt_s[k] / steps
        for _ in range(steps):
            R, P, V, F, Q = _step(kind, h, R, P, V, w, a_b, mu, spin, radius, C, S, noise, F, Q)
    # One Newton step back to the rotations undoes the rounding of the products.
    R = 0.5 * R @ (3.0 * np.eye(3) - R.T @ R)
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = P
    return T, V, F, Q
