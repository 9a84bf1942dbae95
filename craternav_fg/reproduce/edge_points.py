"""Simulated edge points of the paper's flat scenes: the fitted rims, and the pose's Cramér-Rao bound."""

import numpy as np

from craternav_fg.ellipse import pixel_chart, points_and_normals
from craternav_fg.linalg import scaled_inverse
from craternav_fg.resection.edge_fit import fit_edges
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from craternav_fg.simulation.flat_scenes import CAMERA, FlatScene
from factors.arrays import FloatArray, IntArray
from factors.kernels import conic, rim

# Points of the polygon whose length stands for that of a rim in pixels.
_POLYGON_POINTS = 2000


def matched(scene: FlatScene, charts: FloatArray, covariance: FloatArray) -> ResectionProblem:
    """Resection problem of a scene whose craters were measured.

    Parameters
    ----------
    scene : FlatScene
    charts : ndarray, shape (n, 5)
        Measured rims in normalised image coordinates.
    covariance : ndarray, shape (n, 5, 5)

    Returns
    -------
    ResectionProblem
    """
    names = tuple(f"C{k}" for k in range(len(charts)))
    return ResectionProblem(MatchedRims(names, scene.centres, scene.axes, charts, covariance))


def arc_angles(rng: np.random.Generator, count: int, arc: float) -> FloatArray:
    """Ellipse parameters of edge points equally spaced over an arc of a rim; where it begins is random.

    Parameters
    ----------
    rng : Generator
    count : int
        Edge points.
    arc : float
        Share of the rim that they cover, 0 to 1.

    Returns
    -------
    ndarray, shape (count,)
        Radians.
    """
    return rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * arc * np.arange(count) / count


def pixel_arc(rng: np.random.Generator, chart: FloatArray, length_px: int) -> FloatArray:
    """Ellipse parameters of edge points one pixel apart along an arc, or along the whole rim if shorter.

    Parameters
    ----------
    rng : Generator
        Where the arc begins.
    chart : ndarray, shape (5,)
        In normalised image coordinates.
    length_px : int
        Length of the arc.

    Returns
    -------
    ndarray, shape (n,)
        Radians.
    """
    t = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 2.0 * np.pi, _POLYGON_POINTS)
    points, _ = points_and_normals(pixel_chart(chart, CAMERA), t)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.interp(np.arange(min(length_px, int(length[-1]))), length, t)


def measure(
    scene: FlatScene, rng: np.random.Generator, counts: IntArray, arc: float, sigma_px: float
) -> tuple[ResectionProblem | None, FloatArray]:
    """Simulate edge points, fit ellipses to them, and give the bound of the pose.

    Parameters
    ----------
    scene : FlatScene
    rng : Generator
    counts : ndarray of int, shape (n,)
        Edge points of each rim.
    arc : float
        Share of the rim that they cover, 0 to 1.
    sigma_px : float
        Noise of each coordinate of a point.

    Returns
    -------
    problem : ResectionProblem or None
        None when the points of some rim determine no ellipse.
    bound : ndarray, shape (6, 6)
        Cramér-Rao bound of the pose from the same points, for the right twist [w, rho], rad and m.
    """
    charts, covariances, angles = [], [], []
    for chart, count in zip(scene.charts, counts, strict=True):
        angles.append(arc_angles(rng, int(count), arc))
        points, _ = points_and_normals(pixel_chart(chart, CAMERA), angles[-1])
        fit = fit_edges(points + rng.normal(0.0, sigma_px, points.shape), CAMERA, sigma_px)
        if fit is not None:
            charts.append(fit[0])
            covariances.append(fit[1])
    bound = pose_bound(scene, angles, sigma_px)
    if len(charts) < len(scene.charts):
        return None, bound
    return matched(scene, np.array(charts), np.array(covariances)), bound


def pose_bound(scene: FlatScene, angles: list[FloatArray], sigma_px: float) -> FloatArray:
    """Cramér-Rao bound of the pose from edge points, exact for any arc.

    Parameters
    ----------
    scene : FlatScene
    angles : list of ndarray, shape (n_k,)
        Ellipse parameters of each rim's edge points, rad.
    sigma_px : float
        Noise of each coordinate of a point.

    Returns
    -------
    ndarray, shape (6, 6)
        Covariance of the right twist [w, rho], rad and m.
    """
    _, J, _ = conic.chart_jacobian(scene.gTc, np.eye(4), scene.centres, scene.axes)
    information = np.zeros((6, 6))
    for chart, slopes, t in zip(scene.charts, J, angles, strict=True):
        points, _ = points_and_normals(pixel_chart(chart, CAMERA), t)
        D = np.empty((len(t), 5))
        for row, point in zip(D, CAMERA.normalised(points), strict=True):
            rim.rim_distance(point[0], point[1], chart, row)
        A = D @ slopes * (CAMERA.fx_px / sigma_px)
        information += A.T @ A
    return scaled_inverse(information)
