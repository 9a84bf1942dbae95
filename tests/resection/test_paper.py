"""The paper's resection methods: exact without noise, consistent covariances, clear refusals."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.measurements import KnownAttitude, SunTilt
from craternav_fg.resection.paper import equations
from craternav_fg.resection.paper.equations import PaperRims
from craternav_fg.resection.paper.solver import Method, solve_paper
from craternav_fg.resection.problem import (
    MatchedRims,
    PosePrior,
    ResectionError,
    ResectionProblem,
    Status,
)
from factors.kernels import conic
from factors.kernels.gauss_newton import move
from tests.factors.conftest import View, make_view
from tests.resection.scenes import make_scene

UNBIASED = (Method.EDGES, Method.TWO_CRATERS, Method.SHAPES)
SIGMA = np.diag([1e-6, 1e-6, 1e-4, 1e-4, 1e-4])


def problem_of(
    view: View, count: int, rng: np.random.Generator | None = None, **known: object
) -> ResectionProblem:
    charts = view.charts[:count]
    if rng is not None:
        charts = charts + rng.normal(size=(count, 5)) @ SIGMA
    names = view.catalog.identifiers[:count]
    S = np.repeat((SIGMA @ SIGMA)[None], count, axis=0)
    rims = MatchedRims(names, view.catalog.centres[:count], view.catalog.axes[:count], charts, S)
    return ResectionProblem(rims, view.bTc, **known)  # type: ignore[arg-type]


def off(gTb: np.ndarray, rotation_rad: float, distance_m: float, seed: int = 0) -> np.ndarray:
    """A pose moved by a rotation about and a distance along random axes."""
    rng = np.random.default_rng(seed)
    axis, direction = rng.normal(size=(2, 3))
    moved = gTb.copy()
    moved[:3, :3] = gTb[:3, :3] @ frames.rotation_exp(rotation_rad * axis / np.linalg.norm(axis))
    moved[:3, 3] += distance_m * direction / np.linalg.norm(direction)
    return moved


def twist(truth: np.ndarray, gTb: np.ndarray) -> np.ndarray:
    step = frames.inverse(truth) @ gTb
    return np.concatenate([frames.rotation_log(step[:3, :3]), step[:3, 3]])


@pytest.mark.parametrize("method", UNBIASED)
@pytest.mark.parametrize("seed", range(3))
def test_without_noise_the_pose_is_exact(method: Method, seed: int) -> None:
    view = make_view(seed)
    # The basin of (19) is that small.
    start = off(view.gTb, 1e-3, 20.0) if method is Method.SHAPES else off(view.gTb, 0.02, 300.0)
    result = solve_paper(problem_of(view, 5), method, start)
    assert result.solved
    assert np.abs(twist(view.gTb, result.pose.gTb)).max() < 1e-2
    assert np.abs(result.pose.residuals).max() < 0.1


def test_image_centres_are_off_by_the_tilt_and_not_when_looking_straight_down() -> None:
    def error(tilt_deg: float) -> float:
        view = make_view(1, tilt_deg=tilt_deg)
        result = solve_paper(problem_of(view, 5), Method.IMAGE_CENTRES, view.gTb)
        return float(np.linalg.norm(twist(view.gTb, result.pose.gTb)[3:]))

    # What is left looking down is the ground's curvature.
    assert error(25.0) > 50.0 * error(1e-6)


@pytest.mark.parametrize("method", [*UNBIASED, Method.IMAGE_CENTRES])
@pytest.mark.parametrize("known", [False, True])
def test_covariances_are_consistent(method: Method, known: bool) -> None:
    view = make_view(2)
    attitude = KnownAttitude(view.gTb[:3, :3]) if known else None
    rng = np.random.default_rng(5)
    noiseless = solve_paper(problem_of(view, 4, attitude=attitude), method, view.gTb).pose.gTb
    square = []
    for _ in range(150):
        pose = solve_paper(problem_of(view, 4, rng, attitude=attitude), method, noiseless).pose
        e = twist(noiseless, pose.gTb)
        rows = slice(3, 6) if known else slice(0, 6)
        assert known is not bool(pose.covariance[:3, :3].any())
        scale = np.sqrt(np.diag(pose.covariance)[rows])
        e, S = e[rows] / scale, pose.covariance[rows, rows] / np.outer(scale, scale)
        square.append(e @ np.linalg.solve(S, e) / len(e))
    # Standard error of the mean of chi2 / d over 150: sqrt(2 / d / 150), d at least 3.
    assert abs(np.mean(square) - 1.0) < 4.0 * np.sqrt(2.0 / 3.0 / 150.0)


def numerical(function: Callable[[np.ndarray], np.ndarray], pose: np.ndarray) -> np.ndarray:
    """Derivative of a function of a pose for its right twist, by central differences."""
    columns = []
    for k, h in enumerate([1e-5] * 3 + [0.5] * 3):
        ends = []
        for sign in (1.0, -1.0):
            moved = pose.copy()
            move(moved, sign * h * np.eye(6)[k])
            ends.append(function(moved))
        columns.append((ends[0] - ends[1]) / (2.0 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("printed_sign", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_jacobians(seed: int, printed_sign: bool) -> None:
    view = make_view(seed, n=3)
    rims = PaperRims(problem_of(view, 3, np.random.default_rng(seed)).rims)
    gTc = off(view.gTb @ view.bTc, 0.05, 500.0)
    sun = sun_of(view)
    systems = (
        lambda T: equations.edges(rims, T, printed_sign=printed_sign),
        lambda T: equations.two_craters(rims, T, printed_sign=printed_sign),
        lambda T: equations.with_sun(sun, rims, T),
    )
    for system in systems:
        J = system(gTc)[1]
        difference = numerical(lambda T, system=system: system(T)[0], gTc) - J
        assert (np.abs(difference) < 1e-5 * np.abs(J).max(axis=0)).all()
    e, J = equations.angles(rims, gTc[:3, 3])
    difference = numerical(lambda T: equations.angles(rims, T[:3, 3])[0], gTc)[:, 3:] - J @ gTc[:3, :3]
    assert len(e) == 3
    assert (np.abs(difference) < 1e-6 * np.abs(J).max()).all()


def test_covariance_is_the_bodys_with_the_camera_on_a_long_boom() -> None:
    view = make_view(1)
    bTc = frames.pose(frames.rotation_exp(np.array([0.4, -1.0, 2.0])), np.array([3e3, -8e3, 5e3]))
    gTc = view.gTb @ view.bTc
    rims = problem_of(view, 4).rims
    S = solve_paper(ResectionProblem(rims), Method.EDGES, gTc).pose.covariance
    gTb = gTc @ frames.inverse(bTc)
    turned = numerical(lambda T: twist(gTb, T @ frames.inverse(bTc)), gTc)
    found = solve_paper(ResectionProblem(rims, bTc), Method.EDGES, gTb).pose.covariance
    scale = np.sqrt(np.diag(found))
    np.testing.assert_allclose(
        found / np.outer(scale, scale), turned @ S @ turned.T / np.outer(scale, scale), atol=1e-5
    )


def test_known_attitude_needs_fewer_rims() -> None:
    view = make_view(3)
    attitude = KnownAttitude(view.gTb[:3, :3])
    start = off(view.gTb, 0.3, 200.0)
    for method, count in ((Method.EDGES, 2), (Method.TWO_CRATERS, 2), (Method.SHAPES, 1)):
        result = solve_paper(problem_of(view, count, attitude=attitude), method, start)
        assert result.solved
        assert np.linalg.norm(twist(view.gTb, result.pose.gTb)) < 1e-2


def sun_of(view: View) -> SunTilt:
    point = view.charts[0, :2]
    direction = np.cross(view.catalog.normals[0], [0.3, -0.5, 0.8])
    s = (view.gTb @ view.bTc)[:3, :3].T @ direction
    tilt = float(np.arctan2(s[1] - point[1] * s[2], s[0] - point[0] * s[2]))
    return SunTilt(tilt, 0.02, point, direction)


def test_one_crater_with_the_sun_needs_a_prior() -> None:
    view = make_view(0)
    sun = sun_of(view)
    near = off(view.gTb, 2e-3, 20.0)
    alone = solve_paper(problem_of(view, 1, sun=sun), Method.CRATER_AND_SUN, near)
    assert alone.status is Status.AMBIGUOUS
    prior = PosePrior(near, np.diag([1e-2, 1e-2, 1e-2, 100.0, 100.0, 100.0]) ** 2)
    held = solve_paper(problem_of(view, 1, sun=sun, prior=prior), Method.CRATER_AND_SUN)
    assert held.solved
    assert np.linalg.norm(twist(view.gTb, held.pose.gTb)[3:]) < 0.1
    # The sun alone gives the turn about the crater's normal: its sigma must show.
    angles = np.sqrt(np.linalg.eigvalsh(held.pose.covariance[:3, :3]))
    assert angles[-1] > 0.5 * sun.sigma_rad
    sure = PosePrior(near, prior.covariance * 1e-6)
    assert (
        solve_paper(problem_of(view, 1, sun=sun, prior=sure), Method.CRATER_AND_SUN).status is Status.NO_POSE
    )


@pytest.mark.parametrize(
    ("method", "count"), [(Method.IMAGE_CENTRES, 2), (Method.EDGES, 2), (Method.TWO_CRATERS, 1)]
)
def test_too_few_rims_are_said(method: Method, count: int) -> None:
    view = make_view(0)
    result = solve_paper(problem_of(view, count), method, view.gTb)
    assert result.status is Status.TOO_FEW_RIMS
    assert f"found {count}" in result.reason
    assert not result.poses


def test_what_is_missing_is_said() -> None:
    view = make_view(0)
    with pytest.raises(ResectionError, match="start or a prior"):
        solve_paper(problem_of(view, 3), Method.EDGES)
    with pytest.raises(ResectionError, match="sun"):
        solve_paper(problem_of(view, 1), Method.CRATER_AND_SUN, view.gTb)
    with pytest.raises(ResectionError, match="found 2"):
        solve_paper(problem_of(view, 2, sun=sun_of(view)), Method.CRATER_AND_SUN, view.gTb)


def test_a_pose_from_below_is_none() -> None:
    """Equation (19) is zero at (R Rx180, Rx180 T), too: there the camera would be under ground."""
    view = make_view(0)
    gTc = view.gTb @ view.bTc
    gRl, gL = view.catalog.gRl[0], view.catalog.centres[0]
    half_turn = gRl @ np.diag([1.0, -1.0, -1.0]) @ gRl.T
    below = frames.pose(half_turn @ gTc[:3, :3], gL + half_turn @ (gTc[:3, 3] - gL))
    start = below @ frames.inverse(view.bTc)
    attitude = KnownAttitude(start[:3, :3])
    result = solve_paper(problem_of(view, 1, attitude=attitude), Method.SHAPES, start)
    assert result.status is Status.NO_POSE
    assert "C0" in result.reason


def test_circles_seen_alike_leave_a_direction_free() -> None:
    """Concentric circles: the turn about their normal stays free."""
    view = make_view(0, circular=True)
    axes = np.stack([view.catalog.axes[0], 2.0 * view.catalog.axes[0]])
    centres = np.repeat(view.catalog.centres[:1], 2, axis=0)

    charts, _ = conic.project_rims(view.gTb, view.bTc, centres, axes)
    S = np.repeat((SIGMA @ SIGMA)[None], 2, axis=0)
    problem = ResectionProblem(MatchedRims(("A", "B"), centres, axes, charts, S), view.bTc)
    result = solve_paper(problem, Method.SHAPES, view.gTb)
    assert result.status is Status.UNDETERMINED
    assert np.isnan(result.poses[0].covariance).all()


@pytest.mark.parametrize("method", [*UNBIASED, Method.IMAGE_CENTRES])
def test_a_match_to_the_neighbour_is_no_pose(method: Method) -> None:
    """A rim is taken for another crater, and the start is the truth: the equations converge all the same."""
    for seed in range(15):
        scene = make_scene(np.random.default_rng(seed), 50e3, 4)
        assert solve_paper(scene.measured, method, scene.gTb).status is not Status.NO_POSE
        rims = scene.measured.rims
        other = np.array([0, 1, 2, 2])
        wrong = replace(rims, centres=rims.centres[other] + [[0], [0], [0], [1]], axes=rims.axes[other])
        result = solve_paper(replace(scene.measured, rims=wrong), method, scene.gTb)
        assert result.status in (Status.NO_POSE, Status.NOT_CONVERGED)
        assert not result.poses
