"""Rims tell by their sizes that the places of a catalogue are of another scale."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.dataset import Dataset
from craternav_fg.measurements import RimSet
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


def _growth(data: Dataset, rims: list[RimSet]) -> Growth:
    """Growth of a data set's rims, or of others in their place, from the true poses."""
    assert data.measurements is not None
    assert data.truth is not None
    at = np.searchsorted(data.truth.stamps_ns, [frame.stamp_ns for frame in data.measurements])
    frames = [replace(frame, rims=one) for frame, one in zip(data.measurements, rims, strict=True)]
    found = growth_of_rims(frames, data.truth.gTb[at], data.camera, data.catalog)
    assert found is not None
    return found


def test_rims_of_other_craters_do_not_count(data: Dataset) -> None:
    assert data.measurements is not None
    right = [frame.rims for frame in data.measurements]
    larger = np.array([0.0, 0.0, 0.3, 0.0, 0.3])
    wrong = [
        replace(rims, chart=rims.chart + larger * (np.arange(len(rims)) % 5 == k % 5)[:, None])
        for k, rims in enumerate(right)
    ]
    assert abs(_growth(data, wrong).share - _growth(data, right).share) < 2e-4


def test_a_crater_that_is_seen_often_tells_its_own_size_once(data: Dataset) -> None:
    """Each crater is larger or smaller than on the map in all frames alike, which the rims state."""
    assert data.measurements is not None
    sigma, rng = 0.02, np.random.default_rng(1)
    root = np.zeros((5, 5))
    root[[2, 4], 0] = sigma
    squares = []
    for _ in range(30):
        own = sigma * rng.standard_normal(len(data.catalog))
        rims = [
            replace(
                one,
                chart=one.chart + own[one.craters][:, None] * [0.0, 0.0, 1.0, 0.0, 1.0],
                covariance=one.covariance + root @ root.T,
                correlated=np.tile(root, (len(one), 1, 1)),
            )
            for one in (frame.rims for frame in data.measurements)
        ]
        found = _growth(data, rims)
        squares.append((found.share / found.sigma_share) ** 2)
    # As of a standard normal variable; with frames as independent it is above 4.
    assert np.mean(squares) < chi2.ppf(0.999, 30) / 30


def test_growth_within_its_uncertainty_is_not_told() -> None:
    assert scaled_map(None) == scaled_map(Growth(-0.0059, 0.001)) == []
    (text,) = scaled_map(Growth(-0.0061, 0.001))
    assert text.startswith("the rims are 0.61 +- 0.1 % smaller than")
