"""Rims of which one stretch is something else: their covariances know."""

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_axes, normalised_chart
from craternav_fg.vision.ellipse_fit import FitOptions, RimFit, refine_rim
from craternav_fg.vision.wrong_stretch import move_without_stretch

CAMERA = Camera(1024, 1024, 1e3, 1e3, 511.5, 511.5)
TRUTH = chart_of_axes([500.0, 500.0, 45.0, 38.25, 0.0])


def edge(rng, offset_px, share, outline=0.0, count=90):
    """Points of a rim whose errors neighbours share, with an offset along one stretch."""
    t = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    white = 0.06 * rng.normal(size=count)
    off = (white + np.roll(white, 1) + np.roll(white, -1)) / np.sqrt(3.0)
    for order in range(3, 9):
        a, b = 45.0 * outline / order * rng.normal(size=2)
        off += a * np.cos(order * t) + b * np.sin(order * t)
    off += np.where((t - rng.uniform(0.0, 2.0 * np.pi)) % (2.0 * np.pi) < 2.0 * np.pi * share, offset_px, 0.0)
    scale = 1.0 + off / 45.0
    return np.stack([500.0 + 45.0 * scale * np.cos(t), 500.0 + 38.25 * scale * np.sin(t)], axis=-1)


def distance2(points):
    """Squared distance per dimension of the fitted chart, and its standard deviation of x, px."""
    fit = refine_rim(points, TRUTH, CAMERA, FitOptions(outline_share=0.0003), np.ones(len(points)))
    assert isinstance(fit, RimFit)
    error = fit.chart - normalised_chart(TRUTH, CAMERA)[0]
    sigma_px = CAMERA.focal_px * np.sqrt(fit.covariance[0, 0])
    return error @ np.linalg.solve(fit.covariance, error) / 5.0, sigma_px


@pytest.mark.parametrize(("offset_px", "share"), [(0.9, 0.35), (1.8, 0.35), (-0.9, 0.3), (0.9, 0.25)])
def test_a_wrong_stretch_is_in_the_covariance(offset_px, share):
    """Without it, the mean squared distances are 22, 65, 20 and 3.7."""
    rng = np.random.default_rng(0)
    found = [distance2(edge(rng, offset_px, share))[0] for _ in range(30)]
    assert np.mean(found) < 1.5


def test_sound_rims_are_as_certain_as_before():
    rng = np.random.default_rng(1)
    for _ in range(40):
        points = edge(rng, 0.0, 0.3)
        fit = refine_rim(points, TRUTH, CAMERA, FitOptions(), np.ones(len(points)))
        assert isinstance(fit, RimFit)
        moved = move_without_stretch(points, np.ones(90), np.zeros((90, 2)), 1.0, fit.chart_px, 0.03)
        np.testing.assert_array_equal(moved, 0.0)


def test_the_reference_brightness_explains_a_shift_of_one_side():
    """Points that it moves are no wrong stretch."""
    rng = np.random.default_rng(2)
    points = edge(rng, 0.0, 0.3)
    side = np.where(points[:, :1] > 500.0, 1.0, -1.0) * np.array([[1.0, 0.0]])
    shifted = points + 0.6 * side * (np.abs(points[:, 1:] - 500.0) < 30.0)
    motion = side * (np.abs(points[:, 1:] - 500.0) < 30.0)
    fit = refine_rim(shifted, TRUTH, CAMERA, FitOptions(), np.ones(90))
    assert isinstance(fit, RimFit)
    moved = move_without_stretch(shifted, np.ones(90), motion, 1.0, TRUTH, 0.03)
    np.testing.assert_array_equal(moved, 0.0)
