from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg.calibration.pull_of_prediction import View, moved_at_random, pull
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.simulation.scenes import Ground
from craternav_fg.simulation.scenes import scene as rendered_scene
from craternav_fg.vision.ellipse_fit import FitOptions
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions, correlated_roots
from craternav_fg.vision.error_model.systematic import RimErrors
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import SINGLE_IMAGE, GuidedOptions
from factors.kernels.conic import project_rims
from tests.vision import scene


@pytest.fixture(scope="module")
def view():
    """One scene: catalogue, true pose, sun, image."""
    rng = np.random.default_rng(3)
    catalog = scene.craters(rng)
    gTb, sun_g = scene.pose(), scene.sun()
    return catalog, gTb, sun_g, scene.render(catalog, gTb, sun_g, rng)


def check(rims, catalog, gTb, mean_px=0.12):
    truth = scene.true_charts(catalog, gTb, rims.craters)
    centre, major, minor = scene.semi_axes_px(rims.chart)
    true_centre, true_major, true_minor = scene.semi_axes_px(truth)
    assert np.mean(np.linalg.norm(centre - true_centre, axis=1)) < mean_px
    assert np.mean(np.abs(major - true_major)) < mean_px
    assert np.mean(np.abs(minor - true_minor)) < mean_px
    # The systematic part, which no number of rims or frames takes away.
    assert abs(np.mean(major - true_major)) < 0.08
    assert abs(np.mean(minor - true_minor)) < 0.08
    assert np.linalg.norm(np.mean(centre - true_centre, axis=0)) < 0.06
    e = rims.chart - truth
    distance2 = np.einsum("ni,ni->n", e, np.linalg.solve(rims.covariance, e[..., None])[..., 0])
    assert np.sum(distance2) < chi2.ppf(0.999, 5 * len(e))
    return e


def visible(catalog, gTb):
    return catalog.visible(scene.camera(), gTb, min_semi_minor_px=12.0, margin_px=3.0)[0]


def test_a_good_prediction(view):
    catalog, gTb, sun_g, image = view
    out = GuidedFrontEnd(scene.camera(), catalog).measure(image, 7, gTb, scene.covariance(0.5), sun_g)
    assert out.stamp_ns == 7
    assert len(out.rims) >= 0.95 * len(visible(catalog, gTb)) >= 15
    check(out.rims, catalog, gTb)


def test_the_order_of_the_catalogue_does_not_matter(view):
    catalog, gTb, sun_g, image = view
    order = np.random.default_rng(1).permutation(len(catalog))
    one, other = (
        GuidedFrontEnd(scene.camera(), c).measure(image, 7, gTb, scene.covariance(0.5), sun_g).rims
        for c in (catalog, catalog.take(order))
    )
    np.testing.assert_array_equal(order[other.craters], one.craters)
    np.testing.assert_array_equal(other.chart, one.chart)
    np.testing.assert_array_equal(other.covariance, one.covariance)


@pytest.mark.parametrize(("elevation_deg", "tilt_deg"), [(15.0, 0.0), (60.0, 0.0), (35.0, 25.0)])
def test_low_sun_high_sun_and_an_oblique_view(elevation_deg, tilt_deg):
    rng = np.random.default_rng(4)
    catalog = scene.craters(rng, half=0.28)
    gTb, sun_g = scene.pose(1.2, tilt_deg), scene.sun(elevation_deg, 200.0)
    image = scene.render(catalog, gTb, sun_g, rng)
    out = GuidedFrontEnd(scene.camera(), catalog).measure(
        image, 0, scene.moved(gTb, [0.002, -0.001, 0.001]), scene.covariance(1.5), sun_g
    )
    assert len(out.rims) >= 0.9 * len(visible(catalog, gTb)) >= 9
    check(out.rims, catalog, gTb, 0.2)


