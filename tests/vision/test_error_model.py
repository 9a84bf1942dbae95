"""Steps of the error model between the fit of one rim and the frame's rim set."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from craternav_fg.catalogs.map_errors import CRATER_FREEDOM, MapErrors
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.vision.error_model.correlated import (
    CorrelatedErrorOptions,
    in_plane_slopes,
    map_roots,
    split,
)
from craternav_fg.vision.error_model.frame_scatter import variance_factor
from craternav_fg.vision.error_model.outline import unseen_deviation
from craternav_fg.vision.error_model.shape_scatter import shape_variance_factors
from craternav_fg.vision.error_model.steady_roots import with_steady_roots
from craternav_fg.vision.error_model.systematic import RimErrors
from factors.kernels.conic import project_rims
from tests.vision import scene


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("wrong", [0, 200])
def test_variance_factor_is_that_of_the_residuals_whatever_wrong_matches_there_are(scale, wrong):
    rng = np.random.default_rng(1)
    count = 2000
    distance2 = np.sum((scale * rng.normal(size=(count, 5))) ** 2, axis=1)
    distance2[:wrong] = 1e6
    # Wrong matches of 10 % move the median to the quantile 0.556 of the others: 1.10 times the median.
    high = 1.0 if wrong == 0 else 1.10
    # The relative standard error of a median of 2000 chi-squares of 5 degrees of freedom is 1.9 %.
    margin = norm.ppf(0.999) * 0.019
    assert scale**2 * (1.0 - margin) < variance_factor(distance2, 5) < scale**2 * high * (1.0 + margin)


def test_rims_that_scatter_less_than_claimed_keep_their_covariance_and_few_rims_prove_nothing():
    rng = np.random.default_rng(2)
    assert variance_factor(0.3 * rng.chisquare(5, 100), 5) == 1.0
    assert variance_factor(np.full(5, 1e3), 5) == 1.0


def test_irregular_frames_expect_the_same_deviation_of_every_rim():
    shares = np.array([0.001, 0.01, 0.02, 0.015, 0.03])
    unseen = unseen_deviation(shares, 0.0003)
    seen_less = shares < 0.018
    np.testing.assert_allclose(np.hypot(shares, unseen)[seen_less], np.linalg.norm(shares) / np.sqrt(5.0))
    assert np.all(unseen[~seen_less] == 0.0)
    # Mostly ellipses, and no rims.
    assert np.all(unseen_deviation(np.array([0.0003, 0.001, 0.0003, 0.02]), 0.0003) == 0.0)
    assert unseen_deviation(np.empty(0), 0.0003).shape == (0,)


@pytest.fixture(scope="module")
def view():
    catalog = scene.craters(np.random.default_rng(3))
    return scene.pose(0.3, 20.0), scene.sun(30.0, 50.0), scene.camera(), catalog


def claimed(count):
    """Errors of rims with a systematic part and a part from the brightness, all drawn at random."""
    rng = np.random.default_rng(4)
    root = 1e-4 * rng.normal(size=(count, 5, 5))
    brightness = 1e-4 * rng.normal(size=(count, 5))
    white, outline = 1e-8 * np.eye(5), root @ np.swapaxes(root, 1, 2)
    return RimErrors.stack(
        [RimErrors.of_fit(white, S, v, white) for S, v in zip(outline, brightness, strict=True)]
    )


def test_correlated_and_shared_parts_leave_a_white_rest(view):
    """Without common shifts the whole covariance is the fit's; what is correlated is taken from it."""
    count = len(view[3])
    errors = claimed(count)
    quiet = CorrelatedErrorOptions(
        camera_shift_px=0.0, sun_shift_px=0.0, stretch_px=0.0, stretch_share=0.0, size_px=0.0, size_share=0.0
    )
    covariance, correlated, of_map, shared, _ = split(errors, 1.0, np.arange(count), *view, quiet)
    assert of_map is None
    np.testing.assert_allclose(covariance, errors.covariance, rtol=0.0, atol=1e-18)
    rest = covariance - correlated @ np.swapaxes(correlated, 1, 2) - shared @ np.swapaxes(shared, 1, 2)
    assert np.linalg.eigvalsh(rest)[:, 0].min() > 0.9e-8
    # What is common comes on top of the fit's own covariance.
    louder, *_ = split(errors, 1.0, np.arange(count), *view, CorrelatedErrorOptions())
    assert np.linalg.eigvalsh(louder - covariance)[:, 0].min() > -1e-18
    assert np.trace(louder - covariance, axis1=1, axis2=2).min() > 1e-8


