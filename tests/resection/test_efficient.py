"""The efficient solver: exact without noise, every solution with its probability, a status that says why."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import least_squares
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.ellipse import chart_covariance
from craternav_fg.errors import EstimationError
from craternav_fg.measurements import KnownAttitude, SunTilt
from craternav_fg.resection import caveats
from craternav_fg.resection.efficient import SolveOptions, refine, solve
from craternav_fg.resection.problem import (
    MatchedRims,
    PosePrior,
    ResectionError,
    ResectionProblem,
    Status,
)
from factors.kernels import sun as sun_kernel
from factors.kernels.gauss_newton import screw, screw_between
from tests.resection.scenes import CAMERA, Scene, bTc, camera_pose, level_axes, make_scene


def off_m(gTb: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(gTb[:3, 3] - truth[:3, 3]))


def squared_distance(gTb: np.ndarray, truth: np.ndarray, covariance: np.ndarray) -> float:
    error = gtsam.Pose3(gTb).localCoordinates(gtsam.Pose3(truth))
    return float(error @ np.linalg.solve(covariance, error))


def with_sun(
    scene: Scene, problem: ResectionProblem, sigma_rad: float, off_rad: float = 0.0
) -> ResectionProblem:
    direction, point = np.array([0.8, -0.6, 0.0]), scene.true.rims.chart[0, :2]
    tilt, _ = sun_kernel.sun_tilt(np.ascontiguousarray(scene.gTb), bTc, direction, *point, np.empty((1, 6)))
    return replace(problem, sun=SunTilt(tilt + off_rad, sigma_rad, point, direction))


@pytest.mark.parametrize("angle", [1e-7, 1e-3, 0.3, 2.9])
def test_screw_is_the_exponential_of_se3(angle: float) -> None:
    rng = np.random.default_rng(0)
    start = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), 1e3 * rng.normal(size=3))
    twist = np.concatenate([rng.normal(size=3), 1e3 * rng.normal(size=3)])
    twist[:3] *= angle / np.linalg.norm(twist[:3])
    moved = np.ascontiguousarray(start.matrix())
    screw(moved, twist)
    np.testing.assert_allclose(moved, start.compose(gtsam.Pose3.Expmap(twist)).matrix(), atol=1e-9)
    back = np.empty(6)
    screw_between(np.ascontiguousarray(start.matrix()), moved, back)
    np.testing.assert_allclose(back, twist, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 10])
@pytest.mark.parametrize("altitude_m", [10e3, 100e3])
def test_true_rims_give_the_true_pose_from_no_start(count: int, altitude_m: float) -> None:
    for seed in range(8):
        scene = make_scene(np.random.default_rng(seed), altitude_m, count, off_nadir_deg=(10.0, 60.0))
        result = solve(scene.true)
        assert result.poses, result.reason
        assert off_m(result.poses[0].gTb, scene.gTb) < 1e-4 * altitude_m
        assert result.poses[0].cost < 1e-5


def test_two_rims_seen_from_afar_have_a_mirrored_solution_and_both_are_returned() -> None:
    """The plane that leans the other way, by as much: an image from afar hardly tells them apart."""
    seen = 0
    for seed in range(60):
        scene = make_scene(np.random.default_rng(seed), 100e3, 2, off_nadir_deg=(20.0, 30.0))
        result = solve(scene.measured)
        if result.status is not Status.AMBIGUOUS:
            continue
        seen += 1
        assert not result.solved
        assert sum(pose.probability for pose in result.poses) == pytest.approx(1.0)
        assert list(result.poses) == sorted(result.poses, key=lambda pose: -pose.probability)
        for pose in result.poses:
            # Another optimiser finds no way down from any of them.
            def residual(
                x: np.ndarray, start: np.ndarray = pose.gTb, rims: MatchedRims = scene.measured.rims
            ) -> np.ndarray:
                gTb = start.copy()
                screw(gTb, x)
                return rims.residuals(gTb, bTc).ravel()

            settled = least_squares(residual, np.zeros(6), x_scale=np.repeat([1.0, 1e5], 3), xtol=1e-12)
            assert 2.0 * settled.cost == pytest.approx(pose.cost, rel=1e-3, abs=1e-3)
        first, second = (frames.rotation_log(scene.gTb[:3, :3].T @ p.gTb[:3, :3]) for p in result.poses[:2])
        assert np.linalg.norm(first - second) > np.radians(3.0)
    assert seen >= 3


def test_what_is_left_out_of_a_solution_does_not_matter() -> None:
    """Of all minima weighed by their probabilities, no component errs by more than the best one's sigma says.

    A mirrored pose a hundred standard deviations away matters with a probability of 1 in 1000.
    """
    improbable = 0
    for seed in range(150):
        scene = make_scene(np.random.default_rng(seed), 100e3, 2)
        result = solve(scene.measured)
        if result.status is Status.AMBIGUOUS:
            improbable += result.poses[1].probability < 0.01
            continue
        best, *others = solve(scene.measured, SolveOptions(least_probability=1e-12)).poses
        moment = best.covariance.copy()
        for other in others:
            error = gtsam.Pose3(best.gTb).localCoordinates(gtsam.Pose3(other.gTb))
            moment += other.probability * np.outer(error, error)
        assert eigh(moment, best.covariance, eigvals_only=True).max() < 1.1 + 1e-6
    assert improbable >= 2


def test_one_rim_and_the_attitude_give_the_position() -> None:
    distances = []
    for seed in range(150):
        scene = make_scene(np.random.default_rng(seed), 50e3, 1, drawn=True)
        result = solve(replace(scene.measured, attitude=KnownAttitude(scene.gTb[:3, :3])))
        pose = result.pose
        np.testing.assert_allclose(pose.gTb[:3, :3], scene.gTb[:3, :3], atol=1e-14)
        assert not pose.covariance[:3].any()
        error = scene.gTb[:3, :3].T @ (pose.gTb[:3, 3] - scene.gTb[:3, 3])
        distances.append(error @ np.linalg.solve(pose.covariance[3:, 3:], error))
    # Mean of 150 chi-square variables of 3 degrees of freedom: 3 +- 3 * 0.2.
    assert np.mean(distances) == pytest.approx(3.0, abs=0.6)


def test_a_star_trackers_error_is_in_the_covariance() -> None:
    sigma = 1e-3
    distances = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, 50e3, 2, drawn=True)
        gRb = scene.gTb[:3, :3] @ frames.rotation_exp(sigma * rng.normal(size=3))
        pose = solve(replace(scene.measured, attitude=KnownAttitude(gRb, sigma))).pose
        distances.append(squared_distance(pose.gTb, scene.gTb, pose.covariance))
    # 6 +- 3 * 0.28.
    assert np.mean(distances) == pytest.approx(6.0, abs=0.85)


def test_one_rim_with_a_prior() -> None:
    sigma = np.repeat([np.radians(3.0), 500.0], 3)
    distances = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, 50e3, 1, drawn=True)
        off = sigma * rng.normal(size=6)
        prior = frames.pose(scene.gTb[:3, :3] @ frames.rotation_exp(off[:3]), scene.gTb[:3, 3] + off[3:])
        pose = solve(replace(scene.measured, prior=PosePrior(prior, np.diag(sigma**2)))).poses[0]
        distances.append(squared_distance(pose.gTb, scene.gTb, pose.covariance))
    assert np.mean(distances) == pytest.approx(6.0, abs=0.85)


def turned(scene: Scene, angle: float) -> np.ndarray:
    """Turn the true pose about the first rim's normal through its centre."""
    centre = scene.true.rims.centres[0]
    R = frames.rotation_exp(angle * scene.true.rims.normals[0])
    return frames.pose(R @ scene.gTb[:3, :3], centre + R @ (scene.gTb[:3, 3] - centre))


