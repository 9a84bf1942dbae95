import numpy as np
from numpy.testing import assert_allclose

from craternav_fg.ellipse import points_on
from craternav_fg.ellipse_distance import signed_distances

CHART = np.array([300.0, 200.0, np.log(60.0), 0.4, np.log(45.0)])


def test_distances_to_a_circle_are_exact_and_positive_outside():
    chart = np.array([300.0, 200.0, np.log(60.0), 0.0, np.log(60.0)])
    turns = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 9)
    outward = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    off = np.linspace(-20.0, 20.0, 9)
    distances, normals, _ = signed_distances(chart[:2] + (60.0 + off)[:, None] * outward, chart)
    assert_allclose(distances, off, atol=1e-10)
    assert_allclose(normals, outward, atol=1e-12)


def test_derivatives_at_the_ellipse_are_central_differences():
    points = points_on(CHART[None], 16)[0]
    distances, _, derivatives = signed_distances(points, CHART)
    assert_allclose(distances, 0.0, atol=1e-10)
    steps = 1e-5 * np.eye(5)
    ahead, behind = (
        np.stack([signed_distances(points, CHART + sign * step)[0] for step in steps], axis=1)
        for sign in (1.0, -1.0)
    )
    assert_allclose(derivatives, (ahead - behind) / 2e-5, atol=1e-5)
