import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.ellipse import matrix_of_chart, pixel_chart, points_on
from factors.kernels import conic
from tests.catalogs.population import power_law_population

BODY = Body("ball", 250e3, 1.0, (0.0, 0.0, 0.0))
DISTORTION = (-0.12, 0.03, 0.0004, -0.0002, 0.0)


def catalog(rng, count=4000, heights_m=3000.0):
    drawn = power_law_population(rng, BODY, count, (400.0, 60e3))
    values = vars(drawn) | {"height_m": heights_m * rng.standard_normal(count)}
    return Catalog(**{name: values[name] for name in Catalog.__dataclass_fields__})


def camera(rng, distortion=(0.0, 0.0, 0.0, 0.0, 0.0), focal_px=600.0):
    bTc = frames.pose(frames.rotation_exp(0.2 * rng.standard_normal(3)), rng.standard_normal(3))
    return Camera(800, 600, focal_px, 1.1 * focal_px, 390.0, 310.0, bTc, distortion)


def looking_down(rng, altitude_m, tilt_rad, place=None):
    up = rng.standard_normal(3) if place is None else np.array(place)
    up = up / np.linalg.norm(up)
    side = np.cross(up, rng.standard_normal(3))
    side /= np.linalg.norm(side)
    z = frames.rotation_exp(tilt_rad * side) @ -up
    return frames.pose(np.stack([side, np.cross(z, side), z], axis=-1), (BODY.radius_m + altitude_m) * up)


def seen_by_brute_force(craters, lens, gTb, least_px, margin_px):
    charts, seen = conic.project_rims(gTb, lens.bTc, craters.centres, craters.axes)
    rows = np.flatnonzero(seen)
    points = lens.pixels(points_on(charts[rows], 720))
    inside = np.all(lens.contains(points, margin_px), axis=1)
    size = np.sqrt(np.linalg.eigvalsh(matrix_of_chart(pixel_chart(charts[rows], lens)))[:, 0])
    return rows[inside & (size >= least_px)]


