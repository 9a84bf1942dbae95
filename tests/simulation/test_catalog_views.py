"""Simulated views of a catalogue: rims as found, the truth, and when an identification is right."""

import numpy as np
import pytest

from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.simulation.catalog_views import (
    View,
    ViewOptions,
    random_view,
    square_camera,
    synthetic_catalog,
)
from craternav_fg.simulation.scenes import MOON

CATALOG = synthetic_catalog(MOON, np.random.default_rng(0), count=4000)
EXACT = ViewOptions(sigma_px=0.0, missing=0.0, false=0.0)


def test_without_errors_the_rims_are_those_that_the_pose_shows() -> None:
    view = random_view(CATALOG, EXACT, np.random.default_rng(1), true_rims=(10, 1000))
    order = np.argsort(view.craters)
    rows, charts = CATALOG.visible(view.camera, view.gTb, min_semi_minor_px=EXACT.least_px)
    facing = CATALOG.normals[rows] @ (view.gTb[:3, 3] / np.linalg.norm(view.gTb[:3, 3])) > 0.9
    seen = axes_of_chart(pixel_chart(charts, view.camera))
    np.testing.assert_array_equal(view.craters[order], rows[facing])
    np.testing.assert_allclose(view.ellipses_px[order], seen[facing])


def test_shares_of_missing_and_false_rims_are_those_asked_for() -> None:
    rng = np.random.default_rng(2)
    options = ViewOptions(missing=0.25, false=0.2)
    views = [random_view(CATALOG, options, rng, true_rims=(10, 1000)) for _ in range(40)]
    false = sum(int(np.sum(view.craters < 0)) for view in views) / sum(len(view.craters) for view in views)
    assert false == pytest.approx(0.2, abs=0.02)
    assert all(view.true == np.sum(view.craters >= 0) >= 10 for view in views)


@pytest.mark.parametrize(
    ("named", "right"),
    [
        ([0, 1, 2, -1, -1, -1], True),
        ([0, 1, -1, -1, -1, -1], False),
        ([0, 1, 2, 3, 9, -1], True),
        ([0, 1, 2, 9, 9, -1], False),
        ([-1, -1, -1, -1, -1, -1], False),
        # A false rim that is named counts as wrong.
        ([0, 1, 2, 3, 5, 7], False),
    ],
)
def test_right_names_two_thirds_and_at_least_three(named: list[int], right: bool) -> None:
    view = View(square_camera(60.0), np.zeros((6, 5)), np.eye(4), np.array([0, 1, 2, 3, -1, -1]))
    assert view.agrees(np.array(named)) is right


def test_the_mirror_image_of_the_mirror_image_is_the_view() -> None:
    view = random_view(CATALOG, EXACT, np.random.default_rng(3), true_rims=(5, 1000))
    once = view.mirrored()
    assert np.abs(once[:, 0] - view.ellipses_px[:, 0]).max() > 10.0
    again = View(view.camera, once, view.gTb, view.craters).mirrored()
    np.testing.assert_allclose(again, view.ellipses_px)
