"""Strapdown propagation of mean and covariance in the rotating frame g, eqs. (26)-(28).

Error state, 18: attitude (rotation vector in b, R_true = R exp(phi)), position and velocity (in g), angular
velocity (in b), gyro bias, accelerometer bias. All but the angular velocity are propagated row by row; the
angular velocity is that of the last gyro row.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

SIZE = 18
ATTITUDE, POSITION, VELOCITY, RATE, GYRO_BIAS, ACCELEROMETER_BIAS = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 9),
    slice(9, 12),
    slice(12, 15),
    slice(15, 18),
)
# The states that are propagated.
WITHOUT_RATE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 13, 14, 15, 16, 17])
# Of them those that change over a row, biases do not; and the length of a row of their covariance, with
# which the loops over columns are whole vectors.
_MOVING, _PITCH = 9, 16


@njit(cache=True, error_model="numpy")
def _rotation(w0: float, w1: float, w2: float, E: FloatArray) -> None:
    """Write the rotation matrix E (3, 3) of a rotation vector."""
    t2 = w0 * w0 + w1 * w1 + w2 * w2
    if t2 > 1e-8:
        t = np.sqrt(t2)
        s = np.sin(t) / t
        c = (1.0 - np.cos(t)) / t2
    else:
        s = 1.0 - t2 / 6.0
        c = 0.5 - t2 / 24.0
    E[0, 0] = 1.0 - c * (w1 * w1 + w2 * w2)
    E[1, 1] = 1.0 - c * (w0 * w0 + w2 * w2)
    E[2, 2] = 1.0 - c * (w0 * w0 + w1 * w1)
    E[0, 1] = c * w0 * w1 - s * w2
    E[1, 0] = c * w0 * w1 + s * w2
    E[0, 2] = c * w0 * w2 + s * w1
    E[2, 0] = c * w0 * w2 - s * w1
    E[1, 2] = c * w1 * w2 - s * w0
    E[2, 1] = c * w1 * w2 + s * w0


@njit(cache=True, error_model="numpy")
def _gravity_and_rotation(P: FloatArray, V: FloatArray, mu: float, spin: FloatArray, out: FloatArray) -> None:
    """Write the acceleration (3,) of eq. (26) without the specific force."""
    s0, s1, s2 = spin[0], spin[1], spin[2]
    r2 = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    k = mu / (r2 * np.sqrt(r2))
    # -w x (2 V + w x P)
    u0 = 2.0 * V[0] + s1 * P[2] - s2 * P[1]
    u1 = 2.0 * V[1] + s2 * P[0] - s0 * P[2]
    u2 = 2.0 * V[2] + s0 * P[1] - s1 * P[0]
    out[0] = -k * P[0] - (s1 * u2 - s2 * u1)
    out[1] = -k * P[1] - (s2 * u0 - s0 * u2)
    out[2] = -k * P[2] - (s0 * u1 - s1 * u0)


@njit(cache=True, error_model="numpy")
def _times_transition(
    M: FloatArray, width: int, A: FloatArray, C: FloatArray, B: FloatArray, R: FloatArray, dt: float
) -> None:
    """Replace M by F M, F the transition over one row.

    M (15, width) lies flat, `_PITCH` apart from row to row: a constant, by which the compiler knows that
    columns do not overlap. A (3, 3) turns the attitude error; C = dv/dphi; B = dv/dv - I and dv/dp side by
    side (3, 6); dv/dba = -R dt. Position follows from velocity: dp = dt dv + dt/2 (change of v).
    """
    half = 0.5 * dt
    a00, a01, a02 = A[0, 0], A[0, 1], A[0, 2]
    a10, a11, a12 = A[1, 0], A[1, 1], A[1, 2]
    a20, a21, a22 = A[2, 0], A[2, 1], A[2, 2]
    c00, c01, c02 = C[0, 0], C[0, 1], C[0, 2]
    c10, c11, c12 = C[1, 0], C[1, 1], C[1, 2]
    c20, c21, c22 = C[2, 0], C[2, 1], C[2, 2]
    v01, v02, v12 = B[0, 1], B[0, 2], B[1, 2]
    p00, p01, p02, p11, p12, p22 = B[0, 3], B[0, 4], B[0, 5], B[1, 4], B[1, 5], B[2, 5]
    r00, r01, r02 = dt * R[0, 0], dt * R[0, 1], dt * R[0, 2]
    r10, r11, r12 = dt * R[1, 0], dt * R[1, 1], dt * R[1, 2]
    r20, r21, r22 = dt * R[2, 0], dt * R[2, 1], dt * R[2, 2]
    for j in range(width):
        f0, f1, f2 = M[j], M[_PITCH + j], M[2 * _PITCH + j]
        p0, p1, p2 = M[3 * _PITCH + j], M[4 * _PITCH + j], M[5 * _PITCH + j]
        v0, v1, v2 = M[6 * _PITCH + j], M[7 * _PITCH + j], M[8 * _PITCH + j]
        g0, g1, g2 = M[9 * _PITCH + j], M[10 * _PITCH + j], M[11 * _PITCH + j]
        b0, b1, b2 = M[12 * _PITCH + j], M[13 * _PITCH + j], M[14 * _PITCH + j]
        M[j] = a00 * f0 + a01 * f1 + a02 * f2 - dt * g0
        M[_PITCH + j] = a10 * f0 + a11 * f1 + a12 * f2 - dt * g1
        M[2 * _PITCH + j] = a20 * f0 + a21 * f1 + a22 * f2 - dt * g2
        # The gyro bias acts on the velocity through the row's mean attitude only: see `propagate`.
        f0, f1, f2 = f0 - half * g0, f1 - half * g1, f2 - half * g2
        d0 = c00 * f0 + c01 * f1 + c02 * f2 + v01 * v1 + v02 * v2
        d1 = c10 * f0 + c11 * f1 + c12 * f2 - v01 * v0 + v12 * v2
        d2 = c20 * f0 + c21 * f1 + c22 * f2 - v02 * v0 - v12 * v1
        d0 += p00 * p0 + p01 * p1 + p02 * p2 - r00 * b0 - r01 * b1 - r02 * b2
        d1 += p01 * p0 + p11 * p1 + p12 * p2 - r10 * b0 - r11 * b1 - r12 * b2
        d2 += p02 * p0 + p12 * p1 + p22 * p2 - r20 * b0 - r21 * b1 - r22 * b2
        M[3 * _PITCH + j] = p0 + dt * v0 + half * d0
        M[4 * _PITCH + j] = p1 + dt * v1 + half * d1
        M[5 * _PITCH + j] = p2 + dt * v2 + half * d2
        M[6 * _PITCH + j] = v0 + d0
        M[7 * _PITCH + j] = v1 + d1
        M[8 * _PITCH + j] = v2 + d2


@njit(cache=True, error_model="numpy")
def _propagate(
    gTb: FloatArray,
    gV: FloatArray,
    bias: FloatArray,
    covariance: FloatArray,
    dt_s: FloatArray,
    gyro: FloatArray,
    accelerometer: FloatArray,
    mu: float,
    spin: FloatArray,
    noise: FloatArray,
    row_s: float,
    transition: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Do what `propagate` does; a transition that is not empty, laid out as M, is multiplied by the rows'."""
    R = gTb[:3, :3].copy()
    P = gTb[:3, 3].copy()
    V = gV.copy()
    rate = np.zeros(3)
    index = WITHOUT_RATE
    # The covariance, see `_times_transition`, and its first columns as rows.
    S, columns = np.zeros(15 * _PITCH), np.zeros(15 * _PITCH)
    for i in range(15):
        for j in range(15):
            S[i * _PITCH + j] = covariance[index[i], index[j]]
    E = np.empty((3, 3))
    W = np.empty((3, 3))
    RE = np.empty((3, 3))
    A = np.empty((3, 3))
    B = np.empty((3, 6))
    C = np.empty((3, 3))
    a = np.empty(3)
    u = np.empty(3)
    x = np.empty(3)
    begin = np.empty((3, 3))
    Pm = np.empty(3)
    Vm = np.empty(3)
    var_g, var_a = noise[0] ** 2, noise[1] ** 2
    walk_g, walk_a = noise[2] ** 2, noise[3] ** 2
    s0, s1, s2 = spin[0], spin[1], spin[2]
    rows = dt_s.shape[0]
    for k in range(rows):
        dt = dt_s[k]
        for i in range(3):
            rate[i] = gyro[k, i] - bias[i]
        t0, t1, t2 = rate[0] * dt, rate[1] * dt, rate[2] * dt
        f0 = accelerometer[k, 0] - bias[3]
        f1 = accelerometer[k, 1] - bias[4]
        f2 = accelerometer[k, 2] - bias[5]
        # u = f + t x f / 2 (velocity); x = f / 2 + t x f / 6 (position)
        c0, c1, c2 = t1 * f2 - t2 * f1, t2 * f0 - t0 * f2, t0 * f1 - t1 * f0
        u[0], u[1], u[2] = f0 + 0.5 * c0, f1 + 0.5 * c1, f2 + 0.5 * c2
        x[0], x[1], x[2] = 0.5 * f0 + c0 / 6.0, 0.5 * f1 + c1 / 6.0, 0.5 * f2 + c2 / 6.0
        v0 = R[0, 0] * u[0] + R[0, 1] * u[1] + R[0, 2] * u[2]
        v1 = R[1, 0] * u[0] + R[1, 1] * u[1] + R[1, 2] * u[2]
        v2 = R[2, 0] * u[0] + R[2, 1] * u[1] + R[2, 2] * u[2]
        # The axes also turn against g's spin inside the row.
        h = 0.5 * dt
        w0 = v0 - h * (s1 * v2 - s2 * v1)
        w1 = v1 - h * (s2 * v0 - s0 * v2)
        w2 = v2 - h * (s0 * v1 - s1 * v0)

        # Transition of the error, at the row's start.
        begin[:] = R
        r2 = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
        kg = mu / (r2 * np.sqrt(r2))
        spin2 = s0 * s0 + s1 * s1 + s2 * s2
        for i in range(3):
            for j in range(3):
                B[i, 3 + j] = dt * (3.0 * kg * P[i] * P[j] / r2 - spin[i] * spin[j])
            B[i, i] = 0.0
            B[i, 3 + i] += dt * (spin2 - kg)
            # C = -R [u]x dt
            C[i, 0] = -dt * (R[i, 1] * u[2] - R[i, 2] * u[1])
            C[i, 1] = -dt * (R[i, 2] * u[0] - R[i, 0] * u[2])
            C[i, 2] = -dt * (R[i, 0] * u[1] - R[i, 1] * u[0])
        B[0, 1], B[1, 0] = 2.0 * dt * s2, -2.0 * dt * s2
        B[0, 2], B[2, 0] = -2.0 * dt * s1, 2.0 * dt * s1
        B[1, 2], B[2, 1] = 2.0 * dt * s0, -2.0 * dt * s0

        _gravity_and_rotation(P, V, mu, spin, a)
        for i in range(3):
            force = w0 if i == 0 else (w1 if i == 1 else w2)
            Pm[i] = P[i] + h * V[i] + 0.5 * h * h * (a[i] + force)
            Vm[i] = V[i] + h * (a[i] + force)
        _gravity_and_rotation(Pm, Vm, mu, spin, a)
        for i in range(3):
            force = w0 if i == 0 else (w1 if i == 1 else w2)
            P[i] += dt * V[i] + dt * dt * (R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2] + 0.5 * a[i])
            V[i] += dt * (force + a[i])

        _rotation(t0, t1, t2, E)
        _rotation(-dt * s0, -dt * s1, -dt * s2, W)
        for i in range(3):
            for j in range(3):
                A[i, j] = E[j, i]
                RE[i, j] = R[i, 0] * E[0, j] + R[i, 1] * E[1, j] + R[i, 2] * E[2, j]
        for i in range(3):
            for j in range(3):
                R[i, j] = W[i, 0] * RE[0, j] + W[i, 1] * RE[1, j] + W[i, 2] * RE[2, j]

        if transition.shape[0] > 0:
            _times_transition(transition, _PITCH, A, C, B, begin, dt)
        # F S F' in two products. Columns of biases are done with the first.
        _times_transition(S, _PITCH, A, C, B, begin, dt)
        for i in range(_MOVING):
            for j in range(15):
                columns[j * _PITCH + i] = S[i * _PITCH + j]
        _times_transition(columns, _PITCH - 4, A, C, B, begin, dt)
        for i in range(15):
            for j in range(_MOVING):
                S[i * _PITCH + j] = columns[i * _PITCH + j]
        for i in range(3):
            S[i * _PITCH + i] += var_g * dt
            S[(3 + i) * _PITCH + 3 + i] += var_a * dt * dt * dt / 3.0
            S[(3 + i) * _PITCH + 6 + i] += 0.5 * var_a * dt * dt
            S[(6 + i) * _PITCH + 3 + i] += 0.5 * var_a * dt * dt
            S[(6 + i) * _PITCH + 6 + i] += var_a * dt
            if k < rows - 1:
                S[(9 + i) * _PITCH + 9 + i] += walk_g * dt
                S[(12 + i) * _PITCH + 12 + i] += walk_a * dt

    out = np.empty((18, 18))
    for i in range(15):
        for j in range(15):
            out[index[i], index[j]] = 0.5 * (S[i * _PITCH + j] + S[j * _PITCH + i])
    # Angular velocity: w = gyro - bg - n of the last row, with the mean noise n of the whole row, which is
    # also in what it turned until the end.
    dt = dt_s[rows - 1]
    for i in range(3):
        for j in range(18):
            if not 9 <= j < 12:
                out[9 + i, j] = -out[12 + i, j]
                out[j, 9 + i] = -out[12 + i, j]
        for j in range(3):
            out[9 + i, 9 + j] = out[12 + i, 12 + j]
    for i in range(3):
        out[9 + i, 9 + i] += var_g / row_s
        out[9 + i, i] += var_g * dt / row_s
        out[i, 9 + i] += var_g * dt / row_s
    for i in range(3):
        out[12 + i, 12 + i] += walk_g * dt
        out[15 + i, 15 + i] += walk_a * dt

    # One Newton step back to the rotations undoes the rounding of the products.
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            E[i, j] = (3.0 if i == j else 0.0) - (R[0, i] * R[0, j] + R[1, i] * R[1, j] + R[2, i] * R[2, j])
    for i in range(3):
        for j in range(3):
            T[i, j] = 0.5 * (R[i, 0] * E[0, j] + R[i, 1] * E[1, j] + R[i, 2] * E[2, j])
        T[i, 3] = P[i]
    return T, V, rate, out


