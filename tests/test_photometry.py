"""Brightness of the ground."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from craternav_fg.photometry import flat_terrain_brightness, lunar_lambert_share, slope_curvature

SUN = np.array([0.6, 0.0, 0.8])


def tilted(slope_x: float, slope_y: float) -> np.ndarray:
    """Unit normal of ground z = slope_x x + slope_y y."""
    normal = np.array([[-slope_x, -slope_y, 1.0]])
    return normal / np.linalg.norm(normal)


@pytest.mark.parametrize("view", [[0.0, 0.0, 1.0], [0.48, 0.36, 0.8], [-0.6, 0.0, 0.8]])
def test_slope_contrast_is_what_a_small_slope_changes(view: list[float]) -> None:
    towards = np.array([view])
    level, contrast = flat_terrain_brightness(tilted(0.0, 0.0), SUN, towards)
    h = 1e-5
    for axis, (x, y) in enumerate([(h, 0.0), (0.0, h)]):
        up, down = (flat_terrain_brightness(tilted(k * x, k * y), SUN, towards)[0] for k in (1.0, -1.0))
        assert_allclose(-contrast[0, axis], (up - down)[0] / (2.0 * h * level[0]), atol=1e-8)
    assert contrast[0, 2] == 0.0


@pytest.mark.parametrize("view", [[0.0, 0.0, 1.0], [0.48, 0.36, 0.8], [-0.6, 0.0, 0.8], [0.6, 0.0, 0.8]])
def test_slope_curvature_is_the_second_order_of_what_a_slope_changes(view: list[float]) -> None:
    towards = np.array([view])
    K = slope_curvature(tilted(0.0, 0.0), SUN, towards)[0]
    level = flat_terrain_brightness(tilted(0.0, 0.0), SUN, towards)[0][0]
    h = 1e-3
    for angle in np.linspace(0.0, np.pi, 5):
        u = np.array([np.cos(angle), np.sin(angle), 0.0])
        up, down = (
            flat_terrain_brightness(tilted(*(k * h * u[:2])), SUN, towards)[0][0] for k in (1.0, -1.0)
        )
        assert_allclose(u @ K @ u, 0.5 * (up + down - 2.0 * level) / (h**2 * level), atol=1e-5)
    assert_allclose(K @ [0.0, 0.0, 1.0], 0.0, atol=1e-15)


def test_ground_that_rises_towards_the_sun_is_darker() -> None:
    _, contrast = flat_terrain_brightness(tilted(0.0, 0.0), SUN, np.array([[0.0, 0.0, 1.0]]))
    assert contrast[0, 0] > 0.5
    assert contrast[0, 1] == pytest.approx(0.0)


def test_ground_without_sun_or_camera_above_it_is_dark() -> None:
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    view = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -1.0]])
    brightness, contrast = flat_terrain_brightness(normals, SUN, view)
    assert_allclose(brightness, 0.0)
    assert_allclose(contrast, 0.0)


def test_the_share_of_lommel_seeliger_falls_with_phase_and_stays_a_share() -> None:
    share = lunar_lambert_share(np.radians([0.0, 30.0, 60.0, 90.0, 150.0]))
    assert share[0] == 1.0
    assert np.all(np.diff(share) <= 0.0)
    assert share[-1] == 0.0
