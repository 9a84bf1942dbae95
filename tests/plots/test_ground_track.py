"""Downrange and crossrange of trajectories that go far around the body."""

import numpy as np
import numpy.typing as npt
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.plots.ground_track import GroundTrack
from craternav_fg.plots.trajectories import draw_descent
from craternav_fg.reports.charts import track_chart
from craternav_fg.trajectory import Trajectory
from tests.plots.test_trajectories import MOON

RADIUS_KM = 1e-3 * MOON.radius_m


def orbit(revolutions: float, frames_count: int = 80) -> Trajectory:
    """Eastwards along the equator, 100 km high."""
    angle = np.linspace(0.0, 2.0 * np.pi * revolutions, frames_count)
    up = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    gTb = np.stack([frames.pose(np.eye(3), (MOON.radius_m + 100e3) * one) for one in up])
    zero = np.zeros((frames_count, 3))
    return Trajectory(np.arange(frames_count) * 10**9, gTb, zero, np.zeros((frames_count, 6)))


def craters(longitudes_deg: list[float]) -> Catalog:
    """Craters on the equator."""
    zero = np.zeros(len(longitudes_deg))
    names = tuple(f"{value:g}" for value in longitudes_deg)
    return Catalog(
        names, zero, np.radians(longitudes_deg), zero + 9e3, zero + 7e3, zero + 0.5, zero, MOON
    )  # fmt: skip


@pytest.mark.parametrize("revolutions", [0.1, 0.6, 0.95, 1.3])
def test_downrange_grows_along_an_orbit(revolutions: float) -> None:
    gP = orbit(revolutions).gP
    downrange_km, crossrange_km = GroundTrack.along(gP, MOON).ranges_km(gP)
    expected_km = 2.0 * np.pi * RADIUS_KM * np.linspace(0.0, revolutions, 80)
    np.testing.assert_allclose(downrange_km, expected_km, atol=1e-6)
    np.testing.assert_allclose(crossrange_km, 0.0, atol=1e-6)


def test_a_slanted_descent_ends_on_its_track() -> None:
    """Noise of a descent straight down in all but 10 m: its direction is that between its ends."""
    rng = np.random.default_rng(1)
    gP = np.array([MOON.radius_m, 0.0, 0.0]) + rng.normal(0.0, 1.0, (50, 3))
    gP[-1] = gP[0] + [-20e3, 0.0, 10.0]
    _, crossrange_km = GroundTrack.along(gP, MOON).ranges_km(gP)
    assert abs(crossrange_km[-1]) < 1e-6


@pytest.mark.parametrize("revolutions", [0.8, 1.3])
def test_craters_are_below_the_orbit_that_passes_them(revolutions: float) -> None:
    """In each revolution, and in one piece on the far side."""
    found, orbited = craters([10.0, 180.0, 250.0, 330.0]), orbit(revolutions)
    expected_deg = [10.0, 180.0, 250.0, 330.0, 370.0][: 3 if revolutions < 1.0 else 5]
    expected_km = np.radians(expected_deg) * RADIUS_KM
    axes = draw_descent(orbited, None, found, MOON).axes[1]
    drawn_km = np.sort(axes.collections[0].get_offsets()[:, 0])
    np.testing.assert_allclose(drawn_km, expected_km, atol=1e-6)
    outlines = track_chart({"smoother": orbited}, None, found, MOON).spec["data"][0]["x"]
    x: npt.NDArray[np.float64] = np.array(outlines, dtype=float).reshape(-1, 26)[:, :25]
    assert np.ptp(x, axis=1).max() < 20.0
    for place_km in expected_km:
        assert np.abs(x.mean(axis=1) - place_km).min() < 1.0
