"""Wrong matches: robust start, graduated non-convexity, and what it does to the demo's measurements."""

import dataclasses
import itertools
from pathlib import Path

import gtsam
import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.estimators import filter_state, gnc
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.consensus import agreeing, robust_track
from craternav_fg.estimators.gnc import GncSmoother, truncated_weights
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.matching.rematch import NO_CRATER, rematched
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.runs.write import write_run
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.scenario_tables import MeasurementSection
from craternav_fg.trajectory import Trajectory

LIMIT2 = float(chi2.ppf(0.999, 5))
Right = list[np.ndarray]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The demo's descent, its rims measured analytically with the demo's limit of size."""
    measurements = MeasurementSection(
        edge_sigma_px=1.0, points_per_rim=60, min_semi_minor_px=12.0, sun_tilt_sigma_deg=10.0
    )
    case = load_scenario("lunar_descent").model_copy(update={"render": None, "measurements": measurements})
    return Dataset.open(simulate(case, tmp_path_factory.mktemp("demo") / "d"))


def first(data: Dataset, frames_count: int) -> Dataset:
    """The beginning of a descent."""
    assert data.measurements is not None
    assert data.truth is not None
    cut = {k: getattr(data.truth, k)[:frames_count] for k in ("stamps_ns", "gTb", "gV", "bias")}
    return dataclasses.replace(
        data,
        measurements=tuple(data.measurements[:frames_count]),
        stamps_ns=data.stamps_ns[:frames_count],
        truth=Trajectory(**cut),
    )


def problem(data: Dataset, measured: list[FrameMeasurement]) -> Problem:
    return make_problem(Descent.of(data), measured)


def nearest_other(catalog: Catalog, crater: int) -> int:
    away = np.linalg.norm(catalog.centres - catalog.centres[crater], axis=1)
    return int(np.argsort(away)[1])


def with_wrong_matches(
    data: Dataset, share: float, rng: np.random.Generator, kind: str
) -> tuple[list[FrameMeasurement], Right]:
    """Return a share of all rims another crater: one of those in view, the nearest, or always the same."""
    assert data.measurements is not None
    counts = [len(frame.rims) for frame in data.measurements]
    all_craters = np.concatenate([frame.rims.craters for frame in data.measurements])
    if kind == "correlated":
        known = np.unique(all_craters)
        wrong = np.isin(all_craters, rng.choice(known, round(share * len(known)), replace=False))
    else:
        wrong = np.zeros(len(all_craters), dtype=np.bool_)
        wrong[rng.choice(len(wrong), round(share * len(wrong)), replace=False)] = True
    out, right = [], []
    for frame, bad in zip(data.measurements, np.split(wrong, np.cumsum(counts)[:-1]), strict=True):
        craters = frame.rims.craters.copy()
        for i in np.flatnonzero(bad):
            others = frame.rims.craters[frame.rims.craters != craters[i]]
            if kind == "in view" and len(others):
                craters[i] = rng.choice(others)
            else:
                craters[i] = nearest_other(data.catalog, int(craters[i]))
        out.append(dataclasses.replace(frame, rims=dataclasses.replace(frame.rims, craters=craters)))
        right.append(~bad)
    return out, right


def rms_m(estimate: Trajectory, truth: Trajectory) -> float:
    return float(np.sqrt(np.mean(np.sum(errors(estimate, truth).position_m ** 2, axis=1))))


def used(estimate: Trajectory) -> np.ndarray:
    assert estimate.rim_weights is not None
    return np.concatenate(estimate.rim_weights) == 1.0


def check(data: Dataset, share: float, seed: int, kind: str) -> tuple[float, float]:
    """Errors of the smoother with wrong matches, and with none."""
    measured, right = with_wrong_matches(data, share, np.random.default_rng(seed), kind)
    robust = GncSmoother().estimate(problem(data, measured))
    assert data.truth is not None
    assert data.measurements is not None
    clean = BatchSmoother().estimate(problem(data, list(data.measurements)))
    expected = np.concatenate(right)
    assert not (used(robust) & ~expected).any()
    # The limit loses one right rim in a thousand.
    assert (~used(robust) & expected).sum() <= 5
    assert robust.rim_craters is not None
    taken = np.concatenate(robust.rim_craters)
    true = np.concatenate([frame.rims.craters for frame in data.measurements])
    assert (taken[taken >= 0] == true[taken >= 0]).all()
    assert (taken >= 0).mean() > 0.99
    return rms_m(robust, data.truth), rms_m(clean, data.truth)


def test_two_of_five_matches_wrong_and_no_worse_than_with_none(demo: Dataset) -> None:
    for seed, kind in enumerate(("in view", "nearest", "correlated")):
        robust, clean = check(first(demo, 25), 0.4, seed, kind)
        assert robust < 1.1 * clean


def test_the_plain_smoother_needs_it(demo: Dataset) -> None:
    data = first(demo, 12)
    measured, _ = with_wrong_matches(data, 0.4, np.random.default_rng(0), "in view")
    assert data.measurements is not None
    clean = BatchSmoother().estimate(problem(data, list(data.measurements)))
    p = problem(data, measured)
    robust, plain = (rms_m(e.estimate(p), clean) for e in (GncSmoother(), BatchSmoother()))
    assert robust < 1.0
    assert plain > 30.0


def test_without_wrong_matches_it_is_the_smoother(demo: Dataset) -> None:
    assert demo.measurements is not None
    p = problem(demo, list(demo.measurements)[:12])
    plain, robust = BatchSmoother().estimate(p), GncSmoother().estimate(p)
    assert (~used(robust)).sum() <= 1
    assert robust.pose_covariance is not None
    assert plain.pose_covariance is not None
    assert_allclose(robust.pose_covariance[-1], plain.pose_covariance[-1], rtol=0.2, atol=1e-4)
    sigma = np.sqrt(np.diagonal(plain.pose_covariance, axis1=1, axis2=2))
    step = np.concatenate(
        [frames.rotation_log(np.swapaxes(plain.gRb, 1, 2) @ robust.gRb), robust.gP - plain.gP], axis=1
    )
    assert (np.abs(step) < sigma).all()


def test_a_trusted_rim_out_of_sight_at_first_does_not_reject_all(
    demo: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    p = problem(demo, list((demo.measurements or ())[:12]))
    squared = gnc._Rims.squared
    calls = []

    def first_unseen(self: gnc._Rims, values: gtsam.Values) -> np.ndarray:
        out = squared(self, values)
        if not calls:
            out[-1] = np.inf
        calls.append(len(out))
        return out

    monkeypatch.setattr(gnc._Rims, "squared", first_unseen)
    assert (~used(GncSmoother().estimate(p))).sum() <= 1
    # The rounds end when the weights no longer change, not when all are zero.
    assert len(calls) > 3


def test_gnc_finds_the_way_from_dead_reckoning(demo: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """States that a filter did not correct: here the rounds decide, not the tracker."""
    measured, right = with_wrong_matches(first(demo, 20), 0.4, np.random.default_rng(1), "in view")

    def uncorrected(p: Problem, limit2: float, options: GraphOptions) -> gnc.Track:
        track = robust_track(p, limit2, options)
        states = track.states[:1]
        for before, frame in itertools.pairwise(p.frames[track.start.frame :]):
            states.append(filter_state.propagate(states[-1], p, before.stamp_ns, frame.stamp_ns))
        return dataclasses.replace(track, states=states)

    monkeypatch.setattr(gnc, "robust_track", uncorrected)
    expected = np.concatenate(right)
    estimate = GncSmoother().estimate(problem(demo, measured))
    assert not (used(estimate) & ~expected).any()
    assert (~used(estimate) & expected).sum() <= 2


def test_a_start_is_found_behind_frames_that_are_wholly_wrong_or_empty(demo: Dataset) -> None:
    data = first(demo, 10)
    measured, _ = with_wrong_matches(data, 0.3, np.random.default_rng(2), "nearest")
    rims = measured[0].rims
    measured[0] = dataclasses.replace(
        measured[0], rims=dataclasses.replace(rims, craters=np.roll(rims.craters, 1))
    )
    measured[1] = dataclasses.replace(measured[1], rims=RimSet.empty())
    p = problem(data, measured)
    assert robust_track(p, LIMIT2).start.frame == 2
    estimate = GncSmoother().estimate(p)
    assert estimate.rim_weights is not None
    assert not estimate.rim_weights[0].any()
    assert data.truth is not None
    assert estimate.pose_covariance is not None
    assert nees(errors(estimate, data.truth).pose, estimate.pose_covariance).max() < chi2.ppf(1 - 1e-6, 6)


def test_without_any_rim_the_prior_is_carried_on(demo: Dataset) -> None:
    blind = [FrameMeasurement(stamp, RimSet.empty(), None) for stamp in map(int, demo.stamps_ns[:4])]
    estimate = GncSmoother().estimate(problem(demo, blind))
    assert_allclose(estimate.gP[0], demo.initial.gTb[:3, 3], atol=1.0)
    assert estimate.rim_weights is not None
    assert [len(w) for w in estimate.rim_weights] == [0] * 4


def test_rims_that_agree_with_one_another_are_kept() -> None:
    """A wide prediction lets all five through one by one; three of them agree on where the pose is."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(5, 5, 6))
    errors_of = [np.full(6, 5.0)] * 3 + [np.full(6, -5.0), np.array([9.0, -9.0, 9.0, -9.0, 9.0, -9.0])]
    residual = np.array([a @ e + rng.normal(size=5) for a, e in zip(A, errors_of, strict=True)])
    seen = np.ones(5, dtype=np.bool_)
    kept, cost = agreeing(A, residual, seen, 100.0 * np.eye(6), LIMIT2)
    assert_array_equal(kept, [True, True, True, False, False])
    assert 2 * LIMIT2 < cost < 5 * LIMIT2
    kept, _ = agreeing(A, residual, np.array([False, True, True, True, True]), 100.0 * np.eye(6), LIMIT2)
    assert_array_equal(kept, [False, True, True, False, False])
    kept, cost = agreeing(A, residual + 1e4, seen, np.eye(6), LIMIT2)
    assert not kept.any()
    assert cost == pytest.approx(5 * LIMIT2)


