"""Cost of the resection solver: without a start, and against SciPy on the same residual and start."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from craternav_fg.bench.timing import seconds_of
from craternav_fg.ellipse import chart_covariance
from craternav_fg.resection.efficient import refine, solve
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from craternav_fg.simulation.flat_scenes import CAMERA
from craternav_fg.simulation.scenes import ALTITUDE_M
from factors.arrays import FloatArray
from factors.kernels import packed
from factors.kernels.conic import project_rims
from factors.kernels.gauss_newton import screw

# Edge points of a rim, as in the simulations of the paper's cases.
EDGE_POINTS = 60
# Standard deviations of the start for both sides, rad and m: about those of a single rim's pose.
START_SIGMA = np.repeat([np.radians(2.0), 1e3], 3)


def resection_scalars(repetitions: int = 200) -> dict[str, float]:
    """Measure the resection solver.

    Parameters
    ----------
    repetitions : int
        Problems of each size.

    Returns
    -------
    dict of str to float
        `pose_ms_n3`, `pose_ms_n10`: median milliseconds of `solve`, without a start, with covariance;
        `pose_vs_scipy_ratio`: median cost of `refine`, with covariance, over that of
        `scipy.optimize.least_squares` with its default settings, three rims.
    """
    rng = np.random.default_rng(4)
    out = {}
    for n in (3, 10):
        problems = [_problem(rng, n) for _ in range(repetitions)]
        solve(problems[0])
        out[f"pose_ms_n{n}"] = 1e3 * float(
            np.median([seconds_of(lambda p=problem: solve(p)) for problem in problems])  # type: ignore[misc]
        )
    return {**out, "pose_vs_scipy_ratio": _scipy_ratio(rng, repetitions)}


def _scipy_ratio(rng: np.random.Generator, repetitions: int) -> float:
    ratios = []
    for _ in range(repetitions):
        problem = _problem(rng, 3)
        start = solve(problem).poses[0].gTb.copy()
        screw(start, START_SIGMA * rng.normal(size=6))
        ours, theirs = _ours(problem, start), _scipy(problem, start)
        ours(), theirs()
        # Not alternately: each call would find the caches filled by the other side.
        times = [np.median([seconds_of(run) for _ in range(5)]) for run in (ours, theirs)]
        ratios.append(times[0] / times[1])
    return float(np.median(ratios))


def _ours(problem: ResectionProblem, start: FloatArray) -> Callable[[], object]:
    return lambda: refine(problem, start)


def _scipy(problem: ResectionProblem, start: FloatArray) -> Callable[[], object]:
    data = problem.rims.packed(problem.bTc)
    rows = np.empty((7, 5 * len(problem.rims)))
    scale = np.repeat([1.0, ALTITUDE_M], 3)

    def residual(x: FloatArray) -> FloatArray:
        gTb = start.copy()
        screw(gTb, x)
        packed.shape_residuals(gTb, data, False, rows)
        return rows[6].copy()

    return lambda: least_squares(residual, np.zeros(6), x_scale=scale)


def _problem(rng: np.random.Generator, n: int) -> ResectionProblem:
    """Flat terrain from 50 km, up to 30 deg off nadir, n rims in view with noise."""
    tilt, turn, roll = rng.uniform(0.0, [np.radians(30.0), 2.0 * np.pi, 2.0 * np.pi])
    down = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    across = np.array([-np.sin(turn), np.cos(turn), 0.0])
    x = np.cos(roll) * across + np.sin(roll) * np.cross(down, across)
    gTb = np.eye(4)
    gTb[:3, :3] = np.stack([x, np.cross(down, x), down], axis=-1)
    gTb[2, 3] = ALTITUDE_M
    sight = np.concatenate([rng.uniform(-0.35, 0.35, (n, 2)), np.ones((n, 1))], axis=1) @ gTb[:3, :3].T
    centres = gTb[:3, 3] - sight * (ALTITUDE_M / sight[:, 2:])
    sizes = np.sort(rng.uniform(500.0, 2500.0, (n, 2)), axis=1)[:, ::-1]
    angle = rng.uniform(0.0, np.pi, n)
    axes = np.zeros((n, 2, 3))
    axes[:, 0, 0], axes[:, 0, 1] = sizes[:, 0] * np.cos(angle), sizes[:, 0] * np.sin(angle)
    axes[:, 1, 0], axes[:, 1, 1] = -sizes[:, 1] * np.sin(angle), sizes[:, 1] * np.cos(angle)
    charts, _ = project_rims(gTb, np.eye(4), centres, axes)
    covariance = chart_covariance(charts, CAMERA, 1.0, EDGE_POINTS)
    noise = np.linalg.cholesky(covariance) @ rng.normal(size=(n, 5, 1))
    names = tuple(str(k) for k in range(n))
    return ResectionProblem(MatchedRims(names, centres, axes, charts + noise[..., 0], covariance))
