"""Craters that err by more than they state get larger variances, and no longer decide."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.crater_scatter import variance_factors, with_variance_factors
from craternav_fg.estimators.start import find_start
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import MAP_SIZE, SHARED_SIZE
from craternav_fg.trajectory import Trajectory
from factors.kernels.rim_errors import ground_slopes
from tests.descents import problem, scenario

IN_PLANE = [0, 1, 3, 4, 5]
# Standard deviation of what a crater keeps, in radii: a map of the ground's craters is no better.
KEPT = 0.02


def with_kept_errors(p: Problem, truth: Trajectory, kept: dict[int, np.ndarray]) -> Problem:
    """State an error of `KEPT` in the place of each crater, and move craters by `kept` (2,), in radii."""
    frames = []
    for frame, gTb in zip(p.frames, truth.gTb, strict=True):
        rims, rows = frame.rims, frame.rims.craters
        slopes = ground_slopes(
            np.ascontiguousarray(gTb), p.camera.bTc, p.catalog.centres[rows], p.catalog.axes[rows]
        )[:, :, IN_PLANE]
        root = slopes * np.array([KEPT, KEPT, 0.1 * KEPT, 0.1 * KEPT, 0.1 * KEPT])
        chart = rims.chart.copy()
        for i, row in enumerate(rows.tolist()):
            chart[i] += slopes[i, :, :2] @ kept.get(row, np.zeros(2))
        covariance = rims.covariance + root @ np.swapaxes(root, 1, 2)
        frames.append(replace(frame, rims=replace(rims, chart=chart, covariance=covariance, correlated=root)))
    return replace(p, frames=frames, start=find_start(p, frames))


@pytest.fixture(scope="module")
def descents(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Trajectory]]:
    folder = tmp_path_factory.mktemp("scatter")
    return [problem(folder, scenario(duration_s=40.0), trial) for trial in range(4)]


def test_only_the_misplaced_crater_is_told_apart(descents: list[tuple[Problem, Trajectory]]) -> None:
    p, truth = descents[0]
    row = int(p.frames[0].rims.craters[0])
    moved = with_kept_errors(p, truth, {row: np.array([8.0 * KEPT, 0.0])})
    found = variance_factors(moved.frames, list(truth.gTb), p.camera, p.catalog, 4.0)
    assert set(found) == {row}
    # Eight standard deviations of one of five components, white errors small beside them.
    assert found[row] == pytest.approx((4.0 + 64.0) / 9.0, rel=0.15)


def test_white_errors_count_as_estimators_take_them(descents: list[tuple[Problem, Trajectory]]) -> None:
    """Where they take more of it than rims state, a crater that is off says less."""
    p, truth = descents[0]
    row = int(p.frames[0].rims.craters[0])
    moved = with_kept_errors(p, truth, {row: np.array([8.0 * KEPT, 0.0])})
    fused = []
    for frame in moved.frames:
        rims = frame.rims
        white = rims.uncorrelated_covariance + 25.0 * (rims.covariance - rims.uncorrelated_covariance)
        fused.append(replace(frame, rims=replace(rims, fused_white=white)))
    factors = [
        variance_factors(frames, list(truth.gTb), p.camera, p.catalog, 4.0)
        for frames in (moved.frames, fused)
    ]
    assert factors[1].get(row, 1.0) < 0.8 * factors[0][row]


def test_what_all_rims_share_explains_a_crater(descents: list[tuple[Problem, Trajectory]]) -> None:
    """An error that rims state to have in common is no sign of a bad crater."""
    p, truth = descents[0]
    row = int(p.frames[0].rims.craters[0])
    moved = with_kept_errors(p, truth, {row: np.array([8.0 * KEPT, 0.0])})
    frames = []
    for frame, gTb in zip(moved.frames, truth.gTb, strict=True):
        rims, rows = frame.rims, frame.rims.craters
        slopes = ground_slopes(
            np.ascontiguousarray(gTb), p.camera.bTc, p.catalog.centres[rows], p.catalog.axes[rows]
        )
        shared = np.zeros((len(rims), 5, SHARED_SIZE))
        shared[:, :, 0] = 8.0 * KEPT * slopes[:, :, 0]
        covariance = rims.covariance + shared @ np.swapaxes(shared, 1, 2)
        frames.append(replace(frame, rims=replace(rims, covariance=covariance, shared=shared)))
    assert variance_factors(frames, list(truth.gTb), p.camera, p.catalog, 4.0) == {}


def test_frames_may_state_other_parts_of_the_covariance(descents: list[tuple[Problem, Trajectory]]) -> None:
    """A file may have the shared part for some of its frames, and errors of the map for some."""
    p, truth = descents[0]
    row = int(p.frames[0].rims.craters[0])
    moved = with_kept_errors(p, truth, {row: np.array([8.0 * KEPT, 0.0])})
    mixed = []
    for k, frame in enumerate(moved.frames):
        rims = frame.rims
        if k % 2 and rims.correlated is not None:
            of_map, shared = (np.zeros((len(rims), 5, size)) for size in (MAP_SIZE, SHARED_SIZE))
            rims = replace(rims, of_map=of_map, shared=shared)
        mixed.append(replace(frame, rims=rims))
    alike, others = (
        variance_factors(frames, list(truth.gTb), p.camera, p.catalog, 4.0)
        for frames in (moved.frames, mixed)
    )
    assert others == pytest.approx(alike)


def test_rims_without_kept_errors_are_as_stated(descents: list[tuple[Problem, Trajectory]]) -> None:
    p, truth = descents[0]
    poses = [gTb.copy() for gTb in truth.gTb]
    for gTb in poses:
        gTb[:3, 3] *= 1.01
    assert variance_factors(p.frames, poses, p.camera, p.catalog, 4.0) == {}


def test_factors_leave_shared_errors(descents: list[tuple[Problem, Trajectory]]) -> None:
    p, truth = descents[0]
    frame = with_kept_errors(p, truth, {}).frames[0]
    shared = 1e-4 * np.random.default_rng(1).standard_normal((len(frame.rims), 5, SHARED_SIZE))
    covariance = frame.rims.covariance + shared @ np.swapaxes(shared, 1, 2)
    frame = replace(frame, rims=replace(frame.rims, covariance=covariance, shared=shared))
    row = int(frame.rims.craters[1])
    before, after = frame.rims, with_variance_factors(frame, {row: 3.0}).rims
    assert before.correlated is not None
    assert after.correlated is not None
    assert_allclose(
        after.uncorrelated_covariance[1], 3.0 * before.uncorrelated_covariance[1], rtol=1e-9, atol=1e-18
    )
    assert_allclose(after.correlated[1], np.sqrt(3.0) * before.correlated[1])
    assert_allclose(after.covariance[0], before.covariance[0], rtol=1e-12)
    assert np.array_equal(after.shared, shared)


def test_one_misplaced_crater_does_not_decide(descents: list[tuple[Problem, Trajectory]]) -> None:
    """A crater that is ten standard deviations off, among some as good as stated."""
    off: dict[float | None, list[float]] = {4.0: [], None: []}
    for trial, (p, truth) in enumerate(descents):
        rng = np.random.default_rng(trial)
        rows = np.unique(np.concatenate([frame.rims.craters for frame in p.frames])).tolist()
        kept = {row: KEPT * rng.standard_normal(2) for row in rows}
        kept[int(p.frames[0].rims.craters[0])] = np.array([10.0 * KEPT, 0.0])
        moved = with_kept_errors(p, truth, kept)
        for freedom, values in off.items():
            options = BatchOptions(crater_freedom=freedom)
            estimate = BatchSmoother(options).estimate(moved)
            assert estimate.pose_covariance is not None
            values.append(float(nees(errors(estimate, truth).pose, estimate.pose_covariance).mean()))
    assert np.mean(off[4.0]) < 0.5 * np.mean(off[None])
    assert np.mean(off[None]) > 12.0
