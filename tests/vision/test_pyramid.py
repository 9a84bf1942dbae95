"""Pyramid of the crater network: levels, local contrast, and quarter turns."""

import numpy as np
import pytest

from craternav_fg.vision.pyramid import (
    LEAST_PX,
    MOST_PX,
    STRIDE_PX,
    level,
    levels,
    normalised,
    quarters_to_right,
    turned_back,
)


def _spot(shape, x, y, sigma):
    """White spot on black."""
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    return (255.0 * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / sigma**2)).astype(np.float32)


def test_neighbouring_levels_leave_no_radius_out():
    assert MOST_PX > 2.0 * LEAST_PX
    assert levels((512, 512), LEAST_PX) == 1
    count = levels((2048, 2048), 150.0)
    assert LEAST_PX * 2 ** (count - 1) < 150.0 < MOST_PX * 2 ** (count - 1)
    # An image of few cells has few levels, whatever is searched.
    assert levels((STRIDE_PX, 4000), 1e4) == 1
    assert levels((3, 3), 1e4) == 1


@pytest.mark.parametrize("number", [0, 1, 3])
def test_a_level_halves_the_resolution(number):
    small = level(_spot((128, 192), 100.0, 40.0, 12.0), number)
    assert small.dtype == np.float32
    assert small.shape == (128 // 2**number, 192 // 2**number)
    y, x = np.mgrid[0 : small.shape[0], 0 : small.shape[1]]
    # A pixel of the level covers 2**number of the image, whose corner is at -0.5.
    centre = ((v * small).sum() / small.sum() for v in (x, y))
    np.testing.assert_allclose([(v + 0.5) * 2**number - 0.5 for v in centre], (100.0, 40.0), atol=0.05)


def test_local_contrast_does_not_depend_on_the_camera():
    rng = np.random.default_rng(0)
    image = rng.uniform(60.0, 120.0, (200, 300)).astype(np.float32)
    seen = normalised(image)
    assert seen.shape == image.shape
    assert abs(seen.mean()) < 0.02
    assert 0.8 < seen.std() < 1.0
    # A gain, an offset and a slope of brightness.
    other = 1.5 * image + 20.0 + 0.1 * np.arange(300, dtype=np.float32)
    inner = slice(60, -60)
    assert np.abs(normalised(other) - seen)[inner, inner].max() < 0.2
    # Noise of a grey level on nothing stays small; a white spot is clipped.
    assert np.abs(normalised(np.full((100, 100), 9.0, np.float32))).max() == 0.0
    assert normalised(_spot((200, 200), 90.0, 90.0, 1.0)).max() == 4.0


@pytest.mark.parametrize("sun_deg", [-170.0, -95.0, -50.0, 0.0, 44.0, 60.0, 133.0, 180.0])
def test_quarter_turns_bring_the_sun_to_the_right(sun_deg):
    sun = np.deg2rad(sun_deg)
    towards = np.array([np.cos(sun), np.sin(sun)])
    shape, foot = (90, 160), np.array([80.0, 45.0])
    tip = foot + 20.0 * towards
    quarters = quarters_to_right(sun)
    turned = [np.rot90(_spot(shape, *point, 2.0), quarters) for point in (foot, tip)]
    (y0, x0), (y1, x1) = (np.unravel_index(np.argmax(spot), spot.shape) for spot in turned)
    assert abs(np.arctan2(y1 - y0, x1 - x0)) < np.deg2rad(49.0)
    back = turned_back(np.array([[x0, y0], [x1, y1]], dtype=float), quarters, shape)
    np.testing.assert_allclose(back, [foot, tip], atol=0.51)
