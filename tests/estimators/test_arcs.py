"""Rims of which a quarter is seen: every estimator that takes ellipses takes their edge points, too."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.ellipse import pixel_chart, points_and_normals
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import BatchSmoother
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.gnc import GncSmoother
from craternav_fg.estimators.online import FixedLagSmoother, OnlineSmoother
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import SHARED_SIZE, ArcSet, FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.kernels.conic import project_rims
from tests.descents import problem, scenario

SIGMA_PX = 0.3
POINTS = 15
# Of each coordinate, the same for all arcs of a descent.
SHARED_PX = 1.0


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Problem, Problem, Trajectory]]:
    """Descents with two ellipses a frame; the same with edge points on a quarter of three other rims."""
    folder = tmp_path_factory.mktemp("arcs")
    out = []
    for trial in range(5):
        p, truth = problem(folder, scenario(duration_s=40.0), trial)
        rng = np.random.default_rng(trial)
        without = [replace(f, rims=f.rims.take(f.rims.craters < 2)) for f in p.frames]
        frames = []
        for frame, bare, gTb in zip(p.frames, without, truth.gTb, strict=True):
            rows = frame.rims.craters[frame.rims.craters >= 2]
            charts, seen = project_rims(gTb, p.camera.bTc, p.catalog.centres[rows], p.catalog.axes[rows])
            points, sigmas = [], []
            for chart in charts[seen]:
                angles = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 0.5 * np.pi, POINTS)
                on_rim, normal = points_and_normals(pixel_chart(chart, p.camera), angles)
                off = SIGMA_PX * rng.normal(size=(POINTS, 1))
                points.append(p.camera.normalised(on_rim + off * normal))
                sigmas.append(np.full(POINTS, SIGMA_PX / p.camera.focal_px))
            frames.append(replace(bare, arcs=ArcSet(rows[seen], tuple(points), tuple(sigmas))))
        out.append((replace(p, frames=without), replace(p, frames=frames), truth))
    return out


@pytest.mark.parametrize("make", [BatchSmoother, OnlineSmoother, FixedLagSmoother, ekf, GncSmoother])
def test_arcs_inform_and_stay_consistent(
    trials: list[tuple[Problem, Problem, Trajectory]], make: Callable[[], Estimator]
) -> None:
    ends, gains = [], []
    for without, with_arcs, truth in trials:
        bare, full = make().estimate(without), make().estimate(with_arcs)
        assert bare.pose_covariance is not None
        assert full.pose_covariance is not None
        ends.append(nees(errors(full, truth).pose, full.pose_covariance)[-1])
        gains.append(np.linalg.det(full.pose_covariance[-1]) / np.linalg.det(bare.pose_covariance[-1]))
    n = len(ends)
    assert chi2.ppf(0.001, 6 * n) / n < np.mean(ends) < chi2.ppf(0.999, 6 * n) / n
    # Per direction, the standard deviation falls to less than three quarters.
    assert np.median(gains) ** (1 / 12) < 0.75


def test_an_arc_of_another_crater_is_left_out(
    trials: list[tuple[Problem, Problem, Trajectory]],
) -> None:
    without, with_arcs, truth = trials[0]
    wrong = [replace(f, arcs=replace(f.arcs, craters=np.roll(f.arcs.craters, 1))) for f in with_arcs.frames]
    assert all(len(frame.arcs) > 1 for frame in wrong)
    robust = GncSmoother().estimate(replace(with_arcs, frames=wrong))
    bare = GncSmoother().estimate(without)
    np.testing.assert_allclose(robust.gP, bare.gP, atol=0.01)
    assert robust.pose_covariance is not None
    np.testing.assert_allclose(robust.pose_covariance, bare.pose_covariance, rtol=0.01, atol=1e-6)
    assert nees(errors(robust, truth).pose, robust.pose_covariance).mean() < 12.0


def test_an_arc_far_off_its_rim_does_not_move_the_filter(
    trials: list[tuple[Problem, Problem, Trajectory]],
) -> None:
    """A quarter larger in one frame, at full weight it used to move the filter by ten standard deviations."""
    _, with_arcs, truth = trials[0]
    frames = list(with_arcs.frames)
    k = len(frames) // 2
    arcs = frames[k].arcs
    rows = arcs.craters[:1]
    charts, _ = project_rims(
        truth.gTb[k], with_arcs.camera.bTc, with_arcs.catalog.centres[rows], with_arcs.catalog.axes[rows]
    )
    far = charts[0, :2] + 1.25 * (arcs.points[0] - charts[0, :2])
    frames[k] = replace(frames[k], arcs=replace(arcs, points=(far, *arcs.points[1:])))
    estimate, sound = (ekf().estimate(replace(with_arcs, frames=one)) for one in (frames, with_arcs.frames))
    assert estimate.pose_covariance is not None
    assert sound.pose_covariance is not None
    assert nees(errors(estimate, truth).pose, estimate.pose_covariance)[k] < 20.0
    sigma_m = np.sqrt(np.trace(sound.pose_covariance[k, 3:, 3:]))
    assert np.linalg.norm(estimate.gP[k] - sound.gP[k]) < sigma_m


def test_a_frame_with_arcs_alone_measures(trials: list[tuple[Problem, Problem, Trajectory]]) -> None:
    _, with_arcs, truth = trials[0]
    before, last = with_arcs.frames[:4], with_arcs.frames[4]
    arcs, nothing = (
        FrameMeasurement(last.stamp_ns, RimSet.empty(), None, of_frame)
        for of_frame in (last.arcs, ArcSet.empty())
    )
    # An IMU that leaves something to tell.
    noise = replace(
        with_arcs.imu_noise,
        accelerometer_density_m_s2_sqrt_hz=1000.0 * with_arcs.imu_noise.accelerometer_density_m_s2_sqrt_hz,
    )
    told, untold = (
        ekf().states(replace(with_arcs, frames=[*before, frame], imu_noise=noise))[-1]
        for frame in (arcs, nothing)
    )
    ratio = np.linalg.det(told.covariance[:6, :6]) / np.linalg.det(untold.covariance[:6, :6])
    assert ratio ** (1 / 12) < 0.8
    error = frames.rotation_log(told.gTb[:3, :3].T @ truth.gRb[4]), truth.gP[4] - told.gTb[:3, 3]
    assert nees(np.concatenate(error)[None], told.covariance[None, :6, :6])[0] < chi2.ppf(0.9999, 6)


@pytest.mark.parametrize("make", [BatchSmoother, OnlineSmoother, FixedLagSmoother])
def test_what_all_arcs_share_is_estimated(
    trials: list[tuple[Problem, Problem, Trajectory]], make: Callable[[], Estimator]
) -> None:
    """All arcs of a descent are shifted alike: no number of frames averages that out."""
    means = {True: [], False: []}
    for trial, (_, p, truth) in enumerate(trials[:3]):
        everyone = np.random.default_rng(trial).standard_normal(2)
        for known, found in means.items():
            frames = []
            for frame in p.frames:
                roots = np.zeros((len(frame.arcs), 5, SHARED_SIZE))
                roots[:, [0, 1], [0, 1]] = SHARED_PX / p.camera.focal_px
                points = tuple(one + SHARED_PX / p.camera.focal_px * everyone for one in frame.arcs.points)
                arcs = replace(frame.arcs, points=points, shared=roots if known else None)
                frames.append(replace(frame, arcs=arcs))
            estimate = make().estimate(replace(p, frames=frames))
            assert estimate.pose_covariance is not None
            found.append(nees(errors(estimate, truth).pose, estimate.pose_covariance).mean())
    assert np.mean(means[True]) < 12.0
    assert np.mean(means[False]) > 2.0 * np.mean(means[True])