def test_errors_of_the_map_are_added_and_stay_with_their_craters(view):
    """A shift of a crater by a sigma of the map changes its chart by a sigma of what is added."""
    count = len(view[3])
    options = CorrelatedErrorOptions(map_place_share=0.05, map_size_share=0.02)
    parts = split(claimed(count), 1.0, np.arange(count), *view, options)
    without = split(claimed(count), 1.0, np.arange(count), *view, CorrelatedErrorOptions())
    added = parts.covariance - without.covariance
    assert parts.of_map is not None
    np.testing.assert_allclose(added, parts.of_map @ np.swapaxes(parts.of_map, 1, 2), atol=1e-17)
    for name in ("correlated", "shared", "fused_white"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(without, name))
    gTb, _, camera, catalog = view
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    place, size, cos = 0.05 * radius_m, 0.02, np.cos(catalog.latitude_rad)
    moved = [
        {"latitude_rad": catalog.latitude_rad + place / catalog.body.radius_m},
        {"longitude_rad": catalog.longitude_rad + place / catalog.body.radius_m / cos},
        {"semi_major_m": catalog.semi_major_m * (1.0 + size)},
        {"semi_minor_m": catalog.semi_minor_m * (1.0 + size)},
    ]  # fmt: skip

    def charts(craters):
        return project_rims(gTb, camera.bTc, craters.centres, craters.axes)[0]

    steps = [charts(dataclasses.replace(catalog, **change)) - charts(catalog) for change in moved]
    expected = sum(step[:, :, None] * step[:, None, :] for step in steps)
    # The shear is the fifth part; the rest is that of the four moved catalogues.
    diagonal = np.diagonal(added, axis1=1, axis2=2)
    np.testing.assert_allclose(
        np.diagonal(expected, axis1=1, axis2=2)[:, [0, 1]], diagonal[:, [0, 1]], rtol=0.05
    )
    assert np.all(diagonal[:, 2:] > 0.4 * np.diagonal(expected, axis1=1, axis2=2)[:, 2:])


def test_scaling_multiplies_every_part_of_the_variance():
    errors = claimed(3)
    scaled = errors.scaled(4.0)
    assert np.allclose(scaled.covariance, 4.0 * errors.covariance)
    rest = scaled.systematic - scaled.brightness_root[:, :, None] * scaled.brightness_root[:, None, :]
    before = errors.systematic - errors.brightness_root[:, :, None] * errors.brightness_root[:, None, :]
    assert np.allclose(rest, 4.0 * before)


def test_errors_that_the_catalogue_states_are_added_crater_by_crater(view):
    """A step of a standard deviation of one crater's height changes its chart by what is added."""
    gTb, sun, camera, catalog = view
    count = len(catalog)
    none, height = np.zeros(count), np.zeros(count)
    height[3] = 150.0
    stated = dataclasses.replace(catalog, errors=MapErrors(none, none, height))
    options = CorrelatedErrorOptions()
    rows = np.arange(count)
    covariance, correlated, of_map, *_ = split(claimed(count), 1.0, rows, gTb, sun, camera, stated, options)
    without, kept, *_ = split(claimed(count), 1.0, rows, *view, options)
    added = covariance - without
    assert np.abs(np.delete(added, 3, axis=0)).max() < 1e-18
    raised = dataclasses.replace(catalog, height_m=catalog.height_m + height)
    charts = [project_rims(gTb, camera.bTc, one.centres, one.axes)[0][3] for one in (catalog, raised)]
    step = charts[1] - charts[0]
    np.testing.assert_allclose(added[3], np.outer(step, step), rtol=0.1, atol=0.02 * np.max(step**2))
    # It stays with the crater, in a direction of its own.
    np.testing.assert_allclose(of_map[3, :, 2], step, rtol=0.05, atol=0.02 * np.max(np.abs(step)))
    np.testing.assert_array_equal(correlated, kept)
    placed = dataclasses.replace(catalog, errors=MapErrors(0.05 * radius(catalog), none + 0.02, none))
    shares = CorrelatedErrorOptions(map_place_share=0.05, map_size_share=0.02)
    told, *_ = split(claimed(count), 1.0, rows, gTb, sun, camera, placed, options)
    assumed, *_ = split(claimed(count), 1.0, rows, *view, shares)
    np.testing.assert_allclose(told, assumed, rtol=1e-12, atol=1e-18)


