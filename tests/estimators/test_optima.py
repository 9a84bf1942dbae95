"""Local optima of the batch smoother: suspected, and compared, where covariances are as stated."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import batch
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother, build_graph, trajectory
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from tests.descents import problem, scenario
from tests.estimators.test_correlated_errors import KNOWING, spoilt


@pytest.fixture(scope="module")
def p(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    sound, truth = problem(tmp_path_factory.mktemp("optima"), scenario(duration_s=40.0), 0)
    return spoilt(sound, truth, np.random.default_rng(0))


def test_craters_far_off_make_an_optimum_suspect(p: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Although their variances grow until they fit: the more they are off, the better they used to fit."""
    rng = np.random.default_rng(5)
    away = {row: 15.0 * rng.standard_normal(8)[:5] for row in range(len(p.catalog))}
    frames = []
    for frame in p.frames:
        rims = frame.rims
        assert rims.correlated is not None
        shift = [A @ away[row] for A, row in zip(rims.correlated, rims.craters.tolist(), strict=True)]
        frames.append(replace(frame, rims=replace(rims, chart=rims.chart + np.array(shift))))
    runs, optima = [], []
    run, optimum = OnlineSmoother.run, batch.optimum

    def counted(self: OnlineSmoother, problem: Problem) -> Any:
        runs.append(problem)
        return run(self, problem)

    def counted_optimum(*of: Any) -> Any:
        optima.append(of)
        return optimum(*of)

    monkeypatch.setattr(OnlineSmoother, "run", counted)
    monkeypatch.setattr(batch, "optimum", counted_optimum)
    BatchSmoother(KNOWING).estimate(p)
    assert (len(runs), len(optima)) == (0, 1)
    # The last optimisation is long there, and made once.
    BatchSmoother(KNOWING).estimate(replace(p, frames=frames))
    assert (len(runs), len(optima)) == (1, 2)


def test_of_two_optima_the_one_is_taken_that_fits_what_is_stated(
    p: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever comes first; if its last optimisation fails, the other one."""
    expected = BatchSmoother(KNOWING).estimate(p)
    start, finish = BatchSmoother._start, BatchSmoother._finished
    errors: list[float] = []
    finished: list[float] = []

    def stated(self: BatchSmoother, *of: Any) -> Any:
        return replace(start(self, *of), stated_error=errors.pop(), suspect=True)

    def fails_with_2(self: BatchSmoother, problem: Problem, one: Any) -> Any:
        finished.append(one.stated_error)
        if one.stated_error == 2.0:
            raise EstimationError("no convergence")
        return finish(self, problem, one)

    monkeypatch.setattr(BatchSmoother, "_start", stated)
    monkeypatch.setattr(BatchSmoother, "_finished", fails_with_2)
    for second, first, taken in ((1.0, 3.0, [1.0]), (3.0, 1.0, [1.0]), (3.0, 2.0, [2.0, 3.0])):
        errors[:], finished[:] = [second, first], []
        assert_allclose(BatchSmoother(KNOWING).estimate(p).gP, expected.gP, atol=1.0)
        assert finished == taken


def test_contracting_steps_need_one_elimination_for_the_covariances(
    p: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step that leaves nothing is the last one; where contraction is unknown, the next one tells."""
    one = replace(p, frames=p.frames[:1])
    start = OnlineSmoother(KNOWING).run(one).smoothed_values()
    graph = build_graph(one, KNOWING, start)
    best = levenberg_marquardt(graph, start, LmOptions(relative_tolerance=1e-14)).values
    near = gtsam.Values(best)
    near.update(X(0), best.atPose3(X(0)).retract(np.array([0.0, 0.0, 0.0, 1e-2, 0.0, 0.0])))
    predicted = Marginals(graph, near).predicted_decrease
    near.update(
        X(0),
        best.atPose3(X(0)).retract(np.array([0.0, 0.0, 0.0, 1e-2 * np.sqrt(1e-3 / predicted), 0.0, 0.0])),
    )
    made = []

    class Counted(Marginals):
        def __init__(self, *graph_and_values: Any, **options: Any) -> None:
            super().__init__(*graph_and_values, **options)
            made.append(self.predicted_decrease)

    monkeypatch.setattr("craternav_fg.estimators.batch.Marginals", Counted)
    trajectory(one, KNOWING, graph, near, [0], contraction=1e-4)
    assert_allclose(made, [1e-3], rtol=0.1)
    trajectory(one, KNOWING, graph, near, [0])
    assert len(made) == 3