# Errors of 30 px, with a consistent covariance and with one that is far too small.
@pytest.mark.parametrize(("right_px", "down_px", "sigma_px"), [(-20.0, 22.0, 15.0), (24.0, 18.0, 0.5)])
def test_a_prediction_thirty_pixels_off(view, right_px, down_px, sigma_px):
    catalog, gTb, sun_g, image = view
    focal = scene.camera().focal_px
    wrong = scene.moved(gTb, [down_px / focal, right_px / focal, 0.005], [15.0, -10.0, 60.0])
    out = GuidedFrontEnd(scene.camera(), catalog).measure(image, 0, wrong, scene.covariance(sigma_px), sun_g)
    assert len(out.rims) >= 0.95 * len(visible(catalog, gTb))
    check(out.rims, catalog, gTb)


def test_the_result_does_not_follow_the_prediction(view):
    catalog, gTb, sun_g, image = view
    front_end = GuidedFrontEnd(scene.camera(), catalog)
    poses = [scene.moved(gTb, [1.5e-3, 0.0, 0.0]), scene.moved(gTb, [-1.5e-3, 0.0, 0.0], [0.0, 40.0, 0.0])]
    a, b = (front_end.measure(image, 0, p, scene.covariance(2.0), sun_g).rims for p in poses)
    both, i, j = np.intersect1d(a.craters, b.craters, return_indices=True)
    assert len(both) >= 0.9 * len(visible(catalog, gTb))
    sigma = np.sqrt(np.diagonal(a.covariance[i], axis1=1, axis2=2))
    assert np.mean(np.abs(a.chart[i] - b.chart[j]) / sigma) < 0.3


def test_of_rims_seen_too_little_edge_points_are_measured(view):
    """As long as at least three others are seen enough; else all ellipses stay."""
    catalog, gTb, sun_g, image = view

    def measured(share):
        front_end = GuidedFrontEnd(scene.camera(), catalog, GuidedOptions(full_arc_share=share))
        return front_end.measure(image, 0, gTb, scene.covariance(0.5), sun_g)

    every = measured(0.0)
    shares = every.rims.quality.arc_share
    limit = np.sort(shares)[5]
    assert np.sort(shares)[0] < limit
    some = measured(limit)
    np.testing.assert_array_equal(some.rims.craters, every.rims.craters[shares >= limit])
    gone = np.setdiff1d(every.rims.craters, some.rims.craters)
    assert len(np.intersect1d(some.arcs.craters, gone)) >= 0.8 * len(gone)
    np.testing.assert_array_equal(measured(1.1).rims.craters, every.rims.craters)


def test_what_is_not_there_is_not_measured(view):
    """Half of the catalogue is not in the image; then one crater stands 2.5 px beside its place."""
    catalog, gTb, sun_g, image = view
    rng = np.random.default_rng(5)
    absent = scene.craters(rng)
    angle = np.zeros(24)
    both = Catalog(
        tuple(f"{k}" for k in range(48)),
        *(
            np.concatenate([getattr(catalog, name), getattr(absent, name)])
            for name in ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m")
        ),
        np.concatenate([catalog.angle_rad, angle]),
        np.concatenate([catalog.height_m, absent.height_m]),
        catalog.body,
    )
    front_end = GuidedFrontEnd(scene.camera(), both)
    rims = front_end.measure(image, 0, gTb, scene.covariance(1.0), sun_g).rims
    assert np.count_nonzero(rims.craters >= 24) <= 1
    present = visible(catalog, gTb)
    assert np.count_nonzero(rims.craters < 24) >= 0.9 * len(present)

    row = int(present[0])
    longitude = catalog.longitude_rad.copy()
    longitude[row] += 2.5 * scene.ALTITUDE_M / scene.camera().focal_px / scene.MOON.radius_m
    shifted = Catalog(
        catalog.identifiers, catalog.latitude_rad, longitude, catalog.semi_major_m, catalog.semi_minor_m,
        catalog.angle_rad, catalog.height_m, catalog.body,
    )  # fmt: skip
    rims = GuidedFrontEnd(scene.camera(), shifted).measure(image, 0, gTb, scene.covariance(4.0), sun_g).rims
    assert row not in rims.craters
    # A catalogue that is known to be as far off as that keeps it, and no other rim is worse for it.
    poor = GuidedOptions(correlated_errors=CorrelatedErrorOptions(map_place_share=0.08))
    found = GuidedFrontEnd(scene.camera(), shifted, poor).measure(image, 0, gTb, scene.covariance(4.0), sun_g)
    assert row in found.rims.craters
    white = np.trace(found.rims.uncorrelated_covariance[:, :2, :2], axis1=1, axis2=2)
    assert np.median(white) < 1.5 * np.median(
        np.trace(rims.uncorrelated_covariance[:, :2, :2], axis1=1, axis2=2)
    )
    assert len(rims) >= 0.9 * len(present) - 1


