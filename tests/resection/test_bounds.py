"""The Cramer-Rao bound from the edge points themselves, and what is free in which geometry."""

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_covariance, pixel_chart, points_and_normals
from craternav_fg.measurements import KnownAttitude
from craternav_fg.resection.bounds import cramer_rao
from craternav_fg.resection.edge_fit import fit_covariance, fit_edges
from craternav_fg.resection.problem import MatchedRims, PosePrior, ResectionProblem
from craternav_fg.resection.solve_kernel import covariance_and_log_det
from factors.kernels.conic import project_rims
from tests.resection.scenes import CAMERA, camera_pose, level_axes

POINTS = 40


def problem_at(gTb: np.ndarray, sizes: list[tuple[float, float]], **known: object) -> ResectionProblem:
    centres = np.array([[0.0, 0.0, 0.0], [9e3, 2e3, 0.0], [-4e3, 8e3, 100.0]])[: len(sizes)]
    axes = np.array([level_axes(a, b, 0.3 + k) for k, (a, b) in enumerate(sizes)])
    charts, seen = project_rims(gTb, np.eye(4), centres, axes)
    assert seen.all()
    S = np.array([chart_covariance(y, CAMERA, 1.0, POINTS) for y in charts])
    names = tuple("ABC"[: len(sizes)])
    return ResectionProblem(MatchedRims(names, centres, axes, charts, S), **known)  # type: ignore[arg-type]


def tilted(off_nadir_deg: float) -> np.ndarray:
    """A pose that looks at the origin from 50 km away."""
    gTb = camera_pose(np.random.default_rng(5), 1.0, np.radians(off_nadir_deg))
    gTb[:3, 3] = -50e3 * gTb[:3, 2]
    return gTb


def distance_px(gTb: np.ndarray, centre: np.ndarray, axes: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    """First-order distances of pixels from a rim's image: a level function of the ground over its slope."""
    n = np.cross(axes[0], axes[1])

    def level(pixels: np.ndarray) -> np.ndarray:
        rays = np.column_stack([CAMERA.normalised(pixels), np.ones(len(pixels))]) @ gTb[:3, :3].T
        ground = gTb[:3, 3] + rays * (((centre - gTb[:3, 3]) @ n) / (rays @ n))[:, None] - centre
        return np.sqrt(sum((ground @ axis / (axis @ axis)) ** 2 for axis in axes)) - 1.0

    h = 1e-3
    slopes = [(level(points_px + d) - level(points_px - d)) / (2 * h) for d in h * np.eye(2)]
    return np.asarray(level(points_px) / np.hypot(*slopes))


def test_the_bound_is_that_of_the_edge_points() -> None:
    """Information of each point's normal distance, by differences of the rays' footprints."""
    gTb = tilted(35.0)
    problem = problem_at(gTb, [(2e3, 1.5e3), (1.5e3, 1e3), (2.5e3, 2.4e3)])
    information = np.zeros((6, 6))
    steps = np.repeat([1e-5, 0.5], 3)
    for centre, axes, chart in zip(problem.rims.centres, problem.rims.axes, problem.rims.chart, strict=True):
        points, _ = points_and_normals(pixel_chart(chart, CAMERA), 2.0 * np.pi * np.arange(POINTS) / POINTS)
        columns = []
        for step in np.diag(steps):
            ends = [
                distance_px(
                    frames.pose(
                        gTb[:3, :3] @ frames.rotation_exp(s * step[:3]),
                        gTb[:3, 3] + gTb[:3, :3] @ (s * step[3:]),
                    ),
                    centre, axes, points,
                )
                for s in (1.0, -1.0)
            ]  # fmt: skip
            columns.append((ends[0] - ends[1]) / (2.0 * step.max()))
        J = np.stack(columns, axis=-1)
        information += J.T @ J
    scale = 1.0 / np.sqrt(np.diag(information))
    expected = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    bound = cramer_rao(problem, gTb)
    np.testing.assert_allclose(
        bound.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), rtol=1e-3, atol=1e-3
    )
    assert bound.observability.rank == 6
    assert bound.position_rms_m == pytest.approx(np.sqrt(np.trace(expected[3:, 3:])), rel=1e-3)


@pytest.mark.parametrize(
    ("off_nadir_deg", "size", "rank"),
    [(35.0, (2e3, 1.2e3), 5), (35.0, (2e3, 2e3), 5), (0.0, (2e3, 1.2e3), 4), (0.0, (2e3, 2e3), 3)],
)
def test_the_rank_of_one_rim(off_nadir_deg: float, size: tuple[float, float], rank: int) -> None:
    seen = cramer_rao(problem_at(tilted(off_nadir_deg), [size]), tilted(off_nadir_deg))
    assert seen.observability.rank == rank
    assert len(seen.observability.words) == len(seen.observability.free) == 6 - rank
    assert np.isnan(seen.covariance).all()


