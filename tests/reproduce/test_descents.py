"""Figs. 15 to 18 and the lag: whole descents."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_allclose

from craternav_fg.campaign.trial import FILTERED_BOUND, SCHEMA, SMOOTHED_BOUND
from craternav_fg.reproduce import ablation as ablation_module
from craternav_fg.reproduce import fig15_18 as descent_figures
from craternav_fg.reproduce import fig15_18_trials, run
from craternav_fg.reproduce import lag as lag_module
from craternav_fg.reproduce.fig15_18_trials import CENTRES, FILTER, ONLINE, PAPERS, SMOOTHER, Descents
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import Row
from craternav_fg.simulation.scenario_file import load_scenario
from tests.descents import scenario

SMALL = ReproduceOptions(descents=2, workers=1)
ALTITUDE_KM = np.array([50.0, 26.0, 10.0])
# Position errors along an axis, m, of two trials at three frames.
ERRORS = {
    PAPERS: [[600.0, 300.0, 150.0], [800.0, 500.0, 450.0]],
    FILTER: [[60.0, 30.0, 6.0], [80.0, 50.0, 8.0]],
    ONLINE: [[50.0, 30.0, 5.0], [70.0, 40.0, 9.0]],
    SMOOTHER: [[30.0, 15.0, 5.0], [40.0, 25.0, 9.0]],
    CENTRES: [[300.0, 150.0, 90.0], [400.0, 250.0, 120.0]],
}
SIGMAS_M = {FILTERED_BOUND: [50.0, 30.0, 6.0], SMOOTHED_BOUND: [25.0, 15.0, 6.0]}


def known() -> pa.Table:
    """Table of two trials with simple errors and bounds."""
    rows = []
    for trial in range(2):
        for name in (*ERRORS, *SIGMAS_M):
            for k, km in enumerate(ALTITUDE_KM):
                bound = name in SIGMAS_M
                sigma = SIGMAS_M[name][k] if bound else 1.0
                rows.append(
                    {
                        "trial": trial,
                        "estimator": name,
                        "stamp_ns": 10**9 * k,
                        "altitude_m": 1e3 * km,
                        "rims": 3 - k,
                        "attitude_error_rad": None if bound else [0.0, 0.01, 0.0],
                        "position_error_m": None if bound else [0.0, 0.0, ERRORS[name][trial][k]],
                        "velocity_error_m_s": None if bound else [0.0, 0.0, 0.0],
                        "pose_sigma": [0.01, 0.0, 0.0, sigma, 0.0, 0.0],
                        "nees": None if bound else 4.0 + 2.0 * trial + k,
                    }
                )
    return pa.Table.from_pylist(rows, schema=SCHEMA)


def find(rows: list[Row], quantity: str, condition: str) -> Row:
    (row,) = (row for row in rows if row.quantity == quantity and row.condition.startswith(condition))
    return row


def test_rows_say_what_the_trials_hold() -> None:
    rows = list(descent_figures.draw_up("fig17", known()).rows)
    last = find(rows, "position error, mean", "10 km")
    assert (last.paper, last.as_printed, last.corrected, last.efficient) == (200.0, 300.0, 7.0, 7.0)
    assert last.verdict == "not met by the paper's filter: 300 m; met by the chart EKF: 7 m"
    middle = find(rows, "position error, RMS", "50 km")
    assert middle.corrected == pytest.approx(np.sqrt(5000.0))
    assert middle.bound == pytest.approx(50.0)
    assert find(rows, "position error, RMS, in retrospect", "50 km").bound == pytest.approx(25.0)
    # Frames weigh by the altitude that they stand for: 24, 20 and 16 km.
    ratios = np.sqrt([3700.0 / 2500.0, 1250.0 / 900.0, 53.0 / 36.0])
    over = find(rows, "position RMS over the bound, mean over the altitude", "2 trials")
    assert over.efficient == pytest.approx(np.average(ratios, weights=np.abs(np.gradient(ALTITUDE_KM))))
    end = find(rows, "position RMS over that of the smoother", "end")
    assert end.as_printed == pytest.approx(np.sqrt((150.0**2 + 450.0**2) / (5.0**2 + 9.0**2)))
    ended = find(rows, "trials that end within 200 m and 1 deg", "2 trials")
    assert (ended.as_printed, ended.corrected, ended.efficient) == (1, 2, 2)
    assert find(rows, "pose ANEES", "all").efficient == pytest.approx(6.0)
    lowest = find(rows, "pose ANEES", "20 to 0")
    assert lowest.efficient == pytest.approx(7.0)
    assert lowest.verdict.startswith("inside")


def test_one_trial_is_the_first() -> None:
    row = find(list(descent_figures.draw_up("fig15", known()).rows), "position error, one trial", "26 km")
    assert (row.paper, row.as_printed, row.corrected, row.efficient) == (40.0, 300.0, 30.0, 30.0)
    assert row.bound == pytest.approx(30.0)
    angle = find(list(descent_figures.draw_up("fig16", known()).rows), "attitude error, one trial", "26 km")
    assert angle.corrected == pytest.approx(np.degrees(0.01))


def without(name: str, *trials: int) -> pa.Table:
    """Leave an estimator out of some of the known trials."""
    data = known()
    pairs = zip(data["estimator"].to_pylist(), data["trial"].to_pylist(), strict=True)
    return data.filter(pa.array([not (one == name and trial in trials) for one, trial in pairs]))


def test_an_estimator_counts_in_the_trials_where_it_gave_a_trajectory() -> None:
    every = Descents(without(PAPERS, 1), "m")
    assert_allclose(every.of(PAPERS).mean, ERRORS[PAPERS][0])
    assert_allclose(every.of(FILTER).mean, np.mean(ERRORS[FILTER], axis=0))


def test_estimators_are_compared_over_the_trials_of_both() -> None:
    result = descent_figures.draw_up("fig17", without(PAPERS, 1))
    row = find(list(result.rows), "position RMS over that of the smoother", "end")
    # Of the first trial alone: 150 m over 5 m.
    assert row.as_printed == pytest.approx(30.0)
    assert row.corrected == pytest.approx(np.sqrt((6.0**2 + 8.0**2) / (5.0**2 + 9.0**2)))
    assert row.verdict.endswith("; no trajectory of ekf_paper in 1 of 2 trials")
    assert "is 30.00 for the paper's EKF" in result.note
    assert "end 0 of the 1 trials of the paper's EKF" in result.note
    assert "No trajectory of ekf_paper in 1 of 2 trials: " in result.note
    rows = list(descent_figures.draw_up("fig17", without(SMOOTHER, 0)).rows)
    # Of the second trial alone, in the one frame from 50 to 30 km: 40 m over 80 m.
    gain = find(rows, "position RMS, smoother in retrospect over chart EKF", "50 to 30 km")
    assert gain.efficient == pytest.approx(0.5)


def nulls(row: dict[str, Any]) -> int:
    return list(row.values()).count(None)


COLUMN = {PAPERS: "as_printed", FILTER: "corrected", ONLINE: "efficient"}


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("figure", ["fig15", "fig16", "fig17", "fig18"])
def test_a_figure_is_drawn_without_an_estimator_that_gave_nothing(figure: str, name: str) -> None:
    every = descent_figures.draw_up(figure, known())
    lacking = descent_figures.draw_up(figure, without(name, 0, 1))
    label = descent_figures.LABELS[name]
    labels = [[line.get_label() for line in one.drawing.axes[0].lines] for one in (every, lacking)]
    assert labels[1] == [one for one in labels[0] if one != label]
    rows, whole = ([row.as_dict() for row in one.rows] for one in (lacking, every))
    json.dumps(rows, allow_nan=False)
    assert [row["condition"] for row in rows] == [row["condition"] for row in whole]
    told = f"no trajectory of {name}" + ("" if figure in ("fig15", "fig16") else " in 2 of 2 trials")
    pairs = zip(rows, whole, strict=True)
    verdicts = [str(row["verdict"]) for row, other in pairs if nulls(row) > nulls(other)]
    assert verdicts
    assert all(verdict.endswith(told) for verdict in verdicts)
    assert f"N{told[1:]}" in lacking.note
    if name in COLUMN:
        at_26_km = find(list(lacking.rows), every.rows[0].quantity, "26 km").as_dict()
        assert [key for key in COLUMN.values() if at_26_km[key] is None] == [COLUMN[name]]


def test_what_the_note_says_of_the_paper_follows_from_the_trials() -> None:
    good, poor = dict(ERRORS), {**ERRORS, FILTER: [[600.0, 300.0, 250.0], [800.0, 500.0, 350.0]]}
    for errors_m, word in (
        (good, "below 200 m, holds for the chart EKF and iSAM2 and does not hold for the paper's EKF"),
        (poor, "below 200 m, holds for iSAM2 and does not hold for the paper's EKF and the chart EKF"),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(ERRORS, FILTER, errors_m[FILTER])
            assert word in descent_figures.draw_up("fig17", known()).note
    assert (
        "below 1 deg, holds for the paper's EKF, the chart EKF and iSAM2"
        in descent_figures.draw_up("fig18", known()).note
    )


def test_an_ablated_filter_without_a_trajectory_has_no_number_and_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = [
        *ablation_module.filters(),
        ablation_module.CENTRES,
        ablation_module.ELLIPSE_CENTRES,
        ablation_module.RIMS,
    ]

    def trial(task: fig15_18_trials.Trial) -> pa.Table:
        end_m = [np.inf if k == 0 and task.number else 10.0 + k for k in range(len(names))]
        return pa.table({"trial": [task.number] * len(names), "estimator": names, "end_m": end_m})

    monkeypatch.setattr(ablation_module, "_run_trial", trial)
    result = ablation_module.ablation(ReproduceOptions(descents=3, workers=1))
    rows = [row for row in result.rows if row.condition.startswith(names[0])]
    assert [(row.as_printed, row.corrected) for row in rows] == [(None, None)] * 2
    assert all(row.verdict.endswith("no trajectory in 2") for row in rows)
    (other, _) = (row for row in result.rows if row.condition.startswith(names[1]))
    assert (other.as_printed, other.verdict) == (11.0, "the paper prints no number")


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("module", [lag_module, ablation_module])
def test_the_seed_is_that_of_the_figures_trials(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = []

    class EnoughError(Exception):
        """No trial is run."""

    def noted(task: Any) -> pa.Table:
        seeds.append(task.scenario.seed)
        raise EnoughError

    monkeypatch.setattr(module, "_run_trial", noted)
    for seed in (1, 5):
        with pytest.raises(EnoughError):
            run.reproduce([module.__name__.rpartition(".")[2]], ReproduceOptions(workers=1, seed=seed))
    assert seeds == [scenario().seed, scenario().seed + 4]


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of 20 s in place of the paper's descent."""
    monkeypatch.setattr(fig15_18_trials, "load_scenario", lambda name: scenario(duration_s=20.0))


