"""Errors of the map: a constant vector for each crater, but for a part of the place, which changes."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.correlated_errors import MAP_LETTERS, RimErrorOptions, RimErrorStates
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.start import find_start
from craternav_fg.evaluation.bounds import position_rms_m, posterior_bound
from craternav_fg.measurements import CORRELATED_SIZE, MAP_SIZE, TILT_SIZE, RimSet
from craternav_fg.trajectory import Trajectory
from factors.kernels.rim_errors import ground_slopes, tilt_slopes
from tests.descents import mean_nees, problem, scenario

TRIALS = 8
SIZE = MAP_SIZE + TILT_SIZE
# Standard deviations of the map in radii: larger than those of the rims.
SIGMAS = np.array([0.005, 0.005, 0.005, 0.003, 0.003, 0.003, 0.003, 0.003])
CONSTANT = RimErrorOptions(constant_place_share=1.0)


def moved(p: Problem, truth: Trajectory, rng: np.random.Generator) -> Problem:
    """Let the map be wrong in place, height, shape and tilt of each crater, and the rims say so."""
    wrong = rng.standard_normal((len(p.catalog), SIZE))
    frames = []
    for frame, gTb in zip(p.frames, truth.gTb, strict=True):
        rims, rows = frame.rims, frame.rims.craters
        view = gTb.copy(), p.camera.bTc, p.catalog.centres[rows], p.catalog.axes[rows]
        A = np.concatenate([ground_slopes(*view), tilt_slopes(*view)], axis=2) * SIGMAS
        chart = rims.chart + np.einsum("nij,nj->ni", A, wrong[rows])
        covariance = rims.covariance + A @ np.swapaxes(A, 1, 2)
        frames.append(replace(frame, rims=replace(rims, chart=chart, covariance=covariance, of_map=A)))
    return replace(p, frames=frames, start=find_start(p, frames))


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    folder = tmp_path_factory.mktemp("moved")
    out = []
    for trial in range(TRIALS):
        p, truth = problem(folder, scenario(duration_s=40.0), trial)
        out.append((moved(p, truth, np.random.default_rng(trial)), truth))
    return out


@pytest.mark.parametrize(
    "estimator",
    [BatchSmoother(BatchOptions(rim_errors=CONSTANT)), OnlineSmoother(GraphOptions(rim_errors=CONSTANT))],
)
def test_consistent_with_a_wrong_map(trials: list[tuple[Problem, Trajectory]], estimator: Estimator) -> None:
    low, high = (chi2.ppf(q, 6 * TRIALS) / TRIALS for q in (0.001, 0.999))
    assert low < mean_nees(estimator, trials) < high


def test_too_sure_as_if_new_in_every_frame(trials: list[tuple[Problem, Trajectory]]) -> None:
    high = chi2.ppf(0.999, 6 * TRIALS) / TRIALS
    white = GraphOptions(rim_errors=None, variance_inflation=1.0)
    assert mean_nees(BatchSmoother(white), trials) > high


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
def test_the_bound_is_that_of_the_same_model(trials: list[tuple[Problem, Trajectory]], share: float) -> None:
    p, truth = trials[0]
    options = RimErrorOptions(constant_place_share=share, step_shape_change=0.0)
    bound = posterior_bound(p, p.frames, truth, options)
    for estimator, least in (
        (BatchSmoother(BatchOptions(rim_errors=options, crater_freedom=None)), bound.smoothed),
        (OnlineSmoother(GraphOptions(rim_errors=options)), bound.filtered),
    ):
        estimate = estimator.estimate(p)
        assert estimate.pose_covariance is not None
        ratio = position_rms_m(estimate.pose_covariance) / position_rms_m(least)
        assert_allclose(ratio[2:], 1.0, atol=0.05)


def test_a_crater_has_one_variable_however_its_image_changes() -> None:
    def rims(sizes: dict[int, float], count: int) -> RimSet:
        charts = np.array([[0.0, 0.0, size, 0.0, size] for size in sizes.values()])
        root = np.tile(0.1 * np.eye(5, count), (len(sizes), 1, 1))
        return RimSet(np.array(list(sizes)), charts, np.tile(np.eye(5), (len(sizes), 1, 1)), of_map=root)

    for count, letter in MAP_LETTERS.items():
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        states = RimErrorStates(CONSTANT)
        (first,) = states.enter(rims({7: 0.0, 8: 0.0}, count), graph, values)
        (second,) = states.enter(rims({8: 2.0, 9: 0.0}, count), graph, values)
        assert second.keys[0] == first.keys[1]
        assert [gtsam.Symbol(key).index() for key in (*first.keys, second.keys[1])] == [0, 1, 2]
        assert {chr(gtsam.Symbol(key).chr()) for key in (*first.keys, *second.keys)} == {letter}
        # One prior each.
        assert graph.size() == values.size() == 3


def test_frames_may_state_errors_of_another_size(trials: list[tuple[Problem, Trajectory]]) -> None:
    """A crater then has a variable for each size: less is known, and nothing fails."""
    p, truth = trials[0]
    sigmas = []
    for mixed in (False, True):
        frames = []
        for k, frame in enumerate(p.frames):
            A = frame.rims.of_map
            assert A is not None
            rims = frame.rims
            if mixed and k % 2:
                less = rims.covariance - A[:, :, MAP_SIZE:] @ np.swapaxes(A[:, :, MAP_SIZE:], 1, 2)
                rims = replace(rims, covariance=less, of_map=A[:, :, :MAP_SIZE])
            elif mixed and k == 2:
                less = rims.covariance - A[:, :, :MAP_SIZE] @ np.swapaxes(A[:, :, :MAP_SIZE], 1, 2)
                rims = replace(rims, covariance=less, of_map=A[:, :, MAP_SIZE:])
            frames.append(replace(frame, rims=rims))
        one = replace(p, frames=frames)
        assert len(posterior_bound(one, frames, truth).smoothed) == len(frames)
        for estimator in (BatchSmoother(), OnlineSmoother()):
            estimate = estimator.estimate(one)
            assert estimate.pose_covariance is not None
            sigmas.append(position_rms_m(estimate.pose_covariance)[-1])
    assert 0.3 * sigmas[0] < sigmas[2] < 3.0 * sigmas[0]
    assert 0.3 * sigmas[1] < sigmas[3] < 3.0 * sigmas[1]


def test_a_part_of_the_place_counts_as_changing() -> None:
    """The whole covariance stays; the time-correlated root is the triangular one on the ground."""
    rng = np.random.default_rng(5)
    n = 4
    slopes = rng.standard_normal((n, 5, 5))
    own = np.linalg.cholesky(np.eye(5) + (B := rng.standard_normal((n, 5, 5))) @ np.swapaxes(B, 1, 2))
    place = np.zeros((n, 5, MAP_SIZE))
    place[:, :, :2] = 3.0 * slopes[:, :, :2]
    place[:, :, 2:] = rng.standard_normal((n, 5, 4))
    correlated = slopes @ own
    whole = correlated @ np.swapaxes(correlated, 1, 2) + place @ np.swapaxes(place, 1, 2)
    rims = RimSet(np.arange(n), np.zeros((n, 5)), whole + np.eye(5), correlated=correlated, of_map=place)
    changed = rims.with_changing_place(0.3)
    assert changed.correlated is not None
    assert changed.of_map is not None
    assert_allclose(changed.uncorrelated_covariance, rims.uncorrelated_covariance, atol=1e-9)
    added = np.diag([0.3 * 9.0, 0.3 * 9.0, 0.0, 0.0, 0.0])
    expected = slopes @ np.linalg.cholesky(own @ np.swapaxes(own, 1, 2) + added)
    assert_allclose(changed.correlated, expected, rtol=1e-7, atol=1e-9)
    assert_allclose(changed.of_map[:, :, :2], np.sqrt(0.7) * place[:, :, :2])
    assert_allclose(changed.of_map[:, :, 2:], place[:, :, 2:])
    # Without errors of their own, and without a part that changes.
    alone = replace(rims, correlated=None).with_changing_place(1.0)
    assert alone.correlated is not None
    assert alone.correlated.shape == (n, 5, CORRELATED_SIZE)
    assert_allclose(alone.correlated[:, :, :2], place[:, :, :2])
    assert not alone.correlated[:, :, 2:].any()
    assert rims.with_changing_place(0.0) is rims
    # A root may be singular.
    flat = correlated.copy()
    flat[:, :, 2:] = 0.0
    singular = replace(rims, correlated=flat)
    assert singular.with_changing_place(0.5) is singular


@pytest.mark.parametrize("count", [MAP_SIZE, SIZE, TILT_SIZE])
def test_rims_over_an_exact_map_keep_the_tilts_alone(count: int) -> None:
    rng = np.random.default_rng(6)
    A = rng.standard_normal((3, 5, count))
    covariance = np.eye(5) + A @ np.swapaxes(A, 1, 2)
    exact = RimSet(np.arange(3), np.zeros((3, 5)), covariance, of_map=A).with_exact_map()
    assert_allclose(exact.uncorrelated_covariance, np.tile(np.eye(5), (3, 1, 1)), atol=1e-12)
    if count == MAP_SIZE:
        assert exact.of_map is None
    else:
        assert exact.of_map is not None
        assert_allclose(exact.of_map, A[:, :, -TILT_SIZE:])


@pytest.mark.parametrize("share", [-0.1, 1.1, np.nan])
def test_a_share_is_a_share(share: float) -> None:
    with pytest.raises(EstimationError, match="constant_place_share: expected 0 to 1"):
        RimErrorOptions(constant_place_share=share)
