"""Rims, sun tilt, IMU and sensors by one interface, which says what the factors say."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from craternav_fg.ellipse import points_on
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.ekf.filter import ekf, ekf_paper
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, add_frame
from craternav_fg.estimators.instruments import CAMERA_AND_IMU, Rims, Sun, instruments
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.evaluation.innovations import innovations
from craternav_fg.measurements import ArcSet, RimSet
from factors.custom import Loss
from factors.kernels import robust
from factors.kernels.conic import project_rims
from tests import descents


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    case = descents.scenario(duration_s=20.0, sensors={"altimeter": {"rate_hz": 0.5}})
    return descents.problem(tmp_path_factory.mktemp("d"), case, 0)[0]


@pytest.fixture(scope="module")
def predicted(problem: Problem) -> FilterState:
    """At the fourth frame, from those before."""
    before, frame = problem.frames[2:4]
    return filter_state.propagate(ekf().states(problem)[2], problem, before.stamp_ns, frame.stamp_ns)


def test_rims_and_sun_compare_what_their_factors_add(problem: Problem, predicted: FilterState) -> None:
    frame = problem.frames[3]
    assert len(frame.rims) > 2
    rows = [row for one in (Rims(), Sun()) for row in one.compare(predicted, frame, problem)]
    assert len(rows) == len(frame.rims) + 1
    A, r = np.concatenate([row.A for row in rows]), np.concatenate([row.residual for row in rows])
    graph, values = FactorGraph(), gtsam.Values()
    values.insert(X(0), gtsam.Pose3(predicted.gTb))
    weighted = with_predicted_covariances(frame, predicted.gTb, problem.camera, problem.catalog)
    add_frame(graph, problem, GraphOptions(loss=Loss(robust.NONE)), X(0), weighted)
    J, b = graph.linearize(values).jacobian()
    # The graph's step is in b, the filter's in g.
    J[:, 3:] = J[:, 3:] @ predicted.gTb[:3, :3].T
    steps = np.sqrt(np.diag(predicted.covariance))[:6]
    information, expected = (np.outer(steps, steps) * (M.T @ M) for M in (A, J))
    np.testing.assert_allclose(information, expected, atol=1e-6 * np.abs(expected).max())
    vector, expected = steps * (A.T @ r), steps * (J.T @ b)
    np.testing.assert_allclose(vector, expected, atol=1e-6 * np.abs(expected).max())


def test_each_gives_its_innovations_and_can_be_left_out(problem: Problem, predicted: FilterState) -> None:
    frame = problem.frames[3]
    found = {one.name: one.nis(predicted, frame, problem) for one in instruments(problem)}
    sizes = {name: [size for _, size in nis] for name, nis in found.items()}
    assert sizes == {"rims": [5] * len(frame.rims), "sun": [1], "imu": [6], "altimeter": [1]}
    assert all(0.0 < nis < 60.0 for every in found.values() for nis, _ in every)
    for one in CAMERA_AND_IMU[:2]:
        rest = one.left_out(frame)
        assert one.nis(predicted, rest, problem) == []
        assert sum(len(other.nis(predicted, rest, problem)) for other in CAMERA_AND_IMU) > 0


def test_an_instrument_without_data_says_nothing(problem: Problem) -> None:
    bare = [replace(frame, sun=None) for frame in problem.frames]
    without = replace(problem, frames=bare, sensors=())
    assert set(innovations(without, ekf().states(without)).sensor) == {"rims", "imu"}


def test_predictions_that_a_filter_kept_are_those_of_its_states(problem: Problem) -> None:
    run = ekf().run(problem)
    assert run.predictions is not None
    assert len(run.predictions) == len(problem.frames) - problem.start.frame - 1
    kept, made = (innovations(problem, run.states, one) for one in (run.predictions, None))
    assert kept.sensor == made.sensor
    np.testing.assert_allclose(kept.nis, made.nis, rtol=1e-9)
    # What the paper publishes is not what it propagates.
    assert ekf_paper().run(problem).predictions is None


def arcs_of(craters, charts, sizes, rng, off=0.0, noise=1e-3, shared=None):
    """Points on a quarter of each rim, displaced outwards."""
    points = []
    for chart, size in zip(charts, sizes, strict=True):
        rim = points_on(chart[None], 360)[0]
        chosen = rim[rng.integers(0, 90, size)]
        outward = (chosen - chart[:2]) / np.linalg.norm(chosen - chart[:2], axis=1, keepdims=True)
        points.append(chosen + (off + noise * rng.standard_normal((size, 1))) * outward)
    sigmas = tuple(np.full(size, noise) for size in sizes)
    return ArcSet(craters, tuple(points), sigmas, shared)


def test_innovations_of_rims_and_arcs_keep_their_order(problem: Problem, predicted: FilterState) -> None:
    """Those of one shape are whitened at once, and each is what it is alone."""
    frame = problem.frames[3]
    rims = frame.rims.take(np.arange(3))
    arcs = arcs_of(rims.craters, rims.chart, (9, 7, 9), np.random.default_rng(0))
    both = Rims().nis(predicted, replace(frame, arcs=arcs), problem)
    assert [size for _, size in both] == [5] * len(frame.rims) + [1, 1, 1]
    alone = Rims().nis(predicted, frame, problem)
    for k in range(3):
        one = replace(frame, rims=RimSet.empty(), arcs=arcs.take(np.array([k])))
        alone += Rims().nis(predicted, one, problem)
    np.testing.assert_allclose([nis for nis, _ in both], [nis for nis, _ in alone], rtol=1e-9)


def test_the_innovation_of_an_arc_scatters_as_its_shared_error_does(
    problem: Problem, predicted: FilterState
) -> None:
    """Points that err together are not so many measurements: where the pose is known the mean NIS is one."""
    frame = problem.frames[3]
    craters, catalog = frame.rims.craters[:1], problem.catalog
    charts = project_rims(predicted.gTb, problem.camera.bTc, catalog.centres[craters], catalog.axes[craters])[
        0
    ]
    known = replace(predicted, covariance=1e-12 * predicted.covariance)
    rng = np.random.default_rng(1)
    nis = []
    for _ in range(300):
        shared = 5e-4
        off = shared * rng.standard_normal()
        arcs = arcs_of(craters, charts, (40,), rng, off, 2e-4, np.array([shared]))
        nis += [d2 for d2, _ in Rims().nis(known, replace(frame, rims=RimSet.empty(), arcs=arcs), problem)]
    assert np.mean(nis) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / 300))
