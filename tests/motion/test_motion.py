"""Motion models against scipy's integrators, central differences and potentials in closed form."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X
from scipy.integrate import quad, solve_ivp
from scipy.special import lpmv

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.errors import InputError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.linalg import whitening
from craternav_fg.motion.coast import coast
from craternav_fg.motion.gravity import GravityField, degree_two, read_gravity
from craternav_fg.motion.model import Motion
from craternav_fg.motion.white_acceleration import white_acceleration
from craternav_fg.motion.white_jerk import white_jerk
from craternav_fg.trajectory import InitialState
from factors.checking import numerical_jacobian
from factors.kernels import motion as kernel
from factors.motion import motion_factor

MOON = Body("Moon", 1737400.0, 4902800118000.0, (0.0, 0.0, 2.6616995e-6))
J2, C22 = 2.033e-4, 2.24e-5


_NAMES = ["coast", "coast in a field", "white_acceleration", "white_jerk"]


def _state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An orbit of 100 km, the body turning with it, a small acceleration."""
    R = frames.rotation_exp(rng.standard_normal(3))
    P = 1837400.0 * R[:, 2]
    V = 1633.5 * R[:, 0]
    bias = np.concatenate([[2e-4, -9e-4, 1e-4], [0.01, -0.02, 0.015]])
    return frames.pose(R @ frames.rotation_exp([0.1, 0.2, -0.3]), P), V, bias


def _models() -> list[Motion]:
    field = degree_two(1738000.0, J2, C22)
    return [
        coast(1e-4),
        coast(1e-4, gravity=field, rate_walk_rad_s2_sqrt_hz=1e-6),
        white_acceleration(0.3, rate_walk_rad_s2_sqrt_hz=1e-6),
        white_jerk(1e-3, rate_walk_rad_s2_sqrt_hz=1e-6),
    ]


@pytest.mark.parametrize("gravity", [GravityField(), degree_two(1738000.0, J2, C22)], ids=["point", "J2 C22"])
def test_coast_agrees_with_dop853_in_an_inertial_frame_over_30_minutes(gravity):
    gTb, gV, bias = _state(np.random.default_rng(1))
    spin = np.array(MOON.spin_rad_s)

    def potential(x):
        r = np.linalg.norm(x)
        u = MOON.mu_m3_s2 / r
        if len(gravity.C) > 1:
            k = (gravity.radius_m / r) ** 2
            u += MOON.mu_m3_s2 / r * k * (-J2 * (1.5 * (x[2] / r) ** 2 - 0.5))
            u += MOON.mu_m3_s2 / r * k * C22 * 3.0 * (x[0] ** 2 - x[1] ** 2) / r**2
        return u

    def rate(t, y):
        turn = frames.rotation_exp(spin * t)
        x = turn.T @ y[:3]
        h = 20.0
        slope = [(potential(x + h * e) - potential(x - h * e)) / (2.0 * h) for e in np.eye(3)]
        if len(gravity.C) == 1:
            slope = -MOON.mu_m3_s2 * x / np.linalg.norm(x) ** 3
        return np.concatenate([y[3:], turn @ slope])

    seconds = 1800.0
    y = np.concatenate([gTb[:3, 3], gV + np.cross(spin, gTb[:3, 3])])
    end = solve_ivp(rate, (0.0, seconds), y, method="DOP853", rtol=1e-11, atol=1e-6).y[:, -1]
    turn = frames.rotation_exp(spin * seconds)
    T, v, _, _ = coast(1e-5, gravity=gravity).free(MOON, (gTb, gV, bias), seconds)
    assert np.linalg.norm(T[:3, 3] - turn.T @ end[:3]) < 1.0
    np.testing.assert_allclose(v + np.cross(spin, T[:3, 3]), turn.T @ end[3:], atol=1e-3)
    # The attitude turns at a constant inertial rate.
    inertial = gTb[:3, :3] @ frames.rotation_exp(-bias[:3] * seconds)
    np.testing.assert_allclose(T[:3, :3], turn.T @ inertial, atol=1e-9)


@pytest.mark.parametrize("model", _models(), ids=_NAMES)
def test_transition_is_the_derivative_of_the_propagation(model):
    state = _state(np.random.default_rng(2))
    _, _, F, _ = model.free(MOON, state, 25.2)
    steps = np.repeat([1e-5, 100.0, 0.1, 1e-7, 1e-4], 3)
    T0, v0, _, _ = model.free(MOON, state, 25.2)

    def moved(delta):
        gTb = state[0].copy()
        gTb[:3, :3] = gTb[:3, :3] @ frames.rotation_exp(delta[:3])
        gTb[:3, 3] += delta[3:6]
        T, v, _, _ = model.free(MOON, (gTb, state[1] + delta[6:9], state[2] + delta[9:]), 25.2)
        turn = frames.rotation_log(T0[:3, :3].T @ T[:3, :3])
        return np.concatenate([turn, T[:3, 3] - T0[:3, 3], v - v0, delta[9:]])

    numeric = np.array(
        [(moved(s * e) - moved(-s * e)) / (2 * s) for s, e in zip(steps, np.eye(15), strict=True)]
    ).T
    scale = np.abs(F).max(axis=1, keepdims=True)
    np.testing.assert_allclose(F / scale, numeric / scale, atol=2e-5)


