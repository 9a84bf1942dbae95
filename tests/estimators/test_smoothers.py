"""Start, online and batch smoother on simulated descents."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state, registry
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother, build_graph, optimum
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.correlated_errors import RimErrorOptions
from craternav_fg.estimators.ekf.filter import DistributedEkf
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.gnc import GncOptions
from craternav_fg.estimators.graph import GraphOptions, state_stamps
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.optimise import LmOptions, gauss_newton, levenberg_marquardt
from craternav_fg.estimators.registry import ESTIMATORS, estimator, is_retrospective
from craternav_fg.estimators.start import find_start
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.custom import pose_factor
from tests.descents import problem, scenario

TRIALS = 12


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    """Descents of 40 s, 21 frames, from the paper's initial errors."""
    folder = tmp_path_factory.mktemp("trials")
    return [problem(folder, scenario(duration_s=40.0), trial) for trial in range(TRIALS)]


def mean_nees(pairs: list[tuple[Trajectory, Trajectory]], frame: int) -> float:
    values = []
    for estimate, truth in pairs:
        assert estimate.pose_covariance is not None
        values.append(nees(errors(estimate, truth).pose, estimate.pose_covariance)[frame])
    return float(np.mean(values))


def interval(n: int) -> tuple[float, float]:
    """99.8 % interval of the mean of n pose NEES."""
    return float(chi2.ppf(0.001, 6 * n) / n), float(chi2.ppf(0.999, 6 * n) / n)


def test_start_reaches_the_optimum_from_25_deg_and_4_km(tmp_path: Path) -> None:
    """Every start's error is explained by its covariance; none is left in another minimum."""
    case = scenario(duration_s=2.0)
    values = []
    for trial in range(40):
        p, truth = problem(tmp_path, case, trial)
        there = Trajectory(truth.stamps_ns[:1], truth.gTb[:1], truth.gV[:1], truth.bias[:1])
        start = dataclasses.replace(
            there, gTb=p.start.gTb[None], pose_covariance=p.start.pose_covariance[None]
        )
        values.append(nees(errors(start, there).pose, p.start.pose_covariance[None])[0])
    low, high = interval(len(values))
    assert max(values) < chi2.ppf(1 - 1e-6, 6)
    assert low < np.mean(values) < high


def test_start_without_measurements_is_the_prior(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[0]
    start = find_start(p, [FrameMeasurement(p.initial.stamp_ns, RimSet.empty(), None)])
    assert_allclose(start.gTb, p.initial.gTb, atol=1e-6)
    sigmas = np.repeat([p.initial.attitude_sigma_rad, p.initial.position_sigma_m], 3)
    assert_allclose(np.sqrt(np.diag(start.pose_covariance)), sigmas, rtol=1e-6)


def test_online_and_batch_are_consistent(trials: list[tuple[Problem, Trajectory]]) -> None:
    online = [(OnlineSmoother().estimate(p), truth) for p, truth in trials]
    batch = [(BatchSmoother().estimate(p), truth) for p, truth in trials]
    low, high = interval(TRIALS)
    for pairs in (online, batch):
        for frame in (5, 12, 20):
            assert low < mean_nees(pairs, frame) < high
    # Retrospect: at the first frames the batch knows what came later.
    rms = [
        np.sqrt(np.mean([np.sum(errors(*pair).position_m[1] ** 2) for pair in pairs]))
        for pairs in (online, batch)
    ]
    assert rms[1] < 0.8 * rms[0]


def test_a_start_that_leads_astray_is_replaced_by_the_online_smoothers(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Begun above the wrong craters, the optimum contradicts the measurements, or there is none."""
    p, _ = trials[0]
    expected = BatchSmoother().estimate(p)

    def astray(self: DistributedEkf, problem: Problem) -> list[FilterState]:
        states = filter_state.states_to_start(problem)
        turned = states[0].gTb.copy()
        turned[:3, :3] = turned[:3, :3] @ frames.rotation_exp(np.array([0.0, 0.0, 2.5]))
        return [dataclasses.replace(states[0], gTb=turned)] * len(problem.frames)

    monkeypatch.setattr(DistributedEkf, "states", astray)
    found = BatchSmoother().estimate(p)
    assert_allclose(found.gP, expected.gP, atol=0.5)


def test_batch_ends_where_online_ends(trials: list[tuple[Problem, Trajectory]]) -> None:
    """The last online estimate has all data: it is the batch's, up to what iSAM2 leaves unrelinearised."""
    p, _ = trials[0]
    online, batch = OnlineSmoother().estimate(p), BatchSmoother().estimate(p)
    assert online.pose_covariance is not None
    assert batch.pose_covariance is not None
    sigma = np.sqrt(np.diag(batch.pose_covariance[-1]))
    step = np.concatenate(
        [frames.rotation_log(online.gRb[-1].T @ batch.gRb[-1]), online.gP[-1] - batch.gP[-1]]
    )
    assert (np.abs(step) < 0.05 * sigma).all()
    assert_allclose(
        online.pose_covariance[-1], batch.pose_covariance[-1], atol=0.05 * np.outer(sigma, sigma).max()
    )


def test_covariance_is_the_inverse_of_the_dense_information(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[1]
    short = dataclasses.replace(p, frames=p.frames[:3])
    values = OnlineSmoother().run(short).smoothed_values()
    graph = build_graph(short, BatchOptions(), values)
    result = levenberg_marquardt(graph, values)
    found = Marginals(graph, result.values).covariances([int(X(1))])[X(1)]
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
    A, _ = graph.linearize(result.values).jacobian(ordering)
    # Column scaling keeps the inversion of radians beside metres accurate.
    scale = np.linalg.norm(A, axis=0)
    R = np.linalg.qr(A / scale, mode="r")
    inverse = np.linalg.inv(R) / scale[:, None]
    offset = 0
    for i in range(ordering.size()):
        key = ordering.at(i)
        size = {"x": 6, "v": 3, "b": 6}[chr(gtsam.Symbol(key).chr())]
        if key == X(1):
            rows = inverse[offset : offset + size]
            expected = rows @ rows.T
            spread = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
            assert_allclose(found / spread, expected / spread, atol=1e-6)
            return
        offset += size
    pytest.fail("no state 1")


def test_steps_that_shrink_before_a_wall_have_not_converged() -> None:
    def kernel(gTb: np.ndarray, bTc: np.ndarray, linearise: bool, e: np.ndarray, J: np.ndarray) -> None:
        e[:] = 10.0 + gTb[0, 3] if gTb[0, 3] > -0.1 else 1e3
        J[:] = [[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]]

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(pose_factor(X(0), 1, kernel, np.eye(4)))
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e3)))
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3())
    result = levenberg_marquardt(graph, values)
    assert_allclose(result.values.atPose3(X(0)).x(), -0.1, atol=1e-6)
    assert not result.converged


