"""The matched filter near known circles: it returns to the crater from circles that are a little off."""

import numpy as np
import pytest

from craternav_fg.vision import crater_profile
from craternav_fg.vision.local_match import best_near

CENTRE, SUN_RAD = np.array([110.0, 90.0]), 0.6


def _bowl(radius):
    """Brightness of a canonical crater under oblique light."""
    y, x = np.mgrid[:200, :220]
    off = np.stack([x, y], axis=-1) - CENTRE
    rho = np.hypot(*np.moveaxis(off, -1, 0)) / radius
    slope = np.where(rho < 3.0, crater_profile.slopes(np.clip(rho, 0.02, 3.0)), 0.0)
    towards = off @ [np.cos(SUN_RAD), np.sin(SUN_RAD)] / np.maximum(rho * radius, 0.5)
    return (100.0 * (1.0 - 0.3 * slope * towards)).astype(np.float32)


@pytest.mark.parametrize("radius", [8.0, 21.0, 50.0])
def test_a_circle_that_is_off_comes_back(radius):
    circles = np.array(
        [[*(CENTRE + radius * np.array(step)), 1.2 * radius] for step in ((0.25, 0.0), (-0.1, 0.2))]
    )
    found = best_near(_bowl(radius), circles, np.full(2, SUN_RAD))
    assert np.all(np.hypot(*(found.xy_px - CENTRE).T) < 0.12 * radius)
    assert np.all(np.abs(np.log(found.radius_px / radius)) < 0.2)
    assert np.all(np.abs(found.sun_angle_rad - SUN_RAD) < 0.1)
    assert np.all(found.correlation > 0.9)


def test_a_dome_is_no_bowl():
    found = best_near(_bowl(20.0), np.array([[*CENTRE, 20.0]]), np.array([SUN_RAD + np.pi]))
    assert found.correlation[0] < 0.5


def test_circles_at_the_border_and_none():
    image = _bowl(20.0)
    found = best_near(image, np.array([[-3.0, 50.0, 12.0], [219.0, 199.0, 90.0]]), np.zeros(2))
    assert np.all(np.isfinite(found.xy_px))
    assert len(best_near(image, np.empty((0, 3)), np.empty(0))) == 0
