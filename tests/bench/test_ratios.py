"""The benchmark measures the same problem on both sides, and reports what it promises."""

import contextlib
import functools
import json
import time
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from craternav_fg.bench import detect, floors, images, pipeline, ratios, report
from craternav_fg.bench.problems import Bench, make, tracked
from craternav_fg.bench.sessions import Reference
from craternav_fg.cli.app import app
from craternav_fg.estimators.batch import build_graph
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.graph import add_prior
from craternav_fg.estimators.incremental import Isam
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.optimise import levenberg_marquardt
from factors.kernels import strapdown

TINY = report.Sizes((20, 40, 80), (1, 10), 30, 40, 40, 1, 5, 1, 3)
PROMISED = {
    "factor_ratio_n10",
    "factor_ratio_n30",
    "factor_floor_n10",
    "batch_ratio",
    "batch_step_ratio",
    "batch_step_floor",
    "batch_iterations",
    "batch_reference_iterations",
    "online_mean_ratio",
    "online_p99_ratio",
    "fixed_lag_ratio",
    "errors_batch_ratio",
    "errors_batch_floor",
    "errors_online_ratio",
    "errors_online_floor",
    "ekf_step_us",
    "scaling_exponent_batch",
    "pose_ms_n3",
    "pose_ms_n10",
    "pose_vs_scipy_ratio",
    "render_s",
    "detect_ms",
    "identify_ms_median",
    "identify_ms_p95",
    "identify_large_false_ms",
    "identify_index_s",
    "rim_ms",
    "pipeline_ms",
}


@pytest.fixture(scope="module")
def bench() -> Bench:
    return make(60, 10)


def test_both_sides_solve_their_problem(bench: Bench) -> None:
    """A start 50 m off comes down to errors that the measurements explain, with either kind of factor."""
    start = bench.values(np.random.default_rng(1))
    ours = build_graph(bench.problem, BatchOptions(), start)
    reference = gtsam.NonlinearFactorGraph()
    add_prior(reference, bench.problem.initial)
    for i in range(ours.size()):
        if isinstance(ours.at(i), gtsam.CombinedImuFactor):
            reference.push_back(ours.at(i))
    for i in range(60):
        bench.landmark_factors(reference, i)
    for graph, residuals in ((ours, 60 * 10 * 5), (reference, 60 * 10 * 3)):
        result = levenberg_marquardt(graph, start)
        assert 0.8 * residuals < 2.0 * result.error < 1.2 * residuals
        off = [
            np.linalg.norm(result.values.atPose3(X(i)).translation() - bench.gTb[i, :3, 3]) for i in range(60)
        ]
        assert max(off) < 60.0


def test_a_floor_has_the_same_system_to_solve(bench: Bench) -> None:
    """Evaluated beforehand, our factors give at any values what they give where they were evaluated."""
    ours, _, values = ratios.batch_graphs(bench)
    linear = ours.linearize(values)
    moved = bench.values(np.random.default_rng(2))
    with ours.ahead.at(values, linearise=True):
        floor = gtsam.NonlinearFactorGraph.linearize(ours, moved)
    of_ours = [n for n in range(ours.size()) if isinstance(ours.at(n), gtsam.CustomFactor)]
    assert len(of_ours) == len(bench.problem.frames)
    for number in of_ours:
        A, b = linear.at(number).jacobian()
        found = floor.at(number).jacobian()
        assert_allclose(found[0], A)
        assert_allclose(found[1], b)


def test_updates_of_a_session_are_repeated_without_our_factors() -> None:
    """Of a descent whose errors are recognised as lasting: the solver ends where the session's did."""
    problem = tracked(12, 6)
    assert len(np.unique(problem.frames[6].rims.craters)) == 6
    for options in (BatchOptions(), BatchOptions(rim_errors=None)):
        session = OnlineSmoother(options).run(problem)
        solver = floors._Recorded(problem, options).replay()
        key = X(session.frame_state_indices[-1])
        found = solver.tree.calculateEstimatePose3(key).translation()
        sigma_m = np.sqrt(np.diag(session.state.covariance)[strapdown.POSITION])
        assert (np.abs(found - session.state.gTb[:3, 3]) < 0.05 * sigma_m).all()


def test_reference_session_tracks_as_ours_does(bench: Bench) -> None:
    reference = Reference(bench, Isam())
    for _ in range(59):
        reference.update()
    ours = OnlineSmoother().estimate(bench.problem)
    assert np.linalg.norm(reference._state.position() - bench.gTb[-1, :3, 3]) < 60.0
    assert np.linalg.norm(ours.gP[-1] - bench.gTb[-1, :3, 3]) < 60.0


