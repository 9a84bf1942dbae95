"""Scores of detections against marked circles: limits of a match, precision, and calibration."""

import numpy as np
import pytest

from craternav_fg.evaluation.annotation import Matches, match_circles, scores


def test_a_match_is_near_and_of_about_the_size() -> None:
    circle = np.array([[100.0, 80.0, 20.0]])
    for off_px, found in ((10.9, True), (11.1, False)):
        ellipse = np.array([[100.0, 80.0 - off_px, 20.0, 20.0, 0.0]])
        matches = match_circles(ellipse, np.ones(1), circle)
        assert (matches.found_by[0] == 0) == found
        assert np.isnan(matches.centre_error_px[0]) == (not found)
    # The radius of an ellipse is that of the circle of its area.
    for factor, found in ((1.59, True), (1.61, False), (1.0 / 1.59, True), (1.0 / 1.61, False)):
        axes = 20.0 * factor * np.array([1.25, 0.8])
        matches = match_circles(np.array([[100.0, 80.0, *axes, 0.0]]), np.ones(1), circle)
        assert (matches.found_by[0] == 0) == found
        assert matches.radius_px[0] == pytest.approx(20.0 * factor)


def test_each_mark_is_found_once_by_the_best() -> None:
    circle = np.array([[100.0, 80.0, 20.0], [130.0, 80.0, 20.0]])
    ellipses = np.array([[100.0, 81.0, 20.0, 20.0, 0.0], [100.0, 80.0, 20.0, 20.0, 0.0]])
    matches = match_circles(ellipses, np.array([0.6, 0.8]), circle)
    assert matches.quality.tolist() == [0.8, 0.6]
    assert matches.found_by.tolist() == [0, -1]
    assert matches.centre_error_px[0] == 0.0
    # Of two marks within reach, the nearer one.
    between = match_circles(
        np.array([[112.0, 80.0, 26.0, 26.0, 0.0]]), np.ones(1), np.add(circle[::-1], [0.0, 0.0, 6.0])
    )
    assert between.found_by.tolist() == [-1, 0]
    # Of two marks about one centre, the one of its size.
    nested = np.array([[100.0, 80.0, 25.0], [100.0, 80.0, 20.0]])
    assert match_circles(
        np.array([[100.0, 80.0, 21.0, 21.0, 0.0]]), np.ones(1), nested
    ).found_by.tolist() == [-1, 0]


def matches(quality: list[float], right: list[bool], marked: int) -> Matches:
    """Detections of 20 px, the right ones 2 px off craters that are a quarter larger."""
    n = len(quality)
    radius = np.where(right, 25.0, np.nan)
    found_by = np.full(marked, -1)
    found_by[: sum(right)] = np.flatnonzero(right)
    return Matches(
        np.array(quality),
        np.full(n, 20.0),
        radius,
        np.where(right, 2.5, np.nan),
        np.full(marked, 25.0),
        found_by,
    )


def test_scores_of_half_of_the_craters() -> None:
    found = scores(matches([0.95, 0.85, 0.75], [True, False, True], 8), 12.0, 0.5)
    assert found.recall == pytest.approx(2.0 / 8.0)
    assert found.precision == pytest.approx(2.0 / 3.0)
    # Harmonic mean.
    assert 1.0 / found.f1 == pytest.approx(0.5 * (8.0 / 2.0 + 3.0 / 2.0))
    assert found.centre_radii == pytest.approx(0.1)
    assert found.log_radius == pytest.approx(np.log(0.8))
    nothing = scores(matches([], [], 3), 12.0, 0.5)
    assert (nothing.recall, nothing.f1, nothing.average_precision) == (
        0.0,
        pytest.approx(np.nan, nan_ok=True),
        0.0,
    )
    assert np.isnan(nothing.precision)
    assert np.isnan(nothing.calibration_error)


def test_probabilities_that_are_shares_are_calibrated() -> None:
    quality = np.repeat([1.0, 0.75, 0.25], 40).tolist()
    right = 40 * [True] + 30 * [True] + 10 * [False] + 10 * [True] + 30 * [False]
    assert scores(matches(quality, right, 80), 12.0, 0.5).calibration_error == pytest.approx(0.0, abs=1e-12)
    # Twice as sure as right, or half as sure, in a third of them each.
    turned = 40 * [True] + 10 * [True] + 30 * [False] + 30 * [True] + 10 * [False]
    assert scores(matches(quality, turned, 80), 12.0, 0.5).calibration_error == pytest.approx(2.0 * 0.5 / 3.0)
