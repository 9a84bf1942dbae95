"""The gyro's noise in the angular velocity: in the session's state, and in sensors away from the IMU."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.filter_state import propagate, states_to_start
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.evaluation.sensor_consistency import smoothed_residuals
from craternav_fg.motion.model import Motion
from craternav_fg.motion.white_acceleration import white_acceleration
from craternav_fg.trajectory import Trajectory
from factors.kernels.strapdown import GYRO_BIAS, RATE
from tests.descents import problem, scenario

TRIALS = 10
ARM_M = 6.0
T_BS = {"data": (1.0, 0.0, 0.0, ARM_M, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)}
# 0.01 rad/s in a row of 10 ms, and 6 cm/s at the end of the lever arm.
GYRO_DEG_SQRT_H = 3.4


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    case = scenario(duration_s=20.0)
    imu = case.imu.model_copy(update={"gyro_arw_deg_sqrt_h": GYRO_DEG_SQRT_H})
    sensors = {"velocimeter": {"rate_hz": 0.5, "noise_m_s": 0.01, "T_BS": T_BS, "loss": "none"}}
    case = scenario(duration_s=20.0, imu=imu, sensors=sensors)
    folder = tmp_path_factory.mktemp("gyro")
    return [problem(folder, case, trial) for trial in range(TRIALS)]


@pytest.mark.parametrize("estimator", [BatchSmoother(), OnlineSmoother(), ekf()], ids=lambda one: one.name)
def test_a_sensor_on_a_lever_arm_has_the_noise_of_the_gyro(
    trials: list[tuple[Problem, Trajectory]], estimator: BatchSmoother
) -> None:
    squares = []
    for p, truth in trials:
        found = estimator.estimate(p)
        assert found.velocity_covariance is not None
        off = truth.gV[-1] - found.gV[-1]
        squares.append(float(off @ np.linalg.solve(found.velocity_covariance[-1], off)))
    low, high = chi2.ppf([0.001, 0.999], 3 * TRIALS) / TRIALS
    assert low < np.mean(squares) < high


def test_residuals_of_a_sensor_on_a_lever_arm_are_of_unit_variance(
    trials: list[tuple[Problem, Trajectory]],
) -> None:
    residuals = [smoothed_residuals([p], BatchSmoother().estimate(p))["velocimeter"] for p, _ in trials]
    assert 0.5 < np.mean(np.square(residuals)) < 1.3


def test_the_rate_of_a_session_has_the_noise_of_the_gyro(trials: list[tuple[Problem, Trajectory]]) -> None:
    p = replace(trials[0][0], sensors=())
    session = OnlineSmoother(GraphOptions()).run(p)
    filtered = ekf().states(p)[-1]
    P = session.state.covariance
    noise = P[RATE, RATE] - P[GYRO_BIAS, GYRO_BIAS]
    density = p.imu_noise.gyro_density_rad_s_sqrt_hz
    np.testing.assert_allclose(noise, 100.0 * density**2 * np.eye(3), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.diag(P)[RATE], np.diag(filtered.covariance)[RATE], rtol=0.05)


@pytest.mark.parametrize("motion", [None, white_acceleration(0.01)])
@pytest.mark.parametrize("after_ns", [10_000_000, 1_000])
def test_a_row_that_an_image_cuts_has_the_noise_of_the_whole(
    trials: list[tuple[Problem, Trajectory]], motion: Motion | None, after_ns: int
) -> None:
    """A microsecond after a row began, the angular velocity was uncertain by 1 rad/s."""
    p = replace(trials[0][0], sensors=(), motion=motion)
    row_ns = int(p.imu.stamps_ns[100])
    start = states_to_start(p)[-1]
    P = propagate(start, p, row_ns - 500_000_000, row_ns + after_ns).covariance
    noise = P[RATE, RATE] - P[GYRO_BIAS, GYRO_BIAS]
    density = p.imu_noise.gyro_density_rad_s_sqrt_hz
    np.testing.assert_allclose(noise, 100.0 * density**2 * np.eye(3), rtol=1e-4, atol=1e-9)
