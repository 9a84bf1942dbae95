"""Ellipses in their several forms."""

import numpy as np
import pytest

from craternav_fg.ellipse import chart_of_axes, shape_change


def test_change_of_shape() -> None:
    round_one = chart_of_axes([0.1, -0.2, 0.05, 0.05, 0.0])
    larger = round_one + np.array([0.3, 0.0, 0.1, 0.0, 0.1])
    assert shape_change(round_one, larger) == pytest.approx(0.1)
    assert shape_change(larger, round_one) == pytest.approx(0.1)
    # Squeezed by 20 % along an axis at 40 deg.
    slant = chart_of_axes([0.0, 0.0, 0.05, 0.04, np.radians(130.0)])
    assert shape_change(round_one, slant) == pytest.approx(np.log(1.25))
