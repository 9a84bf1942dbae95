"""What the measurements of a rim keep: on one short descent with five craters in view."""

import time

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from gtsam.symbol_shorthand import X

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import basins
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.rim_models import RIM_MODELS, rim_factors
from craternav_fg.reproduce import rim_models
from craternav_fg.reproduce.fig15_18_trials import Trial, problem_of
from craternav_fg.reproduce.run import chosen
from craternav_fg.trajectory import Trajectory
from factors.custom import Loss
from tests import descents


@pytest.fixture(scope="module")
def trial() -> Trial:
    return Trial(descents.scenario(duration_s=60.0), 0)


@pytest.fixture(scope="module")
def data(trial: Trial) -> pa.Table:
    return rim_models._run_trial(trial)


def test_each_measurement_keeps_what_it_should(data: pa.Table) -> None:
    kept = rim_models.evaluate(data)
    assert set(kept) == {(model, name) for model in RIM_MODELS for name in rim_models.ESTIMATORS}
    chart, los = kept["chart", "smoother"], kept["los", "smoother"]
    for model in ("eq19", "los+shape", "points"):
        # The same information: the same optimum up to curvature.
        assert kept[model, "smoother"].from_chart_sigmas < min(0.1, 0.5 * los.from_chart_sigmas)
    assert los.anees < 15.0
    assert kept["centre", "smoother"].anees > 3.0 * chart.anees
    assert chart.basin == 1.0
    assert all(one.frame_ms > 0.0 for one in kept.values())


def test_from_far_off_the_chart_converges_most_often(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rim_models, "_TURN_RAD", np.radians(30.0))
    monkeypatch.setattr(rim_models, "_SHIFT", 0.3)
    problem, truth = problem_of(trial)
    starts = rim_models._starts(problem, truth, np.random.default_rng(1))
    shares = {m: rim_models._basin(problem, truth, m, starts) for m in ("chart", "eq19", "points")}
    assert shares["chart"] > max(shares["eq19"], shares["points"]) + 0.1, shares


def rows(model: str, name: str, error_m: dict[int, float], altitudes_km: tuple[float, ...]) -> pa.Table:
    """Trials of an estimator, each with one error."""
    values = [
        {
            "trial": trial, "model": model, "estimator": name, "altitude_m": 1e3 * km, "rims": 3,
            "error_m": e, "nees": km, "from_chart_sigmas": np.nan, "frame_s": 1e-3, "basin": 1.0,
        }
        for trial, e in error_m.items()
        for km in altitudes_km
    ]  # fmt: skip
    return pa.Table.from_pylist(values, schema=rim_models._SCHEMA)


def test_the_note_is_computed(data: pa.Table) -> None:
    kept = rim_models.evaluate(data)
    text = rim_models.note(data, 1)
    ratio = kept["los", "online"].rms_m / kept["chart", "online"].rms_m
    assert f"los: {ratio:.3g} times that error" in text
    assert f"chart {100 * kept['chart', 'online'].basin:.0f} %" in text
    points = pc.and_(pc.equal(data["model"], "points"), pc.equal(data["estimator"], "online"))
    assert "points produced no trajectory" in rim_models.note(data.filter(pc.invert(points)), 1)


def test_ratios_are_over_the_trials_of_both() -> None:
    """The chart ends all trials, the other model the easy one only: it is no better there."""
    data = pa.concat_tables(
        [
            rows("chart", "online", {0: 10.0, 1: 1000.0}, (50.0, 20.0)),
            rows("eq19", "online", {0: 10.0}, (50.0, 20.0)),
            rows("points", "online", {2: 10.0}, (50.0, 20.0)),
        ]
    )
    text = rim_models.note(data, 3)
    assert "position error of 707 m in the 2 with a trajectory." in text
    assert "eq19: 1 times that error; 1 times its CPU time (over the 1 of 3 trials with both)." in text
    assert "points: no trial in common with the chart." in text


def test_the_chart_may_fail_in_all_trials() -> None:
    text = rim_models.note(rows("eq19", "online", {0: 10.0}, (50.0, 20.0)), 1)
    assert "the ellipse chart produced no trajectory. eq19: no trial in common with the chart." in text
    rim_models._draw(rim_models.evaluate(rim_models._SCHEMA.empty_table()))


def test_bins_without_frames_keep_their_place() -> None:
    kept = rim_models.evaluate(rows("chart", "online", {0: 10.0}, (50.0, 20.0)))
    np.testing.assert_equal(kept["chart", "online"].anees_by_altitude, (np.nan, 50.0, 20.0))


def test_only_the_chart_is_the_reference(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses with other measurements are not compared with the first one that survives."""

    class Fails:
        def estimate(self, problem: object) -> None:
            raise EstimationError("no sense")

    of = rim_models._estimators
    monkeypatch.setattr(rim_models, "RIM_MODELS", ("chart", "centre", "los"))
    monkeypatch.setattr(rim_models, "_basin", lambda *_: 1.0)
    monkeypatch.setattr(
        rim_models, "_estimators", lambda model: {"ekf": Fails() if model == "chart" else of(model)["ekf"]}
    )
    found = rim_models._run_trial(trial)
    assert found["model"].unique().to_pylist() == ["centre", "los"]
    assert np.isnan(found["from_chart_sigmas"].to_numpy()).all()


def test_what_a_process_does_once_is_no_cost_of_a_frame(
    trial: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a process for each trial, kernels that are loaded count in every one of them."""

    class Loads:
        loaded = False

        def estimate(self, problem: Problem) -> Trajectory:
            began = time.process_time()
            while not self.loaded and time.process_time() < began + 0.2:
                pass
            self.loaded = True
            return known

    known = rim_models._estimators("chart")["ekf"].estimate(problem_of(trial)[0])
    monkeypatch.setattr(rim_models, "RIM_MODELS", ("chart",))
    monkeypatch.setattr(rim_models, "_basin", lambda *_: 1.0)
    monkeypatch.setattr(rim_models, "_estimators", lambda model: {"ekf": Loads()})
    spent_s = rim_models._run_trial(trial)["frame_s"].to_numpy()
    assert spent_s.sum() < 0.1


def test_the_ablation_includes_it() -> None:
    assert chosen(["ablation"]) == ("ablation", "rim_models")
    assert chosen(["rim_models"]) == ("rim_models",)


def test_steps_to_the_optimum(trial: Trial) -> None:
    problem, truth = problem_of(trial)
    gTb, rims = truth.gTb[0], problem.frames[0].rims
    factors = rim_factors("chart", X(0), problem.camera, problem.catalog, rims, gTb, Loss())
    turned = gTb @ frames.pose(frames.rotation_exp(np.array([0.0, 0.1, 0.0])), np.zeros(3))
    upside_down = gTb @ frames.pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    steps = basins.steps_to_optimum(factors, gTb, np.array([gTb, turned, upside_down]))
    assert 0 < steps[0] < steps[1] < 15
    assert steps[2] == basins.NOT_REACHED
    damped = basins.steps_to_optimum(factors, gTb, np.array([turned]), "levenberg-marquardt")
    assert 0 < damped[0] < 30
    one = rim_factors("chart", X(0), problem.camera, problem.catalog, rims.take([0]), gTb, Loss())
    with pytest.raises(EstimationError, match="do not determine"):
        basins.steps_to_optimum(one, gTb, np.array([gTb]))