@njit(cache=True, error_model="numpy")
def forces_along_first_axes(
    dt_s: FloatArray, gyro: FloatArray, accelerometer: FloatArray, bias: FloatArray
) -> FloatArray:
    """Turn the mean forces of rows, along turning axes, to the axes at the rows' beginnings.

    Parameters
    ----------
    dt_s : ndarray, shape (m,)
        Durations of the rows.
    gyro, accelerometer : ndarray, shape (m, 3)
        Interval means of the inertial angular velocity (rad/s) and the specific force (m/s^2) in b.
    bias : ndarray, shape (6,)
        Gyro (rad/s), accelerometer (m/s^2), in b.

    Returns
    -------
    ndarray, shape (m, 3)
        f + (w dt) x f / 2, of the force and the angular velocity without their biases; m/s^2, with the bias.
    """
    out = np.empty_like(accelerometer)
    for k in range(len(dt_s)):
        half = 0.5 * dt_s[k]
        for i in range(3):
            j, n = (i + 1) % 3, (i + 2) % 3
            turned = (gyro[k, j] - bias[j]) * (accelerometer[k, n] - bias[3 + n])
            turned -= (gyro[k, n] - bias[n]) * (accelerometer[k, j] - bias[3 + j])
            out[k, i] = accelerometer[k, i] + half * turned
    return out