def test_all_poses_of_one_rim_with_a_vague_prior_are_found() -> None:
    """Of a prior a quarter turn off: the ellipse, its half-turn, each with a second plane."""
    sigma = np.repeat([1.0, 20e3], 3)
    options = SolveOptions(misfit_sigma=50.0)
    found = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, 50e3, 1, off_nadir_deg=(5.0, 40.0))
        problem = replace(scene.measured, prior=PosePrior(turned(scene, 0.5 * np.pi), np.diag(sigma**2)))
        result = solve(problem, options)
        costs = np.array([pose.cost for pose in result.poses])
        for quarters in range(4):
            start = turned(scene, 0.5 * np.pi * quarters)
            screw(start, np.repeat([0.3, 8e3], 3) * rng.normal(size=6))
            local = refine(problem, start, options)
            if local.poses and local.poses[0].cost < costs[0] + 3.0:
                assert np.abs(costs - local.poses[0].cost).min() < 1e-3
                found += 1
    assert found >= 20


def test_a_poor_prior_helps_two_rims() -> None:
    """25 deg and 4 km: the annealed way from there and the starts without it lead to one pose."""
    sigma = np.repeat([np.radians(25.0), 4e3], 3)
    for seed in range(25):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, 50e3, 2)
        off = sigma * rng.normal(size=6)
        prior = frames.pose(scene.gTb[:3, :3] @ frames.rotation_exp(off[:3]), scene.gTb[:3, 3] + off[3:])
        result = solve(replace(scene.measured, prior=PosePrior(prior, np.diag(sigma**2))))
        assert squared_distance(result.poses[0].gTb, scene.gTb, result.poses[0].covariance) < 30.0


