"""The online smoother's trees with errors of rims: Cholesky factorisation, and QR where that fails."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from craternav_fg.bench.problems import tracked
from craternav_fg.estimators import incremental, online_session
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.correlated_errors import ERROR_LETTER, SHARED_LETTER
from craternav_fg.estimators.elimination import apart_key, newest_last
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.incremental import FixedLagIsam
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.measurements import MAP_SIZE
from craternav_fg.motion.white_acceleration import white_acceleration
from tests.descents import assert_same_estimates
from tests.estimators.test_incremental import with_other_sensors

REFUSAL = RuntimeError("\nIndeterminate linear system detected while working near variable\n")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return tracked(30, 10)


def run(p: Problem, *, by_qr: bool = False) -> OnlineSession:
    session = OnlineSession(p)
    session._solver._refused = by_qr
    session.run(p)
    assert session._solver.by_cholesky != by_qr
    return session


def poorly_known(p: Problem, factor: float) -> Problem:
    """The same descent with an initial state, and rims, that many times less accurate."""
    initial = replace(p.initial, position_sigma_m=factor * p.initial.position_sigma_m)
    frames = []
    for frame in p.frames:
        rims = frame.rims
        assert rims.correlated is not None
        assert rims.shared is not None
        rims = replace(
            rims,
            covariance=factor**2 * rims.covariance,
            correlated=factor * rims.correlated,
            shared=factor * rims.shared,
        )
        frames.append(replace(frame, rims=rims))
    return replace(p, initial=initial, frames=frames)


@pytest.mark.parametrize("case", ["usual", "poorly known", "long gap"])
def test_covariances_keep_their_digits(case: str, problem: Problem) -> None:
    p = problem
    if case == "poorly known":
        p = poorly_known(p, 30.0)
    elif case == "long gap":
        # Five minutes: the position is known to 10 m before, to a kilometre after.
        p = tracked(90, 10)
        p = replace(p, frames=[*p.frames[:8], *p.frames[82:]])
    assert_same_estimates(run(p).filtered(), run(p, by_qr=True).filtered(), 1e-3)


def test_beside_other_sensors_and_tracked_points(tmp_path: Path) -> None:
    altimeter = {"rate_hz": 0.5, "bias_sigma_m": 20.0}
    p = with_other_sensors(tmp_path, {"features": {"simulation": {"count": 30}}, "altimeter": altimeter})
    frames = []
    for frame in p.frames:
        A = 0.9 * np.linalg.cholesky(frame.rims.covariance)
        of_map = np.concatenate([0.3 * A, np.zeros((len(A), 5, MAP_SIZE - 5))], axis=2)
        frames.append(replace(frame, rims=replace(frame.rims, correlated=A, of_map=of_map)))
    p = replace(p, frames=frames)
    assert p.features is not None
    assert p.sensors
    assert_same_estimates(run(p).filtered(), run(p, by_qr=True).filtered(), 1e-3)


def test_an_accelerometer_that_ties_states_too_stiffly_is_left_to_qr(problem: Problem) -> None:
    noise = replace(problem.imu_noise, accelerometer_density_m_s2_sqrt_hz=1e-7)
    session = OnlineSession(replace(problem, imu_noise=noise))
    session.run(problem)
    assert not session._solver.by_cholesky


def test_a_fixed_lag_and_a_motion_model_are_left_to_qr(problem: Problem) -> None:
    """GTSAM orders the first by itself; how stiffly the second ties states is not known."""
    solver = FixedLagIsam(30.0)
    OnlineSession(problem, solver=solver).run(problem)
    assert not solver.by_cholesky
    model = replace(problem, motion=white_acceleration(0.01))
    session = OnlineSession(model)
    session.run(model)
    assert session._errors is not None
    assert not session._solver.by_cholesky


def test_a_tree_without_errors_of_rims_has_neither_cholesky_nor_more_variables(problem: Problem) -> None:
    session = OnlineSession(problem, GraphOptions(rim_errors=None))
    session.run(problem)
    assert not session._solver.by_cholesky
    assert session._solver.trees == 1
    values = session.smoothed_values()
    assert values.size() == session._solver.tree.getLinearizationPoint().size()
    assert {chr(gtsam.Symbol(key).chr()) for key in values.keys()} == set("xvb")  # noqa: SIM118


def refuse(session: OnlineSession, chosen: Callable[[int, Sequence[int]], bool]) -> list[int]:
    """Let GTSAM refuse the first update that is chosen by its number and dropped slots, half done."""
    apply, refused = session._solver._apply, []
    numbers = itertools.count()

    def refusing(
        graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        apply(graph, values, time_s, drop)
        number = next(numbers)
        if not refused and chosen(number, drop):
            refused.append(number)
            raise REFUSAL

    session._solver._apply = refusing  # type: ignore[method-assign]
    return refused


@pytest.mark.parametrize("at", [0, 5])
def test_goes_on_by_qr_where_an_update_is_refused(at: int, problem: Problem) -> None:
    session = OnlineSession(problem)
    refused = refuse(session, lambda number, _: number == at)
    session.run(problem)
    assert refused == [at]
    assert not session._solver.by_cholesky
    assert_same_estimates(session.filtered(), run(problem).filtered(), 1e-3)


def test_factors_are_dropped_once_where_their_replacement_is_refused(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slots of a tree are void in the one that follows it."""
    monkeypatch.setattr(online_session, "MIDPOINT_TOLERANCE_M", 0.01)
    monkeypatch.setattr(online_session, "GRAVITY_SHIFT_SIGMAS", 0.0)
    expected = run(problem)
    session = OnlineSession(problem)
    refused = refuse(session, lambda _, drop: len(drop) > 0)
    session.run(problem)
    assert refused
    assert_same_estimates(session.filtered(), expected.filtered(), 1e-3)
    factors = session._solver.tree.getFactorsUnsafe()
    intervals = [
        factors.at(slot)
        for slot in range(factors.size())
        if factors.exists(slot) and isinstance(factors.at(slot), gtsam.CombinedImuFactor)
    ]
    assert len(intervals) == session.frame_state_indices[-1]


