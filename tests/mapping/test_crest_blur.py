"""Size and centre of small rims whose model is blurred: profiles and grounds that the calibration has not."""

import numpy as np
import pytest

from craternav_fg.calibration.crest_blur import log_found, profiles
from craternav_fg.ellipse import chart_of_axes, mean_radius
from craternav_fg.mapping.crest_blur import RESOLUTION_RADII, crest_bias
from craternav_fg.mapping.wall_centre import wall_shift
from tests.foreign.profiles import FAMILIES, draw_profile

RHO = np.arange(0.005, 3.2, 0.01)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("share", [0.12, 0.2, 0.28, 0.36])
def test_foreign_profiles_are_found_as_much_too_large_as_expected(family, share):
    """Each kind of wall for itself."""
    rng = np.random.default_rng(3)
    heights = np.array([draw_profile(rng, family, rng.uniform(0.0, 0.3))(RHO) for _ in range(12)])
    found = log_found(heights, share)
    rest = [one - crest_bias(share * np.exp(-one))[0] for one in found]
    spread = crest_bias(share * np.exp(-float(found.mean())))[1]
    assert abs(np.mean(rest)) < 0.03
    assert np.std(rest) < 1.5 * spread
    # What is corrected is more than what is left, where the model hardly resolves the crater.
    assert share < 0.3 or abs(np.mean(rest)) < 0.5 * np.mean(found)


def test_large_craters_keep_their_size():
    assert abs(crest_bias(0.0)[0]) < 0.015
    assert crest_bias(10.0) == crest_bias(float(RESOLUTION_RADII[-1]))


def test_profiles_of_the_calibration_have_their_crest_at_the_radius():
    highest = RHO[np.argmax(profiles(1.0), axis=1)]
    np.testing.assert_allclose(highest, 1.0, atol=0.01)


def crater(centre, radius, slope, bend):
    """Terrain with a blurred crater, on ground with a slope and a bend."""
    rho = np.linspace(0.0, 4.0, 801)
    height = 0.25 * radius * np.tanh(2.5 * (rho - 0.8)) * np.exp(-(np.maximum(rho - 1.0, 0.0) ** 2) / 0.3)

    def terrain(places):
        off = places - centre
        ground = places @ slope + bend * off[:, 0] * np.hypot(*off.T) / radius
        return np.interp(np.hypot(*off.T) / radius, rho, height) + ground

    return terrain


def test_walls_show_the_centre_of_a_crater_on_sloping_ground():
    truth = np.array([60.0, -40.0])
    circle = chart_of_axes([0.0, 0.0, 1000.0, 1000.0, 0.0])
    terrain = crater(truth, 1000.0, np.array([0.08, -0.05]), 0.01)
    # An ellipse that is not known at all takes the centre of the walls.
    np.testing.assert_allclose(wall_shift(circle, terrain, 1e6), truth, atol=6.0)
    # One that is known as well as the walls takes half of it.
    np.testing.assert_allclose(wall_shift(circle, terrain, 60.0), 0.5 * truth, atol=4.0)


def test_walls_of_an_ellipse_are_moved_along_its_own_axes():
    squash = np.array([[1.0, 0.0], [0.3, 0.8]])
    ellipse = np.array([0.0, 0.0, np.log(1000.0), 0.3, np.log(800.0)])
    round_one = crater(np.array([50.0, 30.0]), 1000.0, np.zeros(2), 0.0)

    def terrain(places):
        return round_one(places @ np.linalg.inv(squash).T)

    found = wall_shift(ellipse, terrain, 1e6)
    np.testing.assert_allclose(found, squash @ [50.0, 30.0], atol=4.0)


def test_walls_move_an_ellipse_by_a_fifth_of_its_radius_at_most():
    circle = chart_of_axes([0.0, 0.0, 1000.0, 1000.0, 0.0])
    far = wall_shift(circle, crater(np.array([450.0, 0.0]), 1000.0, np.zeros(2), 0.0), 1e6)
    assert np.hypot(*far) == pytest.approx(0.2 * float(mean_radius(circle)), rel=1e-3)
    assert not wall_shift(circle, lambda places: np.zeros(len(places)), 60.0).any()
