"""What the notes conclude follows from their numbers: other numbers, other sentences."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pytest

from craternav_fg.reproduce import (
    ablation,
    fig02,
    fig03_04,
    fig10,
    fig11_14,
    fig11_14_trials,
    fig15_18,
    lag,
    table1,
    table2,
    table2_trials,
)
from craternav_fg.reproduce.fig15_18_trials import CENTRES, FILTER, PAPERS, SMOOTHER
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.sentences import changed, compared, listed
from craternav_fg.reproduce.table1_trials import ERRORS, FINE, IRREGULAR, MEASURED, Sets
from tests.reproduce import test_descents as descents

SMALL = ReproduceOptions(trials=4, altitude_steps=2, workers=1)


@pytest.mark.parametrize(
    ("value", "reference", "words"),
    [
        (1.05, 1.0, "about equal to"),
        (0.95, 1.0, "about equal to"),
        (1.2, 1.0, "larger than"),
        (0.8, 1.0, "smaller than"),
        (0.1, 0.0, "larger than"),
        (np.nan, 1.0, "not comparable with"),
        (1.0, np.nan, "not comparable with"),
    ],
)
def test_a_comparison_says_which_is_larger(value: float, reference: float, words: str) -> None:
    assert compared(value, reference) == words


def test_changes_and_lists() -> None:
    assert changed(2.0, 8.0) == "grows by a factor of 4"
    assert changed(8.0, 2.0) == "falls by a factor of 4"
    assert changed(8.0, 8.4) == "stays about the same"
    assert changed(np.nan, 8.0) == changed(np.nan, np.nan) == "is not known"
    assert [listed(["a", "b", "c"][:n]) for n in range(4)] == ["", "a", "a and b", "a, b and c"]


def test_fig02_says_whether_the_deviation_grows() -> None:
    rising = 1e-3 * np.add.outer(np.arange(1.0, 7.0), np.arange(8.0))
    for values, words in (
        (rising, "grows in 100% of the steps in angle and in 100% of the steps in altitude, up to 0.01 deg"),
        (rising[::-1], "grows in 0% of the steps in angle and in 100% of the steps in altitude"),
        (rising[:, ::-1], "grows in 100% of the steps in angle and in 0% of the steps in altitude"),
    ):
        assert words in fig02.note(values, values, values, 0.045)
    assert "as printed differ from the projected rim by at most 20.0 %" in fig02.note(
        rising, 1.2 * rising, rising, 0.045
    )
    assert "exceeds it at 0 of the 8 altitudes. " in fig02.note(rising, rising, rising, 1.0)
    assert "exceeds it at 8 of the 8 altitudes, the highest 50 r" in fig02.note(rising, rising, rising, 1e-4)


@pytest.mark.parametrize(("power", "share"), [(-1.0, "100%"), (1.0, "0%")])
def test_fig03_says_whether_the_error_grows(power: float, share: str) -> None:
    error = [[tilt * float(h) ** power for h in fig02.ALTITUDES] for tilt in fig02.TILTS_DEG]
    flat = np.array(error).ravel()
    data = pa.table({"deviation_deg": flat, "centres_error_radii": flat, "edges_error_radii": flat})
    note = fig03_04.fig03(data).note
    assert f"grows in 100% of the steps in angle and in {share} of the steps in altitude" in note
    assert "in 0.0% of the triples" in note


def rims(errors: Mapping[tuple[str, str], tuple[float, float]]) -> Sets:
    """Return two rims of each set: error of the centre in x and of both semi-axes, by set and method."""
    rows = []
    for kind in (FINE, IRREGULAR):
        for image in range(2):
            row: dict[str, object] = {"set": kind, "image": image}
            for method in MEASURED:
                x, axis = errors.get((kind, method), (0.1, 0.0))
                row |= dict(zip((f"{method}_{name}" for name in ERRORS), (x, 0.0, axis, axis), strict=True))
            rows.append(row)
    table = pa.Table.from_pylist(rows)
    return Sets(table, table, np.empty(0))


def test_table1_gives_the_biases_and_the_ratio_of_the_rims() -> None:
    note = table1.table1(rims({(FINE, "canny"): (0.1, -0.8), (IRREGULAR, "guided"): (0.3, 0.0)})).note
    assert "-0.80 and -0.80 px by Canny edges, +0.00 and +0.00 px by the blind detector" in note
    assert "is 3.0 times that of fine" in note
    note = table1.table1(rims({(FINE, "canny"): (0.1, 0.2), (IRREGULAR, "guided"): (0.05, 0.0)})).note
    assert "+0.20 and +0.20 px by Canny edges" in note
    assert "is 0.5 times that of fine" in note


def coefficients(scale: float) -> pa.Table:
    """Return two rims at each altitude whose errors have the paper's standard deviations times a scale."""
    rows = []
    for km, printed in table2.TABLE2.items():
        for sign in (-1.0, 1.0):
            row = {"altitude_km": float(km), "semi_minor_px": 50.0}
            for name, value in zip(table2_trials.COEFFICIENTS, printed, strict=True):
                for method in ("canny", "blind", "guided"):
                    row |= {f"{method}_{name}": sign * scale * value}
                    row |= {f"{method}_{name}{table2_trials.CENTRAL}": 0.5 * sign * scale * value}
            rows.append(row)
    return pa.Table.from_pylist(rows)