def test_gauss_newton_reaches_what_levenberg_marquardt_does(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[0]
    start = OnlineSmoother().run(p).smoothed_values()
    graph = build_graph(p, BatchOptions(), start)
    ours, reference = gauss_newton(graph, start), levenberg_marquardt(graph, start)
    assert ours.converged
    assert_allclose(ours.error, reference.error, rtol=1e-6)
    lost = gtsam.NonlinearFactorGraph()
    lost.push_back(graph.at(graph.size() - 1))
    assert not gauss_newton(lost, start).converged


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
def test_a_step_that_does_as_predicted_is_the_last(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch, tolerance: float
) -> None:
    """It saves a step that would gain nothing, and leaves less than the tolerance."""
    p, _ = trials[0]
    start = OnlineSmoother().run(p).smoothed_values()
    for n in range(len(p.frames)):
        start.update(X(n), start.atPose3(X(n)).retract(np.array([1e-3, -1e-3, 2e-3, 30.0, -40.0, 50.0])))
    graph = build_graph(p, BatchOptions(), start)
    options = LmOptions(relative_tolerance=tolerance)
    ours = levenberg_marquardt(graph, start, options)
    monkeypatch.setattr("craternav_fg.estimators.optimise.MAX_LAST_SHARE", 0.0)
    best = levenberg_marquardt(graph, start, LmOptions(relative_tolerance=1e-14))
    reference = levenberg_marquardt(graph, start, options)
    assert ours.converged
    assert ours.iterations < reference.iterations
    assert ours.error - best.error < tolerance * best.error


def test_a_step_that_gains_more_than_predicted_is_not_the_last() -> None:
    """Half of the curvature is in the residual's bend, and steps by its slope leave half of the way."""

    def kernel(gTb: np.ndarray, bTc: np.ndarray, linearise: bool, e: np.ndarray, J: np.ndarray) -> None:
        x = gTb[0, 3]
        e[:] = [1.0 - 0.0625 * x * x, 0.5 * x]
        J[:] = 0.0
        J[:, 3] = [-0.125 * x, 0.5]

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(pose_factor(X(0), 2, kernel, np.eye(4)))
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e3)))
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(gtsam.Rot3(), np.array([0.1, 0.0, 0.0])))
    result = levenberg_marquardt(graph, values, LmOptions(relative_tolerance=1e-6))
    assert result.converged
    assert result.error - 0.5 < 1e-6
    assert_allclose(result.contraction, 0.25, rtol=0.02)
    first = levenberg_marquardt(graph, values, LmOptions(relative_tolerance=1e6))
    assert (first.iterations, first.contraction) == (1, 1.0)


