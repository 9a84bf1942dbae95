"""Rows, verdicts, files, and the command."""

import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from craternav_fg.errors import CraternavError
from craternav_fg.reproduce import (
    fig11_14 as pose_figures,
)
from craternav_fg.reproduce import (
    fig11_14_notes as pose_notes,
)
from craternav_fg.reproduce import (
    fig11_14_trials,
    line_plots,
    run,
)
from craternav_fg.reproduce.fig11_14_statistics import MEAN, RMS, STD, Condition
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import FIELDS, number, verdict
from tests.cli.calls import call

SMALL = ReproduceOptions(trials=4, altitude_steps=2, workers=1)


def same(a: pa.Table, b: pa.Table) -> bool:
    """Whether two tables are equal, NaN in the same places."""
    return a.schema == b.schema and all(
        np.array_equal(a[name].to_numpy(), b[name].to_numpy(), equal_nan=True) for name in a.column_names
    )


@pytest.mark.parametrize(
    ("paper", "corrected", "bound", "error", "expected"),
    [
        (None, 3.0, 1.0, 0.0, "the paper prints no number"),
        (100.0, 105.0, 20.0, 0.0, "reproduced"),
        (100.0, 105.0, 20.0, 9.0, "reproduced"),
        (100.0, 105.0, 20.0, 11.0, "within the trials' scatter: 1.1 times"),
        (100.0, 160.0, 20.0, 25.0, "within the trials' scatter: 1.6 times"),
        (100.0, 160.0, 20.0, 0.0, "same order: 1.6 times the paper's"),
        (100.0, 900.0, 20.0, 0.0, "not reproduced: 9 times the paper's"),
        (100.0, 900.0, 400.0, 0.0, "not reproduced: 9 times the paper's; out of reach: the bound"),
        (100.0, None, None, 0.0, "not reproduced"),
    ],
)
def test_verdicts(
    paper: float | None, corrected: float | None, bound: float | None, error: float, expected: str
) -> None:
    assert verdict(paper, corrected, bound, error=error).startswith(expected)
    assert ("out of reach" in verdict(paper, corrected, bound, error=error)) == ("out of" in expected)


def test_numbers_are_readable() -> None:
    assert [number(x) for x in (None, 0.0, 1e-9, 0.01234, 3.14159, 10287.4, 2e17)] == [
        "-", "0", "0", "0.0123", "3.14", "10287", "2e+17",
    ]  # fmt: skip


def test_written_figures_are_whole_and_the_same_again(tmp_path: Path) -> None:
    names = ("fig02", "fig11", "fig12", "fig13", "fig14")
    results = run.reproduce(names, SMALL)
    run.write(tmp_path, results, SMALL)
    rows = json.loads((tmp_path / "reproduction.json").read_text())
    assert all(tuple(row) == FIELDS for row in rows)
    assert {row["figure"] for row in rows} == set(names)
    for row in rows:
        assert row["verdict"]
        for field in ("paper", "as_printed", "corrected", "efficient", "bound"):
            assert row[field] is None or row[field] >= 0.0
    printed = {(row["quantity"], row["condition"]): row["paper"] for row in rows if row["paper"] is not None}
    assert printed == {
        ("position error of (13), mean", "10 km, 3 craters, 1 px"): 258.0,
        ("position error of (13), mean", "100 km, 3 craters, 1 px"): 945.0,
        ("position error of (13), standard deviation", "10 km, 3 craters, 1 px"): 227.0,
        ("position error of (13), standard deviation", "100 km, 3 craters, 1 px"): 593.0,
        ("position error of (23), mean", "100 km, 2 craters, 1 px"): 107.0,
        ("position error of (23), standard deviation", "100 km, 2 craters, 1 px"): 203.0,
    }
    fine = [row for row in rows if "0.01 px" in row["condition"]]
    assert [(row["figure"], row["verdict"]) for row in fine] == [
        ("fig13", "not the paper's set-up: it prints no number")
    ]
    # Cramér-Rao bounds no scatter of an error's length.
    assert not any("out of reach" in row["verdict"] for row in rows if "deviation" in row["quantity"])
    for row in rows:
        assert (row["as_printed"] is None) == (row["corrected"] is None)
    report = (tmp_path / "reproduction.md").read_text()
    assert "started at the truth" in report.split("## fig02")[0]
    for result in results:
        assert result.note in report
        assert ("tarted at the truth" in result.note) == (result.name in ("fig11", "fig13"))
        assert (tmp_path / f"{result.name}.png").read_bytes().startswith(b"\x89PNG")
        assert same(pq.read_table(tmp_path / f"{result.name}.parquet"), result.data)
    again = fig11_14_trials.simulate(SMALL, 2, pose_figures.fine_conditions(SMALL))
    assert same(again, results[3].data)


