"""Wrong matches: found, named, and without effect on the pose."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from craternav_fg.ellipse import chart_covariance
from craternav_fg.measurements import KnownAttitude
from craternav_fg.resection.efficient import solve
from craternav_fg.resection.problem import MatchedRims, ResectionProblem, Status
from craternav_fg.resection.robust import RobustOptions, solve_robustly
from factors.kernels.conic import project_rims
from tests.resection.scenes import CAMERA, Scene, bTc, camera_pose, level_axes, make_scene, on_ground


def mismatched(
    rng: np.random.Generator, scene: Scene, count: int, swapped: bool
) -> tuple[ResectionProblem, set[str]]:
    """Return `count` rims another crater: one another's, or one elsewhere in view of about the size."""
    rims = scene.measured.rims
    bad = rng.permutation(len(rims))[:count]
    centres, axes = rims.centres.copy(), rims.axes.copy()
    if swapped:
        centres[bad], axes[bad] = rims.centres[np.roll(bad, 1)], rims.axes[np.roll(bad, 1)]
    else:
        for k in bad:
            centre = None
            while centre is None:
                centre = on_ground(scene.gTb @ bTc, rng.uniform(0.0, 1023.0, 2))
            a, b = np.linalg.norm(axes[k], axis=1) * rng.uniform(0.8, 1.25)
            centres[k], axes[k] = centre, level_axes(a, b, rng.uniform(0.0, np.pi))
    problem = replace(scene.measured, rims=replace(rims, centres=centres, axes=axes))
    return problem, {rims.identifiers[k] for k in bad}


def score(trials: int, altitude_m: float, swapped: bool) -> tuple[float, float, float]:
    """Shares of trials with the right pose, with every wrong match named; of true matches called wrong."""
    rng = np.random.default_rng(0)
    right, named, false = 0, 0, 0
    for _ in range(trials):
        scene = make_scene(rng, altitude_m, 10)
        problem, bad = mismatched(rng, scene, 3, swapped)
        result = solve_robustly(problem)
        if not result.poses:
            continue
        error = gtsam.Pose3(result.poses[0].gTb).localCoordinates(gtsam.Pose3(scene.gTb))
        right += error @ np.linalg.solve(result.poses[0].covariance, error) < 38.0
        named += bad <= set(result.wrong)
        false += len(set(result.wrong) - bad)
    return right / trials, named / trials, false / (7 * trials)


@pytest.mark.parametrize("swapped", [True, False], ids=["swapped", "elsewhere"])
@pytest.mark.parametrize("altitude_m", [10e3, 100e3])
def test_three_wrong_of_ten(altitude_m: float, swapped: bool) -> None:
    right, named, false = score(40, altitude_m, swapped)
    assert right == 1.0
    assert named >= 0.95
    assert false < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [True, False], ids=["swapped", "elsewhere"])
@pytest.mark.parametrize("altitude_m", [10e3, 50e3, 100e3])
def test_three_wrong_of_ten_in_a_thousand_trials(altitude_m: float, swapped: bool) -> None:
    right, named, false = score(1000, altitude_m, swapped)
    assert right >= 0.99
    assert named >= 0.95
    assert false < 0.01


def test_true_matches_are_all_kept() -> None:
    scene = make_scene(np.random.default_rng(1), 50e3, 6)
    result = solve_robustly(scene.measured)
    assert result.status is Status.SOLVED
    assert result.wrong == ()
    assert result.pose.residuals.shape == (6, 5)


def test_a_wrong_match_beside_a_known_attitude() -> None:
    rng = np.random.default_rng(2)
    scene = make_scene(rng, 50e3, 4)
    problem, bad = mismatched(rng, scene, 1, False)
    result = solve_robustly(replace(problem, attitude=KnownAttitude(scene.gTb[:3, :3])))
    assert set(result.wrong) == bad
    assert np.linalg.norm(result.pose.gTb[:3, 3] - scene.gTb[:3, 3]) < 500.0


def test_rims_of_nowhere_are_no_pose() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        problem, _ = mismatched(rng, make_scene(rng, 10e3, 5), 5, False)
        result = solve_robustly(problem)
        assert result.status is Status.NO_POSE
        assert result.reason == "no 3 of the 5 rims agree on a pose within the gate"
        assert not result.poses


def test_two_rims_cannot_check_each_other() -> None:
    scene = make_scene(np.random.default_rng(3), 50e3, 2)
    assert solve_robustly(scene.measured).status is Status.TOO_FEW_RIMS
    exact = replace(scene.measured, attitude=KnownAttitude(scene.gTb[:3, :3]))
    assert solve_robustly(exact).status is Status.SOLVED


def test_one_true_and_one_wrong_match_with_a_known_attitude_are_no_pose() -> None:
    """Either could be the wrong one."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, 50e3, 2)
        problem, _ = mismatched(rng, scene, 1, False)
        result = solve_robustly(replace(problem, attitude=KnownAttitude(scene.gTb[:3, :3])))
        assert result.status is Status.NO_POSE
        assert result.reason == "no 2 of the 2 rims agree on a pose within the gate"
        assert result.wrong == ()


def test_concentric_circles_and_a_wrong_match_leave_a_direction_free() -> None:
    gTc = camera_pose(np.random.default_rng(1), 50e3, 0.5)
    centres = np.array([[0.0, 0.0, 0.0]] * 3 + [[6e3, 0.0, 0.0]])
    axes = np.array([level_axes(size, size, 0.0) for size in (1e3, 2e3, 3e3, 1.5e3)])
    charts, seen = project_rims(gTc, np.eye(4), centres, axes)
    assert seen.all()
    covariance = np.array([chart_covariance(chart, CAMERA, 1.0, 60) for chart in charts])
    centres[3] = [0.0, 15e3, 0.0]
    result = solve_robustly(ResectionProblem(MatchedRims(tuple("ABCD"), centres, axes, charts, covariance)))
    assert result.status is Status.UNDETERMINED
    assert result.wrong == ("D",)
    for pose in result.poses:
        assert pose.residuals.shape == (4, 5)


@pytest.mark.parametrize("seed", [144, 0, 1, 2])
def test_with_a_tight_gate_too_the_pose_is_that_of_the_rims_not_named(seed: int) -> None:
    """In the first scene a rim at the gate comes and goes."""
    scene = make_scene(np.random.default_rng(seed), 50e3, 10)
    result = solve_robustly(scene.measured, RobustOptions(gate_chi2=8.0))
    rims = scene.measured.rims
    kept = np.array([name not in result.wrong for name in rims.identifiers])
    again = solve(replace(scene.measured, rims=rims.take(kept)))
    np.testing.assert_allclose(again.pose.gTb, result.pose.gTb, atol=1e-6)
    assert (np.sum(result.pose.residuals[kept] ** 2, axis=1) < 8.0).all()