def test_table2_compares_our_deviations_with_the_printed_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    options = ReproduceOptions(images=2)
    for scale, words in ((1.0, "ours are 1 to 1 times"), (3.0, "ours are 3 to 3 times")):
        assert words in table2.table2(coefficients(scale), options).note
    lines = [row.verdict for row in table2.table2(coefficients(1.0), options).rows]
    assert sum("out of line" in line for line in lines) == 6
    # Were the paper's 50 km row like the others, nothing would be said of it.
    monkeypatch.setitem(table2.TABLE2, 50, table2.TABLE2[40])
    result = table2.table2(coefficients(1.0), options)
    assert not any("out of line" in row.verdict for row in result.rows)
    assert "A, B and C change by factors of 1 to 1" in result.note


def test_fig10_gives_the_mean_errors() -> None:
    errors = {name: np.full((4, 3), px) for name, px in (("canny", 1.25), ("blind", 0.5), ("guided", np.nan))}
    expected = "1.25 px by Canny edges, 0.5 px by the blind detector, - px by guided measurement"
    assert expected in fig10.note(errors)


@pytest.fixture(scope="module")
def poses() -> dict[int, pa.Table]:
    return {n: fig11_14_trials.simulate(SMALL, n) for n in (2, 3)}


def scaled(data: pa.Table, name: str, factors: tuple[float, float]) -> pa.Table:
    """Set the errors of a method to those of eq. (13) or (23), times a factor at 10 and at 100 km."""
    base = "edges" if "edges_m" in data.column_names and data["craters"][0].as_py() == 3 else "two_craters"
    far = data["altitude_m"].to_numpy() == 1e5
    for unit in ("m", "deg"):
        values = data[f"{base}_{unit}"].to_numpy() * np.where(far, factors[1], factors[0])
        data = data.set_column(data.column_names.index(f"{name}_{unit}"), f"{name}_{unit}", pa.array(values))
    return data


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ((5.0, 1.0), "larger than that of the edges (13) at 10 km (5 times) and about equal to it at 100 km"),
        ((0.5, 3.0), "smaller than that of the edges (13) at 10 km (0.5 times) and larger than it at 100 km"),
    ],
)
def test_fig11_says_where_edges_are_better(
    factors: tuple[float, float], words: str, poses: dict[int, pa.Table]
) -> None:
    data = scaled(poses[3], "centres", factors)
    assert words in fig11_14.draw_up("fig11", data, SMALL).note


def test_fig12_says_whose_error_falls(poses: dict[int, pa.Table]) -> None:
    flat = poses[3]
    far = flat["altitude_m"].to_numpy() == 1e5
    for near_deg, far_deg, words in (
        (1.0, 2.0, "rises for"),
        (2.0, 1.0, "falls for eq. (13)"),
        (1.0, 1.0, "stays about the same for eq. (13)"),
    ):
        values = pa.array(np.where(far, far_deg, near_deg))
        data = flat.set_column(flat.column_names.index("edges_deg"), "edges_deg", values)
        text = fig11_14.draw_up("fig12", data, SMALL).note
        assert words in text
        assert f"{near_deg:g} and {far_deg:g} deg for eq. (13)" in text


def test_nothing_is_compared_over_one_altitude() -> None:
    options = ReproduceOptions(trials=4, altitude_steps=1, altitudes_km=(100.0, 100.0), workers=1)
    three, two = (fig11_14_trials.simulate(options, n) for n in (3, 2))
    notes = {name: fig11_14.draw_up(name, three, options).note for name in ("fig11", "fig12")}
    notes["fig13"] = fig11_14.draw_up("fig13", two, options, three).note
    for text in notes.values():
        for word in ("rises for", "falls for", "by a factor", "about the same", "100 km and", "From 100 to"):
            assert word not in text.replace("the altitude rises", "")
    assert "At 100 km the means are" in notes["fig12"]


def test_other_sizes_are_not_compared_with_the_papers_numbers() -> None:
    assert fig11_14.papers_set_up(ReproduceOptions(), 3)
    assert not fig11_14.papers_set_up(ReproduceOptions(semi_axes_m=(500.0, 1000.0)), 3)


def test_fig13_and_fig14_compare_the_printed_mean_with_the_bound(poses: dict[int, pa.Table]) -> None:
    options = ReproduceOptions(trials=4, altitude_steps=2, altitudes_km=(80.0, 100.0), workers=1)
    data = fig11_14_trials.simulate(options, 2)
    for figure, unit, printed in (("fig13", "m", 107.0), ("fig14", "deg", 0.173)):
        for ratio, words in ((10.0, "smaller than the bound"), (1.0, "about equal to the bound")):
            name = f"bound_mean_{unit}"
            values = pa.array(np.full(len(data), ratio * printed))
            changed_data = data.set_column(data.column_names.index(name), name, values)
            note = fig11_14.draw_up(figure, changed_data, options).note
            assert f"{ratio:g} times as much: the paper's number is {words}" in note


