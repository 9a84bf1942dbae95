"""Ground that the crater network is trained on: craters of all ages, light, and what is asked for."""

from functools import cache

import cv2
import numpy as np
import pytest

from craternav_fg.training.digging import dig, raise_hills
from craternav_fg.training.light import lit, photograph
from craternav_fg.training.relief import fractal, relief
from craternav_fg.training.targets import CENTRE_RADII, marking, target
from craternav_fg.training.terrain import SIDE_PX, Terrain, _buried, terrain
from craternav_fg.training.tiles import TILE_PX, TileMaker, cut_tiles
from craternav_fg.vision.pyramid import LEAST_PX, MOST_PX, STRIDE_PX

SIDE = 256


def _bowl(wear, slope=0.0, base=0.0, radius=30.0):
    """Height map of one crater on a slope."""
    x = np.arange(SIDE) - 0.5 * SIDE
    heights = np.tile((base + slope * x).astype(np.float32), (SIDE, 1))
    circle = np.array([[0.5 * SIDE, 0.5 * SIDE, radius]])
    dig(heights, circle, np.array([wear]), np.random.default_rng(3))
    return heights - (base + slope * x).astype(np.float32)


@cache
def _terrain(number):
    return terrain(np.random.default_rng([4, number]))


def _ground(heights, circle, depth):
    """Terrain of one crater."""
    return Terrain(
        heights, np.array([circle]), np.array([depth]), np.zeros(1, np.bool_), np.zeros_like(heights)
    )


def test_a_worn_crater_is_shallower_and_its_rim_softer():
    fresh, worn = _bowl(0.0), _bowl(0.8)
    middle, rim = SIDE // 2, SIDE // 2 + 30
    assert 0.1 < -fresh[middle, middle] / 30.0 < 0.5
    assert -0.3 * fresh[middle, middle] > -worn[middle, middle] > 0.0
    assert fresh[middle, rim - 3 : rim + 4].max() > 0.5
    # Curvature at the rim, relative to the depth.
    bend = [
        np.abs(np.diff(h[middle, rim - 6 : rim + 7], 2)).max() / -h[middle, middle] for h in (fresh, worn)
    ]
    assert bend[1] < 0.5 * bend[0]
    assert np.all(fresh[:20] == 0.0)


def test_a_crater_keeps_the_slope_it_fell_on_at_any_height():
    level, tilted = _bowl(0.0, radius=2.6), _bowl(0.0, slope=0.2, base=-400.0, radius=2.6)
    assert np.abs(tilted - level).max() < 0.25 * np.abs(level).max()


def test_terrain_is_determined_by_its_seed_and_tells_what_is_left_of_its_craters():
    one, again = _terrain(2), terrain(np.random.default_rng([4, 2]))
    np.testing.assert_array_equal(one.heights, again.heights)
    np.testing.assert_array_equal(one.depth_radii, again.depth_radii)
    assert one.heights.shape == (SIDE_PX, SIDE_PX)
    assert 0.0 < np.mean(one.buried) < 0.9
    inside = np.all((one.circles_px[:, :2] > 40.0) & (one.circles_px[:, :2] < SIDE_PX - 40.0), axis=1)
    clear = inside & ~one.buried & (one.circles_px[:, 2] > 6.0) & (one.circles_px[:, 2] < 40.0)
    assert clear.sum() > 20
    # Deep craters are pits: their middle is below the mean of the ground at two radii.
    deep = one.circles_px[clear & (one.depth_radii > 0.15)]
    rows, columns = np.rint(deep[:, 1]).astype(int), np.rint(deep[:, 0]).astype(int)
    wide = np.array(
        [
            one.heights[
                max(y - 2 * int(r), 0) : y + 2 * int(r) + 1, max(x - 2 * int(r), 0) : x + 2 * int(r) + 1
            ].mean()
            for x, y, r in zip(columns, rows, deep[:, 2], strict=True)
        ]
    )
    assert np.mean(one.heights[rows, columns] < wide) > 0.95


def test_later_craters_bury_earlier_ones():
    later = np.array([[54.0, 50.0, 20.0], [70.0, 50.0, 30.0], [70.0, 50.0, 20.0], [50.0, 60.0, 12.0]])
    for circle, expected in zip(later, (True, True, False, False), strict=True):
        assert _buried(np.array([[50.0, 50.0, 20.0], circle])).tolist() == [expected, False]