def subset(catalog, rows):
    return Catalog(
        tuple(catalog.identifiers[r] for r in rows), catalog.latitude_rad[rows], catalog.longitude_rad[rows],
        catalog.semi_major_m[rows], catalog.semi_minor_m[rows], catalog.angle_rad[rows],
        catalog.height_m[rows], catalog.body,
    )  # fmt: skip


def test_position_covariance_is_in_g(view):
    """Two rims cannot prove a prediction wrong: only its covariance makes the search wide enough."""
    catalog, gTb, sun_g, image = view
    pair = subset(catalog, visible(catalog, gTb)[:2])
    east = scene.SITE[:, 0]
    cov = scene.covariance(0.3, 1.0)
    cov[3:, 3:] += 300.0**2 * np.outer(east, east)
    front_end = GuidedFrontEnd(scene.camera(), pair)
    rims = front_end.measure(image, 0, scene.moved(gTb, [0.0] * 3, 450.0 * east), cov, sun_g).rims
    assert len(rims) == 2
    assert np.all(np.abs(rims.chart - scene.true_charts(pair, gTb, rims.craters)) < 0.03)
    assert len(front_end.measure(image, 0, gTb, cov, sun_g).rims) == 2
    # As far off across the line along which it is uncertain.
    north = scene.SITE[:, 1]
    assert len(front_end.measure(image, 0, scene.moved(gTb, [0.0] * 3, 450.0 * north), cov, sun_g).rims) == 0


def test_a_single_rim_must_lie_where_the_covariance_allows(view):
    catalog, gTb, sun_g, image = view
    one = subset(catalog, visible(catalog, gTb)[:1])
    front_end = GuidedFrontEnd(scene.camera(), one)
    beside = scene.moved(gTb, [2.0 / scene.camera().focal_px, 0.0, 0.0])
    assert len(front_end.measure(image, 0, beside, scene.covariance(2.0, 1.0), sun_g).rims) == 1
    assert len(front_end.measure(image, 0, beside, scene.covariance(0.2, 1.0), sun_g).rims) == 0


def test_bright_ground_about_a_crater_does_not_move_its_rim(view):
    catalog, gTb, sun_g, image = view
    rows = visible(catalog, gTb)
    centre, major, _ = scene.semi_axes_px(scene.true_charts(catalog, gTb, rows))
    row = int(np.argmax(major))
    v, u = np.mgrid[0 : scene.SIZE_PX, 0 : scene.SIZE_PX]
    near = np.exp(-0.5 * (np.hypot(u - centre[row, 0], v - centre[row, 1]) / (3.0 * major[row])) ** 2)
    albedo = np.clip(np.round(image * (1.0 + 0.06 * near)), 0, 255).astype(np.uint8)
    rims = GuidedFrontEnd(scene.camera(), catalog).measure(albedo, 0, gTb, scene.covariance(1.0), sun_g).rims
    found = np.flatnonzero(rims.craters == rows[row])
    assert len(found) == 1
    measured, _, _ = scene.semi_axes_px(rims.chart[found])
    assert np.linalg.norm(measured[0] - centre[row]) < 0.25