def test_another_seed_gives_other_trials() -> None:
    first, other = (ReproduceOptions(trials=2, altitude_steps=1, workers=1, seed=seed) for seed in (1, 2))
    assert not same(fig11_14_trials.simulate(first, 2), fig11_14_trials.simulate(other, 2))


def test_bounds_are_one_distribution() -> None:
    """Its mean, standard deviation and rms belong together, and the mean is below the rms."""
    data = fig11_14_trials.simulate(SMALL, 2)
    condition = Condition(data, 1e4, 1.0, "m")
    mean, std, rms = (condition.bound(kind) for kind in (MEAN, STD, RMS))
    assert mean**2 + std**2 == pytest.approx(rms**2)
    assert 0.5 * rms < mean < 0.98 * rms


def test_a_bar_below_zero_runs_to_the_axis_without_a_cap() -> None:
    series = {"a": line_plots.Series("k", "o", "-", np.array([100.0, 200.0]))}
    figure = line_plots.draw_errors(
        np.array([10.0, 100.0]), series, "m", "", [(10.0, 258.0, 227.0), (100.0, 107.0, 203.0)]
    )
    axes = figure.axes[0]
    bars = axes.collections[-1].get_segments()  # type: ignore[attr-defined]
    assert bars[0][:, 1] == pytest.approx([31.0, 485.0])
    assert bars[1][:, 1] == pytest.approx([axes.get_ylim()[0], 310.0])
    caps = [y for line in axes.lines if line.get_marker() == "_" for y in np.asarray(line.get_ydata())]
    assert sorted(caps) == [31.0, 310.0, 485.0]


def test_other_set_ups_have_no_number_of_the_paper() -> None:
    options = ReproduceOptions(trials=2, altitude_steps=1, altitudes_km=(20.0, 20.0), noise_px=0.5, workers=1)
    rows = run.reproduce(("fig13",), options)[0].rows
    assert all(row.paper is None for row in rows)
    assert {row.condition for row in rows} == {"20 km, 2 craters, 0.5 px"}


def test_every_statistic_is_of_the_same_trials() -> None:
    """A trial without an efficient solution counts for no method, nor for the bound."""
    data = fig11_14_trials.simulate(SMALL, 3)
    solutions = data["solutions"].to_numpy().copy()
    assert (solutions > 0.0).all()
    whole = Condition(data, 1e4, 1.0, "m")
    solutions[(data["altitude_m"].to_numpy() == 1e4) & (data["trial"].to_numpy() == 1.0)] = 0.0
    column = data.column_names.index("solutions")
    fewer = Condition(data.set_column(column, "solutions", pa.array(solutions)), 1e4, 1.0, "m")
    kept = [0, 2, 3]
    for method in fig11_14_trials.METHODS:
        np.testing.assert_array_equal(fewer.values(method), whole.values(method)[kept])
    assert fewer.bound(RMS) == pytest.approx(np.sqrt(np.mean(whole.bounds()[kept] ** 2)))
    assert "the same 7 of 8 trials; in 12.5% the efficient solver finds no pose" in pose_notes.efficiency(
        {10.0: fewer, 100.0: Condition(data, 1e5, 1.0, "m")}
    )


