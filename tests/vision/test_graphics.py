"""Graphics burnt into images are no craters; shadows and overexposed ground remain."""

import cv2
import numpy as np
import pytest

from craternav_fg.ellipse import chart_of_axes
from craternav_fg.simulation.scenes import scene
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.graphics import on_ground
from craternav_fg.vision.network_detect import find_rims_network

TEXT = "NASA O 0 Q 8 GSFC 690 6 3 9 D C B"


@pytest.fixture(scope="module")
def one():
    return scene(0)


def _rows(rims, first, last):
    return np.flatnonzero((rims.ellipses_px[:, 1] >= first) & (rims.ellipses_px[:, 1] < last))


@pytest.mark.parametrize("back", [0, 255])
@pytest.mark.parametrize("detector", [find_rims_network, find_rims])
def test_captions_hold_no_rims(one, detector, back):
    """The template method finds none there by itself."""
    image = one.image.copy()
    assert image.dtype == np.uint8
    top = image.shape[0] - 70
    image[top:] = back
    cv2.putText(image, TEXT, (8, top + 48), cv2.FONT_HERSHEY_SIMPLEX, 1.3, 255 - back, 6)
    plain, captioned = detector(one.image), detector(image)
    assert len(_rows(captioned, top, 9999)) == 0
    kept = _rows(plain, 0, top - 60)
    assert len(kept) > 10
    assert len(_rows(captioned, 0, top - 60)) >= 0.95 * len(kept)


def _ground():
    return np.random.default_rng(4).normal(120.0, 4.0, (200, 200)).astype(np.float32)


def _disc(radius):
    y, x = np.mgrid[:200, :200]
    return radius - np.hypot(x - 100.0, y - 100.0)


RIM = chart_of_axes(np.array([[100.0, 100.0, 20.0, 20.0, 0.0]]))


def test_a_rim_on_a_black_label():
    image = _ground()
    image[80:120, 60:140] = 0.0
    assert not on_ground(image, RIM).any()
    assert on_ground(image, RIM + np.array([60.0, 60.0, 0.0, 0.0, 0.0])).all()


def test_a_crater_full_of_shadow_stays():
    image = _ground()
    image[_disc(19.0) > 0.0] = 0.0
    assert on_ground(image, RIM).all()


def test_overexposed_ground_stays():
    # It ends in ground that is nearly as bright.
    image = _ground() + np.clip(8.0 * _disc(60.0), 0.0, 200.0).astype(np.float32)
    image = np.where(_disc(15.0) > 0.0, np.float32(20.0), np.minimum(image, 255.0))
    assert on_ground(image, RIM).all()


def test_the_night_stays():
    image = _ground()
    image[:, :90] = np.float32(0.0)
    assert on_ground(image, RIM).all()


def test_missing_pixels_are_no_graphics():
    image = _ground()
    image[80:120, 60:140] = np.nan
    assert on_ground(image, RIM).all()
    assert len(on_ground(image, np.empty((0, 5)))) == 0
