"""Figure that compares runs: each with its own truth, no two lines alike."""

from dataclasses import replace
from pathlib import Path

import pytest

from craternav_fg.cli.comparison import _draw
from craternav_fg.errors import InputError
from craternav_fg.plots.comparison import draw_comparison
from craternav_fg.plots.style import line_styles
from craternav_fg.runs.read import Run
from craternav_fg.trajectory import Trajectory
from tests.plots.test_trajectories import straight_down


def moved(trajectory: Trajectory, off_m: float) -> Trajectory:
    gTb = trajectory.gTb.copy()
    gTb[:, 1, 3] += off_m
    return replace(trajectory, gTb=gTb)


def test_errors_are_those_against_each_runs_own_truth() -> None:
    near = straight_down(9)
    far = moved(near, 50e3)
    runs = {"a": {"ekf": moved(near, 3.0)}, "b": {"ekf": moved(far, 4.0)}}
    lines = draw_comparison(runs, {"a": near, "b": far}).axes[0].get_lines()
    assert [line.get_ydata().mean() for line in lines] == pytest.approx([3.0, 4.0])
    # Without truth from the first run's first estimator.
    (line,) = draw_comparison(runs, None).axes[0].get_lines()
    assert line.get_ydata().mean() == pytest.approx(50e3 + 1.0)


def test_without_truth_runs_of_different_descents_are_refused(tmp_path: Path) -> None:
    t = straight_down(9)
    one = Run(tmp_path / "a", {}, {"ekf": t, "online": moved(t, 1.0)}, None, tmp_path / "data")
    longer = {"ekf": straight_down(10)}
    for other, what in ((replace(one, dataset=tmp_path / "other"), "data set"), (
        replace(one, trajectories=longer), "frames"
    )):  # fmt: skip
        with pytest.raises(InputError, match=f"expected the {what} of .*a for --output without ground"):
            _draw([one, replace(other, path=tmp_path / "b")], tmp_path / "errors.png")
    _draw([one, one], tmp_path / "errors.png")
    assert (tmp_path / "errors.png").exists()


def test_no_two_lines_are_alike() -> None:
    names = ("ekf", "ekf_los", "ekf_eq19", "mine", "yours", "ours")
    trajectories = {name: moved(straight_down(30), 1.0) for name in names}
    truths = {f"run {k}": straight_down(30) for k in range(7)}
    lines = draw_comparison(dict.fromkeys(truths, trajectories), truths).axes[0].get_lines()
    looks = {(line.get_color(), line.get_linestyle(), line.get_marker()) for line in lines}
    assert len(looks) == len(lines) == 42
    # Each has some markers.
    assert all(start < 10 for start, _ in (line.get_markevery() for line in lines))


def test_many_estimators_of_others_have_lines_of_their_own() -> None:
    styles = line_styles(f"mine_{k}" for k in range(24))
    assert len({(style["color"], style["ls"]) for style in styles.values()}) == 24
