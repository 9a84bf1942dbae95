"""Flat ground with craters in view: the truth, and what a camera measures."""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_covariance, pixel_chart, points_and_normals
from craternav_fg.resection.edge_fit import fit_edges
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

FOCAL_PX = 512 / np.tan(np.radians(22))
# Turned and off the body's origin: a mistake in the mounting shows.
bTc = frames.pose(frames.rotation_exp(np.array([0.4, -0.3, 1.2])), np.array([1.2, -0.3, 0.8]))
CAMERA = Camera(1024, 1024, FOCAL_PX, FOCAL_PX, 511.5, 511.5, bTc)
EDGE_SIGMA_PX = 1.0


@dataclass(frozen=True)
class Scene:
    """A true pose, the problem as measured, and the same with the true charts and their covariances."""

    gTb: FloatArray
    measured: ResectionProblem
    true: ResectionProblem


def make_scene(
    rng: np.random.Generator, altitude_m: float, count: int, *, drawn: bool = False,
    off_nadir_deg: tuple[float, float] = (0.0, 30.0), circles: bool = False,
) -> Scene:  # fmt: skip
    """Draw a scene: semi-axes of 0.5 to 2.5 km, 10 to 100 edge points round each rim, 1 px.

    The measured charts are fitted to edge points with noise along the rim's normal; `drawn`, they come from
    the covariance that such points give at the true rim.
    """
    while True:
        gTc = camera_pose(rng, altitude_m, np.radians(rng.uniform(*off_nadir_deg)))
        centres, axes, charts = _craters(rng, gTc, count, circles)
        if len(charts) < count:
            continue
        covariances, measured, spread = [], [], []
        for chart in charts:
            points = int(rng.integers(10, 101))
            covariance = chart_covariance(chart, CAMERA, EDGE_SIGMA_PX, points)
            covariances.append(covariance)
            fit = (
                (chart + np.linalg.cholesky(covariance) @ rng.normal(size=5), covariance)
                if drawn
                else _fitted(rng, chart, points)
            )
            if fit is not None:
                measured.append(fit[0])
                spread.append(fit[1])
        if len(measured) == count:
            break
    names = tuple(f"c{k}" for k in range(count))
    true = MatchedRims(names, centres, axes, charts, np.array(covariances))
    problem = ResectionProblem(true, bTc)
    rims = replace(true, chart=np.array(measured), covariance=np.array(spread))
    return Scene(gTc @ frames.inverse(bTc), replace(problem, rims=rims), problem)


def camera_pose(rng: np.random.Generator, altitude_m: float, off_nadir_rad: float) -> FloatArray:
    """Pose gTc (4, 4) above the origin of flat ground, z up, that looks so far off nadir, with any roll."""
    turn, roll = rng.uniform(0.0, 2.0 * np.pi, 2)
    spin = frames.rotation_exp(np.array([0.0, 0.0, turn]))
    tilt = frames.rotation_exp(np.array([np.pi - off_nadir_rad, 0.0, 0.0]))
    return frames.pose(
        spin @ tilt @ frames.rotation_exp(np.array([0.0, 0.0, roll])), np.array([0.0, 0.0, altitude_m])
    )


def on_ground(gTc: FloatArray, pixel: FloatArray) -> FloatArray | None:
    """Ground point (3,) that a pixel shows, None above some 3 deg below the horizon."""
    ray = gTc[:3, :3] @ np.append(CAMERA.normalised(pixel), 1.0)
    return None if ray[2] > -0.05 else gTc[:3, 3] - ray * (gTc[2, 3] / ray[2])


def level_axes(a: float, b: float, angle: float) -> FloatArray:
    """Semi-axes (2, 3) of a level rim."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[a * c, a * s, 0.0], [-b * s, b * c, 0.0]])


def _craters(
    rng: np.random.Generator, gTc: FloatArray, count: int, circles: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    centres, axes, charts = [], [], []
    for _ in range(300):
        if len(charts) == count:
            break
        centre = on_ground(gTc, rng.uniform(0.0, 1023.0, 2))
        if centre is None:
            continue
        b, a = np.sort(rng.uniform(500.0, 2500.0, 2))
        rim = level_axes(a, a if circles else b, rng.uniform(0.0, np.pi))
        chart, seen = project_rims(gTc, np.eye(4), centre[None], rim[None])
        if not seen[0]:
            continue
        points, _ = points_and_normals(pixel_chart(chart[0], CAMERA), np.linspace(0.0, 2.0 * np.pi, 20))
        if CAMERA.contains(points).all():
            centres.append(centre)
            axes.append(rim)
            charts.append(chart[0])
    return np.array(centres), np.array(axes), np.array(charts)


def _fitted(rng: np.random.Generator, chart: FloatArray, count: int) -> tuple[FloatArray, FloatArray] | None:
    angles = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(count) / count
    points, normals = points_and_normals(pixel_chart(chart, CAMERA), angles)
    return fit_edges(points + EDGE_SIGMA_PX * rng.normal(size=(count, 1)) * normals, CAMERA, EDGE_SIGMA_PX)
