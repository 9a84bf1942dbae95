"""Time-correlated errors of rims: smoothers with variables for them are consistent, others are not."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from numpy.testing import assert_allclose
from scipy.stats import chi2

from craternav_fg.dataset.measurements import read_measurements, write_measurements
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import correlated_errors, incremental
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import (
    FINAL_LM,
    BatchOptions,
    BatchSmoother,
    _solved_for,
    build_graph,
    trajectory,
)
from craternav_fg.estimators.correlated_errors import (
    ERROR_LETTER,
    PLACE_SIZE,
    SHARED_FRAMES,
    SHARED_LETTER,
    STATE_SIZE,
    RimErrorOptions,
    RimErrorStates,
    correlation,
    transition,
    transitions,
)
from craternav_fg.estimators.ekf.filter import DistributedEkf
from craternav_fg.estimators.gnc import GncSmoother
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, RimVariables, add_frame
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from craternav_fg.estimators.rim_models import RIM_MODELS
from craternav_fg.estimators.start import find_start
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.evaluation.metrics import errors
from craternav_fg.measurements import CORRELATED_SIZE, SHARED_SIZE, ArcSet, RimSet
from craternav_fg.trajectory import Trajectory
from tests.descents import assert_same_estimates, mean_nees, problem, scenario

TRIALS = 8
DECAY = 0.5


def spoilt(p: Problem, truth: Trajectory, rng: np.random.Generator) -> Problem:
    """Add to the rims time-correlated errors of three times their sigma, and as large ones that all share."""
    kept: dict[int, tuple[float, np.ndarray]] = {}
    everyone = rng.standard_normal(SHARED_SIZE)
    frames = []
    for frame, gP in zip(p.frames, truth.gP, strict=True):
        rims = frame.rims
        A = 3.0 * np.linalg.cholesky(rims.covariance)
        B = np.zeros((len(rims), 5, SHARED_SIZE))
        B[:, :, :5] = A
        chart = rims.chart + np.einsum("nij,j->ni", B, everyone)
        for i, crater in enumerate(rims.craters.tolist()):
            range_m = float(np.linalg.norm(p.catalog.centres[crater] - gP))
            z = rng.standard_normal(STATE_SIZE)
            if crater in kept:
                F = transition(abs(np.log(range_m / kept[crater][0])), DECAY)
                z = F @ kept[crater][1] + np.linalg.cholesky(np.eye(STATE_SIZE) - F @ F.T) @ z
            kept[crater] = range_m, z
            chart[i] += A[i] @ z[:5]
        total = rims.covariance + 2.0 * A @ np.swapaxes(A, 1, 2)
        frames.append(
            replace(frame, rims=replace(rims, chart=chart, covariance=total, correlated=A, shared=B))
        )
    return replace(p, frames=frames, start=find_start(p, frames))


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    folder = tmp_path_factory.mktemp("trials")
    out = []
    for trial in range(TRIALS):
        p, truth = problem(folder, scenario(duration_s=40.0), trial)
        out.append((spoilt(p, truth, np.random.default_rng(trial)), truth))
    return out


KNOWING = BatchOptions(rim_errors=RimErrorOptions(decay_shape_change=DECAY, step_shape_change=0.02))


@pytest.mark.parametrize("estimator", [BatchSmoother(KNOWING), OnlineSmoother(KNOWING)])
def test_consistent_with_errors_that_last(
    trials: list[tuple[Problem, Trajectory]], estimator: Estimator
) -> None:
    low, high = (chi2.ppf(q, 6 * TRIALS) / TRIALS for q in (0.001, 0.999))
    assert low < mean_nees(estimator, trials) < high


@pytest.mark.parametrize("spoilt_by", [1.0, 0.999, 1e-10])
def test_cholesky_factorisation_leads_to_the_same_optimum(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch, spoilt_by: float
) -> None:
    """Also where rounding spoils its steps, so that they end near the optimum or lead nowhere."""
    p, _ = trials[0]
    one = replace(p, frames=p.frames[:1])
    start = OnlineSmoother(KNOWING).run(one).smoothed_values()
    graph = build_graph(one, KNOWING, start)
    # Without the IMU of several frames, which Cholesky may refuse.
    linear = graph.linearize(start)
    linear.optimize(gtsam.Ordering.ColamdGaussianFactorGraph(linear))
    start.update(X(0), start.atPose3(X(0)).retract(np.array([0.0, 0.0, 1e-3, 50.0, 0.0, 0.0])))
    best = levenberg_marquardt(graph, start)
    assert best.converged
    assert graph.error(start) > 2.0 * best.error
    expected = trajectory(one, replace(KNOWING, rim_errors=None), graph, best.values, [0])
    exactly = gtsam.GaussianFactorGraph.optimize

    def solve(linear: gtsam.GaussianFactorGraph, *how: Any) -> gtsam.VectorValues:
        step = exactly(linear, *how)
        return step if gtsam.EliminateQR in how else step.scale(spoilt_by)

    monkeypatch.setattr(gtsam.GaussianFactorGraph, "optimize", solve)
    result = levenberg_marquardt(graph, start, LmOptions(cholesky=True, relative_tolerance=1e-6))
    assert result.converged
    found = trajectory(one, KNOWING, graph, result.values, [0])
    sigma_m = np.sqrt(np.diag(expected.pose_covariance[0])[3:])
    assert (np.abs(found.gP - expected.gP) < 1e-3 * sigma_m).all()
    assert_allclose(
        found.pose_covariance, expected.pose_covariance, rtol=1e-4, atol=1e-5 * sigma_m.max() ** 2
    )


def test_the_step_that_the_covariances_give_is_taken(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It saves an elimination, and a hundredth of a sigma is not left over."""
    p, _ = trials[0]
    one = replace(p, frames=p.frames[:1])
    start = OnlineSmoother(KNOWING).run(one).smoothed_values()
    graph = build_graph(one, KNOWING, start)
    best = levenberg_marquardt(graph, start, LmOptions(relative_tolerance=1e-14)).values
    expected = trajectory(one, KNOWING, graph, best, [0])
    away = np.zeros(6)
    away[3:] = 1e-3 * np.sqrt(np.diag(expected.pose_covariance[0])[3:])
    near = gtsam.Values(best)
    near.update(X(0), best.atPose3(X(0)).retract(away))
    sigmas = np.sqrt(2.0 * Marginals(graph, near).predicted_decrease)
    near.update(X(0), best.atPose3(X(0)).retract(0.01 / sigmas * away))
    monkeypatch.delattr("craternav_fg.estimators.batch.levenberg_marquardt")
    found = trajectory(one, KNOWING, graph, near, [0])
    left = np.abs(found.gP - expected.gP) / np.abs(near.atPose3(X(0)).translation() - expected.gP)
    assert (left < 0.05).all()


