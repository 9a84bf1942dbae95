"""A catalogue without heights: the sphere is assumed, said, and paid for in the covariance."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.catalogs.common_shift import unknown_height_sigma_m, unknown_height_warnings
from craternav_fg.catalogs.files import read_catalog, write_catalog
from craternav_fg.dataset import Dataset
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from tests.descents import scenario


@pytest.mark.parametrize("name", ["craters.csv", "craters.parquet"])
def test_files_tell_whether_heights_are_known(tmp_path: Path, name: str) -> None:
    data = Dataset.open(simulate(scenario(duration_s=2.0), tmp_path / "d"))
    for known in (True, False):
        write_catalog(tmp_path / name, replace(data.catalog, has_heights=known))
        again = read_catalog(tmp_path / name, data.body)
        assert again.has_heights is known
        assert again.take(np.array([1, 0])).has_heights is known


def test_an_unknown_height_is_in_the_covariance_of_the_height_alone(tmp_path: Path) -> None:
    data = Dataset.open(simulate(scenario(duration_s=6.0), tmp_path / "d"))
    names = ["ekf", "dead_reckoning"]
    known = reconstruct(data, names)
    unknown = reconstruct(replace(data, catalog=replace(data.catalog, has_heights=False)), names)
    assert not any("RIM_HEIGHT_M" in text for text in known.warnings)
    assert any("RIM_HEIGHT_M" in text and "1737 m" in text for text in unknown.warnings)
    more = unknown.trajectories["ekf"].pose_covariance - known.trajectories["ekf"].pose_covariance
    up = known.trajectories["ekf"].gTb[:, :3, 3]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    along = np.cross(up, [0.0, 0.0, 1.0])
    sigma_m = 1e-3 * data.body.radius_m
    np.testing.assert_allclose(np.einsum("ki,kij,kj->k", up, more[:, 3:, 3:], up), sigma_m**2, rtol=1e-6)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", more[:, 3:, 3:], along), 0.0, atol=1e-3)
    alone = [one.trajectories["dead_reckoning"].pose_covariance for one in (known, unknown)]
    np.testing.assert_array_equal(*alone)


@pytest.mark.parametrize(
    ("radius_m", "height_m", "least", "most"),
    # RMS heights of the IAU's ellipsoids above their spheres, and of the Moon's ground.
    [(1737400.0, 1900.0, 0.5, 2.0), (561400.0, 980.0, 0.5, 4.0), (198200.0, 4500.0, 0.5, 4.0),
     (11080.0, 1000.0, 0.5, 4.0), (245.03, 6.6, 0.5, 4.0)],
)  # fmt: skip
def test_small_bodies_are_less_round(radius_m: float, height_m: float, least: float, most: float) -> None:
    assert least < unknown_height_sigma_m(radius_m) / height_m < most


def test_the_height_that_is_unknown_on_an_asteroid_is_told_in_full() -> None:
    (told,) = unknown_height_warnings(unknown_height_sigma_m(2.5))
    assert "0.25 m of it" in told
