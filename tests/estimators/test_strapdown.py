"""Strapdown kernel against an independent integrator, and its covariance against perturbed runs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from factors.kernels import strapdown

MOON_MU = 4.9028e12
MOON_SPIN = 2.6617e-6
RADIUS_M = 1737.4e3
LN200S = np.array([0.07 * np.pi / 180 / 60, 35e-6 * 9.80665, 2e-8, 3e-7])


def rates(t):
    """Inertial angular velocity in b, rad/s, at times (n,)."""
    return np.stack(
        [
            0.004 * np.sin(0.05 * t) + 0.001,
            0.012 * np.cos(0.03 * t + 0.4) - 0.002,
            0.006 * np.sin(0.021 * t + 1.0),
        ],
        axis=-1,
    )


def forces(t):
    """Specific force in b, m/s^2, at times (n,)."""
    return np.stack([0.3 * np.sin(0.07 * t), 0.2 * np.cos(0.11 * t), 1.9 + 0.5 * np.sin(0.013 * t)], axis=-1)


def row_means(duration_s, rate_hz):
    """Interval means of both, by Gauss-Legendre quadrature inside each row."""
    n = round(duration_s * rate_hz)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    t = ((np.arange(n)[:, None] + 0.5 + 0.5 * nodes) / rate_hz).ravel()

    def mean(values):
        return np.einsum("nkj,k->nj", values.reshape(n, 4, 3), 0.5 * weights)

    return np.full(n, 1.0 / rate_hz), mean(rates(t)), mean(forces(t))


def reference(P, V, q_xyzw, spin, duration_s):
    """Integrate eqs (26), (27) with DOP853; attitude as a quaternion against inertial space."""

    def rhs(t, x):
        P, V, q = x[:3], x[3:6], x[6:]
        gRi = Rotation.from_rotvec(-spin * t)
        f = (gRi * Rotation.from_quat(q)).apply(forces(np.array([t]))[0])
        acc = f - MOON_MU * P / np.linalg.norm(P) ** 3
        acc -= 2.0 * np.cross(spin, V) + np.cross(spin, np.cross(spin, P))
        w = rates(np.array([t]))[0]
        vector, scalar = q[:3], q[3]
        qdot = 0.5 * np.concatenate([scalar * w + np.cross(vector, w), [-vector @ w]])
        return np.concatenate([V, acc, qdot])

    out = solve_ivp(
        rhs, (0.0, duration_s), np.concatenate([P, V, q_xyzw]), method="DOP853", rtol=1e-12, atol=1e-9
    )
    x = out.y[:, -1]
    return (Rotation.from_rotvec(-spin * duration_s) * Rotation.from_quat(x[6:])).as_matrix(), x[:3], x[3:6]


def start():
    R = Rotation.from_euler("zyx", [0.3, -1.1, 2.0])
    T = np.eye(4)
    T[:3, :3] = R.as_matrix()
    T[:3, 3] = (RADIUS_M + 100e3) * np.array([0.36, 0.48, 0.8])
    return T, np.array([900.0, -600.0, -60.0]), R.as_quat()


@pytest.mark.parametrize("spin_factor", [1.0, 100.0])
def test_ten_minutes_without_noise_agree_with_dop853(spin_factor):
    spin = spin_factor * MOON_SPIN * np.array([0.1, -0.2, np.sqrt(0.95)])
    T, V, q = start()
    R_ref, P_ref, V_ref = reference(T[:3, 3], V, q, spin, 600.0)
    gTb, gV, rate, _ = strapdown.propagate(
        T, V, np.zeros(6), np.eye(18), *row_means(600.0, 100.0), MOON_MU, spin, np.zeros(4), 0.01
    )
    angle_deg = np.degrees(Rotation.from_matrix(R_ref.T @ gTb[:3, :3]).magnitude())
    assert np.linalg.norm(gTb[:3, 3] - P_ref) < 0.02
    assert np.linalg.norm(gV - V_ref) < 1e-4
    assert angle_deg < 2e-6
    np.testing.assert_allclose(rate, rates(np.array([599.995]))[0], atol=1e-8)
    np.testing.assert_allclose(gTb[:3, :3] @ gTb[:3, :3].T, np.eye(3), atol=1e-14)


def test_an_interval_cut_in_two_is_the_same():
    T, V, _ = start()
    spin = np.array([0.0, 0.0, MOON_SPIN])
    P0 = np.diag(np.arange(1.0, 19.0)) * 1e-3
    dt, w, f = row_means(4.0, 50.0)
    bias = np.array([1e-4, -2e-4, 3e-4, 0.01, -0.02, 0.03])
    whole = strapdown.propagate(T, V, bias, P0, dt, w, f, MOON_MU, spin, LN200S, dt[-1])
    T1, V1, _, P1 = strapdown.propagate(
        T, V, bias, P0, dt[:70], w[:70], f[:70], MOON_MU, spin, LN200S, dt[-1]
    )
    cut = strapdown.propagate(T1, V1, bias, P1, dt[70:], w[70:], f[70:], MOON_MU, spin, LN200S, dt[-1])
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_transition_and_its_noise_make_the_propagated_covariance():
    T, V, _ = start()
    spin = np.array([0.0, 0.0, MOON_SPIN])
    dt, w, f = row_means(4.0, 50.0)
    bias = np.array([1e-4, -2e-4, 3e-4, 0.01, -0.02, 0.03])
    root = np.random.default_rng(1).normal(size=(18, 18)) * np.repeat([1e-3, 10.0, 0.1, 1e-3, 1e-6, 1e-4], 3)
    P = root.T @ root
    F, Q = strapdown.transition(T, V, bias, dt, w, f, MOON_MU, spin, LN200S)
    part = np.ix_(strapdown.WITHOUT_RATE, strapdown.WITHOUT_RATE)
    expected = strapdown.propagate(T, V, bias, P, dt, w, f, MOON_MU, spin, LN200S, dt[-1])[3][part]
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        (F @ P[part] @ F.T + Q) / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-12
    )


def perturbed(T, V, bias, d):
    """Truth that differs from a mean by an error-state vector (18,)."""
    out = T.copy()
    out[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(d[:3]).as_matrix()
    out[:3, 3] += d[3:6]
    return out, V + d[6:9], bias + d[12:]


def error(T, V, w, bias, T0, V0, w0, bias0):
    phi = Rotation.from_matrix(T0[:3, :3].T @ T[:3, :3]).as_rotvec()
    return np.concatenate([phi, T[:3, 3] - T0[:3, 3], V - V0, w - w0, bias - bias0])


def test_transition_agrees_with_perturbed_runs():
    # Without noise P -> F P F': with P = d d' the result must be the outer product of the error that the
    # perturbed state's own propagation shows. Long enough for gravity gradient and Coriolis to matter.
    T, V, _ = start()
    spin = 300.0 * MOON_SPIN * np.array([0.3, -0.4, np.sqrt(0.75)])
    dt, w, f = row_means(100.0, 50.0)
    bias = np.array([1e-4, -2e-4, 3e-4, 0.01, -0.02, 0.03])
    sizes = np.repeat([1e-5, 10.0, 0.1, 1e-3, 1e-6, 1e-4], 3)

    def run(T, V, bias, P):
        return strapdown.propagate(T, V, bias, P, dt, w, f, MOON_MU, spin, np.zeros(4), dt[-1])

    mean = run(T, V, bias, np.eye(18))
    for i in range(18):
        d = sizes[i] * np.eye(18)[i]
        ends = []
        for sign in (1.0, -1.0):
            T1, V1, b1 = perturbed(T, V, bias, sign * d)
            Tk, Vk, wk, _ = run(T1, V1, b1, np.eye(18))
            ends.append(error(Tk, Vk, wk, b1, *mean[:3], bias))
        expected = 0.5 * (ends[0] - ends[1])
        P = run(T, V, bias, np.outer(d, d))[3]
        if 9 <= i < 12:
            # The last gyro row replaces the angular velocity: what was known of it before is gone.
            np.testing.assert_array_equal(P, 0.0)
            np.testing.assert_array_equal(expected, 0.0)
            continue
        floor = np.repeat([1e-9, 1e-3, 1e-5, 1e-10, 1e-12, 1e-12], 3)
        largest = np.argmax(np.abs(expected) / floor)
        found = P[:, largest] / np.sqrt(P[largest, largest]) * np.sign(expected[largest])
        for part in range(0, 18, 3):
            g = slice(part, part + 3)
            tolerance = 1e-3 * np.linalg.norm(expected[g]) + floor[part]
            assert np.linalg.norm(found[g] - expected[g]) < tolerance, (i, part)


# Of 4 rows the last one's noise shows; of which only a part may count.
@pytest.mark.parametrize(("duration_s", "share"), [(0.4, 1.0), (10.0, 1.0), (10.0, 0.05)])
def test_noise_agrees_with_monte_carlo(duration_s, share):
    T, V, _ = start()
    spin = np.array([0.0, 0.0, MOON_SPIN])
    rows_s, w, f = row_means(duration_s, 10.0)
    noise = np.array([2e-4, 3e-3, 1e-5, 2e-4])
    dt, row_s = rows_s.copy(), rows_s[-1]
    dt[-1] *= share
    mean = strapdown.propagate(T, V, np.zeros(6), np.zeros((18, 18)), dt, w, f, MOON_MU, spin, noise, row_s)
    rng = np.random.default_rng(5)
    errors = []
    runs = 2000
    for _ in range(runs):
        # The truth: measured rows minus their noise and the walking bias.
        walk = np.cumsum(rng.normal(size=(len(dt), 6)) * np.repeat(noise[2:], 3) * np.sqrt(dt)[:, None], 0)
        before = np.vstack([np.zeros(6), walk[:-1]])
        n = rng.normal(size=(len(dt), 6)) * np.repeat(noise[:2], 3) / np.sqrt(rows_s)[:, None] + before
        Tk, Vk, wk, _ = strapdown.propagate(
            T, V, np.zeros(6), np.zeros((18, 18)), dt, w - n[:, :3], f - n[:, 3:], MOON_MU, spin, noise, row_s
        )
        errors.append(error(Tk, Vk, wk, walk[-1], *mean[:3], np.zeros(6)))
    sample = np.cov(np.array(errors).T, bias=True)
    scale = np.sqrt(np.diag(mean[3]))
    np.testing.assert_allclose(
        (sample - mean[3]) / np.outer(scale, scale), 0.0, atol=5.0 * np.sqrt(2.0 / runs)
    )