def test_one_rim_and_the_sun_have_several_exact_poses_the_true_one_among_them() -> None:
    nearest = []
    for seed in range(20):
        scene = make_scene(np.random.default_rng(seed), 50e3, 1, off_nadir_deg=(10.0, 50.0))
        result = solve(with_sun(scene, scene.true, 0.01), SolveOptions(least_probability=1e-6))
        assert len(result.poses) >= 2
        for pose in result.poses:
            assert pose.cost < 1e-2
        nearest.append(min(off_m(pose.gTb, scene.gTb) for pose in result.poses))
    assert max(nearest) < 50.0


def test_one_rim_alone_is_undetermined() -> None:
    scene = make_scene(np.random.default_rng(2), 50e3, 1, off_nadir_deg=(20.0, 30.0))
    result = solve(scene.measured)
    assert result.status is Status.UNDETERMINED
    assert "does not change the image of crater 'c0'" in result.reason
    assert len(result.poses) > 4
    for pose in result.poses:
        assert np.isnan(pose.covariance).all()
        assert np.abs(pose.residuals).max() < 1e-2
    with pytest.raises(ResectionError, match="no pose: rank 5"):
        _ = result.pose


def head_on(a: float, b: float) -> ResectionProblem:
    """A rim in the middle of an image taken from straight above."""
    from factors.kernels.conic import project_rims

    gTc = camera_pose(np.random.default_rng(0), 50e3, 0.0)
    axes = level_axes(a, b, 0.3)[None]
    charts, _ = project_rims(gTc, np.eye(4), np.zeros((1, 3)), axes)
    covariance = chart_covariance(charts[0], CAMERA, 1.0, 60)[None]
    return ResectionProblem(MatchedRims(("only",), np.zeros((1, 3)), axes, charts, covariance))


def test_a_circle_head_on_is_no_pose() -> None:
    result = solve(head_on(2e3, 2e3))
    assert result.status is Status.UNDETERMINED
    assert "rank 3" in result.reason
    assert "rotation about the normal of crater 'only' through its centre" in result.reason


def test_no_rims() -> None:
    scene = make_scene(np.random.default_rng(0), 50e3, 2)
    result = solve(replace(scene.measured, rims=scene.measured.rims.take([])))
    assert result.status is Status.TOO_FEW_RIMS
    assert not result.poses


def test_rims_that_contradict_each_other_name_the_worst() -> None:
    scene = make_scene(np.random.default_rng(3), 50e3, 6)
    centres = scene.measured.rims.centres.copy()
    centres[4] += [1500.0, 0.0, 0.0]
    result = solve(replace(scene.measured, rims=replace(scene.measured.rims, centres=centres)))
    assert result.status is Status.NO_POSE
    assert "'c4'" in result.reason
    assert not result.poses


def contradicting(name: str) -> ResectionProblem:
    """Six good rims, and one thing known beside them that is far off."""
    scene = make_scene(np.random.default_rng(3), 50e3, 6)
    gRb = scene.gTb[:3, :3] @ frames.rotation_exp(np.array([0.0, 0.3, 0.0]))
    if name == "attitude":
        return replace(scene.measured, attitude=KnownAttitude(gRb))
    if name == "vague attitude":
        return replace(scene.measured, attitude=KnownAttitude(gRb, 1e-3))
    if name == "prior":
        prior = PosePrior(frames.pose(gRb, scene.gTb[:3, 3]), np.diag([1e-6] * 3 + [1e4] * 3))
        return replace(scene.measured, prior=prior)
    return with_sun(scene, scene.measured, 1e-3, off_rad=1.0)