@pytest.mark.parametrize("seed", range(24))
def test_visible_craters_are_those_found_one_by_one(seed):
    rng = np.random.default_rng(seed)
    craters = catalog(rng)
    lens = camera(rng, DISTORTION if seed % 3 == 0 else (0.0,) * 5, focal_px=(250.0, 600.0, 3000.0)[seed % 3])
    altitude_m = (8e3, 60e3, 300e3)[seed % 3] * (1.0 + rng.random())
    # Over the poles, across the date line and the prime meridian, anywhere.
    place = ((0.0, 0.0, 1.0), (0.01, 0.0, -1.0), (-1.0, 0.001, 0.1), (1.0, 0.0, 0.0), None, None)[seed % 6]
    tilt_rad = (0.0, 0.4, 1.1)[seed // 3 % 3] * (0.3 if seed % 3 == 2 else 1.0)
    gTb = looking_down(rng, altitude_m, tilt_rad, place)
    for least_px, margin_px in ((0.0, 0.0), (1.5, -30.0), (5.0, 10.0)):
        rows, charts = craters.visible(lens, gTb, min_semi_minor_px=least_px, margin_px=margin_px)
        expected = seen_by_brute_force(craters, lens, gTb, least_px, margin_px)
        # 48 points around a rim, or 720: a rim may touch the border between.
        differ = np.setxor1d(rows, expected)
        assert len(differ) <= (1 if lens.distorts else 0)
        assert len(rows) > 3 or least_px > 0.0
        again, seen = conic.project_rims(gTb, lens.bTc, craters.centres[rows], craters.axes[rows])
        assert seen.all()
        np.testing.assert_allclose(charts, again, rtol=0.0, atol=1e-6)


def test_centres_axes_and_normals_are_those_of_the_frames():
    craters = catalog(np.random.default_rng(8))
    x, y, z = np.moveaxis(craters.gRl, 2, 0)
    np.testing.assert_allclose(np.cross(x, y), z, atol=1e-14)
    np.testing.assert_allclose(craters.normals, z, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(craters.axes[:, 0], craters.semi_major_m[:, None] * x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(craters.axes[:, 1], craters.semi_minor_m[:, None] * y, rtol=0.0, atol=1e-9)
    # Height and place of the centre, as they were given.
    height_m = np.linalg.norm(craters.centres, axis=1) - BODY.radius_m
    np.testing.assert_allclose(height_m, craters.height_m, rtol=0.0, atol=1e-8)
    latitude = np.arcsin(craters.centres[:, 2] / (BODY.radius_m + craters.height_m))
    np.testing.assert_allclose(latitude, craters.latitude_rad, rtol=0.0, atol=1e-7)


def test_craters_in_the_dark_are_not_seen():
    rng = np.random.default_rng(3)
    craters, lens = catalog(rng), camera(rng)
    gTb = looking_down(rng, 100e3, 0.0)
    every, _ = craters.visible(lens, gTb, min_semi_minor_px=1.0)
    # Over the horizon of half of the ground in view.
    sun = np.cross(gTb[:3, 3], rng.standard_normal(3))
    sun /= np.linalg.norm(sun)
    lit, _ = craters.visible(lens, gTb, min_semi_minor_px=1.0, sun_g=sun)
    high, _ = craters.visible(lens, gTb, min_semi_minor_px=1.0, sun_g=sun, min_sun_elevation_rad=0.05)
    elevation = np.arcsin(craters.normals[every] @ sun)
    assert 0.2 * len(every) < len(lit) < 0.8 * len(every)
    np.testing.assert_array_equal(lit, every[elevation >= 0.0])
    np.testing.assert_array_equal(high, every[elevation >= 0.05])


@pytest.mark.parametrize(
    "place", [(0.3, 1.0), (np.pi / 2, 0.0), (-1.5, 3.0), (0.2, 2 * np.pi - 1e-4), (0.0, -np.pi)]
)
@pytest.mark.parametrize("distance_m", [20e3, 200e3, 600e3, 800e3])
def test_near_craters_are_those_found_one_by_one(place, distance_m):
    rng = np.random.default_rng(5)
    craters = catalog(rng)
    rows, away_m = craters.near(*place, distance_m, min_diameter_m=900.0)
    up = frames.up(np.array(place[0]), np.array(place[1]))
    angle = np.arctan2(np.linalg.norm(np.cross(craters.normals, up), axis=1), craters.normals @ up)
    expected = np.flatnonzero((BODY.radius_m * angle <= distance_m) & (craters.semi_major_m >= 450.0))
    np.testing.assert_array_equal(np.sort(rows), expected)
    np.testing.assert_allclose(away_m, BODY.radius_m * angle[rows], rtol=1e-6, atol=1e-2)
    assert np.all(np.diff(away_m) >= 0.0)


@pytest.mark.parametrize("reach", [0.001, 0.1, 1.2, 2.0])
def test_craters_of_some_sizes_within_a_cap_are_those_found_one_by_one(reach):
    rng = np.random.default_rng(4)
    craters = catalog(rng)
    log_size = 0.5 * np.log(craters.semi_major_m * craters.semi_minor_m)
    least, most = np.quantile(log_size, [0.2, 0.95])
    out = np.empty(len(craters), dtype=np.int64)
    wanted_any = 0
    for place in [*rng.normal(size=(20, 3)), [0.0, 0.0, 1.0], [0.0, 1e-9, -1.0], [-1.0, 1e-12, 0.1]]:
        x, y, z = np.array(place) / np.linalg.norm(place)
        count = within(craters.index, x, y, z, reach, least, most, out)
        away = np.linalg.norm(craters.normals - [x, y, z], axis=1)
        wanted = (away < 2.0 * np.sin(0.5 * reach)) & (log_size >= least) & (log_size <= most)
        np.testing.assert_array_equal(np.sort(out[:count]), np.flatnonzero(wanted))
        wanted_any += count
        assert within(craters.index, x, y, z, reach, least, most, out[:3]) == min(count, 3)
    assert wanted_any > 0 or reach < 0.01


def test_crossing_rims_and_duplicates_are_those_found_pair_by_pair():
    rng = np.random.default_rng(7)
    craters = catalog(rng, 800, heights_m=0.0)
    copies = rng.choice(800, 20, replace=False)
    moved = craters.take(copies)
    part = Catalog(
        tuple(f"copy of {name}" for name in moved.identifiers),
        moved.latitude_rad + 0.03 * moved.semi_minor_m / BODY.radius_m, moved.longitude_rad,
        1.04 * moved.semi_major_m, moved.semi_minor_m, moved.angle_rad, moved.height_m, BODY,
    )  # fmt: skip
    craters = Catalog.joined([craters, part])
    crossings, duplicates = craters.index.overlaps(0.1)
    assert {tuple(sorted(pair)) for pair in duplicates.tolist()} >= {
        (row, 800 + k) for k, row in enumerate(copies.tolist())
    }
    assert len(duplicates) < 25
    a = craters.semi_major_m
    away = BODY.radius_m * np.linalg.norm(craters.normals[:, None] - craters.normals[None], axis=-1)
    meets = (away < a[:, None] + a) & (away > np.abs(a[:, None] - a))
    meets[duplicates[:, 0], duplicates[:, 1]] = meets[duplicates[:, 1], duplicates[:, 0]] = False
    np.testing.assert_array_equal(a[crossings[:, 0]] >= a[crossings[:, 1]], True)
    found = {tuple(sorted(pair)) for pair in crossings.tolist()}
    assert len(found) == len(crossings)
    assert found == set(map(tuple, np.argwhere(np.triu(meets)).tolist()))


def test_craters_as_large_as_their_body_meet_along_chords():
    """With centres almost as far apart as their radii reach, the arc between is longer than the chord."""
    ball = Body("boulder", 250.0, 1.0, (0.0, 0.0, 0.0))
    angle = 2.0 * np.arcsin(0.499)
    two = Catalog(
        ("A", "B"), np.zeros(2), np.array([0.0, angle]), np.full(2, 125.0), np.full(2, 125.0), np.zeros(2),
        np.zeros(2), ball,
    )  # fmt: skip
    crossings, duplicates = two.index.overlaps(0.1)
    assert crossings.tolist() == [[0, 1]]
    assert not len(duplicates)


def test_a_catalogue_in_order_is_not_moved():
    rng = np.random.default_rng(9)
    craters = catalog(rng)
    ordered = craters.take(craters.index.order)
    np.testing.assert_array_equal(ordered.index.order, np.arange(len(craters)))
    assert not np.array_equal(craters.index.order, np.arange(len(craters)))


def test_no_craters_at_all():
    empty = SphereIndex.of(*(np.empty(0) for _ in range(5)))
    assert len(empty.near(np.array([1.0, 0.0, 0.0]), 1.0)) == 0
    assert len(empty.in_view(np.array([2.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), 0.5, np.inf)) == 0
