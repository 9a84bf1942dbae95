"""IMU preintegration in the rotating frame against an independent integrator."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from factors.checking import numerical_jacobian
from factors.errors import FactorError
from factors.imu import imu_factor, integrate, parameters
from factors.imu_noise import ImuNoise
from tests.factors.conftest import MOON

NOISE = ImuNoise(2e-5, 3.4e-4, 1e-9, 1e-8)
# A spin a hundred times the Moon's, so that Coriolis and centrifugal terms cannot hide.
SPIN = np.array([1e-5, -5e-5, 2.6617e-4])
RATE_HZ = 100


def angular_velocity(t: np.ndarray) -> np.ndarray:
    """Inertial angular velocity in b, rad/s."""
    return np.stack(
        [1e-3 + 4e-3 * np.sin(0.05 * t), -8e-4 + 3e-3 * np.cos(0.083 * t), 2e-3 * np.sin(0.02 * t)], axis=-1
    )


def specific_force(t: np.ndarray) -> np.ndarray:
    """In b, m/s^2."""
    return np.stack([0.3 * np.sin(0.03 * t), 0.2 * np.cos(0.05 * t), 2.5 + 0.5 * np.sin(0.01 * t)], axis=-1)


def truth(
    times_s: np.ndarray, gRb0: Rotation, gP0: np.ndarray, gV0: np.ndarray
) -> tuple[Rotation, np.ndarray]:
    """Integrate eqs. (26), (27) by DOP853; attitude and position at the times."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        P, Vel, q = y[:3], y[3:6], y[6:]
        R = Rotation.from_quat(q, scalar_first=True)
        acceleration = (
            R.apply(specific_force(np.array(t)))
            + MOON.gravity(P)
            - 2 * np.cross(SPIN, Vel)
            - np.cross(SPIN, np.cross(SPIN, P))
        )
        w = angular_velocity(np.array(t)) - R.inv().apply(SPIN)
        s, v = q[0], q[1:]
        return np.concatenate([Vel, acceleration, [-0.5 * v @ w], 0.5 * (s * w + np.cross(v, w))])

    y0 = np.concatenate([gP0, gV0, gRb0.as_quat(scalar_first=True)])
    y = solve_ivp(rates, (0.0, times_s[-1]), y0, "DOP853", t_eval=times_s, rtol=1e-13, atol=1e-10).y.T
    return Rotation.from_quat(y[:, 6:], scalar_first=True), y[:, :3]