def test_slopes_that_the_catalogue_does_not_state_are_unknown(view):
    """They stay with the crater, in directions of their own; a map that states them is believed."""
    gTb, sun, camera, catalog = view
    rows, options = np.arange(len(catalog)), CorrelatedErrorOptions()
    silent = dataclasses.replace(catalog, plane_tilt_rad=None)
    told, kept, exact_map, *_ = split(claimed(len(rows)), 1.0, rows, *view, options)
    assert exact_map is None
    covariance, correlated, tilts, *_ = split(
        claimed(len(rows)), 1.0, rows, gTb, sun, camera, silent, options
    )
    assert tilts.shape == (len(rows), 5, 2)
    np.testing.assert_allclose(correlated, kept, rtol=1e-9, atol=1e-16)
    before = project_rims(gTb, camera.bTc, catalog.centres, catalog.axes)[0]
    for direction in np.eye(2):
        slopes = np.tile(np.arctan(options.map_tilt_rad * direction), (len(rows), 1))
        tilted = dataclasses.replace(catalog, plane_tilt_rad=slopes)
        step = project_rims(gTb, camera.bTc, tilted.centres, tilted.axes)[0] - before
        # East and north lie somewhere between the semi-axes.
        left = step - np.einsum("nij,nj->ni", tilts, _solved(tilts, step))
        assert np.abs(left).max() < 0.05 * np.abs(step).max()
    added = tilts @ np.swapaxes(tilts, 1, 2)
    np.testing.assert_allclose(covariance - told, added, atol=1e-17)
    known = CorrelatedErrorOptions(map_tilt_rad=0.0)
    exact, *_ = split(claimed(len(rows)), 1.0, rows, gTb, sun, camera, silent, known)
    np.testing.assert_allclose(exact, told, rtol=1e-12, atol=1e-18)


def _solved(roots, steps):
    return np.array([np.linalg.lstsq(A, step, rcond=None)[0] for A, step in zip(roots, steps, strict=True)])


def radius(catalog):
    return np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)


def test_scatter_of_a_frame_adds_white_variance_for_estimators_alone(view):
    """What a rim states does not depend on it; beyond a factor of 3 nothing more is added."""
    rows = np.arange(len(view[3]))
    errors, options = claimed(len(rows)), CorrelatedErrorOptions()
    told = {factor: split(errors, factor, rows, *view, options) for factor in (1.0, 1.5, 3.0, 30.0)}
    for parts in told.values():
        for name in ("covariance", "correlated", "shared"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(told[1.0], name))
    covariance, correlated, _, shared, fused = told[1.0]
    white = covariance - sum(A @ np.swapaxes(A, 1, 2) for A in (correlated, shared))
    np.testing.assert_allclose(fused, white, rtol=1e-9, atol=1e-18)
    added = options.excess_white_share * 0.5 * errors.systematic
    np.testing.assert_allclose(told[1.5].fused_white - white, added, rtol=1e-9, atol=1e-18)
    np.testing.assert_array_equal(told[30.0].fused_white, told[3.0].fused_white)


def test_only_the_shape_tells_that_a_rim_errs_by_more_than_it_states(view):
    """Not what a wrong pose does: it moves and enlarges rims."""
    gTb, _, camera, catalog = view
    rows = np.arange(len(catalog))
    slopes = in_plane_slopes(rows, gTb, camera, catalog)
    # Shifts, growths and the shear of 0.1 radii; rims have it in no preferred direction.
    on_ground = 0.01 * np.diag([1.0, 1.0, 1.0, 0.5, 1.0])
    covariance = slopes @ on_ground @ np.swapaxes(slopes, 1, 2)
    moved = np.tile([2.0, -1.0, 0.5, 0.0, 0.5], (len(rows), 1))
    unmoved = shape_variance_factors(np.einsum("nij,nj->ni", slopes, moved), covariance, slopes)
    np.testing.assert_allclose(unmoved, 1.0)
    # The growths differ by 0.3, their variance is 0.02; the shear is 0.2, its variance 0.005.
    for stretch, distance2 in (([0.0, 0.0, 0.15, 0.0, -0.15], 4.5), ([0.0, 0.0, 0.0, 0.2, 0.0], 8.0)):
        errors = np.einsum("nij,nj->ni", slopes, moved + stretch)
        expected = (CRATER_FREEDOM + distance2) / (CRATER_FREEDOM + 2.0)
        np.testing.assert_allclose(shape_variance_factors(errors, covariance, slopes), expected)


