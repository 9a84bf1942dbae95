"""Figures of a campaign whose errors are chosen."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from craternav_fg.campaign import run
from craternav_fg.campaign.read import Campaign, failed_trials, read_campaign
from craternav_fg.campaign.run import montecarlo
from craternav_fg.campaign.store import trial_name
from craternav_fg.campaign.summary import of_estimator, rms_over_bound, summarise, summarise_folder, with_nees
from craternav_fg.campaign.trial import FILTERED_BOUND, SCHEMA, SMOOTHED_BOUND, failed
from craternav_fg.evaluation.consistency import over_altitude
from craternav_fg.files import write_whole
from tests.campaign import inline
from tests.campaign.scene import options, small_scenario

ALTITUDES_M = [900.0, 400.0, 175.0]


def rows(
    trial: int, name: str, altitudes_m: list[float] = ALTITUDES_M, **values: Any
) -> list[dict[str, Any]]:
    """Frames that are alike but for their altitudes."""
    common = {"trial": trial, "estimator": name, "rims": 1, **values}
    return [{**common, "stamp_ns": k, "altitude_m": altitude_m} for k, altitude_m in enumerate(altitudes_m)]


def estimate(
    trial: int,
    name: str,
    off_m: float,
    off_deg: float,
    nees: float,
    altitudes_m: list[float] = ALTITUDES_M,
) -> list[dict[str, Any]]:
    """An estimator whose every frame has the same error."""
    return rows(
        trial,
        name,
        altitudes_m,
        position_error_m=[0.0, off_m, 0.0],
        attitude_error_rad=[np.radians(off_deg), 0.0, 0.0],
        velocity_error_m_s=[0.0, 0.0, 0.0],
        pose_sigma=[1.0] * 6,
        nees=nees,
    )


def campaign(table: list[dict[str, Any]], estimators: list[str]) -> Campaign:
    """Two trials with results, one without."""
    columns = {field.name: [row.get(field.name) for row in table] for field in SCHEMA}
    return Campaign(
        Path("nowhere"),
        {"estimators": estimators},
        pa.table(columns, schema=SCHEMA),
        {2: "no sense"},
        {0: {}, 1: {}},
        {0: {"online": 1.0}, 1: {"online": 2.0}, 3: {"online": 60.0}},
        12.0,
    )


def test_figures_of_known_errors() -> None:
    table = []
    for trial, (off_m, off_deg, nees) in enumerate(((3.0, 0.1, 5.0), (4.0, 0.3, 8.0))):
        for name in ("online", "smoother"):
            table += estimate(trial, name, off_m, off_deg, nees)
        for name, sigma_m in ((FILTERED_BOUND, 2.0), (SMOOTHED_BOUND, 1.0)):
            table += rows(trial, name, pose_sigma=[9.0] * 3 + [sigma_m] * 3)
    summary = summarise(campaign(table, ["online", "smoother", "ekf"]))
    assert (summary["trials"], summary["failed"], summary["wall_s"]) == (3, 1, 12.0)
    online, smoother, none = (summary["estimators"][name] for name in ("online", "smoother", "ekf"))
    assert [values["trajectories"] for values in summary["estimators"].values()] == [2, 2, 0]
    # 2 % of 175 m are 3.5 m.
    assert online["converged"] == 1
    assert online["position_final_mean_m"] == pytest.approx(3.5)
    assert online["position_final_rms_m"] == pytest.approx(np.sqrt(12.5))
    assert online["attitude_final_mean_deg"] == pytest.approx(0.2)
    assert online["anees"] == pytest.approx(6.5)
    assert online["time_per_trial_s"] == 2.0
    assert online["rms_over_pcrb"] == pytest.approx(np.sqrt(12.5 / 12.0))
    assert smoother["rms_over_pcrb"] == pytest.approx(2.0 * online["rms_over_pcrb"])
    assert smoother["time_per_trial_s"] is None
    assert none["converged"] == 0
    assert none["anees"] is None


def test_smoothers_run_on_request_are_held_against_the_smoothed_bound_too() -> None:
    table = []
    for name in ("self_calibrating_smoother", "map_refining_smoother"):
        table += estimate(0, name, 3.0, 0.1, 6.0)
    for name, sigma_m in ((FILTERED_BOUND, 30.0), (SMOOTHED_BOUND, np.sqrt(3.0))):
        table += rows(0, name, pose_sigma=[9.0] * 3 + [sigma_m] * 3)
    found = summarise(campaign(table, ["self_calibrating_smoother", "map_refining_smoother"]))["estimators"]
    assert [values["rms_over_pcrb"] for values in found.values()] == pytest.approx([1.0, 1.0])


def test_an_estimator_that_failed_is_held_against_its_own_trials() -> None:
    table = estimate(1, "online", 3.0, 2.0, 6.0)
    for trial, sigma_m in ((0, 100.0), (1, np.sqrt(3.0))):
        table += rows(trial, FILTERED_BOUND, pose_sigma=[9.0] * 3 + [sigma_m] * 3)
    values = summarise(campaign(table, ["online"]))["estimators"]["online"]
    assert values["trajectories"] == 1
    assert values["rms_over_pcrb"] == pytest.approx(1.0)
    # Near, and turned by more than a degree.
    assert values["converged"] == 0


@pytest.mark.parametrize("singular", [np.inf, np.nan])
def test_trials_with_a_singular_covariance_are_left_out_of_the_anees(singular: float) -> None:
    table = estimate(0, "online", 3.0, 0.1, singular) + estimate(1, "online", 3.0, 0.1, 5.0)
    for trial in (0, 1):
        table += rows(trial, FILTERED_BOUND, pose_sigma=[1.0] * 6)
    values = summarise(campaign(table, ["online"]))["estimators"]["online"]
    assert (values["anees"], values["anees_trials"], values["trajectories"]) == (5.0, 1, 2)


@pytest.mark.parametrize(("off_m", "converged"), [(5.0, 1), (7.0, 0)])
def test_a_landing_on_low_ground_can_converge(off_m: float, converged: int) -> None:
    """The mean sphere is above the lander: 2 % of a hundredth of 30 km count, 6 m."""
    altitudes_m = [30e3, 1e3, -2e3]
    table = estimate(0, "online", off_m, 0.1, 6.0, altitudes_m)
    table += rows(0, FILTERED_BOUND, altitudes_m, pose_sigma=[1.0] * 6)
    assert summarise(campaign(table, ["online"]))["estimators"]["online"]["converged"] == converged


def test_a_folder_is_summarised_trial_by_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "processes", inline.processes)
    small = small_scenario()
    montecarlo(small, tmp_path / "c", options(3))
    write_whole(tmp_path / "c/trials" / trial_name(3), failed(3, "no sense").parquet)
    found = summarise_folder(tmp_path / "c")
    assert found == summarise(read_campaign(tmp_path / "c"))
    assert (found["trials"], found["failed"]) == (4, 1)
    assert failed_trials(tmp_path / "c") == {3: "no sense"}
    ekf = found["estimators"]["ekf"]
    table = read_campaign(tmp_path / "c").table
    last = np.linalg.norm(of_estimator(table, "ekf", "position_error_m")[:, -1], axis=-1)
    assert ekf["position_final_rms_m"] == pytest.approx(np.sqrt(np.mean(last**2)))
    altitude_m = of_estimator(table, "ekf", "altitude_m")[0]
    over_bound = over_altitude(rms_over_bound(table, "ekf"), altitude_m)
    assert ekf["rms_over_pcrb"] == pytest.approx(over_bound)
    assert ekf["anees"] == pytest.approx(of_estimator(table, "ekf", "nees").mean())


def test_values_by_trial_and_frame() -> None:
    table = estimate(0, "online", 3.0, 2.0, 6.0) + estimate(1, "online", 4.0, 2.0, 6.0)
    table += rows(0, FILTERED_BOUND, pose_sigma=[1.0] * 6)
    found = campaign(table, ["online"]).table
    assert of_estimator(found, "online", "position_error_m")[:, :, 1].tolist() == [[3.0] * 3, [4.0] * 3]
    assert of_estimator(found, "online", "altitude_m").tolist() == [ALTITUDES_M, ALTITUDES_M]
    assert np.isnan(of_estimator(found, FILTERED_BOUND, "position_error_m")).all()
    assert of_estimator(found, "ekf", "position_error_m").shape == (0, 0, 3)


def test_trials_count_for_the_anees_if_all_their_frames_have_a_covariance() -> None:
    nees = np.array([[5.0, 7.0], [np.nan, 6.0], [6.0, np.inf], [np.nan, np.nan]])
    assert with_nees(nees).tolist() == [True, False, False, False]
