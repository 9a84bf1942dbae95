"""A focal length or a principal point that is not exact: covariances hold what is stated of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import errors
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.trajectory import Trajectory
from tests.descents import scenario

FOCAL_PERCENT, POINT_PX, TRIALS = 1.0, 3.0, 12
ESTIMATORS = ["smoother", "online", "ekf"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate(scenario(duration_s=20.0), tmp_path_factory.mktemp("intrinsics") / "d"))


def stated(data: Dataset, focal_percent: float | None, point_px: float | None) -> Dataset:
    camera = replace(data.camera, focal_sigma_percent=focal_percent, principal_sigma_px=point_px)
    return replace(data, camera=camera)


def measured_wrongly(data: Dataset, focal_share: float, shift_px: np.ndarray) -> Dataset:
    """Rims by a camera whose focal length and principal point are off."""
    shift = shift_px / data.camera.fx_px

    def change(frame: FrameMeasurement) -> FrameMeasurement:
        chart = frame.rims.chart.copy()
        chart[:, :2] = np.exp(focal_share) * chart[:, :2] + shift
        chart[:, [2, 4]] += focal_share
        return replace(frame, rims=replace(frame.rims, chart=chart))

    assert data.measurements is not None
    return replace(data, measurements=tuple(change(frame) for frame in data.measurements))


def squared(one: Trajectory, data: Dataset) -> float:
    assert one.pose_covariance is not None
    off = errors(one, data.truth).pose[-1, 3:]
    return float(off @ np.linalg.solve(one.pose_covariance[-1, 3:, 3:], off))


def test_errors_of_the_focal_length_agree_with_their_covariances(data: Dataset) -> None:
    """400 m from an altitude of 40 km; the covariances of the estimators are those of rims alone."""
    rng = np.random.default_rng(5)
    squares: dict[str, list[list[float]]] = {name: [] for name in ESTIMATORS}
    for _ in range(TRIALS):
        wrong = measured_wrongly(data, 0.01 * FOCAL_PERCENT * rng.standard_normal(), np.zeros(2))
        found = reconstruct(stated(wrong, FOCAL_PERCENT, None), ESTIMATORS).trajectories
        unstated = reconstruct(stated(wrong, None, None), ESTIMATORS).trajectories
        for name in ESTIMATORS:
            squares[name].append([squared(one[name], data) for one in (found, unstated)])
    for name in ESTIMATORS:
        with_error, without = np.mean(squares[name], axis=0)
        # The error is along one direction, that of the camera's axis.
        assert with_error < chi2.ppf(0.999, 3 * TRIALS) / TRIALS, name
        assert with_error > 0.3, name
        assert without > 4.0 * with_error, name


def test_a_principal_point_may_move_or_turn_the_camera(data: Dataset) -> None:
    rng = np.random.default_rng(6)
    squares = []
    for _ in range(TRIALS):
        wrong = measured_wrongly(data, 0.0, POINT_PX * rng.standard_normal(2))
        found = reconstruct(stated(wrong, None, POINT_PX), ["smoother"]).trajectories["smoother"]
        squares.append(squared(found, data))
    assert np.mean(squares) < chi2.ppf(0.999, 3 * TRIALS) / TRIALS


def test_velocities_follow_the_altitude(data: Dataset) -> None:
    exact, said = (
        reconstruct(stated(data, percent, 0.0), ["ekf"]).trajectories["ekf"]
        for percent in (0.0, FOCAL_PERCENT)
    )
    assert exact.velocity_covariance is not None
    assert said.velocity_covariance is not None
    added = said.velocity_covariance - exact.velocity_covariance
    up = said.gP[-1] / np.linalg.norm(said.gP[-1])
    assert np.sqrt(up @ added[-1] @ up) == pytest.approx(
        0.01 * FOCAL_PERCENT * abs(up @ said.gV[-1]), rel=0.3
    )


def test_dead_reckoning_and_runs_without_rims_do_not_depend_on_the_camera(data: Dataset) -> None:
    for estimator, without in (("dead_reckoning", ()), ("ekf", ("rims",))):
        one, other = (
            reconstruct(stated(data, percent, percent), [estimator], without=without).trajectories[estimator]
            for percent in (0.0, 1.0)
        )
        np.testing.assert_array_equal(one.pose_covariance, other.pose_covariance)