def test_the_efficient_solvers_errors_stand_beside_the_bound_at_each_altitude() -> None:
    """Altitudes at which it is once and twice the bound are not averaged away."""
    data = fig11_14_trials.simulate(SMALL, 3)
    far = data["altitude_m"].to_numpy() == 1e5
    errors = np.where(far, 2.0, 1.0) * data["bound_rms_m"].to_numpy()
    data = data.set_column(data.column_names.index("efficient_m"), "efficient_m", pa.array(errors))
    text = pose_notes.efficiency({km: Condition(data, 1e3 * km, 1.0, "m") for km in (10.0, 100.0)})
    assert "1.00 +- 0.00 (1.00 +- 0.00) at 10 km, 2.00 +- 0.00 (2.00 +- 0.00) at 100 km" in text


def test_what_did_not_converge_is_said() -> None:
    data = fig11_14_trials.simulate(ReproduceOptions(trials=4, altitude_steps=1, workers=1), 3)
    assert "converge" not in pose_notes.efficiency({10.0: Condition(data, 1e4, 1.0, "m")})
    column = data.column_names.index("shapes_converged")
    data = data.set_column(column, "shapes_converged", pa.array([1.0, 0.0, 1.0, 1.0]))
    text = pose_notes.efficiency({10.0: Condition(data, 1e4, 1.0, "m")})
    assert "did not converge: (19), unweighted in 25.0% (25.0% of those from 10 km)" in text


@pytest.mark.parametrize(
    "change",
    [{"arc": 0.36, "altitudes_km": (20.0, 200.0)}, {"noise_px": 10.0, "altitudes_km": (150.0, 200.0)}],
)
def test_hard_set_ups_leave_sentences_without_nan(change: dict[str, object], tmp_path: Path) -> None:
    options = ReproduceOptions(trials=2, altitude_steps=2, workers=1, **change)  # type: ignore[arg-type]
    results = run.reproduce(("fig11", "fig12", "fig13", "fig14"), options)
    run.write(tmp_path, results, options)
    report = (tmp_path / "reproduction.md").read_text()
    assert "nan" not in report
    assert "inf" not in report
    assert any("No trial counts" in result.note for result in results)


# In the quick tests, test_pool.py sees that tasks done in processes come back as they were.
@pytest.mark.slow
def test_processes_change_nothing() -> None:
    seen: list[tuple[int, int]] = []
    shared = fig11_14_trials.simulate(
        ReproduceOptions(trials=4, altitude_steps=2, workers=2), 2,
        progress=lambda what, done, total: seen.append((done, total)),
    )  # fmt: skip
    assert seen == [(1, 2), (2, 2)]
    # In a process of its own: here other tests may have compiled kernels for other array layouts, which numba
    # then takes, and their sums are rounded in another order.
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        alone = pool.submit(fig11_14_trials.simulate, SMALL, 2).result()
    assert same(alone, shared)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"craters": 2}, "craters"),
        ({"altitudes_km": (50.0, 10.0)}, "altitudes"),
        ({"altitudes_km": (100.0, 500.0)}, "altitudes"),
        ({"altitudes_km": (10.0, 100.0), "semi_axes_m": (200.0, 2500.0)}, "altitudes"),
        ({"semi_axes_m": (2500.0, 500.0)}, "semi-axes"),
        ({"noise_px": 0.0}, "noise"),
        ({"noise_px": float("nan")}, "noise"),
        ({"arc": 0.2}, "arc"),
        ({"trials": 1}, "trials"),
        ({"workers": 0}, "workers"),
        ({"seed": -1}, "seed"),
    ],
)
def test_options_that_make_no_sense_are_named(change: dict[str, object], named: str) -> None:
    with pytest.raises(CraternavError, match=f"^{named}: expected"):
        ReproduceOptions(**change)  # type: ignore[arg-type]


def test_the_command_writes_the_folder_and_says_what_is_wrong(tmp_path: Path) -> None:
    done = call("reproduce", "fig02", "-o", tmp_path / "out", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out) == json.loads((tmp_path / "out" / "reproduction.json").read_text())
    unknown = call("reproduce", "fig05", "-o", tmp_path / "other")
    assert unknown.code == 2
    assert "unknown figure 'fig05'" in unknown.err
    assert unknown.err.count("\n") == 1
    assert not (tmp_path / "other").exists()