@pytest.mark.parametrize("error", [REFUSAL, RuntimeError("a factor raised")])
@pytest.mark.parametrize("at", [0, 20])
def test_no_slot_of_a_tree_is_used_in_the_one_that_follows_it(
    at: int, error: RuntimeError, problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where that is built between a frame's update and the change of its gravity."""
    monkeypatch.setattr(online_session, "MIDPOINT_TOLERANCE_M", 0.01)
    monkeypatch.setattr(online_session, "GRAVITY_SHIFT_SIGMAS", 0.0)
    monkeypatch.setattr(online_session, "SETTLED_POSITION_M", 0.0)
    monkeypatch.setattr(online_session, "SETTLED_ALTITUDE_SHARE", 0.0)
    expected = run(problem)
    session = OnlineSession(problem)
    session.begin(problem.frames[0], problem.start)
    apply, repeated = session._solver._apply, itertools.count()

    def failing(
        graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        apply(graph, values, time_s, drop)
        # A solution that is repeated has no new factors.
        if not graph.size() and next(repeated) == at:
            raise error

    session._solver._apply = failing  # type: ignore[method-assign]
    for frame in problem.frames[1:]:
        session.update(frame)
    assert next(repeated) > at
    factors = session._solver.tree.getFactorsUnsafe()
    assert all(X(one.index) in factors.at(one.slot).keys() for one in session._intervals)  # noqa: SIM118
    assert_same_estimates(session.filtered(), expected.filtered(), 1e-3)


@pytest.mark.parametrize("why", ["refused", "digits"])
def test_goes_on_by_qr_where_covariances_fail(
    why: str, problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = run(problem).filtered()
    if why == "digits":
        monkeypatch.setattr(incremental, "MAX_ROUNDING", 1e-12)
    else:
        joint, calls = gtsam.ISAM2.jointMarginalCovariance, []

        def refusing(tree: gtsam.ISAM2, keys: Sequence[int]) -> gtsam.JointMarginal:
            calls.append(keys)
            if len(calls) == 4:
                raise REFUSAL
            return joint(tree, keys)

        monkeypatch.setattr(gtsam.ISAM2, "jointMarginalCovariance", refusing)
    session = OnlineSession(problem)
    session.run(problem)
    assert not session._solver.by_cholesky
    assert_same_estimates(session.filtered(), expected, 1e-3)


def test_newest_state_and_the_errors_it_sees_are_eliminated_last() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    r, s = (gtsam.symbol(letter, 4) for letter in (ERROR_LETTER, SHARED_LETTER))
    bias, (v, b) = gtsam.symbol("1", 0), (gtsam.symbol(letter, 8) for letter in "vb")
    unit = gtsam.noiseModel.Unit.Create(6)
    for n in (7, 8):
        values.insert(X(n), gtsam.Pose3())
        graph.push_back(gtsam.PriorFactorPose3(X(n), gtsam.Pose3(), unit))
    values.insert(v, np.zeros(3))
    values.insert(b, np.zeros(6))
    for pose, error in ((X(7), gtsam.symbol(ERROR_LETTER, 2)), (X(8), r), (X(8), s), (X(8), bias)):
        graph.push_back(linear_factor(pose, error, 6))
    # Nothing ties the pose to the velocity.
    assert newest_last(graph, values) == (graph, values, None)
    graph.push_back(linear_factor(X(8), v, 3))
    factors = graph.size()
    more, added, order = newest_last(graph, values)
    assert order is not None
    apart = apart_key(values)
    assert (order.update.size(), order.later.size()) == (7, 5)
    assert [order.update.at(key) for key in (r, s, X(8))] == [1, 1, 2]
    assert [order.update.at(key) for key in (v, b, bias, apart)] == [3] * 4
    assert [order.later.at(key) for key in (X(8), v, b, bias, apart)] == [1, 2, 2, 2, 2]
    # What the caller gave stays as it was.
    assert (graph.size(), values.size()) == (factors, 4)
    assert (more.size(), added.size()) == (factors + 1, 5)
    assert newest_last(graph, gtsam.Values())[2] is None


def linear_factor(pose: int, other: int, size: int) -> gtsam.LinearContainerFactor:
    """Tie a variable at zero to a pose."""
    unit = gtsam.noiseModel.Unit.Create(6)
    linear = gtsam.JacobianFactor(pose, np.eye(6), other, np.eye(6, size), np.zeros(6), unit)
    at = gtsam.Values()
    at.insert(pose, gtsam.Pose3())
    at.insert(other, np.zeros(size))
    return gtsam.LinearContainerFactor(linear, at)


def test_numbers_of_groups_are_below_that_of_the_variables_in_order(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else GTSAM writes beyond its arrays: in the smallest updates, the newest state alone is ordered."""
    monkeypatch.setattr(online_session, "SETTLED_POSITION_M", 1e-3)
    monkeypatch.setattr(online_session, "SETTLED_ALTITUDE_SHARE", 0.0)
    smallest: dict[bool, int] = {}
    update = gtsam.ISAM2.update

    def watched(
        tree: gtsam.ISAM2,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        drop: object,
        order: object,
    ) -> gtsam.ISAM2Result:
        done = update(tree, graph, values, drop, order)
        if isinstance(order, gtsam.KeyGroupMap):
            new, count = bool(values.size()), done.getVariablesReeliminated()
            # None where nothing has moved.
            smallest[new] = min(smallest.get(new, 99), count or 99)
        return done

    monkeypatch.setattr(gtsam.ISAM2, "update", watched)
    OnlineSession(problem).run(problem)
    assert smallest[True] > 3
    assert smallest[False] > 2