def test_a_rim_is_of_one_crater_that_is_free_and_fits(demo: Dataset) -> None:
    assert demo.measurements is not None
    assert demo.truth is not None
    rims, gTb = demo.measurements[5].rims, np.ascontiguousarray(demo.truth.gTb[5])
    n = len(rims)
    assert n >= 4

    def found(given: RimSet, used_rows: list[int], catalog: Catalog = demo.catalog) -> np.ndarray:
        used_mask = np.isin(np.arange(len(given)), used_rows)
        return rematched(given, used_mask, gTb, demo.camera, catalog, LIMIT2)

    wrong = dataclasses.replace(rims, craters=np.roll(rims.craters, 1))
    assert_array_equal(found(wrong, []), rims.craters)
    # What a rim that is used is of, no other can be.
    assert_array_equal(found(dataclasses.replace(rims, craters=rims.craters[[1, *range(1, n)]]), [1])[:2],
                       [rims.craters[0], rims.craters[1]])  # fmt: skip
    claimed = dataclasses.replace(rims, craters=np.r_[rims.craters[1], rims.craters[1:]])
    assert found(claimed, [0])[1] == NO_CRATER
    # Two rims that look like one crater are of neither.
    twice = rims.take(np.array([0, 0, 1]))
    assert_array_equal(found(twice, []), [NO_CRATER, NO_CRATER, rims.craters[1]])
    # A rim of a crater that the catalogue lacks.
    moved = dataclasses.replace(rims, chart=rims.chart + np.array([0.02, 0.0, 0.0, 0.0, 0.0]))
    assert (found(moved, []) == NO_CRATER).all()