def test_rough_ground_enlarges_the_covariance():
    rng = np.random.default_rng(6)
    catalog = scene.craters(rng)
    gTb, sun_g = scene.pose(), scene.sun()
    front_end = GuidedFrontEnd(scene.camera(), catalog)
    size = []
    for roughness in (0.0, 0.05):
        image = scene.render(catalog, gTb, sun_g, rng, roughness=roughness)
        rims = front_end.measure(image, 0, gTb, scene.covariance(1.0), sun_g).rims
        e = rims.chart - scene.true_charts(catalog, gTb, rims.craters)
        distance2 = np.einsum("ni,ni->n", e, np.linalg.solve(rims.covariance, e[..., None])[..., 0])
        assert np.sum(distance2) < chi2.ppf(0.999, 5 * len(e))
        assert len(rims) >= 0.85 * len(visible(catalog, gTb))
        size.append(np.median(rims.covariance[:, 0, 0]))
    assert size[1] > 2.0 * size[0]


@pytest.mark.parametrize("kind", ["noise", "coarse noise", "black", "white", "night"])
def test_an_image_without_craters_has_no_rims(view, kind):
    catalog, gTb, sun_g, _ = view
    size = (scene.SIZE_PX, scene.SIZE_PX)
    rng = np.random.default_rng(8)
    image = {
        "noise": lambda: rng.normal(110.0, 2.0, size),
        "coarse noise": lambda: rng.normal(110.0, 4.0, size),
        "black": lambda: np.zeros(size),
        "white": lambda: np.full(size, 255),
        "night": lambda: rng.normal(20.0, 1.0, size),
    }[kind]()
    sun = -sun_g if kind == "night" else sun_g
    out = GuidedFrontEnd(scene.camera(), catalog).measure(
        np.clip(image, 0, 255).astype(np.uint8), 3, gTb, scene.covariance(2.0), sun
    )
    assert len(out.rims) == 0
    assert out.rims.chart.shape == (0, 5)
    assert out.rims.covariance.shape == (0, 5, 5)
    assert out.sun is None


def test_no_catalogue_crater_in_view(view):
    catalog, gTb, sun_g, image = view
    options = GuidedOptions(min_semi_minor_px=400.0)
    out = GuidedFrontEnd(scene.camera(), catalog, options).measure(
        image, 0, gTb, scene.covariance(1.0), sun_g
    )
    assert len(out.rims) == 0
    assert out.sun is not None