def times(errors: dict[str, list[list[float]]], name: str, factor: float) -> list[list[float]]:
    return (factor * np.array(errors[name])).tolist()


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        # Filter and smoother alike at the end, the paper's filter far off: the measurement has the effect.
        (
            {FILTER: 1.0, PAPERS: 20.0},
            ["about equal to the smoother's for the chart EKF", "first is larger than"],
        ),
        # The filter is far off as well: smoothing has it.
        (
            {FILTER: 20.0, PAPERS: 21.0},
            ["larger than the smoother's for the paper's EKF, the chart EKF", "first is smaller than"],
        ),
        (
            {FILTER: 0.5, PAPERS: 1.0},
            ["0.50 for the chart EKF", "smaller than the smoother's for the chart EKF"],
        ),
    ],
)
def test_fig17_says_what_decides(
    factors: dict[str, float], words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, factor in factors.items():
        monkeypatch.setitem(descents.ERRORS, name, times(descents.ERRORS, SMOOTHER, factor))
    result = fig15_18.draw_up("fig17", descents.known())
    for part in words:
        assert part in result.note
    chart = {1.0: "about equal to", 20.0: "larger than", 0.5: "smaller than"}[factors[FILTER]]
    row = descents.find(list(result.rows), "position RMS over that of the smoother", "end")
    assert row.verdict.startswith(f"chart EKF: {chart} the smoother's")


@pytest.mark.parametrize(
    ("factor", "word"), [(0.5, "smaller than"), (1.0, "about equal to"), (2.0, "larger than")]
)
def test_fig17_compares_smoothing_in_retrospect_with_the_filter(
    factor: float, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(descents.ERRORS, SMOOTHER, times(descents.ERRORS, FILTER, factor))
    monkeypatch.setitem(descents.ERRORS, CENTRES, times(descents.ERRORS, FILTER, factor**2))
    result = fig15_18.draw_up("fig17", descents.known())
    assert f"{factor:.2f} in the mean: {word} that of the filter." in result.note
    rows = list(result.rows)
    gain = descents.find(rows, "position RMS, smoother in retrospect over chart EKF", "50 to 30 km")
    assert gain.verdict == f"smoother: {word} the chart EKF's"
    centres = descents.find(rows, "position RMS by centres over that of the smoother", "end")
    assert centres.verdict == f"centres: {word} the smoother's"


def test_lag_says_what_a_longer_lag_changes() -> None:
    bounds = [10.0, 5.0]
    same = lag.note([10.0] * 5, [10.0, 9.0, 8.0, 7.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0], bounds, 6)
    assert "at 120 s it is about equal to that at 4 s" in same
    assert "10 m at 4 s and 5 m at 120 s, smaller than at 4 s" in same
    assert "5 ms at 120 s on this machine, larger than at 4 s" in same
    other = lag.note([10.0, 9.0, 8.0, 7.0, 5.0], [5.0, 5.0, 5.0, 5.0, 10.0], [2.0] * 5, bounds, 6)
    assert "at 120 s it is smaller than that at 4 s" in other
    assert "larger than at 4 s (bound" in other
    assert "2 ms at 120 s on this machine, about equal to at 4 s" in other


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        (0, "the ellipse chart for eq. (19)"),
        (1, "each rim's own noise for one Qn"),
        (2, "the prior counted once"),
    ],
)
def test_ablation_names_the_choice_with_the_largest_effect(axis: int, words: str) -> None:
    error_m: npt.NDArray[np.float64] = np.full((2, 2, 2), 80.0)
    error_m[(slice(None),) * axis + (1,)] = 20.0
    median = dict(zip(ablation.filters(), error_m.ravel().tolist(), strict=True))
    smoothers = {ablation.CENTRES: 300.0, ablation.ELLIPSE_CENTRES: 30.0, ablation.RIMS: 10.0}
    note = ablation.note(median | smoothers, 3)
    assert f"so {words} has the largest effect" in note
    assert "divided by 10 (the right model of the centre) and 3 (size and shape of the rims)." in note


def test_ablation_gives_no_factor_of_a_filter_that_is_lost() -> None:
    names = list(ablation.filters())
    smoothers = {ablation.CENTRES: 300.0, ablation.ELLIPSE_CENTRES: 30.0, ablation.RIMS: 10.0}
    for lost in ([0], [1, 7], list(range(8))):
        error_m = [np.inf if k in lost else 20.0 for k in range(8)]
        note = ablation.note(dict(zip(names, error_m, strict=True)) | smoothers, 3)
        assert f"No trajectory in most trials, hence no factors: {names[lost[0]]}" in note
        assert "inf " not in note
        assert "nan" not in note
        assert ("The paper's filter ends at 20 m" in note) == (0 not in lost)
        assert ("the prior counted once, for eq. (29)" in note) == (not {0, 1} & set(lost))
