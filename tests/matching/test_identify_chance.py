"""Density of false rims where the image does not show the ground everywhere."""

import numpy as np
import pytest

from craternav_fg.matching.identify.chance import chance_at, log_by_chance
from craternav_fg.matching.identify.view import view_of
from craternav_fg.simulation.catalog_views import square_camera
from craternav_fg.simulation.scenes import MOON


def test_false_rims_are_denser_where_the_image_shows_sky() -> None:
    """A camera that looks at the limb: half of the image is ground."""
    camera = square_camera(20.0)
    view = view_of(np.array([[200.0, 200.0, 9.0, 9.0, 0.0]]), camera)
    chance, shape_chance = log_by_chance(view)
    height_m, here = 100e3, np.empty(1)
    P = np.array([MOON.radius_m + height_m, 0.0, 0.0])
    dip = np.arccos(MOON.radius_m / P[0])
    # x and z of the camera along the limb and towards it, y downwards.
    z = np.array([-np.sin(dip), 0.0, np.cos(dip)])
    R = np.column_stack([[0.0, 1.0, 0.0], np.cross(z, [0.0, 1.0, 0.0]), z])
    chance_at(view, R, P, MOON.radius_m, chance, shape_chance, here)
    # The rim is above the limb: no craters can be foreshortened alike.
    assert here[0] - chance[0] == pytest.approx(np.log(2.0), abs=0.1)
    down = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    chance_at(view, down, P, MOON.radius_m, chance, shape_chance, here)
    assert here[0] - chance[0] < 1.5
