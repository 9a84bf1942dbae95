"""Short simulated descents with analytic rims, for estimator tests."""

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent, Estimator, Problem
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from craternav_fg.simulation.scenario_tables import Crater, CraterList
from craternav_fg.trajectory import Trajectory

# Places (east, north, km) and sizes (km) of craters below a lander that looks ahead.
CRATERS = [
    (0.0, 2.0, 1.9, 1.6, 35.0),
    (6.0, 6.0, 2.2, 1.8, 110.0),
    (-5.0, -7.0, 2.0, 1.7, 70.0),
    (-9.0, 5.0, 1.6, 1.3, 10.0),
    (4.0, -6.0, 1.5, 1.2, 150.0),
]


def scenario(*, duration_s: float = 100.0, craters: int = 5, **sections: object) -> Scenario:
    """Paper's third case from 40 km on, sinking at 150 m/s in the mean, with more craters in view."""
    case = load_scenario("paper_case3")
    start = case.trajectory.start.model_copy(
        update={"altitude_m": 40e3, "downrange_m": -0.1e3 * duration_s, "ground_speed_m_s": 150.0}
    )
    end = case.trajectory.end.model_copy(
        update={"altitude_m": 40e3 - 150.0 * duration_s, "downrange_m": 0.0, "ground_speed_m_s": 50.0}
    )
    attitude = case.trajectory.attitude.model_copy(
        update={
            "start_pitch_deg": 12.0,
            "end_pitch_deg": 3.0,
            "oscillation_deg": (1.0, 1.5, 2.0),
            "oscillation_period_s": (37.0, 53.0, 71.0),
        }
    )
    trajectory = case.trajectory.model_copy(
        update={"duration_s": duration_s, "start": start, "end": end, "attitude": attitude}
    )
    placed = tuple(
        Crater(east_m=1e3 * e, north_m=1e3 * n, semi_major_m=1e3 * a, semi_minor_m=1e3 * b, angle_deg=angle)
        for e, n, a, b, angle in CRATERS[:craters]
    )
    listed = CraterList(source="list", crater=placed)
    return case.model_copy(update={"trajectory": trajectory, "craters": listed, **sections})


def problem(folder: Path, case: Scenario, trial: int) -> tuple[Problem, Trajectory]:
    """Simulate a trial, write it, read it back; the truth is for the test alone."""
    data = Dataset.open(simulate(case, folder / f"trial{trial}", trial=trial))
    assert data.measurements is not None
    assert data.truth is not None
    return make_problem(Descent.of(data), data.measurements), data.truth


def mean_nees(estimator: Estimator, trials: list[tuple[Problem, Trajectory]]) -> float:
    """Mean squared normalised error of the pose in the middle of descents, over trials with their truths."""
    values = []
    for p, truth in trials:
        estimate = estimator.estimate(p)
        assert estimate.pose_covariance is not None
        values.append(nees(errors(estimate, truth).pose, estimate.pose_covariance)[len(truth) // 2])
    return float(np.mean(values))


def assert_same_estimates(found: Trajectory, expected: Trajectory, tolerance: float) -> None:
    """Compare positions in units of their standard deviations, and covariances in units of variances."""
    assert expected.pose_covariance is not None
    assert found.pose_covariance is not None
    scale = np.sqrt(np.diagonal(expected.pose_covariance, axis1=1, axis2=2))
    assert (np.abs(found.gP - expected.gP) < tolerance * scale[:, 3:]).all()
    scale = scale[:, :, None] * scale[:, None, :]
    assert_allclose(found.pose_covariance / scale, expected.pose_covariance / scale, atol=tolerance)
