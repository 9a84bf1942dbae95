"""Slopes of rims' planes: those of rims that are found on an elevation model, robust against walls."""

import numpy as np
import pytest

from craternav_fg.calibration.rim_tilts import robust_sigma, usual_tilt


def test_a_tenth_of_rims_on_walls_hardly_matters() -> None:
    rng = np.random.default_rng(3)
    tilts = 0.03 * rng.standard_normal((2000, 2))
    tilts[:200] *= 10.0
    assert robust_sigma(tilts) == pytest.approx(0.03, rel=0.2)
    assert np.std(tilts) > 0.08


def test_regions_count_alike() -> None:
    one = usual_tilt([0.03, 0.05])
    assert one.value == pytest.approx(np.sqrt(0.5 * (0.03**2 + 0.05**2)))
    assert one.error == pytest.approx(0.5 * (0.05**2 - 0.03**2) / (2.0 * one.value))
    assert one.name.startswith("CorrelatedErrorOptions.map_tilt_rad")
