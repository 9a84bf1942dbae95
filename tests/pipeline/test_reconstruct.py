"""What reconstruction makes of failures and of errors that repeat."""

import dataclasses
from pathlib import Path

import gtsam
import numpy as np
import pytest

import craternav_fg.pipeline.reconstruct as module
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.measurements import RimSet, SunTilt
from craternav_fg.pipeline import measuring
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.pipeline.tracking import Segment, shared_error
from craternav_fg.simulation.scenario import simulate
from craternav_fg.trajectory import Trajectory
from factors.sun_tilt import sun_tilt_factor
from tests.descents import scenario


class Failing:
    name = "failing"

    def estimate(self, problem: Problem) -> Trajectory:
        raise RuntimeError("on\npurpose. And much\nmore.")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate(scenario(duration_s=6.0), tmp_path_factory.mktemp("data") / "d"))


def test_one_estimator_that_fails_does_not_take_the_others_along(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = module.estimator
    monkeypatch.setattr(module, "estimator", lambda name: Failing() if name == "failing" else known(name))
    result = reconstruct(data, ["failing", "dead_reckoning"])
    assert list(result.trajectories) == ["dead_reckoning"]
    assert result.failures == {"failing": "failing: on purpose"}
    with pytest.raises(EstimationError, match="on purpose"):
        reconstruct(data, ["failing"])


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("gV", np.nan, "gV of frame 2: expected finite numbers"),
        ("gTb", np.inf, "gTb of frame 2: expected finite numbers"),
        ("pose_covariance", -1e-9, "pose covariance of frame 2: expected positive variances"),
    ],
)
def test_numbers_that_are_none_are_a_failure(
    data: Dataset, monkeypatch: pytest.MonkeyPatch, field: str, value: float, expected: str
) -> None:
    known = module.estimator

    class Odd:
        name = "odd"

        def estimate(self, problem: Problem) -> Trajectory:
            right = known("ekf").estimate(problem)
            values = getattr(right, field).copy()
            values[2].flat[0] = value
            return dataclasses.replace(right, **{field: values})

    monkeypatch.setattr(module, "estimator", lambda name: Odd() if name == "odd" else known(name))
    result = reconstruct(data, ["odd", "dead_reckoning"])
    assert list(result.trajectories) == ["dead_reckoning"]
    assert result.failures == {"odd": f"odd: {expected}"}


def test_a_covariance_with_a_negative_variance_in_some_direction_is_a_failure(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = module.estimator

    class Odd:
        name = "odd"

        def estimate(self, problem: Problem) -> Trajectory:
            right = known("ekf").estimate(problem)
            assert right.pose_covariance is not None
            values = right.pose_covariance.copy()
            sigmas = np.sqrt(np.diagonal(values[2]))
            values[2, 3, 4] = values[2, 4, 3] = 1.5 * sigmas[3] * sigmas[4]
            return dataclasses.replace(right, pose_covariance=values)

    monkeypatch.setattr(module, "estimator", lambda name: Odd() if name == "odd" else known(name))
    result = reconstruct(data, ["odd", "dead_reckoning"])
    assert result.failures == {"odd": "odd: pose covariance of frame 2: expected a positive definite matrix"}


def test_reconstruction_does_not_look_at_the_truth(data: Dataset) -> None:
    blind = reconstruct(dataclasses.replace(data, truth=None), ["smoother"])
    seeing = reconstruct(data, ["smoother"])
    assert np.array_equal(blind.trajectories["smoother"].gTb, seeing.trajectories["smoother"].gTb)


def information(sun: SunTilt, frames: int) -> np.ndarray:
    """What factors of a tilt in so many frames say of one pose, at the tilt that it predicts."""
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.4, -0.2, 0.1), np.array([0.0, 0.0, 1.8e6]))
    values = gtsam.Values()
    values.insert(0, pose)
    graph = gtsam.NonlinearFactorGraph()
    for _ in range(frames):
        graph.push_back(sun_tilt_factor(0, np.eye(4), sun.direction, sun.tilt_rad, sun.sigma_rad, sun.point))
    return graph.linearize(values).hessian()[0]


def test_tilts_that_share_an_error_weigh_together_as_one() -> None:
    sun = SunTilt(0.3, 0.1, np.zeros(2), np.array([0.3, -0.8, 0.1]))
    each = shared_error(sun, 75)
    assert each is not None
    assert np.abs(information(sun, 1)).max() > 10.0
    np.testing.assert_allclose(information(each, 75), information(sun, 1), rtol=1e-9, atol=1e-9)
    assert shared_error(None, 75) is None


def test_tracked_points_and_frames_without_rims_suit_every_filter(tmp_path: Path) -> None:
    """The paper's sub-filters have no past poses beside their states, also where the fused one has some."""
    case = scenario(duration_s=8.0, sensors={"features": {"simulation": {"count": 20}}})
    data = Dataset.open(simulate(case, tmp_path / "d"))
    assert data.measurements is not None
    frames = list(data.measurements)
    # One without rims, then a crater that is new.
    frames[1] = dataclasses.replace(frames[1], rims=RimSet.empty())
    for k in (0, 2):
        frames[k] = dataclasses.replace(frames[k], rims=frames[k].rims.take(frames[k].rims.craters > 0))
    result = reconstruct(dataclasses.replace(data, measurements=tuple(frames)), ["ekf", "ekf_paper"])
    assert result.problems[0].features is not None
    assert set(result.trajectories) == {"ekf", "ekf_paper"}
    assert np.all(np.isfinite(result.trajectories["ekf_paper"].gTb))


def test_what_is_left_out_is_left_out_of_disbelieved_frames_too(
    data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert data.measurements is not None
    assert data.initial is not None
    every = data.measurements
    nothing = dataclasses.replace(every[1], rims=RimSet.empty())
    measured = measuring.Measured(
        (every[0], nothing, *every[2:]), (Segment(0, data.initial),), disbelieved={1: every[1]}
    )
    monkeypatch.setattr(measuring.Measuring, "_measured", lambda *_: measured)
    seen: list[int] = []
    monkeypatch.setattr(
        measuring, "check_imu", lambda problems, _: seen.extend(len(f.rims) for f in problems[0].frames)
    )
    reconstruct(data, ["dead_reckoning"], without=["rims"])
    assert seen == [0] * len(every)
