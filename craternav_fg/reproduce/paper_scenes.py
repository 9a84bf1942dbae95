"""The paper's simulated views: flat ground, craters in one plane, a camera of 44 deg by 44 deg.

g has its origin on the ground, z up; body and camera are one (bTc = 1).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.errors import CraternavError
from craternav_fg.reproduce.options import SEMI_AXES_M
from craternav_fg.resection.edge_fit import fit_edges, rim_points
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.kernels import conic, rim

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_HALF_FIELD = float(np.tan(np.deg2rad(22.0)))
_FOCAL_PX = 512.0 / _HALF_FIELD
CAMERA = Camera(1024, 1024, _FOCAL_PX, _FOCAL_PX, 511.5, 511.5)
_NADIR = np.diag([1.0, -1.0, -1.0])
_TRIES = 200
_RESTARTS = 300
# Samples of a rim by which its length in pixels is measured.
_ARC_SAMPLES = 2000


@dataclass(frozen=True)
class Scene:
    """Craters, and a camera that sees them whole.

    Attributes
    ----------
    gTc : ndarray, shape (4, 4)
        Pose of the camera (and body) in g, m.
    centres, axes : ndarray, shape (n, 3), (n, 2, 3)
        Rims in g, m.
    charts : ndarray, shape (n, 5)
        Their images, without noise.
    """

    gTc: FloatArray
    centres: FloatArray
    axes: FloatArray
    charts: FloatArray


def tilted_camera(
    altitude: float, tilt_rad: float, azimuth_rad: float = 0.0, roll_rad: float = 0.0
) -> FloatArray:
    """Pose gTc (4, 4) of a camera above the origin, its axis off nadir by a tilt."""
    tilt = tilt_rad * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    roll = np.array([0.0, 0.0, roll_rad])
    R = _NADIR @ frames.rotation_exp(tilt) @ frames.rotation_exp(roll)
    return frames.pose(R, np.array([0.0, 0.0, altitude]))


def ground_point(gTc: FloatArray, point: FloatArray) -> FloatArray:
    """Point (3,) of the ground that a normalised image point (2,) shows."""
    d = gTc[:3, :3] @ np.append(point, 1.0)
    return np.asarray(gTc[:3, 3] - d * gTc[2, 3] / d[2])


def flat_axes(semi_major: float, semi_minor: float, angle_rad: float) -> FloatArray:
    """Semi-axes (2, 3) of a rim that lies on the ground."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[semi_major * c, semi_major * s, 0.0], [-semi_minor * s, semi_minor * c, 0.0]])


