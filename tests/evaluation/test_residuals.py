"""Residuals of rims at trajectories, with all that was estimated beside the states."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.evaluation.residuals import (
    outlier_share,
    outlying_craters,
    poses_at_exposure,
    rim_residuals,
)
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline.reconstruct import _joined
from craternav_fg.trajectory import Calibrated, Trajectory
from factors.kernels import conic

CAMERA = Camera(512, 512, 500.0, 500.0, 255.5, 255.5, frames.pose(np.eye(3), np.array([0.3, 0.1, 0.5])))
RATE, VELOCITY = np.array([0.02, -0.03, 0.01]), np.array([-40.0, 30.0, 5.0])
NONE = np.zeros(3)


@pytest.fixture
def catalog() -> Catalog:
    longitude = np.array([0.0, 0.002, -0.003])
    return Catalog(
        ("A", "B", "C"), np.array([0.001, -0.002, 0.002]), longitude, np.full(3, 900.0), np.full(3, 700.0),
        np.array([0.2, 1.0, 2.0]), np.zeros(3), Body("Moon", 1.7374e6, 4.9e12, (0.0, 0.0, 0.0)),
    )  # fmt: skip


def pose(second: float) -> np.ndarray:
    """Pose (4, 4) above the craters, turning and moving evenly."""
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return frames.pose(
        down @ frames.rotation_exp(second * RATE), np.array([1.7374e6 + 30e3, 0, 0]) + second * VELOCITY
    )


SECONDS = np.array([0.0, 2.0, 3.0])


@pytest.fixture
def trajectory() -> Trajectory:
    gTb = np.array([pose(second) for second in SECONDS])
    stamps = np.round(1e9 * SECONDS).astype(np.int64)
    return Trajectory(stamps, gTb, np.tile(VELOCITY, (3, 1)), np.zeros((3, 6)))


def images(gTb: np.ndarray, catalog: Catalog, off: np.ndarray) -> list[FrameMeasurement]:
    """Rims as seen from poses, each off by (5,) of its standard deviations."""
    root = 1e-4 * np.linalg.cholesky(0.5 * np.eye(5) + 0.5)
    out = []
    for k, T in enumerate(gTb):
        chart, ahead = conic.project_rims(np.ascontiguousarray(T), CAMERA.bTc, catalog.centres, catalog.axes)
        assert ahead.all()
        rims = RimSet(np.arange(3), chart + off @ root.T, np.tile(root @ root.T, (3, 1, 1)))
        out.append(FrameMeasurement(k, rims, None))
    return out


def test_residuals_are_in_standard_deviations(trajectory: Trajectory, catalog: Catalog) -> None:
    off = np.array([0.0, 3.0, 0.0, -4.0, 0.0])
    found = rim_residuals(trajectory, images(trajectory.gTb, catalog, off), CAMERA, catalog)
    assert found.shape == (9, 5)
    assert_allclose(np.linalg.norm(found, axis=1), 5.0)
    assert rim_residuals(trajectory.take(np.arange(0)), [], CAMERA, catalog).shape == (0, 5)


def test_what_was_estimated_beside_the_states_is_applied(trajectory: Trajectory, catalog: Catalog) -> None:
    """Images 50 ms late, of a camera that is mounted otherwise, and of a crater that lies elsewhere."""
    late_s, turn = 0.05, np.array([2e-3, -1e-3, 3e-3])
    gTb = np.array([pose(second + late_s) for second in SECONDS])
    gTb[:, :3, :3] = gTb[:, :3, :3] @ frames.rotation_exp(turn)
    calibrated = Calibrated(mounting_rad=(turn, NONE), time_offset_s=(late_s, 0.0))
    told = replace(trajectory, calibrated=calibrated)
    assert_allclose(poses_at_exposure(told), gTb, atol=1e-6)
    assert_allclose(poses_at_exposure(trajectory), trajectory.gTb)
    mounted = poses_at_exposure(replace(trajectory, calibrated=Calibrated(mounting_rad=(turn, NONE))))
    assert_allclose(mounted[:, :3, :3], trajectory.gRb @ frames.rotation_exp(turn))
    assert_allclose(mounted[:, :3, 3], trajectory.gP)
    # One frame tells no angular velocity.
    one = poses_at_exposure(
        replace(told.take(np.array([1])), calibrated=Calibrated(time_offset_s=(late_s, 0.0)))
    )
    assert_allclose(one, trajectory.gTb[1:2])

    # By a hundredth of its radius along its major axis.
    step = 0.01 * np.sqrt(900.0 * 700.0)
    angle = catalog.angle_rad[1]
    lat, lon = catalog.latitude_rad.copy(), catalog.longitude_rad.copy()
    lon[1] += step * np.cos(angle) / 1.7374e6 / np.cos(lat[1])
    lat[1] += step * np.sin(angle) / 1.7374e6
    moved = replace(catalog, latitude_rad=lat, longitude_rad=lon)
    measured = images(gTb, moved, np.zeros(5))
    map_errors = {1: (np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(6))}
    for known, most in ((map_errors, 0.05), (None, np.inf)):
        found = rim_residuals(
            replace(told, calibrated=replace(calibrated, map_errors=known)), measured, CAMERA, catalog
        )
        off = np.linalg.norm(found, axis=1)
        assert off.max() < most
        assert (off.reshape(3, 3).argmax(axis=1) == 1).all()
    assert off.max() > 1.0


def test_rims_without_a_residual_are_outliers() -> None:
    residuals = np.zeros((5, 5))
    residuals[0] = np.nan
    residuals[1, 2] = -7.2
    residuals[2] = 3.0
    residuals[3, 0] = np.inf
    assert outlier_share(residuals) == pytest.approx(3.0 / 5.0)
    assert outlier_share(np.zeros((0, 5))) is None


def test_each_segment_has_its_own_calibration(trajectory: Trajectory, catalog: Catalog) -> None:
    turns = (np.array([2e-3, -1e-3, 3e-3]), np.array([-4e-3, 1e-3, 0.0]))
    gTb = trajectory.gTb.copy()
    for rows, turn in zip(([0, 1], [2]), turns, strict=True):
        gTb[rows, :3, :3] = gTb[rows, :3, :3] @ frames.rotation_exp(turn)
    parts = [
        replace(trajectory.take(np.array(rows)), calibrated=Calibrated(mounting_rad=(turn, NONE)))
        for rows, turn in zip(([0, 1], [2]), turns, strict=True)
    ]
    joined = _joined(parts)
    measured = images(gTb, catalog, np.zeros(5))
    assert_allclose(poses_at_exposure(joined), gTb, atol=1e-9)
    assert_allclose(rim_residuals(joined, measured, CAMERA, catalog), 0.0, atol=1e-4)
    some = joined.take(np.array([1, 2]))
    assert_allclose(rim_residuals(some, measured[1:], CAMERA, catalog), 0.0, atol=1e-4)
    assert poses_at_exposure(joined.take(np.arange(0))).shape == (0, 4, 4)


def test_craters_that_contradict_the_others() -> None:
    """One crater of twelve, in most of its frames; two of two are no matter of the craters."""

    def frames_of(craters: int) -> list[FrameMeasurement]:
        rims = RimSet(np.arange(craters), np.zeros((craters, 5)), np.tile(np.eye(5), (craters, 1, 1)))
        return [FrameMeasurement(k, rims, None) for k in range(5)]

    residuals = np.zeros((60, 5))
    residuals[7::12] = 8.0
    assert outlying_craters(residuals, frames_of(12)) == {7: 5}
    residuals[7] = 0.0
    assert outlying_craters(residuals, frames_of(12)) == {7: 5}
    residuals[19] = 0.0
    assert outlying_craters(residuals, frames_of(12)) == {}
    assert outlying_craters(np.full((10, 5), 8.0), frames_of(2)) == {}
    assert outlying_craters(np.full((2, 5), 8.0), frames_of(1)[:2]) == {}
    assert outlying_craters(np.empty((0, 5)), []) == {}