def test_free_directions_in_words() -> None:
    turn = "rotation about the normal of crater 'A' through its centre"
    swings = tuple(
        f"rotation of the camera around the centre of crater 'A' about the image's {axis} axis, still "
        "pointing at it"
        for axis in "xy"
    )
    tilt, nadir = tilted(35.0), tilted(0.0)
    assert cramer_rao(problem_at(tilt, [(2e3, 2e3)]), tilt).observability.words == (turn,)
    assert cramer_rao(problem_at(nadir, [(2e3, 2e3)]), nadir).observability.words == (turn, *swings)
    (words,) = cramer_rao(problem_at(tilt, [(2e3, 1.2e3)]), tilt).observability.words
    assert words.startswith("a motion that does not change the image of crater 'A'")


def test_what_is_known_beside_the_image_counts() -> None:
    gTb = tilted(35.0)
    attitude = cramer_rao(problem_at(gTb, [(2e3, 2e3)], attitude=KnownAttitude(gTb[:3, :3])), gTb)
    assert attitude.observability.rank == 3
    assert not attitude.covariance[:3].any()
    prior = cramer_rao(
        problem_at(gTb, [(2e3, 2e3)], prior=PosePrior(gTb, np.diag([1e-4] * 3 + [1e4] * 3))), gTb
    )
    assert prior.observability.rank == 6
    assert (np.diag(prior.covariance) < [1e-4] * 3 + [1e4] * 3).all()


def test_a_rims_covariance_is_the_scatter_of_fits_to_its_edge_points() -> None:
    camera = Camera(1024, 768, 1267.0, 1100.0, 500.0, 400.0)
    chart = np.array([0.1, -0.05, np.log(0.04), 0.3, np.log(0.02)])
    rng = np.random.default_rng(0)
    angles = 2.0 * np.pi * np.arange(50) / 50
    points, normals = points_and_normals(pixel_chart(chart, camera), angles)
    fits = [fit_edges(points + 0.5 * rng.normal(size=(50, 1)) * normals, camera, 0.5) for _ in range(800)]
    covariance = chart_covariance(chart, camera, 0.5, 50)
    scale = np.sqrt(np.diag(covariance))
    unit = 1.0 / np.outer(scale, scale)
    scatter = np.cov(np.array([fit[0] for fit in fits if fit is not None]).T)
    np.testing.assert_allclose(scatter * unit, covariance * unit, atol=0.16)
    own = np.mean([fit[1] for fit in fits if fit is not None], axis=0)
    np.testing.assert_allclose(own * unit, covariance * unit, atol=0.03)
    np.testing.assert_allclose(pixel_chart(chart, camera)[:2], points.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize("count", [12, 60])
@pytest.mark.parametrize("size_px", [4.0, 6.0])
def test_fits_to_small_rims_scatter_as_they_say_and_more_than_the_bound(size_px: float, count: int) -> None:
    """Squared distances of fits from the true rim, 5 expected, by each fit's own covariance."""
    scale = 1.0 / CAMERA.fx_px
    chart = np.array([0.05, -0.05, np.log(1.5 * size_px * scale), 0.2, np.log(size_px * scale)])
    rng = np.random.default_rng(1)
    spreads = {"own": [], "bound": [], "fit": []}
    bound = chart_covariance(chart, CAMERA, 1.0, count)
    expected = fit_covariance(chart, CAMERA, 1.0, count)
    for _ in range(1200):
        angles = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(count) / count
        points, normals = points_and_normals(pixel_chart(chart, CAMERA), angles)
        fit = fit_edges(points + rng.normal(size=(count, 1)) * normals, CAMERA, 1.0)
        if fit is None:
            continue
        error = fit[0] - chart
        for name, covariance in (("own", fit[1]), ("bound", bound), ("fit", expected)):
            spreads[name].append(error @ np.linalg.solve(covariance, error))
    assert len(spreads["own"]) > 1100
    # Sampling: 5 +- 3 * 0.1; of the smallest rims of few points the tails count.
    limit = 0.3 if size_px > 5.0 or count > 50 else 0.8
    assert np.mean(spreads["own"]) == pytest.approx(5.0, abs=limit)
    assert np.mean(spreads["fit"]) == pytest.approx(5.0, abs=limit)
    assert np.mean(spreads["bound"]) > 1.03 * np.mean(spreads["fit"])


def test_points_on_a_line_are_no_ellipse() -> None:
    line = np.column_stack([np.linspace(100.0, 200.0, 20), np.linspace(100.0, 200.0, 20)])
    assert fit_edges(line, CAMERA, 1.0) is None


@pytest.mark.parametrize("first", [0, 3])
def test_information_is_inverted_with_its_determinant(first: int) -> None:
    """Of radians and metres that differ by orders of magnitude."""
    root = np.random.default_rng(4).normal(size=(6, 6)) * np.array([1e4, 3e4, 2e4, 0.1, 0.02, 0.3])
    N, covariance = root.T @ root, np.empty((6, 6))
    log_det = covariance_and_log_det(N, first, covariance)
    estimated = N[first:, first:]
    assert log_det == pytest.approx(np.linalg.slogdet(estimated)[1], rel=1e-9)
    np.testing.assert_allclose(covariance[first:, first:] @ estimated, np.eye(6 - first), atol=1e-6)
    assert not covariance[:first].any()
    assert not covariance[:, :first].any()
    N[3, 3] = -N[3, 3]
    assert np.isnan(covariance_and_log_det(N, first, covariance))