@pytest.mark.parametrize("model", _models(), ids=_NAMES)
def test_noise_is_the_integral_of_the_transition(model):
    state = _state(np.random.default_rng(3))
    seconds = 20.0
    Q = model.free(MOON, state, seconds)[3]
    L = np.repeat(model.noise.densities**2, 3)
    root = np.concatenate([L[:3], np.zeros(3), L[3:6], L[6:9], L[9:12]])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    total = np.zeros((15, 15))
    for node, weight in zip(nodes, weights, strict=True):
        at = 0.5 * seconds * (1.0 + node)
        T, v, _, _ = model.free(MOON, state, at)
        onward = model.free(MOON, (T, v, state[2]), seconds - at)[2]
        total += 0.5 * seconds * weight * onward @ np.diag(root) @ onward.T
    scale = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(Q / np.outer(scale, scale), total / np.outer(scale, scale), atol=2e-4)


def test_white_acceleration_keeps_the_velocity_in_the_body():
    gTb, gV, bias = _state(np.random.default_rng(4))
    still = Body("still", 1.0, 1.0, (0.0, 0.0, 0.0))
    T, v, _, _ = white_acceleration(1.0).free(still, (gTb, gV, bias), 60.0)
    np.testing.assert_allclose(T[:3, :3].T @ v, gTb[:3, :3].T @ gV, atol=1e-6)
    # A constant twist is a screw: the exponential of SE(3).
    screw = gtsam.Pose3.Expmap(60.0 * np.concatenate([-bias[:3], gTb[:3, :3].T @ gV]))
    np.testing.assert_allclose(T, gTb @ screw.matrix(), atol=1e-3)


def test_white_jerk_adds_a_constant_acceleration_of_the_body():
    gTb, gV, bias = _state(np.random.default_rng(5))
    still = Body("still", 1.0, 1.0, (0.0, 0.0, 0.0))
    T, v, _, _ = white_jerk(1.0).free(still, (gTb, gV, bias), 60.0)
    np.testing.assert_allclose(T[:3, :3].T @ v, gTb[:3, :3].T @ gV - 60.0 * bias[3:], atol=1e-6)


@pytest.mark.parametrize("model", _models(), ids=_NAMES)
def test_factor_has_the_derivatives_that_differences_give(model):
    rng = np.random.default_rng(6)
    begin = _state(rng)
    T, v, _, Q = model.free(MOON, begin, 25.0)
    values = gtsam.Values()
    ends = [
        begin,
        (T @ gtsam.Pose3.Expmap([0.02, -0.03, 0.01, 40.0, 20.0, -30.0]).matrix(), v + 0.5, begin[2]),
    ]
    for k, (gTb, gV, bias) in enumerate(ends):
        values.insert(X(k), gtsam.Pose3(gTb))
        values.insert(V(k), gV)
        values.insert(B(k), gtsam.imuBias.ConstantBias(bias[3:], bias[:3]))

    def propagate(gTb, gV, bias):
        return model.free(MOON, (gTb, gV, bias), 25.0)[:3]

    factor = motion_factor([X(0), V(0), B(0), X(1), V(1), B(1)], propagate, whitening(Q))
    J, _ = factor.linearize(values).jacobian()
    keys = list(factor.linearize(values).keys())
    sizes = {"x": [1e-5] * 3 + [50.0] * 3, "v": [0.1] * 3, "b": [1e-4] * 3 + [1e-7] * 3}
    first = 0
    for key in keys:
        steps = sizes[chr(gtsam.Symbol(key).chr())]
        block = J[:, first : first + len(steps)]
        first += len(steps)
        numeric = numerical_jacobian(factor, values, key, steps)
        np.testing.assert_allclose(block, numeric, atol=3e-5 * np.abs(numeric).max())


