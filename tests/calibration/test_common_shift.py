"""The common shift of a map that is shifted by a known amount."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.calibration.common_shift import crater_shifts_m, student, without_each
from craternav_fg.dataset import Dataset
from craternav_fg.simulation.scenario import simulate
from tests.descents import scenario


def test_the_shift_of_a_turned_map_is_found(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=20.0), tmp_path / "d"))
    catalog = data.catalog
    east, north, up = frames.east_north_up(catalog.latitude_rad[:1], catalog.longitude_rad[:1])[0].T
    turn = np.cross(up, 150.0 * east - 80.0 * north) / catalog.body.radius_m
    latitude, longitude = frames.latitude_longitude(catalog.centres @ frames.rotation_exp(turn).T)
    moved = replace(data, catalog=replace(catalog, latitude_rad=latitude, longitude_rad=longitude))
    assert data.measurements is not None
    measured = data.measurements
    right, shifted = (list(crater_shifts_m(one, measured).values()) for one in (data, moved))
    assert len(right) > 3
    np.testing.assert_allclose(np.median(right, axis=0), [0.0, 0.0], atol=3.0)
    # The map lies too far east and too far south.
    np.testing.assert_allclose(np.median(shifted, axis=0), [-150.0, 80.0], atol=5.0)


def test_ground_truth_is_required(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=20.0), tmp_path / "d"))
    (data.path / "mav0" / "state_groundtruth_estimate0" / "data.csv").unlink()
    with pytest.raises(ValueError, match="expected ground truth, found none"):
        crater_shifts_m(Dataset.open(data.path), data.measurements)


def test_each_crop_takes_the_shifts_of_the_others() -> None:
    found = without_each(np.array([[30.0, 40.0], [0.0, 0.0], [60.0, -80.0]]))
    np.testing.assert_allclose(found, [50.0, np.sqrt(12500.0 / 4.0), 25.0])


@pytest.mark.parametrize("freedom", [3.0, 8.0])
def test_the_tails_of_a_distribution_are_found(freedom: float) -> None:
    rng = np.random.default_rng(1)
    normal = rng.standard_normal((20_000, 2))
    drawn = 1.5 * normal / np.sqrt(rng.chisquare(freedom, 20_000) / freedom)[:, None]
    found, scale = student(drawn)
    assert found == pytest.approx(freedom, rel=0.1)
    assert scale == pytest.approx(1.5, rel=0.03)
