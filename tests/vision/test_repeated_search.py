"""Rims that are searched from several places, where the map states errors."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.measurements import RimQuality
from craternav_fg.vision.error_model.systematic import RimErrors
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.predicted_rims import predict_rims
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from craternav_fg.vision.repeated_search import _means
from craternav_fg.vision.rim_fitting import FittedRims
from tests.vision import scene
from tests.vision.test_guided import view, visible  # noqa: F401 (the fixture)


def stated(catalog):
    """The map, right as it is, with errors that it might have."""
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    return replace(
        catalog, errors=MapErrors(0.08 * radius_m, np.full(len(catalog), 0.08), np.zeros(len(catalog)))
    )


def test_sharp_rims_are_the_same_from_everywhere(view):  # noqa: F811
    catalog, gTb, sun_g, image = view
    found = [
        GuidedFrontEnd(scene.camera(), stated(catalog), options)
        .measure(image, 0, gTb, scene.covariance(0.5), sun_g)
        .rims
        for options in (GuidedOptions(), GuidedOptions(searches=1))
    ]
    several, once = found
    assert set(once.craters) <= set(several.craters) | set(once.craters[:1])
    _, first, second = np.intersect1d(several.craters, once.craters, return_indices=True)
    apart_px = np.linalg.norm(several.chart[first, :2] - once.chart[second, :2], axis=1)
    apart_px *= scene.camera().focal_px
    assert np.median(apart_px) < 0.02
    # Nothing is added to their errors.
    ratio = several.covariance[first, 0, 0] / once.covariance[second, 0, 0]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)


@pytest.fixture
def rims(view):  # noqa: F811
    catalog, gTb, sun_g, image = view
    camera = scene.camera()
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    brightness = ReferenceBrightness(pixels, camera, catalog.body.radius_m, gTb, sun_g)
    return predict_rims(visible(catalog, gTb)[:3], camera, catalog, gTb, sun_g, brightness)


def fitted(rims, rows, charts):
    """Fits of some rims with errors of size one, and a quality that numbers the search."""
    n = len(rows)
    errors = RimErrors(np.tile(np.eye(5), (n, 1, 1)), np.tile(0.5 * np.eye(5), (n, 1, 1)), np.zeros((n, 5)))
    number = np.full(n, charts[0, 0])
    quality = RimQuality(number, number, number, number, number)
    return FittedRims(rims.take(np.array(rows, dtype=np.int64)), charts, errors, quality)


@pytest.mark.parametrize("name", ["searches", "least_searches"])
def test_no_search_at_all_is_refused(name):
    with pytest.raises(ValueError, match=f"{name}: expected 1 or more, found 0"):
        GuidedOptions(**{name: 0})


def test_means_have_the_scatter_of_the_searches_in_their_errors(rims):
    rng = np.random.default_rng(2)
    charts = rng.normal(size=(4, 3, 5))
    # The third rim is found twice.
    found = [
        fitted(rims, rows, charts[k, rows]) for k, rows in enumerate([[0, 1], [0, 1, 2], [0, 1], [0, 2]])
    ]
    means = _means(rims, found, 3)
    np.testing.assert_array_equal(means.predicted.rows, rims.rows[:2])
    np.testing.assert_allclose(means.charts[0], charts[:, 0].mean(axis=0))
    np.testing.assert_allclose(means.charts[1], charts[:3, 1].mean(axis=0))
    for k, several in enumerate((charts[:, 0], charts[:3, 1])):
        scatter = np.cov(several.T)
        np.testing.assert_allclose(means.errors.covariance[k], np.eye(5) + scatter)
        np.testing.assert_allclose(means.errors.systematic[k], 0.5 * np.eye(5) + scatter)
        nearest = np.argmin(np.linalg.norm((several - several.mean(axis=0))[:, :2], axis=1))
        assert means.quality.rms_px[k] == found[nearest].quality.rms_px[0]
    assert len(_means(rims, found, 2)) == 3
    assert len(_means(rims, [], 2)) == 0
