"""Figures of odd runs: nothing to see is no reason to fail."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.registry import ESTIMATORS
from craternav_fg.evaluation.dem_check import DemCheck
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.plots import dem_check, style, trajectories
from craternav_fg.trajectory import Trajectory

MOON = Body("Moon", 1_737_400.0, 4.9028e12, (0.0, 0.0, 2.66e-6))


def one_crater() -> Catalog:
    zero = np.zeros(1)
    return Catalog(("C",), zero, zero, zero + 900.0, zero + 700.0, zero + 0.5, zero, MOON)


def straight_down(frames_count: int, off: float = 0.0) -> Trajectory:
    P = np.array([1.0, 0.0, 0.0]) * (MOON.radius_m + np.linspace(20e3, 5e3, frames_count)[:, None])
    gTb = np.stack([frames.pose(frames.rotation_exp(np.full(3, 1e-3 * off)), p + off) for p in P])
    stamps = np.arange(frames_count, dtype=np.int64) * 10**9
    S = np.tile(np.eye(6), (frames_count, 1, 1))
    V = np.full((frames_count, 3), off)
    return Trajectory(stamps, gTb, V, np.zeros((frames_count, 6)), S, S[:, :3, :3], S)


def test_each_estimator_has_a_line_of_its_own() -> None:
    lines = [style.line_style(name) for name in (*ESTIMATORS, "somebody_else_s")]
    assert len({(line["color"], line["ls"]) for line in lines}) == len(lines)


def test_variants_of_an_estimator_share_its_colour() -> None:
    assert style.colour("ekf_los") == style.colour("ekf")
    assert style.line_style("ekf_los")["ls"] != style.line_style("ekf")["ls"]


def test_own_estimators_of_a_run_have_lines_of_their_own() -> None:
    t, truth = straight_down(9, off=1.0), straight_down(9)
    mine = {f"mine_{k}": t for k in range(8)}
    for figure in (
        trajectories.draw_errors(mine, truth, [0] * 9),
        trajectories.draw_consistency(mine, truth),
        trajectories.draw_bounds(mine, truth),
    ):
        lines = [line for line in figure.axes[0].get_lines() if line.get_label().startswith("mine")]
        assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == len(lines) == 8


@pytest.mark.parametrize("frames_count", [1, pytest.param(2, marks=pytest.mark.slow), 9])
def test_a_vertical_descent_and_a_single_frame_are_drawn(tmp_path: Path, frames_count: int) -> None:
    t, truth = straight_down(frames_count, off=1.0), straight_down(frames_count)
    for number, figure in enumerate(
        (
            trajectories.draw_descent(t, None, one_crater(), MOON),
            # An estimator of another package is drawn as well.
            trajectories.draw_errors({"smoother": t, "carried": t}, truth, [0] * frames_count),
            trajectories.draw_consistency({"smoother": t, "carried": t}, truth),
            trajectories.draw_sigmas({"smoother": t}, [0] * frames_count),
            trajectories.draw_bounds({"smoother": t}, truth),
        )
    ):
        style.save(figure, tmp_path / f"{number}.png")
        assert (tmp_path / f"{number}.png").stat().st_size > 5000


def test_a_figure_is_saved_as_matplotlib_would(tmp_path: Path) -> None:
    # It draws the figure twice for that.
    t, truth = straight_down(9, off=1.0), straight_down(9)
    expected = trajectories.draw_errors({"smoother": t}, truth, [3] * 9)
    style.number_plainly(expected)
    expected.savefig(tmp_path / "expected.png", dpi=80)
    style.save(trajectories.draw_errors({"smoother": t}, truth, [3] * 9), tmp_path / "found.png", 80)
    expected, found = (cv2.imread(str(tmp_path / name)) for name in ("expected.png", "found.png"))
    assert expected.shape == (800, 720, 3)
    np.testing.assert_array_equal(found, expected)


def test_decades_are_plain_numbers() -> None:
    figure = Figure()
    axes, other, wide = figure.subplots(3)
    wide.semilogy([1, 2], [1e-7, 1e7])
    axes.loglog([0.01, 1e4], [2.0, 9.0])
    # A choice of one's own stays.
    other.set_xscale("log")
    other.set_xticks([3.0], ["three"])
    style.number_plainly(figure)
    figure.canvas.draw()
    labels = [one.get_text() for one in axes.get_xticklabels()]
    assert {"0.01", "1", "100"} <= set(labels)
    # Less than a decade: the ticks between.
    between = [one.get_text() for one in axes.get_yticklabels(minor=True)]
    assert {"2", "3", "4"} <= set(between)
    assert all("$" in one.get_text() for one in wide.get_yticklabels() if one.get_text())
    assert [one.get_text() for one in other.get_xticklabels()] == ["three"]


def test_low_altitudes_are_in_metres() -> None:
    t = straight_down(3)
    # 20 m, 4.2 km and 20 km above the sphere.
    for row, height_m in enumerate((20.0, 4.2e3, 20e3)):
        t.gTb[row, 0, 3] = MOON.radius_m + height_m
    none = RimSet(np.zeros(0, int), np.zeros((0, 5)), np.zeros((0, 5, 5)))
    images = [(np.zeros((8, 8), np.uint8), FrameMeasurement(int(stamp), none, None)) for stamp in t.stamps_ns]
    figure = trajectories.draw_overview(images, {"ekf": t}, None, Camera(8, 8, 9.0, 9.0, 3.5, 3.5), MOON)
    titles = [axes.get_title() for axes in figure.axes[:3]]
    assert titles == ["20 m, 0 rims", "4.2 km, 0 rims", "20 km, 0 rims"]


def test_negative_correlations_of_bad_poses_are_drawn() -> None:
    checks = [DemCheck(value, 0.9, 0.0, np.zeros(2), 0.0) for value in (0.8, -0.4)]
    axes = dem_check.draw_dem_check(checks, np.ones(2)).axes[0]
    assert axes.get_ylim() == pytest.approx((-0.45, 1.0))
    assert dem_check.draw_dem_check(checks[:1], np.ones(1)).axes[0].get_ylim() == (0.0, 1.0)


def test_a_figure_is_saved_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "figure.png"
    path.write_bytes(b"former")

    def stopped(self: object, file: Path, **_: object) -> None:
        Path(file).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(style.FigureCanvasAgg, "print_png", stopped)
    with pytest.raises(KeyboardInterrupt):
        style.save(Figure(), path)
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("figure.png", b"former")]