def test_the_time_correlated_part_is_the_systematic_part_on_the_ground(view):
    """The floor of the centre times its share, and never more than the whole covariance."""
    catalog, gTb, sun_g, image = view
    options = GuidedOptions(
        brightness_slope_per_px=0.0,
        level_scatter_share=0.0,
        level_rim_share=0.0,
        fit=FitOptions(),
        correlated_errors=replace(CorrelatedErrorOptions(), crater_share=0.64),
    )
    rims = (
        GuidedFrontEnd(scene.camera(), catalog, options)
        .measure(image, 0, gTb, scene.covariance(0.5), sun_g)
        .rims
    )
    kept_px = np.linalg.norm(rims.correlated[:, 0], axis=1) * scene.camera().fx_px
    _, _, minor = scene.semi_axes_px(rims.chart)
    fit = FitOptions()
    # The frame's rims scatter a little more than they claim.
    more = kept_px / (0.8 * (fit.floor_px + fit.floor_share * minor))
    assert 1.0 <= np.median(more) < 1.2
    np.testing.assert_allclose(more, np.median(more), rtol=0.02)
    assert np.linalg.eigvalsh(rims.uncorrelated_covariance)[:, 0].min() > 0.0


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@pytest.mark.parametrize("elevation_deg", [20.0, 75.0])
def test_shared_errors_follow_camera_and_sun(elevation_deg):
    """Rims shift towards the sun, farther where slopes change the brightness little."""
    rng = np.random.default_rng(6)
    catalog = scene.craters(rng)
    options = CorrelatedErrorOptions(
        sun_shift_px=0.3, camera_shift_px=0.0, stretch_px=0.0, stretch_share=0.0, size_share=0.01
    )
    rows = np.arange(len(catalog))
    none = np.tile(1e-9 * np.eye(5), (len(rows), 1, 1))
    gTb, sun_g = scene.pose(0.0, 0.0), scene.sun(elevation_deg, 50.0)
    errors = RimErrors(none, none, np.zeros((len(rows), 5)))
    shared = correlated_roots(errors, rows, gTb, sun_g, scene.camera(), catalog, options)[1]
    # A step on the ground towards the sun, as the camera sees it.
    level = sun_g - (catalog.normals @ sun_g)[:, None] * catalog.normals
    ahead = project_rims(gTb, np.eye(4), catalog.centres + 10.0 * level, catalog.axes)[0][:, :2]
    step = ahead - project_rims(gTb, np.eye(4), catalog.centres, catalog.axes)[0][:, :2]
    moved = shared[:, :2, 2]
    across = step[:, 0] * moved[:, 1] - step[:, 1] * moved[:, 0]
    lengths = np.linalg.norm(step, axis=1) * np.linalg.norm(moved, axis=1)
    assert np.max(np.abs(across) / lengths) < 0.2
    assert np.all(np.sum(step * moved, axis=1) > 0.0)
    # Sizes are for a large slope contrast: what slopes of 1 % do to the brightness tells it.
    view = _unit(gTb[:3, 3] - catalog.centres)
    changes = []
    for axis in np.moveaxis(catalog.axes, 1, 0):
        rise = 0.01 * _unit(axis)
        low, high = (
            flat_terrain_brightness(_unit(catalog.normals + s * rise), sun_g, view)[0] for s in (-1, 1)
        )
        changes.append((high - low) / (high + low))
    contrast = np.hypot(*changes) / 0.01
    length_px = np.linalg.norm(moved, axis=1) * scene.camera().focal_px
    farther = (0.6 / np.clip(contrast, 0.1, 0.6)) ** 2
    np.testing.assert_allclose(length_px, 0.3 * np.cos(np.radians(elevation_deg)) * farther, rtol=0.12)
    assert (np.median(farther) > 1.2) == (elevation_deg > 30.0)
    # 1 % larger is 0.01 in the logarithms of both axes.
    np.testing.assert_allclose(shared[:, [2, 4], 6], 0.01, rtol=1e-6)


def test_the_error_from_the_reference_brightness_is_in_part_shared():
    """The shared part and the part that each crater keeps add up to the systematic covariance."""
    rng = np.random.default_rng(7)
    catalog = scene.craters(rng)
    rows = np.arange(len(catalog))
    options = CorrelatedErrorOptions(crater_share=1.0, brightness_share=0.3)
    brightness = 1e-3 * rng.normal(size=(len(rows), 5))
    of_brightness = brightness[:, :, None] * brightness[:, None, :]
    systematic = np.tile(1e-8 * np.eye(5), (len(rows), 1, 1)) + of_brightness
    view = scene.pose(0.0, 10.0), scene.sun(20.0, 50.0), scene.camera(), catalog, options
    own, shared = correlated_roots(RimErrors(systematic, systematic, brightness), rows, *view)
    column = shared[:, :, 7]
    np.testing.assert_allclose(column[:, :, None] * column[:, None, :], 0.3 * of_brightness, atol=1e-15)
    np.testing.assert_allclose(own @ np.swapaxes(own, 1, 2), systematic - 0.3 * of_brightness, atol=1e-13)