def inside(charts: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether the rims of charts (n, 5) lie wholly in the image."""
    sx = np.exp(charts[:, 2])
    sy = np.hypot(np.exp(charts[:, 4]), charts[:, 3] * sx)
    m = np.abs(charts[:, :2])
    return np.asarray((m[:, 0] + sx < _HALF_FIELD) & (m[:, 1] + sy < _HALF_FIELD))


def random_scene(
    rng: np.random.Generator,
    craters: int,
    altitude_m: float,
    semi_axes_m: tuple[float, float] = SEMI_AXES_M,
    *,
    max_tilt_deg: float = 30.0,
) -> Scene:
    """Case one and two of the paper: craters apart from one another, wholly in the image.

    At low altitude the image has no room for many large craters, and
    those that fit are smaller.

    Parameters
    ----------
    rng : numpy.random.Generator
    craters : int
    altitude_m : float
    semi_axes_m : tuple of float
        Each semi-axis is uniform between these; the longer of two is the major one.
    max_tilt_deg : float
        Of the optical axis from the craters' normal; uniform from 0.

    Raises
    ------
    CraternavError
        When the image has no room for that many.
    """
    for _ in range(_RESTARTS):
        tilt = np.deg2rad(max_tilt_deg) * rng.uniform()
        gTc = tilted_camera(altitude_m, tilt, *rng.uniform(0.0, 2.0 * np.pi, 2))
        centres: list[FloatArray] = []
        axes: list[FloatArray] = []
        charts: list[FloatArray] = []
        reach: list[float] = []
        for _ in range(_TRIES):
            b, a = np.sort(rng.uniform(*semi_axes_m, 2))
            axis = flat_axes(a, b, rng.uniform(0.0, np.pi))
            centre = ground_point(gTc, rng.uniform(-_HALF_FIELD, _HALF_FIELD, 2))
            chart, visible = conic.project_rims(gTc, np.eye(4), centre[None], axis[None])
            if not (visible[0] and inside(chart)[0]):
                continue
            # Apart for certain: circles about the rims do not meet.
            if any(np.hypot(*(centre - c)[:2]) < r + a for c, r in zip(centres, reach, strict=True)):
                continue
            centres.append(centre)
            axes.append(axis)
            charts.append(chart[0])
            reach.append(a)
            if len(centres) == craters:
                return Scene(gTc, np.array(centres), np.array(axes), np.array(charts))
    raise CraternavError(
        f"no room for {craters} craters with semi-axes of {semi_axes_m[0]:g} m or more in the image from "
        f"{altitude_m / 1e3:g} km: expected fewer craters or a higher altitude"
    )


def random_triple(rng: np.random.Generator, altitude: float, tilt_rad: float) -> Scene:
    """Section 2 of the paper: three circles of radius 1 wholly in the image, which may overlap.

    Three that do not overlap have no room in the image from an altitude of 5 radii.
    """
    gTc = tilted_camera(altitude, tilt_rad, *rng.uniform(0.0, 2.0 * np.pi, 2))
    axes = np.repeat(flat_axes(1.0, 1.0, 0.0)[None], 3, axis=0)
    while True:
        points = rng.uniform(-_HALF_FIELD, _HALF_FIELD, (3, 2))
        centres = np.array([ground_point(gTc, point) for point in points])
        charts, visible = conic.project_rims(gTc, np.eye(4), centres, axes)
        if visible.all() and inside(charts).all():
            return Scene(gTc, centres, axes, charts)


def matched(scene: Scene, charts: FloatArray, covariance: FloatArray) -> ResectionProblem:
    """Pose a static problem of a scene's craters with measured charts (n, 5) and covariances (n, 5, 5)."""
    names = tuple(f"C{k}" for k in range(len(charts)))
    return ResectionProblem(MatchedRims(names, scene.centres, scene.axes, charts, covariance))


def arc_angles(rng: np.random.Generator, count: int, arc: float) -> FloatArray:
    """Parameters (count,) of edge points equally spaced over a part `arc` of a rim, of 1, begun anywhere."""
    return rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * arc * np.arange(count) / count


def pixel_arc(rng: np.random.Generator, chart: FloatArray, length_px: int) -> FloatArray:
    """Parameters of edge points one pixel apart along an arc of a length in pixels, or the whole rim."""
    t = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 2.0 * np.pi, _ARC_SAMPLES)
    points, _ = rim_points(chart, CAMERA, t)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.interp(np.arange(min(length_px, int(length[-1]))), length, t)


def measure(
    scene: Scene, rng: np.random.Generator, counts: IntArray, arc: float, sigma_px: float
) -> tuple[ResectionProblem | None, FloatArray]:
    """Edge points with noise, ellipses through them, and the bound.

    Parameters
    ----------
    scene : Scene
    rng : numpy.random.Generator
    counts : ndarray of int, shape (n,)
        Edge points of each rim.
    arc : float
        Part of the rim, of 1, that they cover.
    sigma_px : float
        Noise of each coordinate of a point.

    Returns
    -------
    problem : ResectionProblem or None
        None when points determine no ellipse.
    bound : ndarray, shape (6, 6)
        Cramér-Rao bound of the pose from the same points, for the right twist [w, rho].
    """
    charts, covariances, angles = [], [], []
    for chart, count in zip(scene.charts, counts, strict=True):
        angles.append(arc_angles(rng, int(count), arc))
        points, _ = rim_points(chart, CAMERA, angles[-1])
        fit = fit_edges(points + rng.normal(0.0, sigma_px, points.shape), CAMERA, sigma_px)
        if fit is not None:
            charts.append(fit[0])
            covariances.append(fit[1])
    bound = pose_bound(scene, angles, sigma_px)
    if len(charts) < len(scene.charts):
        return None, bound
    return matched(scene, np.array(charts), np.array(covariances)), bound


def pose_bound(scene: Scene, angles: list[FloatArray], sigma_px: float) -> FloatArray:
    """Cramér-Rao bound (6, 6) of the pose from edge points at parameters of each rim, exact for any arc."""
    _, J, _ = conic.chart_jacobian(scene.gTc, np.eye(4), scene.centres, scene.axes)
    information = np.zeros((6, 6))
    for chart, slopes, t in zip(scene.charts, J, angles, strict=True):
        points, _ = rim_points(chart, CAMERA, t)
        D = np.empty((len(t), 5))
        for row, point in zip(D, CAMERA.normalised(points), strict=True):
            rim.rim_distance(point[0], point[1], chart, row)
        A = D @ slopes * (CAMERA.fx_px / sigma_px)
        information += A.T @ A
    # Scaled before inversion: radians and metres differ by six orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))
