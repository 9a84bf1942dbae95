"""The common shift of a map that is shifted by a known amount."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.calibration.common_shift import crater_shifts_m, without_each
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
    right, shifted = (crater_shifts_m(one, data.measurements) for one in (data, moved))
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
