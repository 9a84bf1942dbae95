"""A poor prior, and no rims for the first minutes: the IMU leads the prior's mean tens of kilometres away."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.registry import estimator
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.consistency import mean_interval
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import RimSet
from craternav_fg.simulation.scenario import simulate
from craternav_fg.trajectory import Trajectory

ESTIMATORS = ("smoother", "online", "fixed_lag", "ekf")


def late(folder: Path, name: str, trial: int, first: int) -> tuple[Problem, Trajectory]:
    """A descent from 25 deg and 4 km off, without the rims of the first frames."""
    data = Dataset.open(simulate(name, folder / "data", trial=trial))
    assert data.measurements is not None
    assert data.truth is not None
    frames = [
        replace(frame, rims=RimSet.empty()) if k < first else frame
        for k, frame in enumerate(data.measurements)
    ]
    return make_problem(Descent.of(data), frames), data.truth


@pytest.fixture(
    scope="module",
    params=[
        # The prior's mean is 111 km off, and sees none of the ten rims.
        ("measured_descent", 0, 60),
        pytest.param(("measured_descent", 2, 60), marks=pytest.mark.slow),
        pytest.param(("measured_descent", 0, 30), marks=pytest.mark.slow),
        # A star tracker, altimeter and velocimeter measure before the first rims.
        ("lander_full", 0, 40),
    ],
    ids=lambda case: "-".join(map(str, case)),
)
def descent(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Problem, Trajectory]:
    return late(tmp_path_factory.mktemp("late"), *request.param)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_first_rims_put_it_right(descent: tuple[Problem, Trajectory], name: str) -> None:
    problem, truth = descent
    first = problem.start.frame
    assert first >= 30
    found = estimator(name).estimate(problem)
    assert found.pose_covariance is not None
    error = errors(found, truth)
    # One descent's errors are correlated in time: as few as five independent ones in all.
    low, high = mean_interval(6, 5, 1.0 - 1e-4)
    assert low < np.mean(nees(error.pose, found.pose_covariance)[first:]) < high
    assert np.linalg.norm(error.position_m[-1]) < 5.0
    assert np.linalg.norm(error.velocity_m_s[-1]) < 0.2
