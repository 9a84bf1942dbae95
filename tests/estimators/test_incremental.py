"""Roll-back after a failed update, the fixed lag, and IMU factors built anew after a large correction."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, V, X
from numpy.testing import assert_allclose
from scipy.stats import chi2

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import batch, online_session
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.correlated_errors import RimErrorOptions
from craternav_fg.estimators.filter_state import POSE
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, ImuInterval, add_frame
from craternav_fg.estimators.incremental import FixedLagIsam, Isam
from craternav_fg.estimators.initial_values import initial_values
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import RimSet
from craternav_fg.trajectory import Trajectory
from factors.custom import pose_factor
from tests.descents import problem, scenario


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    """Descents of 40 s, 21 frames, from the paper's initial errors."""
    folder = tmp_path_factory.mktemp("incremental")
    return [problem(folder, scenario(duration_s=40.0), trial) for trial in range(6)]


def spoilt_factor(key: int) -> gtsam.CustomFactor:
    """Return a factor that cannot be evaluated."""
    return pose_factor(key, 3, lambda gTb, bTc, linearise, e, J: e.fill(np.nan), np.eye(4))


def step(solver: Isam, number: int, *, bad: bool = False, drop: Sequence[int] = ()) -> list[int]:
    """Add a pose, a metre on from the last, and on demand a factor that cannot be evaluated."""
    graph = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    model = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    metre = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0]))
    if number == 0:
        graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), model))
    else:
        graph.push_back(gtsam.BetweenFactorPose3(X(number - 1), X(number), metre, model))
    values.insert(X(number), gtsam.Pose3(gtsam.Rot3(), np.array([number + 0.3, 0.0, 0.0])))
    if bad:
        graph.push_back(spoilt_factor(X(number)))
    return solver.update(graph, values, float(number), drop)


@pytest.mark.parametrize("make", [Isam, lambda: FixedLagIsam(3.5)], ids=["all", "lag"])
def test_failed_update_is_taken_back(make: Callable[[], Isam]) -> None:
    solver = make()
    for number in range(5):
        step(solver, number)
    held = [i for i in range(5) if solver.tree.valueExists(X(i))]
    before = {i: solver.tree.marginalCovariance(X(i)) for i in held}
    with pytest.raises(EstimationError, match=r"taken back: .*x5: residual or Jacobian is not finite"):
        step(solver, 5, bad=True)
    assert [i for i in range(6) if solver.tree.valueExists(X(i))] == held
    for i in held:
        assert_allclose(solver.tree.calculateEstimatePose3(X(i)).translation(), [i, 0, 0], atol=1e-6)
        assert_allclose(solver.tree.marginalCovariance(X(i)), before[i], rtol=1e-6, atol=1e-9)
    for number in (5, 6):
        step(solver, number)
    assert_allclose(solver.tree.calculateEstimatePose3(X(6)).translation(), [6, 0, 0], atol=1e-6)


def test_a_replacement_that_fails_leaves_the_replaced() -> None:
    solver = Isam()
    step(solver, 0)
    slots = step(solver, 1)
    before = solver.tree.marginalCovariance(X(1))
    with pytest.raises(EstimationError, match="taken back"):
        step(solver, 2, bad=True, drop=slots)
    assert_allclose(solver.tree.marginalCovariance(X(1)), before, rtol=1e-6)