def interval_means(begin_s: float, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """What a noise-free IMU logs: means over each row, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    t = begin_s + (np.arange(rows)[:, None] + 0.5 * (nodes + 1.0)) / RATE_HZ
    return (
        np.einsum("k,rki->ri", 0.5 * weights, angular_velocity(t)),
        np.einsum("k,rki->ri", 0.5 * weights, specific_force(t)),
    )


def test_600_s_against_dop853() -> None:
    gRb0 = Rotation.from_rotvec([0.3, -0.2, 0.5])
    gP0 = np.array([1_790_000.0, 20_000.0, -30_000.0])
    gV0 = np.array([-40.0, 900.0, 300.0])
    seconds = np.arange(601.0)
    attitude, position = truth(seconds, gRb0, gP0, gV0)
    bias = gtsam.imuBias.ConstantBias()
    state = gtsam.NavState(gtsam.Pose3(gtsam.Rot3(gRb0.as_matrix()), gP0), gV0)
    for k in range(600):
        gyro, force = interval_means(float(k), RATE_HZ)
        midpoint = state.position() + 0.5 * state.velocity()
        params = parameters(NOISE, SPIN, MOON.gravity(midpoint))
        pim = integrate(params, np.full(RATE_HZ, 1 / RATE_HZ), gyro, force, np.zeros(6))
        state = pim.predict(state, bias)
    turn = Rotation.from_matrix(state.attitude().matrix()).inv() * attitude[-1]
    assert np.linalg.norm(state.position() - position[-1]) < 0.5
    assert np.rad2deg(turn.magnitude()) < 1e-4


def one_interval(rows: int = 50) -> gtsam.PreintegratedCombinedMeasurements:
    gyro, force = interval_means(3.0, rows)
    params = parameters(NOISE, SPIN, MOON.gravity(np.array([1.79e6, 0, 0])))
    return integrate(params, np.full(rows, 0.01), gyro, force, np.full(6, 1e-4))


def test_jacobians() -> None:
    """Of all six variables, at a state that does not satisfy the factor."""
    keys = [X(0), V(0), X(1), V(1), B(0), B(1)]
    factor = imu_factor(keys, one_interval())
    rng = np.random.default_rng(0)
    values = gtsam.Values()
    pose = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3) * 1e6)
    values.insert(X(0), pose)
    values.insert(X(1), pose.retract(rng.normal(size=6) * [1e-3, 1e-3, 1e-3, 30, 30, 30]))
    values.insert(V(0), rng.normal(size=3) * 100)
    values.insert(V(1), rng.normal(size=3) * 100)
    values.insert(B(0), gtsam.imuBias.ConstantBias(np.full(3, 2e-4), np.full(3, 1.5e-4)))
    values.insert(B(1), gtsam.imuBias.ConstantBias(np.full(3, 1e-4), np.full(3, 1e-4)))
    linear = factor.linearize(values)
    columns = 0
    A = linear.jacobian()[0]
    for key in linear.keys():  # noqa: SIM118 (a method of gtsam)
        steps = {"x": [1e-4] * 3 + [10.0] * 3, "v": [1.0] * 3, "b": [1e-4] * 6}[chr(gtsam.Symbol(key).chr())]
        J = A[:, columns : columns + len(steps)]
        columns += len(steps)
        expected = numerical_jacobian(factor, values, key, steps)
        scale = np.abs(J).max()
        assert_allclose(J / scale, expected / scale, atol=1e-6)


def test_covariance_grows_as_the_densities_say() -> None:
    """After a second: attitude density sqrt(t); velocity density sqrt(t), its own part."""
    pim = one_interval(100)
    covariance = pim.preintMeasCov()
    assert_allclose(np.sqrt(np.diag(covariance)[:3]), NOISE.gyro_density_rad_s_sqrt_hz, rtol=0.01)
    assert_allclose(np.sqrt(np.diag(covariance)[6:9]), NOISE.accelerometer_density_m_s2_sqrt_hz, rtol=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dt_s": np.zeros(0)}, "dt_s: expected at least one row"),
        ({"dt_s": np.array([0.01, 0.0])}, "dt_s: .* positive duration"),
        ({"gyro": np.array([[0, 0, 0], [0, np.nan, 0]])}, "gyro: expected finite"),
        ({"accelerometer": np.zeros((3, 3))}, "accelerometer: expected shape"),
        ({"bias": np.zeros(3)}, "bias: expected shape"),
    ],
    ids=str,
)
def test_bad_rows_are_refused(change: dict[str, np.ndarray], message: str) -> None:
    arguments = {
        "dt_s": np.full(2, 0.01),
        "gyro": np.zeros((2, 3)),
        "accelerometer": np.zeros((2, 3)),
        "bias": np.zeros(6),
    } | change
    with pytest.raises(FactorError, match=message):
        integrate(parameters(NOISE, SPIN, np.zeros(3)), **arguments)


def test_a_bias_without_walk_is_refused() -> None:
    with pytest.raises(FactorError, match="gyro_walk_rad_s2_sqrt_hz"):
        ImuNoise(1e-5, 1e-4, 0.0, 1e-8)


@pytest.mark.parametrize("keys", [[X(0), V(0), X(1), V(1), B(0)], [X(0), V(0), X(0), V(1), B(0), B(1)]])
def test_keys_that_are_not_six_are_refused(keys: list[int]) -> None:
    with pytest.raises(FactorError, match="keys: expected six different"):
        imu_factor(keys, one_interval())
