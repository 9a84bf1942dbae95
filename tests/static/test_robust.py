"""Wrong matches: found, named, and without effect on the pose."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from craternav_fg.static.problem import KnownAttitude, StaticProblem, Status
from craternav_fg.static.robust import solve_robustly
from tests.static.scenes import Scene, bTc, level_axes, make_scene, on_ground


def mismatched(
    rng: np.random.Generator, scene: Scene, count: int, swapped: bool
) -> tuple[StaticProblem, set[str]]:
    """Give `count` rims another crater: one another's, or one elsewhere in view of about the size."""
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