@pytest.mark.parametrize("make", [Isam, lambda: FixedLagIsam(3.5)], ids=["all", "lag"])
def test_first_update_that_fails_leaves_an_empty_solver(make: Callable[[], Isam]) -> None:
    solver = make()
    with pytest.raises(EstimationError, match="taken back"):
        step(solver, 0, bad=True)
    step(solver, 0)
    assert_allclose(solver.tree.calculateEstimatePose3(X(0)).translation(), 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", ["rims", "tracked points", "errors of rims"])
def test_session_goes_on_after_a_frame_that_failed(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frame is lost, nothing else: the end is that of a session that never saw it."""
    tracks = {"features": {"simulation": {"count": 30}}} if kind == "tracked points" else {}
    p = with_other_sensors(tmp_path, tracks)
    if kind == "errors of rims":
        roots = [0.9 * np.linalg.cholesky(frame.rims.covariance) for frame in p.frames]
        rims = [replace(frame.rims, correlated=A) for frame, A in zip(p.frames, roots, strict=True)]
        p = replace(p, frames=[replace(frame, rims=r) for frame, r in zip(p.frames, rims, strict=True)])

    def run(lost: int | None) -> OnlineSession:
        # In so small steps each frame begins variables of errors.
        session = OnlineSession(p, GraphOptions(rim_errors=RimErrorOptions(step_shape_change=1e-3)))
        session.begin(p.frames[0], p.start)
        for k, frame in enumerate(p.frames[1:8], 1):
            if k == lost:
                with monkeypatch.context() as patch:
                    patch.setattr("craternav_fg.estimators.online_session.add_frame", spoilt)
                    with pytest.raises(EstimationError, match="taken back"):
                        session.update(frame)
            elif k != 4:
                session.update(frame)
        return session

    def spoilt(graph: FactorGraph, *arguments: Any, **named: Any) -> None:
        add_frame(graph, *arguments, **named)
        graph.push_back(spoilt_factor(arguments[2]))

    lost, never = run(4), run(None)
    assert lost.frame_state_indices == never.frame_state_indices
    sigma = np.sqrt(np.diag(never.state.covariance)[3:6])
    assert (np.abs(lost.state.gTb[:3, 3] - never.state.gTb[:3, 3]) < 0.05 * sigma).all()
    W = np.linalg.inv(np.linalg.cholesky(never.state.covariance[POSE, POSE]))
    assert_allclose(W @ lost.state.covariance[POSE, POSE] @ W.T, np.eye(6), atol=1e-3)


@pytest.mark.parametrize("failure", [RuntimeError, IndexError, KeyboardInterrupt])
@pytest.mark.parametrize("step", ["newest_state", "_move_gravity", "_altitude_m"])
def test_a_session_without_a_state_has_ended(
    trials: list[tuple[Problem, Trajectory]],
    monkeypatch: pytest.MonkeyPatch,
    step: str,
    failure: type[BaseException],
) -> None:
    """The solver holds the frame's variables, which the next frame would add again."""
    p, _ = trials[0]
    session = OnlineSession(p)
    session.begin(p.frames[0], p.start)

    def fails(*_: object) -> None:
        raise failure("Indeterminant linear system.\nMore of it.")

    with monkeypatch.context() as patch:
        patch.setattr(online_session if hasattr(online_session, step) else session, step, fails)
        patch.setattr(session, "_relinearise_m", lambda _: 1.0)
        patch.setattr("craternav_fg.estimators.online_session.MIDPOINT_TOLERANCE_M", -1.0)
        patch.setattr("craternav_fg.estimators.online_session.GRAVITY_SHIFT_SIGMAS", -1.0)
        told = f"ended: no state at the frame of {p.frames[1].stamp_ns} ns"
        end, message = (EstimationError, told) if issubclass(failure, Exception) else (failure, "More of it")
        with pytest.raises(end, match=message):
            session.update(p.frames[1])
    for call in (
        lambda: session.update(p.frames[1]),
        lambda: session.update(p.frames[2]),
        lambda: session.predict(p.frames[2].stamp_ns),
    ):
        with pytest.raises(EstimationError, match=r"the session has ended.*Indeterminant linear system\.$"):
            call()
    assert len(session.states) == 1


def test_a_variable_given_twice_is_refused_and_nothing_lost() -> None:
    solver = Isam()
    for number in range(3):
        step(solver, number)
    with pytest.raises(EstimationError, match="x1 is in the solver already"):
        step(solver, 1)
    with pytest.raises(EstimationError, match="slot 77 holds no factor"):
        step(solver, 3, drop=[77])
    assert_allclose(solver.tree.calculateEstimatePose3(X(2)).translation(), [2, 0, 0], atol=1e-6)


def test_slots_stay_until_the_next_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """A replacement in a tree that is due to be replaced must hit the factor it was meant for."""
    monkeypatch.setattr("craternav_fg.estimators.incremental.MAX_VARIABLES", 4)
    monkeypatch.setattr("craternav_fg.estimators.incremental.OVERLAP_VARIABLES", 2)
    monkeypatch.setattr("craternav_fg.estimators.tree_snapshot.SNAPSHOT_ATTITUDE_RAD", 10.0)
    solver = Isam()
    for number in range(5):
        slots = step(solver, number)
    trees = solver.trees
    solver.again()
    metre = gtsam.Pose3(gtsam.Rot3(), np.array([2.0, 0.0, 0.0]))
    graph = gtsam.NonlinearFactorGraph()
    model = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    graph.push_back(gtsam.BetweenFactorPose3(X(3), X(4), metre, model))
    solver.update(graph, gtsam.Values(), 4.0, drop=slots)
    assert solver.trees == trees
    assert_allclose(solver.tree.calculateEstimatePose3(X(4)).translation(), [5, 0, 0], atol=1e-6)
    step(solver, 5)
    assert solver.trees == trees + 1


@pytest.mark.parametrize("make", [Isam, lambda: FixedLagIsam(30.0)], ids=["all", "lag"])
def test_callbacks_get_the_held_values(make: Callable[[], Isam]) -> None:
    """A copy of all values for every callback would make the cost of a frame grow."""
    solver = make()
    step(solver, 0)
    seen = []

    def look(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> np.ndarray:
        seen.append(values is solver._hold)
        if H is not None:
            H[0] = np.eye(6)
        return np.zeros(6)

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(6), [X(0)], look))
    solver.update(graph, gtsam.Values(), 0.0)
    assert seen
    assert all(seen)


def test_mounting_beside_the_states() -> None:
    """A variable of all states is relinearised by its own thresholds, and is never handed on."""
    solver = Isam()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    model = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    graph.push_back(gtsam.PriorFactorPose3(C(0), gtsam.Pose3(), model))
    values.insert(C(0), gtsam.Pose3())
    solver.update(graph, values, 0.0)
    for number in range(4):
        step(solver, number)
    assert solver.tree.valueExists(C(0))
    assert solver.tree.valueExists(X(3))


@pytest.mark.parametrize("first", [10, 14, 15, 16, 20])
def test_an_unsettled_state_is_not_handed_on(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    """The first rims come late, about when the tree is full: it must not keep their first linearisation."""
    monkeypatch.setattr("craternav_fg.estimators.incremental.MAX_VARIABLES", 90)
    monkeypatch.setattr("craternav_fg.estimators.incremental.OVERLAP_VARIABLES", 15)
    ends = []
    for p, truth in trials:
        frames = [replace(f, rims=RimSet.empty(), sun=None) for f in p.frames[:first]]
        blind = replace(p, frames=frames + list(p.frames[first:]))
        start = replace(p.start, gTb=p.initial.gTb)
        session = OnlineSession(blind)
        session.begin(blind.frames[0], start)
        for frame in blind.frames[1:]:
            session.update(frame)
        estimate = session.filtered()
        assert estimate.pose_covariance is not None
        ends.append(nees(errors(estimate, truth).pose, estimate.pose_covariance)[-1])
    n = len(ends)
    assert np.mean(ends) < chi2.ppf(0.9999, 6 * n) / n


def test_a_tree_that_grew_hands_on_what_it_knows(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    p, _ = trials[0]
    whole = OnlineSmoother().run(p)
    monkeypatch.setattr("craternav_fg.estimators.incremental.MAX_VARIABLES", 45)
    monkeypatch.setattr("craternav_fg.estimators.incremental.OVERLAP_VARIABLES", 15)
    handed_on = OnlineSmoother().run(p)
    expected, actual = whole.filtered(), handed_on.filtered()
    assert expected.pose_covariance is not None
    assert actual.pose_covariance is not None
    sigma = np.sqrt(np.einsum("nii->ni", expected.pose_covariance)[:, 3:])
    assert (np.abs(actual.gP - expected.gP) < 0.1 * sigma).all()
    W = np.linalg.inv(np.linalg.cholesky(expected.pose_covariance[-1]))
    assert_allclose(W @ actual.pose_covariance[-1] @ W.T, np.eye(6), atol=0.02)
    every, new = (session.smoothed_values() for session in (whole, handed_on))
    assert sorted(every.keys()) == sorted(new.keys())
    assert not handed_on._solver.tree.valueExists(X(0))


def with_other_sensors(folder: Path, sensors: dict[str, Any]) -> Problem:
    """Return a descent of 40 s with further sensors."""
    return problem(folder, scenario(duration_s=40.0, sensors=sensors), 0)[0]


def test_a_tree_that_grew_hands_on_the_biases_of_sensors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bias of a kilometre that the rims have told to a few metres is not asked for again."""
    p = with_other_sensors(tmp_path, {"altimeter": {"rate_hz": 0.5, "bias_sigma_m": 500.0}})
    whole = OnlineSmoother().run(p).filtered()
    monkeypatch.setattr("craternav_fg.estimators.incremental.MAX_VARIABLES", 45)
    monkeypatch.setattr("craternav_fg.estimators.incremental.OVERLAP_VARIABLES", 15)
    session = OnlineSmoother().run(p)
    assert session._solver.trees > 2
    handed_on = session.filtered()
    assert whole.pose_covariance is not None
    assert handed_on.pose_covariance is not None
    W = np.linalg.inv(np.linalg.cholesky(whole.pose_covariance[-1]))
    assert_allclose(W @ handed_on.pose_covariance[-1] @ W.T, np.eye(6), atol=0.02)
    sigma = np.sqrt(np.einsum("nii->ni", whole.pose_covariance)[:, 3:])
    assert (np.abs(handed_on.gP - whole.gP) < 0.1 * sigma).all()


def test_a_tree_that_grew_goes_on_with_tracked_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    p = with_other_sensors(tmp_path, {"features": {"simulation": {"count": 30, "loss_share": 0.2}}})
    whole = OnlineSmoother().run(p)
    monkeypatch.setattr("craternav_fg.estimators.incremental.MAX_VARIABLES", 60)
    monkeypatch.setattr("craternav_fg.estimators.incremental.OVERLAP_VARIABLES", 24)
    handed_on = OnlineSmoother().run(p)
    assert handed_on._solver.trees > 2
    points = [
        [key for key in session._solver.tree.getLinearizationPoint().keys() if key >> 56 == ord("l")]  # noqa: SIM118
        for session in (whole, handed_on)
    ]
    assert 0 < len(points[1]) < 0.7 * len(points[0])
    sigmas = [np.sqrt(np.diag(session.state.covariance)[3:6]) for session in (whole, handed_on)]
    assert (sigmas[1] < 1.2 * sigmas[0]).all()
    assert (np.abs(handed_on.state.gTb[:3, 3] - whole.state.gTb[:3, 3]) < sigmas[0]).all()


def test_a_lag_beyond_the_descent_is_the_online_smoother(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[0]
    session = OnlineSession(p, solver=Isam())
    session.begin(p.frames[0], p.start)
    for frame in p.frames[1:]:
        session.update(frame)
    whole, online = FixedLagSmoother(lag_s=1e3).estimate(p), session.filtered()
    assert online.pose_covariance is not None
    sigma = np.sqrt(np.einsum("nii->ni", online.pose_covariance)[:, 3:])
    assert (np.abs(whole.gP - online.gP) < 0.05 * sigma).all()


def test_fixed_lag_is_consistent_and_forgets(trials: list[tuple[Problem, Trajectory]]) -> None:
    ends = []
    for p, truth in trials:
        estimate = FixedLagSmoother(lag_s=15.0).estimate(p)
        assert estimate.pose_covariance is not None
        ends.append(nees(errors(estimate, truth).pose, estimate.pose_covariance)[-1])
    n = len(ends)
    assert chi2.ppf(0.001, 6 * n) / n < np.mean(ends) < chi2.ppf(0.999, 6 * n) / n
    p, _ = trials[0]
    solver = FixedLagIsam(15.0)
    session = OnlineSession(p, solver=solver)
    session.begin(p.frames[0], p.start)
    for frame in p.frames[1:]:
        session.update(frame)
    assert not solver.tree.valueExists(X(0))
    assert solver.tree.valueExists(X(session.frame_state_indices[-1]))


def test_a_lag_must_be_positive() -> None:
    with pytest.raises(EstimationError, match="lag_s"):
        FixedLagIsam(0.0)


def test_gravity_is_taken_anew_where_a_correction_moved_the_states(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A start 20 km off puts gravity at wrong places: left there it keeps that error."""
    p, _ = trials[0]
    expected = BatchSmoother().estimate(p)

    def displaced(*arguments: Any) -> tuple[gtsam.Values, list[int]]:
        values, numbers = initial_values(*arguments)
        for number in range(numbers[-1] + 1):
            pose = values.atPose3(X(number))
            values.update(X(number), gtsam.Pose3(pose.rotation(), 1.012 * pose.translation()))
        return values, numbers

    monkeypatch.setattr(batch, "initial_values", displaced)
    again = BatchSmoother().estimate(p)
    monkeypatch.setattr(ImuInterval, "with_gravity_at", lambda self, body, midpoint: self)
    once = BatchSmoother().estimate(p)
    off = [np.linalg.norm(t.gP - expected.gP, axis=1).max() for t in (again, once)]
    assert off[0] < 0.1
    assert off[1] > 1.0


@pytest.mark.parametrize("lag_s", [None, 60.0])
def test_online_gravity_follows_a_correction(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch, lag_s: float | None
) -> None:
    """Linearised 20 km from the truth and measured late: the first seconds' gravity was taken too high."""
    p, _ = trials[0]
    frames = [replace(f, rims=RimSet.empty(), sun=None) for f in p.frames[:10]] + list(p.frames[10:])
    expected = BatchSmoother().estimate(replace(p, frames=frames))
    start = replace(p.start, gTb=p.start.gTb.copy())
    start.gTb[:3, 3] *= 1.012

    def end() -> float:
        session = OnlineSession(p, solver=Isam() if lag_s is None else FixedLagIsam(lag_s))
        session.begin(frames[0], start)
        for frame in frames[1:]:
            session.update(frame)
        velocity = session.smoothed_values().atVector(V(0))
        return float(np.linalg.norm(velocity - expected.gV[0]))

    follows = end()
    monkeypatch.setattr("craternav_fg.estimators.online_session.MIDPOINT_TOLERANCE_M", np.inf)
    stays = end()
    assert follows < 0.1 * stays
