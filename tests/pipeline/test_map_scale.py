"""Rims tell by their sizes that the places of a catalogue are of another scale."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.dataset import Dataset
from craternav_fg.pipeline.catalog_warnings import scaled_map
from craternav_fg.pipeline.map_scale import Growth, growth_of_rims
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate

SAID = "than their craters from where the distances between them put the camera"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate("measured_descent", tmp_path_factory.mktemp("scale") / "data"))


def stretched(data: Dataset, share: float) -> Dataset:
    """Places farther from the middle of the region by a share, craters as large as they are."""
    catalog = data.catalog
    latitude, longitude = catalog.latitude_rad, catalog.longitude_rad
    middle = np.mean(latitude), np.mean(longitude)
    places = [one + share * (one - at) for one, at in zip((latitude, longitude), middle, strict=True)]
    return replace(data, catalog=replace(catalog, latitude_rad=places[0], longitude_rad=places[1]))


@pytest.mark.parametrize(
    ("share", "sign"), [(-0.001, "smaller"), (0.0, ""), (0.001, "larger"), (0.01, "larger")]
)
def test_a_map_of_another_scale_is_told(data: Dataset, share: float, sign: str) -> None:
    """The altitude follows the places: 53 m off with a sigma of 3 m, without a word."""
    told = reconstruct(stretched(data, share), ["smoother"]).warnings
    found = [text for text in told if SAID in text]
    assert bool(found) == bool(sign), told
    assert all(f"% {sign} than" in text for text in found)
    assert not any("counts as exact" in text for text in told) or not found


def test_the_growth_is_that_of_the_sizes(data: Dataset) -> None:
    assert data.measurements is not None
    assert data.truth is not None
    at = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    gTb = data.truth.gTb[at]
    right = growth_of_rims(data.measurements, gTb, data.camera, data.catalog)
    assert right is not None
    assert abs(right.share) < 4.0 * right.sigma_share
    growth = np.array([0.0, 0.0, 2e-3, 0.0, 2e-3])
    larger = [
        replace(one, rims=replace(one.rims, chart=one.rims.chart + growth)) for one in data.measurements
    ]
    grown = growth_of_rims(larger, gTb, data.camera, data.catalog)
    assert grown is not None
    assert grown.share - right.share == pytest.approx(2e-3, abs=2e-4)
    # Sizes on a map may all be of another definition, by as much as they are uncertain.
    errors = replace(MapErrors.zeros(len(data.catalog)), size_share=np.full(len(data.catalog), 0.01))
    stated = growth_of_rims(larger, gTb, data.camera, replace(data.catalog, errors=errors))
    assert stated is not None
    assert 0.01 < stated.sigma_share < 0.011
    assumed = growth_of_rims(
        larger, gTb, data.camera, replace(data.catalog, errors=errors), stated_errors=False
    )
    assert assumed is not None
    assert assumed.sigma_share < 0.002
    assert growth_of_rims([], gTb[:0], data.camera, data.catalog) is None
    assert growth_of_rims(data.measurements[:1], gTb[:1], data.camera, data.catalog) is None


def test_growth_within_its_uncertainty_is_not_told() -> None:
    assert scaled_map(None) == scaled_map(Growth(-0.0059, 0.001)) == []
    (text,) = scaled_map(Growth(-0.0061, 0.001))
    assert text.startswith("the rims are 0.61 +- 0.1 % smaller than")
