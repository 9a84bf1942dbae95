"""Frames evaluated at once: the same as each of its own, and only for the values that were evaluated."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, X
from numpy.testing import assert_allclose

from craternav_fg.estimators.graph import FactorGraph
from factors import validation
from factors.conic_shape import conic_shape_factor
from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels import packed, robust
from tests.factors.conftest import make_view

LOSS = Loss(robust.HUBER, 1.5)


def frames(seeds, order, together):
    """Graph of frames with different numbers of rims, and values: poses near theirs, and others."""
    graph = FactorGraph()
    values = gtsam.Values()
    values.insert(M(0), gtsam.Pose3(gtsam.Rot3.Rx(1.0), np.ones(3)))
    for i in seeds:
        pose = gtsam.Pose3(make_view(i).gTb).retract(np.array([1e-3, -2e-3, 3e-3, 20.0, -30.0, 40.0]))
        values.insert(X(i), pose)
        values.insert(X(100 + i), pose.retract(np.full(6, 0.1)))
    for i in order:
        add(graph, i, together)
    return graph, values


def add(graph, i, together):
    view = make_view(i, n=1 + i)
    c = view.catalog
    factor = conic_shape_factor(
        X(i), view.bTc, c.centres, c.axes, view.charts, view.covariances, LOSS,
        reduced=True, ahead=graph.ahead if together else None,
    )  # fmt: skip
    graph.push_back(factor)


def systems(graph, values):
    linear = graph.linearize(values)
    return [linear.at(k).augmentedJacobian() for k in range(linear.size())]


def same(one, other, values):
    assert_allclose(one.error(values), other.error(values), rtol=1e-12)
    for a, b in zip(systems(one, values), systems(other, values), strict=True):
        assert_allclose(a, b, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize("order", [range(8), (5, 0, 7, 3)])
def test_frames_at_once_are_the_frames_one_by_one(order):
    """In any order, of one to eight rims; with frames that come later, and values that get other poses."""
    graphs = [frames(range(8), order, together)[0] for together in (True, False)]
    values = frames(range(8), order, True)[1]
    same(*graphs, values)
    values.update(X(5), values.atPose3(X(5)).retract(np.full(6, 2e-3)))
    values.insert(X(200), gtsam.Pose3())
    values.insert(M(1), gtsam.Pose3())
    same(*graphs, values)
    for graph, together in zip(graphs, (True, False), strict=True):
        add(graph, 6, together)
    same(*graphs, values)


def test_at_other_values_each_factor_is_evaluated():
    graph, values = frames(range(1, 4), range(1, 4), True)
    graph.linearize(values)
    before = [graph.at(k).error(values) for k in range(3)]
    values.update(X(2), values.atPose3(X(2)).retract(np.full(6, 1e-2)))
    after = [graph.at(k).error(values) for k in range(3)]
    assert after[0] == pytest.approx(before[0], rel=1e-12)
    assert after[1] != pytest.approx(before[1], rel=1e-3)
    # Also where something else of the graph could not be evaluated.
    graph.push_back(gtsam.PriorFactorVector(M(7), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    with pytest.raises((RuntimeError, KeyError, IndexError)):
        graph.linearize(values)
    values.update(X(1), values.atPose3(X(1)).retract(np.full(6, 1e-2)))
    assert graph.at(0).error(values) != pytest.approx(before[0], rel=1e-3)


def test_what_cannot_be_evaluated_is_named():
    graph, values = frames(range(1, 4), range(1, 4), True)
    without = gtsam.Values(values)
    without.erase(X(2))
    with pytest.raises((RuntimeError, KeyError, IndexError), match="x2"):
        graph.linearize(without)
    view = make_view(2, n=3)
    c = view.catalog
    W = validation.whitening("covariances", view.covariances, 3, 5)
    data = packed.pack(view.bTc, c.centres, c.axes, np.full((3, 5), np.nan), W, LOSS.kind, LOSS.scale_sigmas)
    graph.ahead.add(X(2), data)
    for evaluate in (graph.error, graph.linearize):
        with pytest.raises(FactorError, match="factor at x2: residual or Jacobian is not finite"):
            evaluate(values)
    assert graph.ahead.written == 0