def test_factor_is_zero_at_a_propagated_state():
    model = coast(1e-4)
    begin = _state(np.random.default_rng(7))
    T, v, _, Q = model.free(MOON, begin, 25.0)
    values = gtsam.Values()
    for k, (gTb, gV) in enumerate([begin[:2], (T, v)]):
        values.insert(X(k), gtsam.Pose3(gTb))
        values.insert(V(k), gV)
        values.insert(B(k), gtsam.imuBias.ConstantBias(begin[2][3:], begin[2][:3]))
    keys = [X(0), V(0), B(0), X(1), V(1), B(1)]
    factor = motion_factor(keys, lambda *s: model.free(MOON, s, 25.0)[:3], whitening(Q))
    assert factor.error(values) < 1e-6


@pytest.mark.parametrize("model", _models(), ids=_NAMES)
def test_there_and_back_is_the_start(model):
    """Backwards over 20 minutes in one step, it used to be 40 km off."""
    gTb, gV, bias = _state(np.random.default_rng(11))
    T, v, F, _ = model.free(MOON, (gTb, gV, bias), 1200.0)
    back, back_gV, back_F, _ = model.free(MOON, (T, v, bias), -1200.0)
    np.testing.assert_allclose(back[:3, 3], gTb[:3, 3], atol=1e-2)
    np.testing.assert_allclose(back[:3, :3], gTb[:3, :3], atol=1e-8)
    np.testing.assert_allclose(back_gV, gV, atol=1e-5)
    # Of slopes up to 1e4 m per radian.
    np.testing.assert_allclose((back_F @ F)[:9, :9], np.eye(9), atol=0.03)


def test_gyro_rows_turn_the_attitude():
    begin = _state(np.random.default_rng(9))
    rates = np.random.default_rng(10).normal(scale=0.05, size=(50, 3))
    rows = np.full(50, 0.1), rates
    model = coast(1e-4)
    T, _, _, Q = model.transition(
        MOON,
        begin,
        rows,
        replace(model.noise, gyro_density_rad_s_sqrt_hz=1e-4, gyro_walk_rad_s2_sqrt_hz=1e-7),
    )
    R = begin[0][:3, :3]
    for w in rates:
        R = (
            frames.rotation_exp(-0.1 * np.array(MOON.spin_rad_s))
            @ R
            @ frames.rotation_exp(0.1 * (w - begin[2][:3]))
        )
    np.testing.assert_allclose(T[:3, :3], R, atol=1e-9)
    np.testing.assert_allclose(np.diag(Q)[:3], 1e-8 * 5.0, rtol=1e-3)


@pytest.mark.parametrize("model", _models(), ids=_NAMES)
def test_a_gyros_noise_is_what_errors_of_its_readings_do(model):
    """Not to the attitude alone: a velocity that is constant in b turns with it."""
    begin, dt_s, density = _state(np.random.default_rng(13)), 0.5, 1e-4
    gyro = np.random.default_rng(14).normal(scale=0.01, size=(20, 3))
    quiet = ImuNoise(density, 1e-12, 1e-12, 1e-12)

    def ahead(readings):
        return model.transition(MOON, begin, (np.full(20, dt_s), readings), quiet)

    T, v, _, Q = ahead(gyro)
    total, step = np.zeros((9, 9)), 1e-5
    for k in range(20):
        for j in range(3):
            moved = gyro.copy()
            moved[k, j] += step
            T1, v1, _, _ = ahead(moved)
            turn = frames.rotation_log(T[:3, :3].T @ T1[:3, :3])
            slope = np.concatenate([turn, T1[:3, 3] - T[:3, 3], v1 - v]) / step
            # White noise over a row: its mean has the variance density^2 / dt.
            total += density**2 / dt_s * np.outer(slope, slope)
    # In units of which the variances are 5 to 30; of attitude alone when coasting.
    scale = np.repeat([1e-4, 1.0, 0.1], 3)
    np.testing.assert_allclose((Q[:9, :9] - total) / np.outer(scale, scale), 0.0, atol=0.3)


