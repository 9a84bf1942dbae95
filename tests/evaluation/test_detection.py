"""Matching of detections to true rims."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from craternav_fg.evaluation.detection import gaussian_angle, match

CIRCLE = np.array([100.0, 80.0, 20.0, 20.0, 0.0])


def moved(x=0.0, y=0.0, a=0.0, b=0.0, ellipse=CIRCLE):
    return np.add(ellipse, [x, y, a, b, 0.0])


def ellipses():
    return st.builds(
        lambda x, y, a, ratio, angle: np.array([x, y, a, ratio * a, angle]),
        st.floats(-20.0, 20.0),
        st.floats(-20.0, 20.0),
        st.floats(5.0, 40.0),
        st.floats(0.4, 1.0),
        st.floats(-3.0, 3.0),
    )


def density(ellipse, x, y):
    """Gaussian whose covariance has the semi-axes as standard deviations."""
    cx, cy, a, b, angle = ellipse
    u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
    v = -(x - cx) * np.sin(angle) + (y - cy) * np.cos(angle)
    return np.exp(-0.5 * ((u / a) ** 2 + (v / b) ** 2)) / (2.0 * np.pi * a * b)


@pytest.mark.parametrize("seed", range(5))
def test_angle_is_that_of_the_densities_overlap(seed):
    rng = np.random.default_rng(seed)
    one, other = (rng.uniform([-8.0, -8.0, 12.0, 6.0, 0.0], [8.0, 8.0, 20.0, 12.0, 3.0]) for _ in range(2))
    y, x = np.mgrid[-150:150.5:0.5, -150:150.5:0.5]
    overlap = np.sum(np.sqrt(density(one, x, y) * density(other, x, y))) * 0.25
    assert gaussian_angle(one, other) == pytest.approx(np.arccos(overlap**2), abs=1e-6)


@given(ellipses(), ellipses())
def test_angle_is_symmetric_and_knows_no_rotation_of_the_image(one, other):
    angle = gaussian_angle(one, other)
    assert 0.0 <= angle <= 0.5 * np.pi + 1e-12
    assert gaussian_angle(other, one) == pytest.approx(angle, abs=1e-7)
    assert gaussian_angle(one, one) == pytest.approx(0.0, abs=1e-6)
    # Rounding does not take the overlap of equal ellipses beyond 1.
    alike = np.tile(one, (50, 1)) * np.linspace(0.9, 1.1, 50)[:, None]
    assert np.isfinite(gaussian_angle(alike, alike)).all()
    turned = [np.array([-e[1], e[0], e[2], e[3], e[4] + 0.5 * np.pi]) for e in (one, other)]
    assert gaussian_angle(*turned) == pytest.approx(angle, abs=1e-6)


def test_gate_lets_errors_of_a_few_pixels_pass():
    shifts = np.arange(0.0, 6.0, 0.25)
    passed = [len(match(moved(dx), CIRCLE).true) == 1 for dx in shifts]
    limit = shifts[int(np.argmin(passed))]
    assert 3.5 < limit < 5.0
    # The same error counts the same on a crater four times as large.
    large = CIRCLE * [1.0, 1.0, 4.0, 4.0, 1.0]
    assert len(match(moved(limit - 0.5, ellipse=large), large).true) == 1
    assert len(match(moved(limit + 0.5, ellipse=large), large).true) == 0


def test_recall_precision_and_errors():
    true = np.array([CIRCLE, moved(100.0, a=5.0), moved(200.0), moved(300.0)])
    wanted = np.array([True, True, True, False])
    found = np.array(
        [
            moved(0.3, 0.4, 0.2, -0.1),  # the first
            moved(0.6),  # the first again: false
            moved(a=-0.5, ellipse=true[1]),  # the second
            true[3],  # not wanted: neither right nor wrong
            moved(y=300.0),  # false
            moved(y=400.0, a=-15.0, b=-15.0),  # false, but too small to count
        ]
    )
    result = match(found, true, wanted, found[:, 3] > 12.0)
    assert result.recall == pytest.approx(2 / 3)
    assert result.precision == pytest.approx(2 / 4)
    assert result.missed.tolist() == [2]
    assert result.false.tolist() == [1, 4]
    np.testing.assert_allclose(result.centre_px, [0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(result.semi_major_px, [0.2, -0.5])
    np.testing.assert_allclose(result.semi_minor_px, [-0.1, 0.0])


def test_as_many_as_possible_are_matched():
    """The detection between two rims is left to the one that has no other."""
    true = np.array([CIRCLE, moved(3.0)])
    found = np.array([moved(1.0), moved(-2.5)])
    result = match(found, true)
    assert sorted(zip(result.detected.tolist(), result.true.tolist(), strict=True)) == [(0, 1), (1, 0)]


def test_nothing_against_nothing():
    nothing = np.empty((0, 5))
    assert np.isnan(match(nothing, nothing).recall)
    assert match(nothing, CIRCLE).recall == 0.0
    assert match(CIRCLE, nothing).precision == 0.0
    assert np.isnan(match(nothing, CIRCLE).precision)