@pytest.mark.usefixtures("short")
@pytest.mark.slow
def test_figures_of_simulated_descents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lag_module, "BAND_KM", (100.0, 0.0))
    monkeypatch.setattr(lag_module, "LAGS_S", (4.0, 10.0))
    names = (*run.DESCENTS, *run.OTHERS)
    results = run.reproduce(names, SMALL)
    run.write(tmp_path, results, SMALL)
    assert [result.name for result in results] == list(names)
    for result in results:
        assert all(row.verdict for row in result.rows)
        assert (tmp_path / f"{result.name}.png").read_bytes().startswith(b"\x89PNG")
    # The state one lag old knows of more frames than the newest.
    table = results[names.index("lag")].data
    assert np.mean(table["oldest_m"].to_numpy() ** 2) < np.mean(table["newest_m"].to_numpy() ** 2)
    table = results[names.index("ablation")].data
    ends = dict(zip(table["estimator"].to_pylist(), table["end_m"].to_pylist(), strict=True))
    # All three corrected choices are the chart EKF, except for its second linearisation.
    best = ends["EKF: ellipse chart, own noise, prior counted once"]
    assert best < 0.2 * ends["EKF: eq. (19), one Qn, eq. (29)"]
    assert ends[ablation_module.RIMS] <= 1.5 * best
    assert ends[ablation_module.ELLIPSE_CENTRES] < ends[ablation_module.CENTRES]
    again, other = (
        fig15_18_trials.simulate(ReproduceOptions(descents=2, workers=1, seed=seed)) for seed in (1, 2)
    )
    assert again.equals(results[2].data)
    assert not other.equals(results[2].data)


def test_the_paper_s_case_varies_from_trial_to_trial() -> None:
    craters = load_scenario(fig15_18_trials.SCENARIO).craters
    assert craters.source == "list"
    assert craters.trials is not None
    assert craters.trials.semi_axes_m == (500.0, 2500.0)