# EuRoC's cam0, a lens that bends the other way, a rational lens and a fisheye.
@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("radial-tangential", (-0.283, 0.074, 2e-4, 2e-5, 0.0)),
        ("radial-tangential", (0.25, 0.1, -0.004, 0.006, 0.02)),
        ("rational", (0.3, -0.05, 3e-4, -2e-4, 0.004, 0.45, -0.04, 0.006)),
        ("fisheye", (0.0034, 0.0007, -0.002, 0.0002)),
    ],
)
def test_a_lens_that_distorts_costs_no_accuracy(model, distortion):
    """Corners move by 20 to 45 px; the prediction is 30 px off besides."""
    camera = replace(scene.camera(), distortion=distortion, lens_model=model)
    rng = np.random.default_rng(11)
    catalog = scene.craters(rng)
    gTb, sun_g = scene.pose(0.8, 10.0), scene.sun(30.0, 100.0)
    image = scene.render(catalog, gTb, sun_g, rng, cam=camera)
    wrong = scene.moved(gTb, [20.0 / camera.focal_px, -22.0 / camera.focal_px, 0.005])
    front_end = GuidedFrontEnd(camera, catalog, SINGLE_IMAGE)
    out = front_end.measure(image, 0, wrong, scene.covariance(15.0), sun_g)
    seen = catalog.visible(camera, gTb, min_semi_minor_px=12.0, margin_px=3.0)[0]
    assert len(out.rims) >= 0.95 * len(seen) >= 15
    e = check(out.rims, catalog, gTb)
    distance2 = np.einsum("ni,ni->n", e, np.linalg.solve(out.rims.covariance, e[..., None])[..., 0])
    low, high = chi2.ppf([0.001, 0.999], 5 * len(e))
    assert low < np.sum(distance2) < high


def test_grey_levels_of_twelve_bits(view):
    """Finer grey levels of the same image give the same rims."""
    catalog, gTb, sun_g, image = view
    fine = replace(scene.camera(), bit_depth=12)
    args = (0, gTb, scene.covariance(1.0), sun_g)
    coarse = GuidedFrontEnd(scene.camera(), catalog).measure(image, *args)
    levels = np.round(image * (4095.0 / 255.0)).astype(np.uint16)
    out = GuidedFrontEnd(fine, catalog).measure(levels, *args)
    np.testing.assert_array_equal(out.rims.craters, coarse.rims.craters)
    sigma = np.sqrt(np.diagonal(coarse.rims.covariance, axis1=1, axis2=2))
    assert np.mean(np.abs(out.rims.chart - coarse.rims.chart) / sigma) < 0.05
    assert out.sun.tilt_rad == pytest.approx(coarse.sun.tilt_rad, abs=0.02)


def test_a_soft_lens_is_corrected_by_the_width_it_is_said_to_have():
    rng = np.random.default_rng(12)
    catalog = scene.craters(rng)
    gTb, sun_g = scene.pose(), scene.sun(25.0)
    image = scene.render(catalog, gTb, sun_g, rng, blur_px=1.8)
    bias = {}
    for said_px in (0.7, 1.8):
        camera = replace(scene.camera(), psf_sigma_px=said_px)
        rims = GuidedFrontEnd(camera, catalog).measure(image, 0, gTb, scene.covariance(0.5), sun_g).rims
        _, _, minor = scene.semi_axes_px(rims.chart)
        bias[said_px] = np.mean(minor - scene.semi_axes_px(scene.true_charts(catalog, gTb, rims.craters))[2])
    assert abs(bias[1.8]) < 0.6 * abs(bias[0.7])
    assert abs(bias[1.8]) < 0.2


@pytest.mark.parametrize("half_px", [40, 70])
def test_small_images_have_a_reference_brightness_of_their_own(view, half_px):
    catalog, gTb, sun_g, image = view
    whole = scene.camera()
    rims = GuidedFrontEnd(whole, catalog).measure(image, 0, gTb, scene.covariance(0.5), sun_g).rims
    centre_px = rims.chart[:, :2] * whole.fx_px + [whole.cx_px, whole.cy_px]
    inside = np.all((centre_px > half_px) & (centre_px < len(image) - half_px), axis=1)
    _, major, _ = scene.semi_axes_px(rims.chart)
    k = int(np.flatnonzero(inside & (major < 0.6 * half_px))[0])
    x, y = np.rint(centre_px[k]).astype(int) - half_px
    window = np.ascontiguousarray(image[y : y + 2 * half_px, x : x + 2 * half_px])
    camera = replace(
        whole, width_px=2 * half_px, height_px=2 * half_px, cx_px=whole.cx_px - x, cy_px=whole.cy_px - y
    )
    part = GuidedFrontEnd(camera, catalog).measure(window, 0, gTb, scene.covariance(0.5), sun_g).rims
    found = np.flatnonzero(part.craters == rims.craters[k])
    assert len(found) == 1
    np.testing.assert_allclose(part.chart[found[0], :2], rims.chart[k, :2], atol=0.3 / whole.fx_px)