def busy(seconds: float) -> None:
    """Use up the processor's time, which sleeping would not."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_a_ratio_is_ours_over_the_reference() -> None:
    ratio = ratios.interleaved(lambda: busy(0.02), lambda: busy(0.005), 5)
    assert 2.0 < ratio.median < 6.0
    assert ratio.low <= ratio.median <= ratio.high
    assert ratio.ours_us > ratio.reference_us > 4e3


def test_exponent() -> None:
    n = np.array([100, 300, 1000])
    assert_allclose(ratios.exponent(n, 3.0 * n**1.5), 1.5)


def test_flatness_compares_the_last_tenth_with_the_first() -> None:
    cpu = np.concatenate([np.full(10, 2.0), np.full(80, 9.0), np.full(10, 3.0)])
    seconds = np.stack([cpu, np.ones(100)], axis=1)
    assert_allclose(ratios.Online(seconds, seconds).flatness, 1.5)


@pytest.mark.slow
def test_factors_cost_what_cpp_factors_cost() -> None:
    """With room for a busy machine: an allocation per crater or a Python loop would show at once."""
    assert ratios.factor_ratio(make(100, 10)).median < 1.8
    assert ratios.factor_ratio(make(100, 30)).median < 0.9


def quiet(what: str, done: int, total: int) -> None:
    """Report nothing."""


@pytest.mark.slow
def test_command_writes_figure_and_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "QUICK", TINY)
    monkeypatch.setattr(images, "ALTITUDES_M", (20e3, 8e3))
    monkeypatch.setattr(images, "FRAMES", 1)
    monkeypatch.setattr(pipeline, "INTERVAL_S", 100.0)
    monkeypatch.setattr(pipeline, "MIN_RIMS", 0)
    # Once for both outputs.
    monkeypatch.setattr(report, "run", functools.cache(report.run))
    monkeypatch.setattr("craternav_fg.cli.benchmark.progress_bars", lambda: contextlib.nullcontext(quiet))
    figure = tmp_path / "cost.png"
    done = CliRunner().invoke(app, ["bench", "-o", str(figure), "--json"])
    assert done.exit_code == 0, done.output
    measured = json.loads(done.stdout)
    assert measured.keys() >= PROMISED
    for name in PROMISED:
        assert np.isfinite(measured[name])
    low, high = measured["batch_ratio_spread"]
    assert low <= measured["batch_ratio"] <= high
    assert measured["batch_ratio_wall"] > 0.0
    assert measured["bench_cpu_s"] > 0.0
    assert measured["bench_peak_mb"] > 50.0
    assert figure.read_bytes().startswith(b"\x89PNG")
    before = {**measured, "pipeline_ms": 2.0 * measured["pipeline_ms"]}
    (tmp_path / "before.json").write_text(json.dumps(before))
    arguments = ["bench", "-o", str(figure), "--force", "--compare", str(tmp_path / "before.json")]
    table = CliRunner().invoke(app, arguments)
    assert "online_mean_ratio" in table.stdout
    assert "1 of " in table.stdout


def test_a_figure_of_no_known_kind_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["bench", "-o", str(tmp_path / "cost.xyz")])
    assert done.exit_code != 0
    assert "expected a name that ends in .png" in str(done.exception)


@pytest.mark.slow
def test_what_an_image_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(images, "ALTITUDES_M", (20e3, 8e3))
    monkeypatch.setattr(images, "FRAMES", 1)
    # More than the limit below: what this process has held must not count.
    ballast = np.ones(250_000_000)
    costs = images.render_costs()
    assert ballast.nbytes > 1500e6
    assert set(costs) == {"render_s", "render_2x2_s", "render_altitude_ratio", "render_peak_mb"}
    assert costs["render_2x2_s"] > costs["render_s"] > 0.0
    assert costs["render_altitude_ratio"] >= 1.0
    assert 50.0 < costs["render_peak_mb"] < 1500.0


def test_detectors_are_measured() -> None:
    figures = detect.detect_ms(images=1)
    assert {"detect_ms", "detect_recall", "detect_hard_precision", "detect_canny_semi_minor_px"} <= set(
        figures
    )
    assert np.isfinite(list(figures.values())).all()
    assert 0.0 < figures["detect_ms"] < 5000.0
    assert figures["detect_hard_rims"] > figures["detect_rims"] > 10
    assert figures["detect_canny_recall"] < figures["detect_recall"]
