"""Maps of how much an image looks like craters: at craters, beside them, and where nothing is known."""

import cv2
import numpy as np
import pytest

from craternav_fg.vision.shading_maps import NO_SHADING, shading_density, shading_maps, sun_axis

SUN_RAD = 0.5


def rough_ground(rng, shape=(360, 480)):
    """Slopes of rough ground towards the sun, and sensor noise."""
    height = sum(2.0**k * cv2.GaussianBlur(rng.normal(size=shape), (0, 0), 1.5 * 2.0**k) for k in range(4))
    dy, dx = np.gradient(height)
    return 120.0 + 20.0 * (np.cos(SUN_RAD) * dx + np.sin(SUN_RAD) * dy) + rng.normal(size=shape)


def with_bowls(image, circles, depth):
    """Add the shading of bowls that are no deeper than the ground is rough."""
    y, x = np.indices(image.shape)
    image = image.copy()
    for x0, y0, radius in circles:
        along = (np.cos(SUN_RAD) * (x - x0) + np.sin(SUN_RAD) * (y - y0)) / radius
        image -= depth * along * np.exp(-2.0 * ((x - x0) ** 2 + (y - y0) ** 2) / radius**2)
    return np.clip(image, 0.0, 255.0).astype(np.float32)


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(np.arange(50, 450, 80), np.arange(50, 340, 80)), axis=-1).reshape(-1, 2)
    circles = np.column_stack(
        [grid + rng.uniform(-10.0, 10.0, grid.shape), rng.uniform(7.0, 14.0, len(grid))]
    )
    return with_bowls(rough_ground(rng), circles, 60.0), circles


def densities(maps, circles, error_px=1.5):
    return np.array([[shading_density(maps, side, *one, error_px) for one in circles] for side in (0, 1)])


def test_the_axis_is_the_suns(scene) -> None:
    assert sun_axis(scene[0]) == pytest.approx(SUN_RAD, abs=0.1)


def test_craters_are_seen_where_they_are_from_the_suns_side_only(scene) -> None:
    """Also those not exactly where they are predicted."""
    image, circles = scene
    maps = shading_maps(image)
    right, wrong = densities(maps, circles)
    assert np.mean(right > 2.0) > 0.8
    assert np.mean(wrong < 0.5) > 0.9
    off = circles + np.array([6.0, -4.0, 0.0])
    right, wrong = densities(maps, off, 8.0)
    assert np.mean(right > 2.0) > 0.6
    assert np.mean(right > wrong) > 0.8


@pytest.mark.parametrize("radius_px", [6.0, 11.0, 20.0])
@pytest.mark.parametrize("error_px", [1.0, 5.0])
def test_anywhere_else_the_mean_is_at_most_one(scene, radius_px, error_px) -> None:
    """Of any image: so has the product over craters that are not there. Ties lose a little."""
    rng = np.random.default_rng(2)
    image, _ = scene
    places = np.column_stack([rng.uniform(0.0, [480.0, 360.0], (20_000, 2)), np.full(20_000, radius_px)])
    for side in densities(shading_maps(image), places, error_px):
        assert 0.75 < side.mean() < 1.1


def test_what_is_not_known_tells_nothing(scene) -> None:
    image, circles = scene
    maps = shading_maps(image)
    x, y, radius = circles[0]
    assert shading_density(maps, 0, x, y, radius, 1.0) != 1.0
    for unknown in [
        (x, y, 3.0, 1.0), (x, y, 200.0, 1.0), (x, y, radius, 60.0), (-0.6, y, radius, 1.0),
        (x, 365.0, radius, 1.0),
    ]:  # fmt: skip
        assert shading_density(maps, 0, *unknown) == 1.0
    for nothing in (NO_SHADING, shading_maps(image[:40, :40])):
        assert shading_density(nothing, 0, x, y, radius, 1.0) == 1.0
