"""Hard cases come to what their scenarios say: what goes wrong shows, and what answers it answers it."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest

from craternav_fg.cli.run_summary import calibration_line
from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.metrics import Metrics, metrics
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.runs.read import read_residuals
from craternav_fg.runs.write import write_run
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import built_in_scenarios, load_scenario
from craternav_fg.simulation.scenario_tables import FaultsSection
from tests.pipeline.hard_cases import FIGURES, run_trials

CASES = [name for name in built_in_scenarios() if load_scenario(name).expected]


def test_every_hard_case_says_what_to_expect() -> None:
    assert {name for name in built_in_scenarios() if name.startswith("hard_")} <= set(CASES)


@functools.cache
def few_trials(name: str) -> dict[str, list[Metrics]]:
    """Metrics of trials 0 and 1."""
    with tempfile.TemporaryDirectory() as folder:
        return run_trials(name, Path(folder), 2)


def check(name: str, found_of: dict[str, list[Metrics]], trials: int) -> None:
    """Means over trials lie within three standard errors of what the scenario expects, or errors below it."""
    expected = load_scenario(name).expected
    for e, found in found_of.items():
        for figure in FIGURES:
            spread = getattr(expected[e], figure)
            if spread is None:
                continue
            away = np.mean([getattr(each, figure) for each in found]) - spread.mean
            standard_errors = away / (spread.sd / np.sqrt(trials))
            least = -3.0 if figure == "anees" else -np.inf
            assert least < standard_errors < 3.0, f"{name}: {figure} of {e} is off by {away:.3g}"


@pytest.mark.parametrize("name", ["hard_wrong_matches", "hard_mounting", "hard_map_errors"])
def test_a_hard_case_is_as_expected(name: str) -> None:
    check(name, few_trials(name), 2)


def test_rims_fit_the_camera_as_it_was_found_to_be(tmp_path: Path) -> None:
    data = Dataset.open(simulate(load_scenario("hard_mounting"), tmp_path / "data", trial=0))
    result = reconstruct(data, ["smoother", "self_calibrating_smoother"])
    (tmp_path / "run").mkdir()
    summary = write_run(
        tmp_path / "run", result, dataset="", truth=None, times_s={}, wall_s=0.0
    )  # fmt: skip
    assert summary["estimators"]["self_calibrating_smoother"]["rim_outlier_share"] < 0.01
    found = read_residuals(tmp_path / "run")
    chi2 = {
        name: found.filter(pc.equal(found["estimator"], name))["chi2"].to_numpy().mean()
        for name in result.trajectories
    }
    # They fit with it, and with the freedom better than without.
    assert 3.0 < chi2["self_calibrating_smoother"] < chi2["smoother"]
    assert calibration_line(summary["estimators"]["self_calibrating_smoother"]["calibrated"]).startswith(
        "a correction of the camera-IMU rotation by "
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_hard_case_is_as_expected(name: str, tmp_path: Path) -> None:
    # Images cost fifty times what analytic rims do.
    trials = 3 if load_scenario(name).render else 20
    check(name, run_trials(name, tmp_path, trials), trials)


# What answers a fault, and its scenario; clean data are those of the scenario on which they all rest.
ANSWERS = {"hard_wrong_matches": "gnc_smoother", "hard_mounting": "self_calibrating_smoother"}
CLEAN = "measured_descent"


def rms(scenario: str, estimator: str, folder: Path, trial: int) -> np.ndarray:
    """Of the position, m, and of the attitude, deg."""
    data = Dataset.open(simulate(load_scenario(scenario), folder / f"{scenario}_{trial}", trial=trial))
    found = metrics(reconstruct(data, [estimator]).trajectories[estimator], data.truth)
    return np.array([found.position_rms_m, found.attitude_rms_deg])


@pytest.mark.parametrize("name", ANSWERS)
def test_a_fault_costs_an_estimator_that_answers_it_little(name: str, tmp_path: Path) -> None:
    # A trial with the fault differs from the clean one in nothing else, so few of them tell.
    for trial, found in enumerate(few_trials(name)[ANSWERS[name]]):
        faulty = np.array([found.position_rms_m, found.attitude_rms_deg])
        assert (faulty <= 1.3 * rms(CLEAN, ANSWERS[name], tmp_path, trial)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ANSWERS)
def test_a_fault_that_is_answered_costs_little_beside_a_smoother_without_it(
    name: str, tmp_path: Path
) -> None:
    # What a freedom costs, be there a fault or not, varies from trial to trial: it takes many to tell 1.3.
    pairs = [
        [
            rms(case, estimator, tmp_path / str(trial), trial)[0]
            for case, estimator in ((name, ANSWERS[name]), (CLEAN, "smoother"))
        ]
        for trial in range(40)
    ]
    answered, clean = np.mean(pairs, axis=0)
    assert answered <= 1.3 * clean


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.1, 0.2, 0.3, 0.4])
def test_wrong_matches_cost_the_robust_smoother_nothing(share: float, tmp_path: Path) -> None:
    case = load_scenario("measured_descent")
    wrong = case.model_copy(update={"faults": FaultsSection(wrong_match_share=share)})
    rms_m = []
    for trial in range(3):
        row = []
        for name, each in (("smoother", case), ("gnc_smoother", wrong)):
            data = Dataset.open(simulate(each, tmp_path / name / str(trial), trial=trial))
            found = metrics(reconstruct(data, [name]).trajectories[name], data.truth)
            assert found.position_rms_m is not None
            row.append(found.position_rms_m)
        rms_m.append(row)
    clean, robust = np.mean(rms_m, axis=0)
    assert robust < 1.1 * clean
