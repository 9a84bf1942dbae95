"""Reprojections of tracked points: derivatives, whiteness at the truth, and the graph's own factor."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.estimators.point_features import UNIT_CALIBRATION, linearise_points, triangulated
from craternav_fg.sensors.point_features import FeatureSettings, FeatureSimulation, simulate_features
from craternav_fg.sensors.protocol import Surroundings

MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 0.0, 2.661_7e-6))
FLAT = Surroundings(MOON, lambda _: 0.0)
SIGMA = 2e-4


def scene(seed: int, count: int = 6) -> tuple[np.ndarray, np.ndarray, Camera]:
    """Ground points (n, 3) in view of a pose gTb (4, 4), and the camera."""
    rng = np.random.default_rng(seed)
    bTc = frames.pose(frames.rotation_exp(0.5 * rng.standard_normal(3)), rng.uniform(-2.0, 2.0, 3))
    camera = Camera(1024, 1024, 1267.2, 1267.2, 511.5, 511.5, bTc=bTc)
    height_m = 10.0 ** rng.uniform(1.5, 5.0)
    gTc = frames.pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, MOON.radius_m + height_m]))
    gL = np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)) * height_m, np.full(count, MOON.radius_m)])
    return gL, gTc @ frames.inverse(bTc), camera


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_are_those_of_central_differences(seed: int) -> None:
    gL, gTb, camera = scene(seed)
    u = np.zeros((len(gL), 2))
    range_m = float(np.linalg.norm(gL[0] - gTb[:3, 3]))

    def predicted(points: np.ndarray, step: np.ndarray) -> np.ndarray:
        pose = frames.pose(gTb[:3, :3] @ frames.rotation_exp(step[:3]), gTb[:3, 3] + step[3:])
        return -linearise_points(points, np.broadcast_to(pose, (len(gL), 4, 4)), u, camera, SIGMA)[0]

    _, of_point, of_pose = linearise_points(gL, np.broadcast_to(gTb, (len(gL), 4, 4)), u, camera, SIGMA)
    for j, size in enumerate(np.repeat([1e-4, 1e-4 * range_m], 3)):
        step = np.zeros(6)
        step[j] = size
        slope = (predicted(gL, step) - predicted(gL, -step)) / (2.0 * size)
        np.testing.assert_allclose(of_pose[:, :, j], slope, atol=1e-6 * np.abs(of_pose[:, :, j]).max())
    for j in range(3):
        shift = np.zeros(3)
        shift[j] = 1e-4 * range_m
        ends = predicted(gL + shift, np.zeros(6)) - predicted(gL - shift, np.zeros(6))
        slope = ends / (2.0 * shift[j])
        np.testing.assert_allclose(of_point[:, :, j], slope, atol=1e-6 * np.abs(of_point).max())


@pytest.mark.parametrize("seed", range(3))
def test_the_graphs_factor_is_the_filters_measurement(seed: int) -> None:
    gL, gTb, camera = scene(seed)
    u = np.random.default_rng(seed).normal(scale=0.1, size=(len(gL), 2))
    residual, of_point, of_pose = linearise_points(
        gL, np.broadcast_to(gTb, (len(gL), 4, 4)), u, camera, SIGMA
    )
    noise = gtsam.noiseModel.Isotropic.Sigma(2, SIGMA)
    for k, point in enumerate(gL):
        factor = gtsam.GenericProjectionFactorCal3_S2(
            u[k], noise, X(0), L(0), UNIT_CALIBRATION, False, False, gtsam.Pose3(camera.bTc)
        )
        values = gtsam.Values()
        values.insert(X(0), gtsam.Pose3(gTb))
        values.insert(L(0), point)
        J, b = factor.linearize(values).jacobian()
        np.testing.assert_allclose(b, residual[k], rtol=1e-6, atol=1e-6)
        ours = np.hstack([of_pose[k, :, :3], of_pose[k, :, 3:] @ gTb[:3, :3], of_point[k]])
        np.testing.assert_allclose(J, ours, rtol=1e-5, atol=1e-7 * np.abs(J).max())


def test_observations_at_the_truth_are_white() -> None:
    _, gTb, camera = scene(0)
    rng = np.random.default_rng(1)
    poses = []
    for k in range(40):
        moved = gTb.copy()
        moved[:3, 3] += [200.0 * k, 0.0, 0.0]
        poses.append((k, moved))
    settings = FeatureSettings(sigma_px=0.3)
    tracks = simulate_features(settings, FeatureSimulation(count=50), camera, poses, FLAT, rng)
    sigma = settings.sigma_px / camera.focal_px
    errors = []
    for track in np.unique(tracks.tracks):
        mine = np.flatnonzero(tracks.tracks == track)
        seen = np.array([poses[k][1] for k in tracks.stamps_ns[mine]])
        u = camera.normalised(tracks.points_px[mine])
        gTc = camera.gTc(seen)
        rays = np.column_stack([u, np.ones(len(u))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        point = triangulated(gTc[:, :3, 3], np.einsum("nij,nj->ni", gTc[:, :3, :3], rays), sigma)
        if point is None or len(mine) < 5:
            continue
        residual, of_point, _ = linearise_points(np.tile(point, (len(u), 1)), seen, u, camera, sigma)
        # What the point cannot take up: of dimension 2 n - 3.
        null = np.linalg.qr(of_point.reshape(-1, 3), mode="complete")[0][:, 3:]
        errors.append(null.T @ residual.ravel())
    every = np.concatenate(errors)
    assert len(every) > 500
    assert abs(np.mean(every**2) - 1.0) < 4.0 * np.sqrt(2.0 / len(every))