def test_hills_stand_above_the_ground():
    heights = np.zeros((SIDE, SIDE), np.float32)
    raise_hills(heights, np.array([[60.0, 60.0, 8.0], [180.0, 120.0, 30.0]]), np.random.default_rng(0))
    assert heights[60, 60] > 0.3
    assert heights[120, 180] > 1.0
    assert heights[120, 180] == pytest.approx(heights.max(), rel=0.05)


def test_some_ground_has_ridges():
    grounds = [relief(np.random.default_rng(k), SIDE) for k in range(8)]
    # Lines make the curvature's distribution long-tailed; a Gaussian field has kurtosis 3.
    kurtosis = [np.mean((b := np.diff(g, 2)) ** 4) / np.mean(b**2) ** 2 for g in grounds]
    assert min(kurtosis) < 3.3
    assert max(kurtosis) > 6.0


def test_a_random_field_has_the_power_law_asked_for():
    rough, smooth = (fractal(np.random.default_rng(0), SIDE, exponent) for exponent in (1.0, 2.2))
    assert rough.std() == pytest.approx(1.0)
    assert np.abs(np.diff(smooth)).mean() < 0.2 * np.abs(np.diff(rough)).mean()


@pytest.mark.parametrize("sun_deg", [0.0, 50.0, 90.0, 200.0])
def test_walls_towards_the_sun_are_dark_and_shadows_have_their_length(sun_deg):
    sun, elevation = np.deg2rad(sun_deg), np.deg2rad(30.0)
    towards = np.array([np.cos(sun), np.sin(sun)])
    light = lit(_bowl(0.0), sun, elevation, np.random.default_rng(0))
    near, far = (
        light[tuple(np.rint(0.5 * SIDE + sign * 0.7 * 30.0 * towards[::-1]).astype(int))] for sign in (1, -1)
    )
    assert near < light[5, 5] < far
    # A tower of 40 px casts a shadow of 40 / tan(elevation), away from the sun.
    heights = np.zeros((SIDE, SIDE), np.float32)
    cv2.circle(heights, (SIDE // 2, SIDE // 2), 12, 40.0, -1)
    dark = lit(heights, sun, elevation, np.random.default_rng(0)) == 0.0
    along = [
        dark[tuple(np.rint(0.5 * SIDE - distance * towards[::-1]).astype(int))] for distance in (40, 70, 92)
    ]
    assert along == [True, True, False]
    assert not dark[tuple(np.rint(0.5 * SIDE + 30 * towards[::-1]).astype(int))]


def test_photographs_vary_and_show_the_sun_side():
    ground = _terrain(3)
    photos = [photograph(np.random.default_rng(k), ground, 0.3) for k in range(4)]
    elevations = [photo.elevation_rad for photo in photos]
    assert len(set(elevations)) == 4
    assert all(0.0 < angle < 0.5 * np.pi for angle in elevations)
    for photo in photos:
        assert photo.image.dtype == np.uint8
        assert np.ptp(photo.image) > 60
        marked = ground.circles_px[(marking(ground, photo) > 0.5) & (ground.circles_px[:, 2] > 8.0)]
        marked = marked[np.all((marked[:, :2] > 50.0) & (marked[:, :2] < SIDE_PX - 50.0), axis=1)]
        smooth = cv2.GaussianBlur(photo.image.astype(float), (0, 0), 2.0)
        offset = 0.55 * marked[:, 2:] * (np.cos(0.3), np.sin(0.3))
        near, far = (
            smooth[tuple(np.rint(marked[:, 1::-1] + sign * offset[:, ::-1]).astype(int).T)]
            for sign in (1, -1)
        )
        assert np.mean(near < far) > 0.8


@pytest.mark.parametrize(
    ("depth", "elevation_deg", "shadow", "expected"),
    [
        (0.3, 30.0, False, (0.5, 1.0)),
        (0.035, 20.0, False, (0.1, 0.5)),
        (0.1, 30.0, False, (0.5, 1.0)),
        (0.01, 10.0, False, (0.0, 0.1)),
        # Nothing of a shallow bowl is seen at noon, nor of a deep one in shadow.
        (0.06, 80.0, False, (0.0, 0.1)),
        (0.3, 30.0, True, (0.0, 0.1)),
    ],
)
def test_what_people_would_mark(depth, elevation_deg, shadow, expected):
    ground = _ground(np.zeros((SIDE, SIDE), np.float32), (100.0, 90.0, 12.0), depth)
    photo = photograph(np.random.default_rng(0), _terrain(2), 0.0)._replace(
        lit=np.full((SIDE, SIDE), not shadow), elevation_rad=np.deg2rad(elevation_deg)
    )
    assert expected[0] <= marking(ground, photo)[0] <= expected[1]


def test_the_clearer_a_crater_the_more_probably_it_is_marked():
    heights = np.zeros((SIDE, SIDE), np.float32)
    photo = photograph(np.random.default_rng(0), _terrain(2), 0.0)._replace(
        lit=np.ones((SIDE, SIDE), np.bool_), elevation_rad=np.deg2rad(30.0)
    )
    depths = (0.01, 0.04, 0.06, 0.1, 0.3)
    marks = [marking(_ground(heights, (100.0, 90.0, 12.0), depth), photo)[0] for depth in depths]
    assert marks[0] == 0.0
    assert marks[-1] == 1.0
    assert np.all(np.diff(marks) > 0.05)
    buried = _ground(heights, (100.0, 90.0, 12.0), 0.3)
    buried.buried[:] = True
    assert np.isnan(marking(buried, photo))


def test_cells_of_a_crater_point_to_its_centre():
    circles = np.array([[101.0, 62.5, 9.0], [30.0, 200.0, 9.0], [180.0, 180.0, 2.0 * MOST_PX]])
    known = target(circles, np.array([0.7, np.nan, 1.0]), (64, 64))
    rows, columns = np.nonzero(known.crater)
    np.testing.assert_allclose(known.crater[rows, columns], 0.7)
    assert 1 <= len(rows) <= 9
    x = (columns + known.circle[0][rows, columns] + 0.5) * STRIDE_PX - 0.5
    y = (rows + known.circle[1][rows, columns] + 0.5) * STRIDE_PX - 0.5
    np.testing.assert_allclose(x, 101.0, atol=1e-4)
    np.testing.assert_allclose(y, 62.5, atol=1e-4)
    radius = np.exp(known.circle[2][rows, columns]) * np.sqrt(LEAST_PX * MOST_PX)
    np.testing.assert_allclose(radius, 9.0, rtol=1e-5)
    centres = np.stack([columns, rows], axis=1) * STRIDE_PX + 0.5 * (STRIDE_PX - 1)
    assert np.all(np.abs(centres - (101.0, 62.5)).max(axis=1) <= max(CENTRE_RADII * 9.0, 0.5 * STRIDE_PX))
    # A buried crater is no example; one of another level's size is ground.
    assert known.weight[200 // STRIDE_PX, 30 // STRIDE_PX] == 0.0
    assert known.weight[180 // STRIDE_PX, 180 // STRIDE_PX] == 1.0
    assert np.all(known.weight[rows, columns] == 1.0)


def test_tiles_show_the_craters_where_the_targets_are():
    ground = _terrain(3)
    made = cut_tiles(np.random.default_rng(0), ground)
    assert made.inputs.shape == (len(made.targets), TILE_PX, TILE_PX)
    assert made.inputs.dtype == np.float32
    contrast, elsewhere = [], []
    for tile, known in zip(made.inputs, made.targets, strict=True):
        smooth = cv2.GaussianBlur(tile, (0, 0), 1.5)
        for row, column in np.argwhere(known.crater > 0.0):
            x = (column + known.circle[0][row, column] + 0.5) * STRIDE_PX - 0.5
            y = (row + known.circle[1][row, column] + 0.5) * STRIDE_PX - 0.5
            if 8.0 < x < TILE_PX - 8.0 and 8.0 < y < TILE_PX - 8.0:
                # The sun is about to the right: the left wall is the bright one.
                contrast.append(smooth[int(y), int(x) - 4] - smooth[int(y), int(x) + 4])
                elsewhere.append(smooth[-int(y), -int(x) - 4] - smooth[-int(y), -int(x) + 4])
    assert len(contrast) > 30
    assert np.mean(np.array(contrast) > 0.0) > 0.8
    assert np.mean(np.array(elsewhere) > 0.0) < 0.75


@pytest.mark.slow
def test_tiles_of_a_step_do_not_depend_on_where_a_run_began():
    maker = TileMaker(5)
    for step in (3, 4):
        last = maker.tiles(step)
    again = TileMaker(5).tiles(4)
    np.testing.assert_array_equal(last.inputs, again.inputs)
    np.testing.assert_array_equal(last.targets[0].weight, again.targets[0].weight)
    assert not np.array_equal(last.inputs, TileMaker(6).tiles(4).inputs)