def test_steps_by_qr_that_do_not_converge_are_no_result(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    p, _ = trials[0]
    one = replace(p, frames=p.frames[:1])
    values = OnlineSmoother(KNOWING).run(one).smoothed_values()
    graph = build_graph(one, KNOWING, values)
    away = values.atPose3(X(0)).retract(np.array([0.0, 0.0, 1e-3, 50.0, 0.0, 0.0]))
    values.update(X(0), away)
    monkeypatch.setattr("craternav_fg.estimators.batch.MAX_LAST_STEPS", 0)
    monkeypatch.setattr("craternav_fg.estimators.batch.FINAL_LM", LmOptions(max_iterations=1))
    with pytest.raises(EstimationError, match="no convergence in 1 iterations"):
        trajectory(one, KNOWING, graph, values, [0])


def test_marginals_are_those_of_isam2(trials: list[tuple[Problem, Trajectory]]) -> None:
    p, _ = trials[0]
    values = OnlineSmoother(KNOWING).run(p).smoothed_values()
    graph = build_graph(p, KNOWING, values)
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.enableRelinearization = False
    isam = gtsam.ISAM2(params)
    linear, linearised = graph.linearize(values), gtsam.NonlinearFactorGraph()
    for number in range(linear.size()):
        linearised.push_back(gtsam.LinearContainerFactor(linear.at(number), values))
    isam.update(linearised, values)
    keys = list(values.keys())
    assert {chr(gtsam.Symbol(key).chr()) for key in keys} == set("xvbrs")
    found = Marginals(graph, values).covariances(keys)
    for key in keys:
        expected = isam.marginalCovariance(key)
        sigmas = np.sqrt(np.diag(expected))
        assert_allclose(found[key] / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-8)


def test_covariances_by_cholesky_factorisation_are_known_to_their_rounding(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a trajectory they are taken where they have enough digits."""
    p, _ = trials[0]
    one = replace(p, frames=p.frames[:1])
    values = BatchSmoother(KNOWING).estimate(one).gTb
    start = OnlineSmoother(KNOWING).run(one).smoothed_values()
    start.update(X(0), gtsam.Pose3(values[0]))
    graph = build_graph(one, KNOWING, start)
    keys = list(start.keys())
    exact, squared = Marginals(graph, start), Marginals(graph, start, cholesky=True)
    assert squared.cholesky
    expected, found = exact.covariances(keys), squared.covariances(keys)
    assert exact.rounding(expected) == 0.0
    information = graph.linearize(start).hessian(_only(X(0), keys))[0][:6, :6]
    share = np.max(np.diag(information) * np.diag(found[X(0)])) * np.finfo(np.float64).eps
    assert squared.rounding({X(0): found[X(0)]}) == pytest.approx(share, rel=1e-9)
    assert np.abs(found[X(0)] / expected[X(0)] - 1.0).max() < 1e3 * share
    made = []

    class Counted(Marginals):
        def __init__(self, *of: Any, **how: Any) -> None:
            super().__init__(*of, **how)
            made.append(self.cholesky)

    monkeypatch.setattr("craternav_fg.estimators.batch.Marginals", Counted)
    trajectory(one, KNOWING, graph, start, [0])
    assert all(made)
    monkeypatch.setattr("craternav_fg.estimators.batch.MAX_ROUNDING", 0.5 * share)
    trajectory(one, KNOWING, graph, start, [0])
    assert not made[-1]


def _only(first: int, keys: list[int]) -> gtsam.Ordering:
    """Order of all keys with one in front."""
    ordering = gtsam.Ordering()
    for key in (first, *(key for key in keys if key != first)):
        ordering.push_back(key)
    return ordering


def test_rims_together_are_the_same_graph(trials: list[tuple[Problem, Trajectory]]) -> None:
    """As those with a factor each, which iSAM2 gets; also where the loss bites: the start is half a degree
    off."""
    p, truth = trials[0]
    systems, costs = [], []
    for together in (False, True):
        graph, values = FactorGraph(), gtsam.Values()
        for n in range(2):
            pose = gtsam.Pose3(truth.gTb[n]).retract(np.array([0.01, 0.0, -0.01, 50.0, -50.0, 20.0]))
            values.insert(X(n), pose)
        states = RimErrorStates(RimErrorOptions(decay_shape_change=DECAY, step_shape_change=0.02))
        for n in range(2):
            variables = RimVariables(values, states, together=together)
            assert add_frame(graph, p, KNOWING, X(n), p.frames[n], variables=variables) == 0
        keys = gtsam.Ordering()
        for key in values.keys():  # noqa: SIM118 (Values is no mapping)
            keys.push_back(key)
        systems.append(graph.linearize(values).augmentedJacobian(keys))
        costs.append(graph.error(values))
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)
    scale = np.linalg.norm(systems[0], axis=0)
    products = [(A / scale).T @ (A / scale) for A in systems]
    assert_allclose(products[1], products[0], atol=1e-12)


def test_too_sure_without(trials: list[tuple[Problem, Trajectory]]) -> None:
    """As if the same errors were new in every frame, and as if there were none beside the white ones."""
    high = chi2.ppf(0.999, 6 * TRIALS) / TRIALS
    assert mean_nees(BatchSmoother(GraphOptions(rim_errors=None)), trials) > high


def test_the_bound_is_that_of_the_same_model(trials: list[tuple[Problem, Trajectory]]) -> None:
    """The smoothers' covariances, where they know of the errors; below those who do not."""
    p, truth = trials[0]
    bound = posterior_bound(p, p.frames, truth, RimErrorOptions(decay_shape_change=DECAY))
    finely = GraphOptions(rim_errors=RimErrorOptions(decay_shape_change=DECAY, step_shape_change=0.0))
    for estimator, least in (
        (BatchSmoother(finely), bound.smoothed),
        (OnlineSmoother(finely), bound.filtered),
    ):
        estimate = estimator.estimate(p)
        assert estimate.pose_covariance is not None
        ratio = position_rms_m(estimate.pose_covariance) / position_rms_m(least)
        np.testing.assert_allclose(ratio[2:], 1.0, atol=0.05)
    bare = [replace(f, rims=replace(f.rims, correlated=None, shared=None)) for f in p.frames]
    without = posterior_bound(p, bare, truth)
    assert np.all(position_rms_m(without.smoothed) < 0.9 * position_rms_m(bound.smoothed))


def test_inflated_rims_have_the_variance_of_their_mean(trials: list[tuple[Problem, Trajectory]]) -> None:
    """Of several frames with the same correlated errors, each taken as white: that of simulated means."""
    frames, draws = 6, 20_000
    rng = np.random.default_rng(3)
    rims = trials[0][0].frames[0].rims.take(np.array([0]))
    assert rims.correlated is not None
    assert rims.shared is not None
    inflated = rims.inflate_correlated(frames)
    assert inflated.correlated is None
    assert inflated.shared is None
    white = np.linalg.cholesky(rims.uncorrelated_covariance[0])
    own = rng.standard_normal((draws, 5)) @ rims.correlated[0].T
    everyone = rng.standard_normal((draws, SHARED_SIZE)) @ rims.shared[0].T
    noise = np.mean([rng.standard_normal((draws, 5)) @ white.T for _ in range(frames)], axis=0)
    # In units of what the inflated covariance says of the mean: the identity.
    scaled = np.linalg.solve(np.linalg.cholesky(inflated.covariance[0] / frames), (own + everyone + noise).T)
    np.testing.assert_allclose(np.cov(scaled), np.eye(5), atol=0.05)


def test_inflated_arcs_have_the_variance_of_their_mean() -> None:
    """As for rims, of all edge points of an arc in so many frames."""
    frames, draws, points = 4, 20_000, 9
    rng = np.random.default_rng(4)
    arcs = ArcSet(np.array([4]), (np.zeros((points, 2)),), (np.full(points, 3.0),), np.array([2.0]))
    shared = 2.0 * rng.standard_normal(draws)
    mean = shared + 3.0 * rng.standard_normal((draws, frames * points)).mean(axis=1)
    claimed = np.mean(arcs.inflate_correlated(frames).sigmas[0] ** 2) / (frames * points)
    assert np.var(mean) == pytest.approx(claimed, rel=0.05)


def test_online_neither_order_nor_renewal_changes_the_estimate(
    trials: list[tuple[Problem, Trajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By QR, which keeps all digits."""
    p, _ = trials[0]

    def by_qr() -> OnlineSession:
        session = OnlineSession(p, KNOWING, keep_past=True)
        session._solver._refused = True
        session.run(p)
        return session

    session = by_qr()
    values = session.smoothed_values()
    shared = [key for key in values.keys() if chr(gtsam.Symbol(key).chr()) == SHARED_LETTER]  # noqa: SIM118
    assert shared == [gtsam.symbol(SHARED_LETTER, 0)]
    monkeypatch.setattr(incremental, "newest_last", lambda graph, values: (graph, values, None))
    monkeypatch.setattr(correlated_errors, "SHARED_FRAMES", len(p.frames))
    assert_same_estimates(session.filtered(), by_qr().filtered(), 1e-5)


def test_what_all_rims_share_is_renewed_as_an_equal_variable() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    states = RimErrorStates(RimErrorOptions(), renewed=True)
    root = np.zeros((1, 5, SHARED_SIZE))
    rims = RimSet(np.array([7]), np.zeros((1, 5)), np.eye(5)[None], shared=root)
    keys = [states.enter(rims, graph, values)[0].keys[0] for _ in range(2 * SHARED_FRAMES + 1)]
    expected = [gtsam.symbol(SHARED_LETTER, n // SHARED_FRAMES) for n in range(2 * SHARED_FRAMES + 1)]
    assert keys == expected
    ordering = gtsam.Ordering()
    for key in values.keys():  # noqa: SIM118 (Values is no mapping)
        ordering.push_back(key)
    covariance = np.linalg.inv(graph.linearize(values).hessian(ordering)[0])
    assert_allclose(covariance, np.kron(np.ones((3, 3)), np.eye(SHARED_SIZE)), atol=1e-5)
    # In another solver that has lost it, the error begins anew.
    assert states.enter(rims, graph, gtsam.Values(), lambda _: False)[0].keys[0] == gtsam.symbol("s", 3)


def test_errors_leave_the_lag_with_their_states(trials: list[tuple[Problem, Trajectory]]) -> None:
    """A crater that comes back after the lag begins anew."""
    p, truth = trials[0]
    blind = [
        replace(f, rims=f.rims.take(f.rims.craters != 0)) if 3 < k < 12 else f for k, f in enumerate(p.frames)
    ]
    estimate = FixedLagSmoother(KNOWING, lag_s=8.0).estimate(replace(p, frames=blind))
    assert np.linalg.norm(errors(estimate, truth).position_m[-1]) < 500.0


def test_noise_of_transitions_is_whitened() -> None:
    """Also where it is small: of a place it grows with the third power of the change."""
    changes = np.array([1e-3, 0.1, 3.0])
    for F, W in zip(*transitions(changes, DECAY), strict=True):
        assert not np.triu(W, 1).any()
        assert_allclose(W @ (np.eye(STATE_SIZE) - F @ F.T) @ W.T, np.eye(STATE_SIZE), atol=1e-5)


def test_transitions_of_two_changes_are_that_of_both() -> None:
    """And what is left of a state's error is what the correlation says, whatever the derivative is."""
    first, second = transition(0.2, DECAY), transition(0.5, DECAY)
    assert_allclose(second @ first, transition(0.7, DECAY), atol=1e-14)
    of_place, of_others = correlation(np.array([0.7]), DECAY)
    expected = np.diag([*[of_place[0]] * PLACE_SIZE, *[of_others[0]] * (CORRELATED_SIZE - PLACE_SIZE)])
    assert_allclose((second @ first)[:CORRELATED_SIZE, :CORRELATED_SIZE], expected, atol=1e-14)
    # The error of a place is smooth: over a small change it grows by its derivative.
    near = transition(1e-4, DECAY)
    assert np.sqrt(1.0 - near[0] @ near[0]) < 0.03 * near[0, CORRELATED_SIZE]


@pytest.mark.parametrize(("step", "atol"), [(0.0, 1e-9), (0.1, 0.06)])
def test_errors_of_a_track_have_the_correlation_of_the_model(step: float, atol: float) -> None:
    """A rim that grows by 4 % from frame to frame: covariances of its errors by the graph's inverse."""
    growth = 0.04
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    states = RimErrorStates(RimErrorOptions(decay_shape_change=DECAY, step_shape_change=step))
    terms = []
    for k in range(12):
        chart = np.array([[0.0, 0.0, growth * k, 0.0, growth * k]])
        root = np.eye(5, CORRELATED_SIZE)[None]
        covariance = root @ np.swapaxes(root, 1, 2) + np.eye(5)
        rims = RimSet(np.array([7]), chart, covariance, correlated=root)
        terms += states.enter(rims, graph, values)
    keys = list(values.keys())
    assert {chr(gtsam.Symbol(key).chr()) for key in keys} == {ERROR_LETTER}
    assert len(keys) == (12 if step == 0.0 else 4)
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    information = graph.linearize(values).hessian(ordering)[0]
    rows = np.zeros((12, 5, len(information)))
    for k, term in enumerate(terms):
        at = STATE_SIZE * keys.index(term.keys[0])
        rows[k, :, at : at + STATE_SIZE] = np.asarray(term.roots)[0]
    found = np.einsum("kin,nm,lim->ikl", rows, np.linalg.inv(information), rows)
    frames = np.arange(12.0)
    of_place, of_others = correlation(growth * np.abs(frames[:, None] - frames), DECAY)
    assert_allclose(found[:PLACE_SIZE], [of_place] * PLACE_SIZE, atol=atol)
    if step == 0.0:
        assert_allclose(found[PLACE_SIZE:], [of_others] * (5 - PLACE_SIZE), atol=atol)


@pytest.mark.parametrize(
    "wrong", [{"decay_shape_change": 0.0}, {"decay_shape_change": np.inf}, {"step_shape_change": -0.1}]
)
def test_options_without_meaning(wrong: dict[str, float]) -> None:
    with pytest.raises(EstimationError, match=next(iter(wrong))):
        RimErrorOptions(**wrong)


def test_only_graphs_with_variables_for_errors_of_rims_use_cholesky(
    trials: list[tuple[Problem, Trajectory]],
) -> None:
    p, _ = trials[0]
    assert p.frames[0].rims.correlated is not None
    used = {rims: _solved_for(FINAL_LM, p, BatchOptions(rims=rims)).cholesky for rims in RIM_MODELS}
    assert used == {rims: rims == "chart" for rims in RIM_MODELS}


def test_round_trip(tmp_path: Path, trials: list[tuple[Problem, Trajectory]]) -> None:
    """Correlated errors survive the disk."""
    p, _ = trials[0]
    write_measurements(tmp_path, p.frames, p.catalog)
    stamps = np.array([f.stamp_ns for f in p.frames])
    sun = SunVectors(stamps[:1], np.array([[1.0, 0.0, 0.0]]))
    read = read_measurements(tmp_path, stamps, p.catalog, p.camera, sun, np.zeros(3))
    for one, again in zip(p.frames, read, strict=True):
        assert np.array_equal(one.rims.correlated, again.rims.correlated)
        assert np.array_equal(one.rims.shared, again.rims.shared)


def test_every_estimator_takes_the_white_part_for_fusion(trials: list[tuple[Problem, Trajectory]]) -> None:
    """It counts as if the rims stated it; the bound, of the same model, says so too."""
    p, truth = trials[0]
    factors = np.random.default_rng(5).uniform(2.0, 6.0, len(p.catalog))
    told, stated = [], []
    for frame in p.frames:
        rims = frame.rims
        factor = factors[rims.craters]
        white = rims.uncorrelated_covariance
        more = (factor - 1.0)[:, None, None] * white
        told.append(replace(frame, rims=replace(rims, fused_white=white + more)))
        stated.append(replace(frame, rims=replace(rims, covariance=rims.covariance + more)))
    smoothers: list[Estimator] = [BatchSmoother(), OnlineSmoother(), DistributedEkf()]
    smoothers += [BatchSmoother(GraphOptions(rim_errors=None)), GncSmoother()]
    for one in smoothers:
        found, same, without = (one.estimate(replace(p, frames=f)) for f in (told, stated, p.frames))
        assert found.pose_covariance is not None
        assert without.pose_covariance is not None
        assert_allclose(found.gTb, same.gTb, rtol=1e-9, atol=1e-2)
        assert np.linalg.norm(found.gP - without.gP) > 1.0
        more_m = position_rms_m(found.pose_covariance) - position_rms_m(without.pose_covariance)
        assert np.all(more_m[1:] > 1.0)
    bounds = [posterior_bound(p, frames, truth).smoothed for frames in (told, stated)]
    assert_allclose(bounds[0], bounds[1], rtol=1e-9)