def test_a_start_that_sees_no_crater_is_no_result(trials: list[tuple[Problem, Trajectory]]) -> None:
    """Its plateau is flat: the optimiser stops there, which is no convergence."""
    p, _ = trials[0]
    away = OnlineSmoother().run(p).smoothed_values()
    back = gtsam.Pose3(gtsam.Rot3.Rx(np.pi), np.zeros(3))
    for key in away.keys():  # noqa: SIM118 (Values is no mapping)
        if gtsam.Symbol(key).chr() == ord("x"):
            away.update(key, away.atPose3(key).compose(back))
    with pytest.raises(EstimationError, match=r"convergence.*(out of sight|contradict)"):
        optimum(p, BatchOptions(), away)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (lambda: GraphOptions(rims="conic"), "rims: expected one of chart, .*, found 'conic'"),  # type: ignore[arg-type]
        (lambda: GraphOptions(keyframe_s=0.0), "keyframe_s: expected a positive"),
        (lambda: GraphOptions(variance_inflation=0.0), "variance_inflation: expected a positive"),
        (
            lambda: GraphOptions(rims="los", rim_errors=RimErrorOptions(decay_shape_change=0.5)),
            "rim_errors: variables for them need rims='chart', found 'los'",
        ),
        (lambda: BatchOptions(crater_freedom=0.0), "crater_freedom: expected a positive"),
        (lambda: LmOptions(first_damping=0.0), "first_damping: expected a positive"),
        (lambda: LmOptions(max_iterations=0), "max_iterations: expected at least 1"),
        (lambda: GncOptions(inlier_probability=1.5), "inlier_probability: expected"),
        (lambda: GncOptions(growth_factor=1.0), "growth_factor: expected a number above 1"),
    ],
)
def test_options_without_meaning_are_refused(options: Callable[[], object], message: str) -> None:
    with pytest.raises(EstimationError, match=message):
        options()