@njit(cache=True, error_model="numpy")
def propagate(
    gTb: FloatArray,
    gV: FloatArray,
    bias: FloatArray,
    covariance: FloatArray,
    dt_s: FloatArray,
    gyro: FloatArray,
    accelerometer: FloatArray,
    mu: float,
    spin: FloatArray,
    noise: FloatArray,
    row_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Propagate a state and its covariance through rows of an IMU log, eqs. (26), (27).

    A row's specific force is a mean along turning axes; it counts with the first orders of the turn inside
    the row, f + (w dt) x f / 2. Gravity and the frame's rotation act at the row's predicted midpoint; the
    spin is removed from the attitude exactly.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    bias : ndarray, shape (6,)
        Gyro (rad/s), accelerometer (m/s^2), in b.
    covariance : ndarray, shape (18, 18)
        Covariance of the error state.
    dt_s : ndarray, shape (m,)
        Durations of the rows, m >= 1.
    gyro, accelerometer : ndarray, shape (m, 3)
        Interval means of the inertial angular velocity (rad/s) and the specific force (m/s^2) in b.
    mu : float
        Gravitational parameter, m^3/s^2.
    spin : ndarray, shape (3,)
        Angular velocity of the target body in g, rad/s.
    noise : ndarray, shape (4,)
        Densities of gyro (rad/s/sqrt(Hz)) and accelerometer (m/s^2/sqrt(Hz)), then of their biases' random
        walks (rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)).
    row_s : float
        Duration of the log's row of which the last row is a part: its mean has the noise of all of it.

    Returns
    -------
    gTb : ndarray, shape (4, 4)
    gV : ndarray, shape (3,)
        In g, m/s.
    rate : ndarray, shape (3,)
        Inertial angular velocity in b, mean over the last row, rad/s.
    covariance : ndarray, shape (18, 18)

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (26)-(28);
    docs/equations.md.
    """
    return _propagate(
        gTb, gV, bias, covariance, dt_s, gyro, accelerometer, mu, spin, noise, row_s, np.empty(0)
    )


@njit(cache=True, error_model="numpy")
def transition(
    gTb: FloatArray,
    gV: FloatArray,
    bias: FloatArray,
    dt_s: FloatArray,
    gyro: FloatArray,
    accelerometer: FloatArray,
    mu: float,
    spin: FloatArray,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Transition of the error state through rows of an IMU log, and the noise that they add.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    bias : ndarray, shape (6,)
        Gyro (rad/s), accelerometer (m/s^2), in b.
    dt_s : ndarray, shape (m,)
        Durations of the rows, m >= 1.
    gyro, accelerometer : ndarray, shape (m, 3)
        Interval means of the inertial angular velocity (rad/s) and the specific force (m/s^2) in b.
    mu : float
        Gravitational parameter, m^3/s^2.
    spin : ndarray, shape (3,)
        Angular velocity of the target body in g, rad/s.
    noise : ndarray, shape (4,)
        Densities of gyro (rad/s/sqrt(Hz)) and accelerometer (m/s^2/sqrt(Hz)), then of their biases' random
        walks (rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)).

    Returns
    -------
    F : ndarray, shape (15, 15)
        Error after = F error before + noise, of the error state without the angular velocity
        (`WITHOUT_RATE`), which is not propagated.
    Q : ndarray, shape (15, 15)
        Covariance of that noise.
    """
    flat = np.zeros(15 * _PITCH)
    for i in range(15):
        flat[i * _PITCH + i] = 1.0
    added = _propagate(
        gTb, gV, bias, np.zeros((SIZE, SIZE)), dt_s, gyro, accelerometer, mu, spin, noise, dt_s[-1], flat
    )[3]
    F, Q = np.empty((15, 15)), np.empty((15, 15))
    for i in range(15):
        for j in range(15):
            F[i, j] = flat[i * _PITCH + j]
            Q[i, j] = added[WITHOUT_RATE[i], WITHOUT_RATE[j]]
    return F, Q