def test_errors_with_a_common_scale_are_told_from_the_shape(view):
    """Places of rims drawn from Student's t distribution are likelier with the variances of their shapes."""
    gTb, _, camera, catalog = view
    rng = np.random.default_rng(7)
    rows = np.repeat(np.arange(len(catalog)), 400)
    slopes = in_plane_slopes(rows, gTb, camera, catalog)
    sigma = np.array([0.1, 0.1, 0.1, 0.1 / np.sqrt(2.0), 0.1])
    covariance = slopes @ np.diag(sigma**2) @ np.swapaxes(slopes, 1, 2)
    drawn = sigma * rng.normal(size=(len(rows), 5))
    scale2 = CRATER_FREEDOM / rng.chisquare(CRATER_FREEDOM, len(rows))
    places2 = np.sum(drawn[:, :2] ** 2, axis=1) * scale2 / sigma[0] ** 2
    errors = np.einsum("nij,nj->ni", slopes, np.sqrt(scale2)[:, None] * drawn)
    factors = shape_variance_factors(errors, covariance, slopes)
    # Worse rims are told, and the mean square of places is nearer to what is stated.
    large = factors > 2.0
    assert np.mean(places2[large]) > 2.0 * np.mean(places2[~large])
    assert abs(np.mean(places2 / factors) / 2.0 - 1.0) < 0.7 * abs(np.mean(places2) / 2.0 - 1.0)
    # Where nothing has heavy tails little is lost.
    normal = shape_variance_factors(np.einsum("nij,nj->ni", slopes, drawn), covariance, slopes)
    assert np.mean(normal) < 1.15


def test_errors_of_the_map_have_one_size_in_all_frames(view):
    """The mean of what its frames show, however large it is in single ones; the rest is white."""
    gTb, _, camera, catalog = view
    n, options, rng = len(catalog), CorrelatedErrorOptions(), np.random.default_rng(5)
    catalog = replace(catalog, errors=MapErrors(0.02 * radius(catalog), np.full(n, 0.01), np.zeros(n)))
    # One crater is not in every frame, and one is never taken for worse.
    rows = [np.arange(n), np.arange(1, n), np.arange(n)]
    factors = [np.where(one == n - 1, 1.0, rng.uniform(1.0, 9.0, len(one))) for one in rows]
    white, before = 1e-8 * np.eye(5), []
    for k, (one, factor) in enumerate(zip(rows, factors, strict=True)):
        roots = map_roots(one, gTb, camera, catalog, options)
        own = RimSet(
            one, np.zeros((len(one), 5)), white + roots @ np.swapaxes(roots, 1, 2), of_map=roots,
            fused_white=np.tile(3.0 * white, (len(one), 1, 1)),
        )  # fmt: skip
        before.append(FrameMeasurement(k, own.scaled(factor), None))
    after = with_steady_roots(before, np.array([gTb] * 3), camera, catalog, options)
    sums, counts = np.zeros(n), np.zeros(n)
    for one, factor in zip(rows, factors, strict=True):
        sums[one] += factor
        counts[one] += 1
    for frame, old, factor in zip(after, before, factors, strict=True):
        rims, mean = frame.rims, (sums / counts)[frame.rims.craters]
        roots = map_roots(rims.craters, gTb, camera, catalog, options)
        np.testing.assert_allclose(rims.of_map, np.sqrt(mean)[:, None, None] * roots, rtol=1e-9)
        part = roots @ np.swapaxes(roots, 1, 2)
        gained, lost = (np.maximum(d, 0.0)[:, None, None] * part for d in (mean - factor, factor - mean))
        np.testing.assert_allclose(rims.covariance - old.rims.covariance, gained, atol=1e-12)
        np.testing.assert_allclose(
            rims.fused_white_covariance - old.rims.fused_white_covariance, lost, atol=1e-12
        )
    exact = replace(catalog, errors=None)
    assert with_steady_roots(before, np.array([gTb] * 3), camera, exact, options) == tuple(before)