@pytest.mark.parametrize("mu", [0.05, 1.0, 20.0])
@pytest.mark.parametrize("squared", [0.5, 4.0, 9.0, 16.0, 80.0])
def test_weight_minimises_the_surrogate(mu: float, squared: float) -> None:
    """Black and Rangarajan's form: w d2 plus the penalty mu (1 - w)/(mu + w) c2 is least at the weight."""
    limit2 = 9.0
    best = minimize_scalar(
        lambda w: w * squared + mu * (1.0 - w) / (mu + w) * limit2, bounds=(0.0, 1.0), method="bounded",
        options={"xatol": 1e-10},
    )  # fmt: skip
    (weight,) = truncated_weights(np.array([squared]), mu, limit2)
    assert weight == pytest.approx(best.x, abs=1e-5)


def test_rejected_matches_are_named_in_the_run(tmp_path: Path, demo: Dataset) -> None:
    data = first(demo, 6)
    measured, right = with_wrong_matches(data, 0.3, np.random.default_rng(4), "in view")
    blind = dataclasses.replace(data, measurements=tuple(measured), truth=None)
    write_run(
        tmp_path, reconstruct(blind, ["gnc_smoother", "dead_reckoning"]), dataset="demo", truth=None,
        times_s={}, wall_s=0.0,
    )  # fmt: skip
    table = pq.read_table(tmp_path / "residuals.parquet").to_pylist()
    own = [row for row in table if row["estimator"] == "gnc_smoother"]
    assert_array_equal([row["weight"] for row in own], np.concatenate(right).astype(float))
    assert data.measurements is not None
    true = [data.catalog.identifiers[row] for frame in data.measurements for row in frame.rims.craters]
    assert [row["reassociated_with"] or row["crater_id"] for row in own] == true
    assert [row["reassociated_with"] is None for row in own] == np.concatenate(right).tolist()
    assert all(row["weight"] is None for row in table if row["estimator"] == "dead_reckoning")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["in view", "nearest", "correlated"])
@pytest.mark.parametrize("share", [0.2, 0.4, 0.5])
def test_many_draws_of_wrong_matches(demo: Dataset, share: float, kind: str) -> None:
    for seed in range(10):
        robust, clean = check(demo, share, 100 + seed, kind)
        assert robust < 1.1 * clean
