"""Poses over a catalogue without heights: the covariance counts that the ground may be high and may slope."""

from dataclasses import replace

import numpy as np

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import share_of_rims
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.measurements import KnownAttitude
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenes import MOON

VIEWS, FOOTPRINT_M = 12, 80e3


def sloping(catalog, gP, rng):
    """The catalogue with heights: around a place ground is high by 1.7 km, and slopes by 0.5 deg per axis."""
    up = gP / np.linalg.norm(gP)
    east, north, _ = frames.east_north_up(*frames.latitude_longitude(gP[None]))[0].T
    away = catalog.centres - MOON.radius_m * up
    slope = rng.normal(0.0, 0.7e3 / FOOTPRINT_M, 2)
    return replace(
        catalog, height_m=rng.normal(0.0, 1.7e3) + slope[0] * (away @ east) + slope[1] * (away @ north)
    )


def test_ground_that_slopes_is_within_the_covariance() -> None:
    flat = replace(synthetic_catalog(MOON, np.random.default_rng(0)), has_heights=False)
    index = TripleIndex.build(flat)
    rng = np.random.default_rng(5)
    options = ViewOptions(altitudes_m=(130e3, 150e3), largest_tilt_deg=15.0, sigma_px=0.0, false=0.0)
    squared = []
    for _ in range(VIEWS):
        view = random_view(flat, options, rng, true_rims=(20, 10_000))
        seen = sloping(flat, view.gTb[:3, 3], rng).take(view.craters)
        _, charts = seen.visible(view.camera, view.gTb, min_semi_minor_px=3.0)
        ellipses = axes_of_chart(pixel_chart(charts, view.camera))
        ellipses[:, :4] += rng.normal(0.0, 0.3, (len(ellipses), 4))
        found = identify(ellipses, view.camera, index)
        assert found.identified
        error = view.gTb[:3, :3].T @ (found.gTb[:3, 3] - view.gTb[:3, 3])
        squared.append(error @ np.linalg.solve(found.covariance[3:, 3:], error))
    # Expected 3, with the height and the slope in common; without the slope, 200.
    assert 1.0 < np.mean(squared) < 6.0


def test_a_known_attitude_is_not_turned_by_the_ground() -> None:
    flat = replace(synthetic_catalog(MOON, np.random.default_rng(0)), has_heights=False)
    view = random_view(flat, ViewOptions(), np.random.default_rng(3), true_rims=(20, 10_000))
    index = TripleIndex.build(flat)
    free = identify(view.ellipses_px, view.camera, index)
    known = identify(view.ellipses_px, view.camera, index, KnownAttitude(view.gTb[:3, :3]))
    sigmas = [np.sqrt(np.trace(one.covariance[:3, :3])) for one in (free, known)]
    assert sigmas[0] > np.radians(0.1)
    assert sigmas[1] < np.radians(0.01)


def test_the_share_of_rims_is_that_of_the_information() -> None:
    of_rims, of_tracker = np.diag([4.0, 4.0, 4.0]), np.diag([1.0, 1.0, 1.0])
    both = np.linalg.inv(np.linalg.inv(of_rims) + np.linalg.inv(of_tracker))
    np.testing.assert_allclose(share_of_rims(both, of_tracker), 0.2)
    assert share_of_rims(both, np.zeros((3, 3))) == 0.0
