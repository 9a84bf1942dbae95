"""Errors of a published map: known distributions are found again."""

import numpy as np
import pytest

from craternav_fg.calibration.catalogue_errors import Differences, by_radius, place_errors, size_error


def student(rng: np.random.Generator, freedom: float, shape: tuple[int, int]) -> np.ndarray:
    return rng.standard_normal(shape) / np.sqrt(rng.chisquare(freedom, shape[0]) / freedom)[:, None]


@pytest.mark.parametrize("freedom", [3.0, 8.0])
def test_both_parts_of_the_scale_and_the_tails_are_found(freedom: float) -> None:
    rng = np.random.default_rng(1)
    radius_m = 10 ** rng.uniform(2.7, 4.0, 8000)
    scale_m = np.hypot(90.0, 0.045 * radius_m)
    found = place_errors(scale_m[:, None] * student(rng, freedom, (8000, 2)), radius_m)
    assert found.freedom == pytest.approx(freedom, rel=0.12)
    assert found.scale_m == pytest.approx(90.0, rel=0.04)
    assert found.scale_share == pytest.approx(0.045, rel=0.06)
    assert found.log_normal < -100.0
    size = size_error(0.08 * student(rng, freedom, (8000, 1))[:, 0], freedom)
    assert size == pytest.approx(0.08, rel=0.04)


def test_normal_errors_are_as_likely_by_a_normal_distribution() -> None:
    rng = np.random.default_rng(2)
    found = place_errors(rng.normal(0.0, 100.0, (2000, 2)), np.full(2000, 1e3))
    assert abs(found.log_normal) < 3.0


def test_rows_hold_the_craters_of_their_radii() -> None:
    radius_m = np.array([500.0, 900.0, 950.0, 1500.0])
    east = np.array([10.0, 20.0, 40.0, 70.0])
    found = Differences(radius_m, np.column_stack([east, -east]), np.zeros(4), np.full(4, 0.9), np.zeros(4))
    lines = by_radius(found)
    assert [line.split(": ")[0] for line in lines] == ["0.4 to 0.7 km", "0.7 to 1 km", "1 to 2 km"]
    assert "2 craters, east 30 ± 15 m, north -30 ± 15 m, size 1.00 ± 0.00, axis ratio 0.90" in lines[1]