@pytest.mark.parametrize("name", ["attitude", "vague attitude", "prior", "sun"])
def test_what_contradicts_good_rims_is_named(name: str) -> None:
    result = solve(contradicting(name))
    assert result.status is Status.NO_POSE
    what = name.removeprefix("vague ")
    assert result.reason.endswith(f": the {what} contradicts the rest, which agrees without it")


def test_a_wrong_match_beside_a_good_attitude_is_named() -> None:
    scene = make_scene(np.random.default_rng(3), 50e3, 6)
    centres = scene.measured.rims.centres.copy()
    centres[4] += [1500.0, 0.0, 0.0]
    wrong = replace(scene.measured, rims=replace(scene.measured.rims, centres=centres))
    result = solve(replace(wrong, attitude=KnownAttitude(scene.gTb[:3, :3])))
    assert "'c4'" in result.reason
    assert "attitude" not in result.reason


@pytest.mark.parametrize(
    ("count", "attitude", "warned"), [(2, False, True), (3, False, False), (1, True, True), (2, True, False)]
)
def test_matches_that_nothing_checks_are_warned_of(count: int, attitude: bool, warned: bool) -> None:
    scene = make_scene(np.random.default_rng(0), 10e3, count)
    problem = scene.measured
    if attitude:
        problem = replace(problem, attitude=KnownAttitude(scene.gTb[:3, :3]))
    result = solve(problem)
    assert result.solved
    assert any("cannot reveal a wrong match" in text for text in result.warnings) is warned


def test_an_attitude_that_looks_away_is_no_pose() -> None:
    scene = make_scene(np.random.default_rng(3), 50e3, 3)
    up = scene.gTb[:3, :3] @ frames.rotation_exp(np.pi * bTc[:3, 0])
    result = solve(replace(scene.measured, attitude=KnownAttitude(up)))
    assert result.status is Status.NO_POSE
    assert not result.poses


def test_a_refinement_stays_at_the_minimum_next_to_its_start() -> None:
    scene = make_scene(np.random.default_rng(5), 50e3, 4)
    start = scene.gTb.copy()
    screw(start, np.array([0.05, -0.04, 0.06, 800.0, -700.0, 900.0]))
    refined, solved = refine(scene.measured, start).pose, solve(scene.measured).pose
    np.testing.assert_allclose(refined.gTb[:3, 3], solved.gTb[:3, 3], atol=0.1)
    np.testing.assert_allclose(refined.covariance, solved.covariance, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"identifiers": ("c0", "c0")}, "'c0' is matched to more than one rim"),
        ({"chart": np.full((2, 5), np.nan)}, "chart: expected finite numbers"),
        ({"chart": np.zeros((3, 5))}, "chart: expected shape"),
        ({"covariance": np.zeros((2, 5, 5))}, "covariance.*positive definite"),
        ({"axes": np.zeros((2, 2, 3))}, "axes"),
    ],
)
def test_a_wrong_field_is_named(change: dict[str, object], says: str) -> None:
    scene = make_scene(np.random.default_rng(0), 50e3, 2)
    with pytest.raises(ResectionError, match=says):
        replace(scene.measured.rims, **change)


def test_a_prior_and_an_attitude_do_not_go_together() -> None:
    scene = make_scene(np.random.default_rng(0), 50e3, 2)
    prior, attitude = PosePrior(scene.gTb, np.eye(6)), KnownAttitude(scene.gTb[:3, :3])
    with pytest.raises(ResectionError, match="found both"):
        replace(scene.measured, prior=prior, attitude=attitude)
    with pytest.raises(EstimationError, match=r"attitude\.gRb: expected a proper rotation"):
        KnownAttitude(2.0 * np.eye(3))
    with pytest.raises(ResectionError, match=r"prior\.covariance"):
        PosePrior(scene.gTb, -np.eye(6))


def test_the_largest_turn_is_a_quantile() -> None:
    assert pytest.approx(chi2.isf(1e-7, 3), abs=1e-4) == caveats._MOST_TURN
