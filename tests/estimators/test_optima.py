"""Local optima of the batch smoother: suspected, and compared, where covariances are as stated."""

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose

from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.correlated_errors import STATE_SIZE
from craternav_fg.estimators.graph import FactorGraph
from craternav_fg.estimators.online import OnlineSmoother
from tests.descents import problem, scenario
from tests.estimators.test_correlated_errors import KNOWING, spoilt


@pytest.fixture(scope="module")
def p(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    sound, truth = problem(tmp_path_factory.mktemp("optima"), scenario(duration_s=40.0), 0)
    return spoilt(sound, truth, np.random.default_rng(0))


def test_craters_far_off_make_an_optimum_suspect(p: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Although their variances grow until they fit: the more they are off, the better they used to fit."""
    rng = np.random.default_rng(5)
    away = {row: 15.0 * rng.standard_normal(STATE_SIZE)[:5] for row in range(len(p.catalog))}
    frames = []
    for frame in p.frames:
        rims = frame.rims
        assert rims.correlated is not None
        shift = [A @ away[row] for A, row in zip(rims.correlated, rims.craters.tolist(), strict=True)]
        frames.append(replace(frame, rims=replace(rims, chart=rims.chart + np.array(shift))))
    runs = []
    run = OnlineSmoother.run

    def counted(self: OnlineSmoother, problem: Problem) -> Any:
        runs.append(problem)
        return run(self, problem)

    monkeypatch.setattr(OnlineSmoother, "run", counted)
    BatchSmoother(KNOWING).estimate(p)
    assert not runs
    BatchSmoother(KNOWING).estimate(replace(p, frames=frames))
    assert len(runs) == 1


def test_of_two_optima_the_one_is_taken_that_fits_what_is_stated(
    p: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In its own graph, the other's error is smaller: there the craters that it contradicts hardly count."""
    expected = BatchSmoother(KNOWING).estimate(p)
    found = BatchSmoother._optimum
    starts = []

    def second_is_right(self: BatchSmoother, *of: Any) -> Any:
        one = found(self, *of)
        starts.append(one)
        if len(starts) == 2:
            return replace(one, suspect=False)
        values = gtsam.Values(one.values)
        values.update(X(0), values.atPose3(X(0)).retract(np.array([0.0, 0.0, 0.0, 1e3, 0.0, 0.0])))
        return replace(one, graph=FactorGraph(), values=values, stated_error=1e6, suspect=True)

    monkeypatch.setattr(BatchSmoother, "_optimum", second_is_right)
    assert_allclose(BatchSmoother(KNOWING).estimate(p).gP, expected.gP, atol=1.0)
    assert len(starts) == 2
