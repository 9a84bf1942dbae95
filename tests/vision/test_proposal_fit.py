"""Measurement of proposed craters: rims cut by the border, foreshortened rims, and what cannot be traced."""

import numpy as np
import pytest

from craternav_fg.ellipse import axes_of_chart
from craternav_fg.evaluation.detection import GATE_CHI2, SIGMA_PX, gaussian_angle
from craternav_fg.simulation.scenes import Ground, scene
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import Candidates
from craternav_fg.vision.detect import BlindOptions, blind_fitter
from craternav_fg.vision.proposal_fit import measured


@pytest.fixture(scope="module")
def tilted():
    """Rims are foreshortened by a third."""
    return scene(4, Ground(tilt_deg=(40.0, 40.0)))


def proposals(circles_px, contrast=1.0):
    x, y, radius = np.asarray(circles_px, dtype=np.float64).reshape(-1, 3).T
    ones = np.ones(len(x))
    return Candidates(np.column_stack([x, y]), radius, 0.8 * ones, 0.0 * ones, contrast * ones)


def measure(image, circles_px, sun_angle_rad):
    _, pixels = filled(brightness(image))
    circles = proposals(circles_px)
    fitter = blind_fitter(pixels, circles, 1.0, BlindOptions())
    return measured(fitter, circles, circles, np.full(len(circles), sun_angle_rad))


def off(charts_px, true_px):
    """Whether ellipses are the true ones, as the rendered benchmark judges."""
    sigma = SIGMA_PX / np.sqrt(true_px[:, 2] * true_px[:, 3])
    return (gaussian_angle(axes_of_chart(charts_px), true_px) / sigma) ** 2 / GATE_CHI2


def test_circles_become_the_rims_around_them(tilted):
    true = tilted.ellipses_px[tilted.wanted]
    assert np.median(true[:, 2] / true[:, 3]) > 1.25
    circles = np.column_stack([true[:, :2], np.sqrt(true[:, 2] * true[:, 3])])
    circles += np.random.default_rng(0).normal(0.0, 0.08, circles.shape) * circles[:, 2:]
    found = measure(tilted.image, circles, tilted.sun_angle_rad)
    assert found.traced.mean() > 0.9
    assert np.mean(off(found.charts_px, true)[found.traced] < 1.0) > 0.95


def test_what_cannot_be_traced_has_the_shape_of_the_rims_around_it(tilted):
    true = tilted.ellipses_px[tilted.wanted]
    circles = np.column_stack([true[:, :2], np.sqrt(true[:, 2] * true[:, 3])])
    k = int(np.argmin(np.hypot(*(true[:, :2] - 512.0).T)))
    x, y, a = np.rint(true[k, :3]).astype(int)
    image = tilted.image.copy()
    # The crater is wiped out, so its proposal cannot be traced.
    image[y - 2 * a : y + 2 * a + 1, x - 2 * a : x + 2 * a + 1] = int(np.median(image))
    found = measure(image, circles, tilted.sun_angle_rad)
    assert not found.traced[k]
    ellipse = axes_of_chart(found.charts_px[k])
    assert ellipse[2] * ellipse[3] == pytest.approx(circles[k, 2] ** 2, rel=1e-6)
    assert ellipse[2] / ellipse[3] > 1.15
    across = np.angle(np.exp(2j * (ellipse[4] - true[k, 4])))
    assert abs(across) < np.deg2rad(40.0)
    assert np.sqrt(found.covariance_px[k, 0, 0]) > 0.1 * circles[k, 2]
    assert np.sqrt(found.covariance_px[~found.traced, 0, 0]).min() > np.sqrt(
        found.covariance_px[found.traced, 0, 0].max()
    )


def test_a_rim_that_the_border_cuts_is_fitted_from_its_arc():
    """The network places such a crater inside the image, smaller than it is."""
    right, wrong = [], []
    for one in (scene(1), scene(3)):
        for x, y, a, b, _ in one.ellipses_px[one.wanted & (one.ellipses_px[:, 3] > 20.0)]:
            radius = np.sqrt(a * b)
            for inside in (0.0, 0.2):
                first = int(x - inside * radius)
                cut = np.ascontiguousarray(one.image[:, first:])
                circle = [x - first + 0.3 * radius, y, 0.75 * radius]
                found = measure(cut, circle, one.sun_angle_rad)
                near = off(found.charts_px, one.ellipses_px - (first, 0.0, 0.0, 0.0, 0.0)).min() < 1.0
                right.append(found.traced[0] and near)
                wrong.append(found.traced[0] and not near)
    assert len(right) >= 20
    assert np.mean(right) > 0.38
    assert np.mean(wrong) < 0.1


def test_no_proposals():
    found = measure(np.full((80, 80), 90, np.uint8), [[40.0, 40.0, 12.0]], 0.0)
    assert not found.traced.any()
    assert np.isfinite(found.charts_px).all()