def test_a_map_that_is_off_is_searched_as_far_as_it_says(view):
    """Craters a quarter of their radius off the map, in random directions."""
    catalog, gTb, sun_g, image = view
    rng = np.random.default_rng(11)
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    angle = rng.uniform(0.0, 2.0 * np.pi, len(catalog))
    shift = 0.25 * radius_m / catalog.body.radius_m
    moved = replace(
        catalog,
        latitude_rad=catalog.latitude_rad + shift * np.sin(angle),
        longitude_rad=catalog.longitude_rad + shift * np.cos(angle) / np.cos(catalog.latitude_rad),
    )
    none = np.zeros(len(catalog))
    stated = replace(moved, errors=MapErrors(0.25 * radius_m / np.sqrt(2.0), none, none))
    rows = visible(catalog, gTb)
    silent, told = (
        GuidedFrontEnd(scene.camera(), c).measure(image, 0, gTb, scene.covariance(0.5), sun_g).rims
        for c in (moved, stated)
    )
    assert len(told) >= 0.8 * len(rows)
    assert len(silent) < 0.7 * len(told)
    # Where the image shows them, not where the map has them.
    off = np.linalg.norm(scene.semi_axes_px(told.chart)[0] - _centres_px(catalog, gTb, told.craters), axis=1)
    assert np.median(off) < 0.3


def test_a_rim_whose_shape_contradicts_a_map_with_errors_counts_less(view):
    catalog, gTb, sun_g, image = view
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    every = np.ones(len(catalog))
    stated = replace(catalog, errors=MapErrors(0.05 * radius_m, 0.04 * every, 0.0 * every))
    odd = visible(catalog, gTb)[0]
    narrow = np.where(np.arange(len(catalog)) == odd, 0.92, 1.0)
    squeezed = replace(
        stated, semi_major_m=stated.semi_major_m / narrow, semi_minor_m=stated.semi_minor_m * narrow
    )
    right, wrong = (
        GuidedFrontEnd(scene.camera(), c).measure(image, 0, gTb, scene.covariance(0.5), sun_g).rims
        for c in (stated, squeezed)
    )
    np.testing.assert_array_equal(right.craters, wrong.craters)
    places = [np.trace(rims.covariance[:, :2, :2], axis1=1, axis2=2) for rims in (right, wrong)]
    larger = places[1] / places[0]
    assert larger[right.craters == odd] > 1.5
    np.testing.assert_allclose(larger[right.craters != odd], 1.0, rtol=0.1)


def _centres_px(catalog, gTb, rows):
    return scene.semi_axes_px(scene.true_charts(catalog, gTb, rows))[0]


def test_rims_do_not_follow_their_predictions():
    """With a map that states errors, rims measured near misplaced predictions must not confirm these."""
    taken = rendered_scene(
        1, Ground(density=0.01, separation_ratio=0.75, irregularity_share=0.08, slope=0.06, size_px=768)
    )
    radius_m = np.sqrt(taken.catalog.semi_major_m * taken.catalog.semi_minor_m)
    errors = MapErrors(0.06 * radius_m, np.full(len(radius_m), 0.08), np.zeros(len(radius_m)))
    catalog = replace(taken.catalog, errors=errors)
    views = [View(taken.image, taken.gTb, taken.sun_g)]
    rng = np.random.default_rng(0)
    pairs = [(moved_at_random(catalog, rng), moved_at_random(catalog, rng)) for _ in range(12)]

    def mean_slope(options):
        found = [pull(views, taken.camera, maps, options) for maps in pairs]
        return np.average([one.slope for one in found], weights=[one.rims for one in found])

    once = mean_slope(GuidedOptions(recentrings=0))
    assert once > 0.1
    assert abs(mean_slope(GuidedOptions(searches=1))) < 0.5 * once
    assert abs(mean_slope(GuidedOptions())) < 0.4 * once
