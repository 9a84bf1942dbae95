"""Simulated edge points: the arcs they cover, the fitted rims, and the bound of the pose."""

import numpy as np
import pytest

from craternav_fg.ellipse import chart_covariance, pixel_chart, points_and_normals
from craternav_fg.reproduce.edge_points import arc_angles, matched, measure, pixel_arc, pose_bound
from craternav_fg.resection.bounds import cramer_rao
from craternav_fg.simulation.flat_scenes import CAMERA, random_scene


def test_arcs_have_the_length_asked_for() -> None:
    rng = np.random.default_rng(0)
    scene = random_scene(rng, 2, 20e3)
    angles = arc_angles(rng, 50, 0.5)
    assert np.ptp(angles) == pytest.approx(np.pi * 49 / 50)
    points, _ = points_and_normals(pixel_chart(scene.charts[0], CAMERA), pixel_arc(rng, scene.charts[0], 40))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert len(points) == 40
    np.testing.assert_allclose(steps, 1.0, atol=0.01)


def test_bound_of_full_rims_is_the_resection_solvers() -> None:
    rng = np.random.default_rng(1)
    scene = random_scene(rng, 3, 50e3)
    counts = np.array([20, 50, 90])
    S = np.array([chart_covariance(y, CAMERA, 0.7, n) for y, n in zip(scene.charts, counts, strict=True)])
    expected = cramer_rao(matched(scene, scene.charts, S), scene.gTc).covariance
    _, bound = measure(scene, rng, counts, 1.0, 0.7)
    scale = np.sqrt(np.diag(expected))
    # Where the points of a rim begin is random.
    np.testing.assert_allclose(np.sqrt(np.diag(bound)) / scale, 1.0, rtol=0.02)
    half, _ = measure(scene, rng, counts, 0.5, 0.7)
    assert half is not None
    assert half.rims.covariance[0, 2, 2] > 2.0 * S[0, 2, 2]


def test_bound_falls_with_noise_and_grows_on_arcs() -> None:
    rng = np.random.default_rng(2)
    scene = random_scene(rng, 3, 20e3)
    full = [np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)] * 3
    half = [np.linspace(0.0, np.pi, 60, endpoint=False)] * 3
    np.testing.assert_allclose(pose_bound(scene, full, 0.5), 0.25 * pose_bound(scene, full, 1.0), rtol=1e-9)
    assert np.trace(pose_bound(scene, half, 1.0)[3:, 3:]) > 1.2 * np.trace(
        pose_bound(scene, full, 1.0)[3:, 3:]
    )