@pytest.mark.parametrize("model", [coast(1e-9), white_acceleration(1e-9), white_jerk(1e-9)])
def test_a_filters_covariance_is_that_of_runs_with_noise_in_the_gyro(model):
    """Also of the angular velocity, which a velocimeter beside the centre of rotation measures."""
    gTb, gV, bias = _state(np.random.default_rng(15))
    rng, density, dt_ns = np.random.default_rng(16), 1e-4, 200_000_000
    gyro = rng.normal(scale=0.01, size=(6, 3))
    noise = replace(model.noise, gyro_density_rad_s_sqrt_hz=density, gyro_walk_rad_s2_sqrt_hz=1e-12)
    log = ImuLog(dt_ns * np.arange(1, 7), gyro, np.zeros((6, 3)))
    given = InitialState(0, gTb, gV, 1e-5, 1e-2, 1e-3, 1e-9, 1e-9, 1e-9)
    descent = Descent(MOON, None, None, log, noise, given, motion=model)
    begin = replace(filter_state.prior(descent), bias=bias)
    found = filter_state.propagate(begin, descent, 0, 6 * dt_ns)
    known = np.r_[0:12]
    root = np.linalg.cholesky(found.covariance[np.ix_(known, known)])
    squares = []
    for _ in range(300):
        start = begin.corrected(rng.normal(size=18) * np.sqrt(np.diag(begin.covariance)), begin.covariance)
        quiet = replace(noise, gyro_density_rad_s_sqrt_hz=1e-12)
        # The true rate is the reading less its noise.
        readings = gyro - density / np.sqrt(0.2) * rng.normal(size=(6, 3))
        true = replace(descent, imu=replace(log, gyro_rad_s=readings), imu_noise=quiet)
        error = filter_state.propagate(start, true, 0, 6 * dt_ns).minus(found)[known]
        squares.append(np.linalg.solve(root, error) ** 2)
    # Of 300 squares the mean has a standard deviation of 0.08.
    np.testing.assert_allclose(np.mean(squares, axis=0), 1.0, atol=0.33)


def test_harmonics_are_the_gradient_of_their_potential():
    rng = np.random.default_rng(11)
    top, radius = 6, 1738000.0
    C, S = np.tril(1e-4 * rng.standard_normal((2, top + 1, top + 1)))
    C[0], S[:, 0], C[1] = 0.0, 0.0, 0.0
    S[1] = 0.0
    C[0, 0] = 1.0

    def potential(x):
        r = np.linalg.norm(x)
        lat, lon = np.arcsin(x[2] / r), np.arctan2(x[1], x[0])
        total = 0.0
        for n in range(top + 1):
            for m in range(n + 1):
                # scipy's Legendre functions have the Condon-Shortley phase.
                p = (-1.0) ** m * lpmv(m, n, np.sin(lat))
                total += (radius / r) ** n * p * (C[n, m] * np.cos(m * lon) + S[n, m] * np.sin(m * lon))
        return MOON.mu_m3_s2 / r * total

    for P in 1.9e6 * np.array([[0.6, 0.0, 0.8], [0.3, -0.7, -0.648], [-0.2, 0.4, 0.894]]):
        out = np.empty(3)
        kernel.gravity(P, MOON.mu_m3_s2, radius, C, S, out)
        h = 30.0
        slope = [(potential(P + h * e) - potential(P - h * e)) / (2 * h) for e in np.eye(3)]
        np.testing.assert_allclose(out, slope, atol=3e-8)


def test_a_table_of_normalised_coefficients_is_read(tmp_path):
    path = tmp_path / "field.tab"
    path.write_text(
        "1738.0, 4902.8, 0.0, 3, 3, 1, 0.0, 0.0\n 2, 0, -9.088e-05, 0.0, 1e-12, 0.0\n"
        " 2, 2, 3.467D-05, 1.0e-09\n 3, 1, 2.6e-05, 5.4e-06\n"
    )
    field = read_gravity(path, 2)
    assert field.radius_m == 1738000.0
    # Unnormalised J2 and C22 of the Moon, as published.
    assert field.C[2, 0] == pytest.approx(-2.0321e-4, rel=1e-3)
    assert field.C[2, 2] == pytest.approx(2.2382e-5, rel=1e-3)
    assert field.C.shape == (3, 3)
    # Of degree 3 and order 1: the square root of 2 * 7 * 2! / 4!.
    assert read_gravity(path).C[3, 1] == pytest.approx(2.6e-5 * np.sqrt(7.0 / 6.0))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "header"),
        ("1738, 4902\n", "header"),
        ("-1, 4902, 0, 2, 2, 1\n", "radius"),
        ("1738, 4902, 0, 2, 2, 0\n2, 0, -2e-4, 0\n", ":1: expected the normalisation 1, .* found 0"),
        ("1738, 4902, 0, 2, 2, 1\n2, 0, x, 0\n", ":2: expected 4 numbers"),
        ("1738, 4902, 0, 2, 2, 1\n2, 3, 1e-5, 0\n", ":2: expected degree and order"),
    ],
)
def test_a_wrong_table_is_refused(tmp_path, text, problem):
    path = tmp_path / "field.tab"
    path.write_text(text)
    with pytest.raises(InputError, match=problem):
        read_gravity(path)


def test_noise_of_coast_over_an_interval_is_that_of_a_double_integrator():
    begin = _state(np.random.default_rng(12))
    Q = coast(2e-3).free(MOON, begin, 10.0)[3]
    expected = quad(lambda t: 4e-6 * t * t, 0.0, 10.0)[0]
    np.testing.assert_allclose(np.diag(Q)[3:6], expected, rtol=1e-3)