def test_frames_without_craters_only_widen_the_covariance(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, truth = trials[2]
    blind = [
        FrameMeasurement(f.stamp_ns, RimSet.empty(), None) if k > 8 else f for k, f in enumerate(p.frames)
    ]
    p = dataclasses.replace(p, frames=blind)
    for name in ("online", "ekf", "smoother"):
        estimate, seeing = estimator(name).estimate(p), estimator(name).estimate(trials[2][0])
        assert estimate.pose_covariance is not None
        assert seeing.pose_covariance is not None
        spread, less = (np.trace(t.pose_covariance[:, 3:, 3:], axis1=1, axis2=2) for t in (estimate, seeing))
        assert (spread[12:] > 1.2 * less[12:]).all()
        assert spread[-1] > 3.0 * less[-1]
        assert nees(errors(estimate, truth).pose, estimate.pose_covariance)[-1] < chi2.ppf(1 - 1e-5, 6)


def test_an_own_factor_without_noise_is_refused(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[0]
    fixed = gtsam.noiseModel.Constrained.All(6)

    def exactly(_: Problem, of_frames: Sequence[int]) -> list[gtsam.NonlinearFactor]:
        return [gtsam.PriorFactorPose3(X(of_frames[0]), gtsam.Pose3(p.start.gTb), fixed)]

    with pytest.raises(EstimationError, match="own factor on x0: expected standard deviations above zero"):
        BatchSmoother(own_factors=exactly).estimate(p)


def test_one_wrong_match_does_not_pull_the_smoother(trials: list[tuple[Problem, Trajectory]]) -> None:
    """Two rims of a frame change their craters; the loss per crater holds them at arm's length."""
    p, truth = trials[3]
    frame = p.frames[8]
    swapped = frame.rims.craters.copy()
    swapped[[0, 1]] = swapped[[1, 0]]
    wrong = dataclasses.replace(frame, rims=dataclasses.replace(frame.rims, craters=swapped))
    clean = BatchSmoother().estimate(p)
    pulled = BatchSmoother().estimate(dataclasses.replace(p, frames=[*p.frames[:8], wrong, *p.frames[9:]]))
    assert clean.pose_covariance is not None
    sigma = np.sqrt(np.trace(clean.pose_covariance[8][3:, 3:]))
    assert np.linalg.norm(pulled.gP[8] - clean.gP[8]) < 2.0 * sigma
    assert np.linalg.norm(errors(pulled, truth).position_m[8]) < 5.0 * sigma


def test_session_refuses_a_frame_from_the_past(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[0]
    session = OnlineSession(p)
    session.begin(p.frames[0], p.start)
    with pytest.raises(EstimationError, match="not later"):
        session.update(p.frames[0])


def test_prediction_changes_nothing_and_matches_dead_reckoning(
    trials: list[tuple[Problem, Trajectory]],
) -> None:
    p, _ = trials[0]
    session = OnlineSession(p)
    session.begin(p.frames[0], p.start)
    before = session.state
    predicted = session.predict(p.frames[1].stamp_ns)
    assert session.state is before
    assert np.linalg.norm(predicted.gTb[:3, 3] - before.gTb[:3, 3]) > 10.0
    session.update(FrameMeasurement(p.frames[1].stamp_ns, RimSet.empty(), None))
    assert_allclose(session.state.gTb[:3, 3], predicted.gTb[:3, 3], atol=0.5)
    sigma = np.sqrt(np.diag(predicted.covariance)[:9])
    assert_allclose(np.sqrt(np.diag(session.state.covariance)[:9]), sigma, rtol=0.02)


@pytest.mark.parametrize(
    ("begin", "end", "longest", "expected"),
    [(0, 10, 1.0, [10]), (0, 2_000_000_000, 1.0, [10**9, 2 * 10**9]), (5, 1_500_000_005, 1.0, None)],
)
def test_state_stamps(begin: int, end: int, longest: float, expected: list[int] | None) -> None:
    stamps = state_stamps(begin, end, longest)
    assert stamps[-1] == end
    assert (np.diff([begin, *stamps]) <= longest * 1e9).all()
    if expected is not None:
        assert stamps.tolist() == expected
    else:
        assert len(stamps) == 2


def test_registry_names_what_there_is() -> None:
    assert list(ESTIMATORS) == [
        "smoother",
        "gnc_smoother",
        "self_calibrating_smoother",
        "map_refining_smoother",
        "smoother_eq19",
        "smoother_los",
        "online",
        "online_eq19",
        "online_los",
        "fixed_lag",
        "ekf",
        "ekf_eq19",
        "ekf_los",
        "ekf_paper",
        "centre_smoother",
        "dead_reckoning",
    ]
    for name in ESTIMATORS:
        assert estimator(name).name == name
    with pytest.raises(EstimationError, match=r"unknown estimator 'nobody'.*smoother"):
        estimator("nobody")


@pytest.mark.parametrize(
    ("former", "present"),
    [("calibrating_smoother", "self_calibrating_smoother"), ("mapping_smoother", "map_refining_smoother")],
)
def test_former_names_are_accepted_with_a_warning(former: str, present: str) -> None:
    with pytest.warns(FutureWarning, match=f"'{former}' is now called '{present}'") as told:
        assert estimator(former).name == present
    assert len(told) == 1
    assert "\n" not in str(told[0].message)


@pytest.mark.parametrize(("attributes", "expected"), [({}, False), ({"retrospective": True}, True)])
def test_an_estimator_of_another_package_says_that_it_looks_back(
    monkeypatch: pytest.MonkeyPatch, attributes: dict[str, bool], expected: bool
) -> None:
    made = SimpleNamespace(name="mine", value=type("Mine", (), attributes))
    monkeypatch.setattr(registry, "plugins", lambda group: [made])
    assert is_retrospective("mine") is expected
    assert not is_retrospective("another, not installed here")


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_who_looks_back_uses_later_frames(name: str, trials: list[tuple[Problem, Trajectory]]) -> None:
    """The bound that an estimator is held against depends on it."""
    p, _ = trials[0]
    whole, part = (
        estimator(name).estimate(dataclasses.replace(p, frames=p.frames[:count])).gTb for count in (7, 5)
    )
    assert (not np.array_equal(whole[:5], part)) == is_retrospective(name)


def test_a_start_without_rims_waits_for_the_first_that_has_some(
    trials: list[tuple[Problem, Trajectory]],
) -> None:
    """A filter that began at the poor prior and met its first rims later would be lost."""
    values = {"ekf": [], "online": [], "smoother": []}
    for p, truth in trials[:6]:
        late = [
            dataclasses.replace(frame, rims=RimSet.empty()) if k < 4 else frame
            for k, frame in enumerate(p.frames)
        ]
        start = find_start(p, late)
        assert start.frame == 4
        problem_late = dataclasses.replace(p, frames=late, start=start)
        for name, found in values.items():
            estimate = estimator(name).estimate(problem_late)
            assert estimate.pose_covariance is not None
            found.append(nees(errors(estimate, truth).pose, estimate.pose_covariance)[-1])
    low, high = interval(6)
    for found in values.values():
        assert low < np.mean(found) < high
