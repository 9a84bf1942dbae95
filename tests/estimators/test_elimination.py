"""Cholesky factorisation in an order that GTSAM accepts, against QR."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X
from numpy.testing import assert_allclose

from craternav_fg.bench.problems import tracked
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother, build_graph
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.elimination import CholeskyOrder
from craternav_fg.estimators.initial_values import initial_values
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.estimators.motion import longest_interval_s

CASES = {"errors of rims": BatchOptions(), "states alone": BatchOptions(rim_errors=None)}


@pytest.fixture(scope="module")
def problem() -> Problem:
    return tracked(30, 10)


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES)
def linear(request: pytest.FixtureRequest, problem: Problem) -> gtsam.GaussianFactorGraph:
    options = request.param
    states = ekf().states(problem)
    values, _ = initial_values(problem, problem.start, states, longest_interval_s(problem, options))
    return build_graph(problem, options, values).linearize(values)


def test_the_order_makes_realistic_imu_information_acceptable(linear: gtsam.GaussianFactorGraph) -> None:
    usual = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    with pytest.raises(RuntimeError, match="Indeterminate"):
        linear.optimize(usual)
    order = CholeskyOrder(linear)
    found = order.apart(linear).optimize(order.ordering)
    expected = linear.optimize(usual, gtsam.EliminateQR)
    # Half the square of their distance in standard deviations.
    assert linear.error(found) - linear.error(expected) < 1e-6


def test_the_newest_state_has_a_clique_of_its_own(linear: gtsam.GaussianFactorGraph) -> None:
    order = CholeskyOrder(linear)
    tree = order.apart(linear).eliminateMultifrontal(order.ordering)
    newest = max(
        gtsam.Symbol(key).index() for key in linear.keyVector() if gtsam.Symbol(key).chr() == ord("x")
    )
    clique = tree[X(newest)]
    assert clique.isRoot()
    own = list(clique.conditional().keys())
    assert own[:3] == [X(newest), V(newest), B(newest)]
    assert len(own) == 4


def test_the_batch_smoother_needs_no_qr_for_errors_of_rims(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    class Counted(Marginals):
        def __init__(self, *of: object, **how: object) -> None:
            super().__init__(*of, **how)  # type: ignore[arg-type]
            made.append(self.cholesky)

    monkeypatch.setattr("craternav_fg.estimators.batch.Marginals", Counted)
    found = BatchSmoother().estimate(problem)
    assert made
    assert all(made)
    monkeypatch.setattr("craternav_fg.estimators.batch.MAX_ROUNDING", 0.0)
    expected = BatchSmoother().estimate(problem)
    assert not made[-1]
    sigmas = np.sqrt(np.diagonal(expected.pose_covariance, axis1=1, axis2=2))
    assert (np.abs(found.gP - expected.gP) < 1e-4 * sigmas[:, 3:]).all()
    scale = sigmas[:, :, None] * sigmas[:, None, :]
    assert_allclose(found.pose_covariance / scale, expected.pose_covariance / scale, atol=3e-4)
