from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import matrix_of_chart, pixel_chart
from craternav_fg.simulation import crater_shape
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from tests.simulation import scene

OPTIONS = CraterFieldOptions(focal_px=scene.FOCAL)


def field(seed: int = 1, options: CraterFieldOptions = OPTIONS) -> Catalog:
    return random_craters(np.random.default_rng(seed), scene.MOON, scene.track(), options, scene.relief())


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return field()


def test_same_seed_same_field(catalog: Catalog) -> None:
    again, other = field(), field(seed=2)
    np.testing.assert_array_equal(again.height_m, catalog.height_m)
    np.testing.assert_array_equal(again.angle_rad, catalog.angle_rad)
    assert other.semi_major_m[0] != catalog.semi_major_m[0]


def test_catalogue_is_valid(catalog: Catalog) -> None:
    assert 300 < len(catalog) < 4000
    assert len(set(catalog.identifiers)) == len(catalog)
    assert catalog.identifiers[0] == "S00001"
    ratio = catalog.semi_minor_m / catalog.semi_major_m
    assert ratio.min() >= 0.75
    assert ratio.max() <= 1.0
    assert np.all(np.diff(catalog.semi_major_m) <= 0.0)


def test_rims_stand_apart(catalog: Catalog) -> None:
    theta = np.linspace(0.0, 2.0 * np.pi, 90)
    for row in range(60):
        rim = scene.rim(catalog, row, theta, rho=1.29)
        distance = np.linalg.norm(catalog.centres - catalog.centres[row], axis=1)
        for other in np.flatnonzero(distance < 4.0 * catalog.semi_major_m[row]):
            if other == row:
                continue
            local = (rim - catalog.centres[other]) @ catalog.gRl[other]
            rho = np.hypot(
                local[:, 0] / catalog.semi_major_m[other], local[:, 1] / catalog.semi_minor_m[other]
            )
            assert rho.min() > 1.29


def test_sizes_are_scale_free() -> None:
    # From one height, with too few craters to crowd one another out.
    still = scene.place(0.0, 0.0, 20e3)[None]
    options = replace(OPTIONS, density=0.0004, max_apparent_px=600.0)
    radii = []
    for seed in range(12):
        one = random_craters(np.random.default_rng(seed), scene.MOON, still, options, scene.relief(slope=0.0))
        radii.append(one.semi_minor_m)
    r = np.concatenate(radii)
    area_m2 = 12 * np.pi * (1.25 * 20e3) ** 2
    for limit_px in (15.0, 30.0, 60.0):
        limit_m = limit_px * 20e3 / scene.FOCAL
        expected = options.density * limit_m**-2 * area_m2
        assert abs(np.sum(r > limit_m) - expected) < 3.5 * np.sqrt(expected) + 0.08 * expected


@pytest.mark.parametrize("k", [0, 20, 40, 59])
@pytest.mark.parametrize(("tilt_deg", "heading_deg"), [(0.0, 90.0), (20.0, 0.0), (20.0, 180.0), (20.0, 90.0)])
def test_enough_craters_in_every_view(catalog: Catalog, k: int, tilt_deg: float, heading_deg: float) -> None:
    gTb = scene.pose(scene.track()[k], tilt_deg, heading_deg)
    rows, _ = catalog.visible(scene.CAMERA, gTb, min_semi_minor_px=10.0)
    assert 6 <= len(rows) <= 60
    # The corridor has no edge in view: the far part of the image has its share.
    px = scene.project(gTb, catalog.centres[rows])
    assert np.sum(px[:, 1] < 512) >= 2


def test_no_crater_too_small_from_the_lowest_point(catalog: Catalog) -> None:
    gTb = scene.pose(scene.track()[-1])
    rows, charts = catalog.visible(scene.CAMERA, gTb, min_semi_minor_px=0.0)
    assert len(rows) > 5
    S = matrix_of_chart(pixel_chart(charts, scene.CAMERA))
    assert np.sqrt(np.linalg.eigvalsh(S)[:, 0]).min() > 11.5


@pytest.mark.parametrize("radius_m", [50.0, 2e3, 7e3, 40e3])
def test_crest_stands_over_level_ground_by_rim_height(radius_m: float) -> None:
    a, b = np.array([1.05 * radius_m]), np.array([0.95 * radius_m])
    height = crater_shape.crest_height_over_centre_ground_m(a, b, scene.MOON)
    one = scene.craters([(0.0, 0.0, a[0], b[0], height[0], 0.4)])
    rim = scene.rim(one, 0, np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False))
    over = scene.MOON.altitude_m(rim).mean()
    assert over == pytest.approx(crater_shape.rim_height_m(np.sqrt(a * b))[0], rel=2e-3)
    # Pike (1977): 0.036 of the diameter for simple craters, less for complex ones.
    assert 0.012 < over / (2.0 * radius_m) < 0.042


def test_profile_is_smooth_over_the_crest() -> None:
    rho = np.linspace(0.9, 1.1, 2001)
    for depth, rim in ((0.39, 0.072), (0.25, 0.072), (0.05, 0.015)):
        h = np.array([crater_shape.crater_profile(x, depth, rim, crater_shape.CREST) for x in rho])
        slope = np.gradient(h, rho)
        bend = np.gradient(slope, rho)
        assert h.argmax() == 1000
        assert h[1000] == pytest.approx(0.0, abs=1e-12)
        assert slope[1000] == pytest.approx(0.0, abs=2e-3 * abs(slope[0]))
        assert bend[996] == pytest.approx(bend[1004], rel=0.05)
        assert crater_shape.crater_profile(0.0, depth, rim, crater_shape.CREST) == pytest.approx(-depth)


def test_clutter_is_small_and_spares_crests(catalog: Catalog) -> None:
    track = scene.track()
    clutter = random_clutter(np.random.default_rng(3), scene.MOON, track, OPTIONS, catalog)
    assert len(clutter) > 2000
    gTb = scene.pose(track[-1])
    rows, charts = clutter.visible(scene.CAMERA, gTb, min_semi_minor_px=0.0)
    S = matrix_of_chart(pixel_chart(charts, scene.CAMERA))
    assert len(rows) > 50
    assert np.sqrt(np.linalg.eigvalsh(S)[:, 1]).max() < 9.5
    theta = np.linspace(0.0, 2.0 * np.pi, 180)
    for row in range(0, len(catalog), 20):
        rim = scene.rim(catalog, row, theta)
        rim *= scene.MOON.radius_m / np.linalg.norm(rim, axis=1, keepdims=True)
        middle = scene.MOON.radius_m * catalog.normals[row]
        distance = np.linalg.norm(clutter.centres - middle, axis=1)
        near = np.flatnonzero(distance < 1.5 * catalog.semi_major_m[row])
        gap = np.linalg.norm(rim[:, None] - clutter.centres[near], axis=2).min(axis=0)
        assert np.all(gap > 1.5 * clutter.semi_major_m[near])


def test_empty_field_and_bad_options() -> None:
    assert len(field(options=replace(OPTIONS, density=0.0))) == 0
    with pytest.raises(ValueError, match="min_apparent_px"):
        CraterFieldOptions(min_apparent_px=20.0, max_apparent_px=10.0)


def test_names_and_places_agree_with_frames(catalog: Catalog) -> None:
    lat, lon = frames.latitude_longitude(catalog.centres)
    np.testing.assert_allclose(lat, catalog.latitude_rad, atol=1e-12)
    np.testing.assert_allclose(lon, catalog.longitude_rad, atol=1e-12)
