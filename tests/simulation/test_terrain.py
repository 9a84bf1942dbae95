import numpy as np
import pytest

from craternav_fg.simulation.crater_shape import rim_height_m
from craternav_fg.simulation.relief import Relief, ReliefOptions, Window
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from tests.simulation import scene

SMALL = TerrainOptions(cells=512)


def renderer(catalog, relief, options=SMALL):
    return Renderer(scene.CAMERA, Terrain(catalog, relief, options), RenderOptions())


def heights(view, gTb, points):
    """Heights of the ground as rendered in the directions of points (n, 3)."""
    ground, _ = view.ground_points(gTb, scene.project(gTb, points))
    return scene.MOON.altitude_m(ground)


def test_grids_of_all_spacings_sample_one_relief():
    relief = scene.relief()
    for exponent, first in ((2, (-37000, 12345)), (5, (1001, -3333)), (5, (1201, -3303))):
        grid = relief.grid(exponent, first, 128, 1)
        i, j = np.array([20, 64, 99]), np.array([31, 80, 10])
        xy = 2.0**exponent * np.stack([first[0] + i, first[1] + j], axis=-1).astype(float)
        exact, _ = relief.at(xy, np.full(3, 2.0 ** (exponent + 1)))
        assert grid[j, i] == pytest.approx(exact, abs=2e-3)
        assert np.std(grid) > 0.1 * 2.0**exponent * relief.options.slope


def test_a_window_of_the_relief_is_a_part_of_it():
    grid = scene.relief().grid(3, (-501, 77), 256, 16)
    for window in (Window(0, 256, 0, 31), Window(97, 140, 31, 256)):
        part = scene.relief().grid(3, (-501, 77), 256, 16, window)
        assert np.array_equal(part, grid[window.low : window.high, window.left : window.right])


@pytest.mark.parametrize("moved", [(61, 0), (-122, 61), (0, -400)])
def test_a_grid_that_moved_is_the_one_built_anew(moved):
    # Craters at all places of a grid, small ones that fade out at its border too, on other levels than the
    # relief.
    rng = np.random.default_rng(0)
    rows = [
        (*rng.uniform(-2e3, 2e3, 2), a := rng.uniform(10.0, 120.0), a * rng.uniform(0.8, 1.0), 300.0, 0.0)
        for _ in range(150)
    ]
    here, there = np.array([0.0, 100.0]), np.array([0.0, 100.0]) + 4.0 * np.array(moved)
    terrains = [Terrain(scene.craters(rows), scene.relief(), SMALL) for _ in range(2)]
    with terrains[0].levels(here - 300.0, here + 300.0, here, 8.0):
        pass
    old, new = (one.levels(there - 300.0, there + 300.0, there, 8.0) for one in terrains)
    with old as old, new as new:
        assert np.array_equal(old.frames_m, new.frames_m)
        assert np.array_equal(old.heights_m[old.slots], new.heights_m[new.slots])
        assert old.top_m == new.top_m


def test_grids_of_a_view_stay_while_others_come_and_go():
    """Also if it is asked for again in between: an exposed image asks for its own twice."""
    terrain = Terrain(scene.craters([]), scene.relief(), SMALL)
    reach = 60.0 * SMALL.cells

    def view(east_m):
        place = np.array([east_m, 0.0])
        return terrain.levels(place - reach, place + reach, place, 8.0)

    with view(0.0):
        pass
    with view(9e4) as kept:
        assert len(kept.slots) == SMALL.levels
        before = kept.heights_m[kept.slots].copy()
        for east_m in (0.0, 1.8e5, 2.7e5, 0.0):
            with view(east_m):
                pass
        assert np.array_equal(kept.heights_m[kept.slots], before)


def test_relief_gradient_and_slope():
    relief = scene.relief()
    xy = np.random.default_rng(0).uniform(-5e4, 5e4, (400, 2))
    only = Relief(scene.MOON, scene.SITE[:, 2], ReliefOptions(slope=0.02, coarsest_m=128.0))
    _, gradient = only.at(xy, np.full(400, 128.0))
    # One octave contributes the slope asked for: (128 / 100)^-0.15 of it.
    assert np.sqrt(np.mean(gradient**2)) == pytest.approx(0.02 * 0.964, rel=0.08)
    step = np.array([0.01, 0.0])
    shortest = np.full(400, 64.0)
    up, down = relief.at(xy + step, shortest)[0], relief.at(xy - step, shortest)[0]
    assert relief.at(xy, shortest)[1][:, 0] == pytest.approx((up - down) / 0.02, abs=1e-6)


def test_seed_changes_the_relief():
    grids = [
        Relief(scene.MOON, scene.SITE[:, 2], ReliefOptions(seed=seed)).grid(4, (0, 0), 64, 8)
        for seed in (0, 1)
    ]
    assert abs(np.corrcoef(grids[0].ravel(), grids[1].ravel())[0, 1]) < 0.9
    assert not np.allclose(grids[0], grids[1])


def test_ground_is_one_on_grids_of_all_spacings():
    # Which craters are near a grid depends on its width; the level of the ground between them must not.
    catalog = scene.craters(
        [(-7e3, 0.0, 300.0, 300.0, -900.0, 0.0), (0.0, 0.0, 90.0, 90.0, -500.0, 0.0)]
        + [(2e4 + 5e3 * k, 1e4, 900.0, 900.0, -100.0 * k, 0.0) for k in range(6)]
    )
    view = renderer(catalog, scene.relief(slope=0.004))
    points = np.array([scene.place(x, y, -400.0) for x in (-900.0, 300.0, 800.0) for y in (-700.0, 600.0)])
    low, high = (
        heights(view, scene.pose(scene.place(0.0, 0.0, altitude_m)), points) for altitude_m in (5e3, 1e5)
    )
    assert low == pytest.approx(high, abs=4.0)
    assert np.all(low < -200.0)


@pytest.mark.parametrize("height_m", [-800.0, 0.0, 1500.0])
def test_crests_stand_at_the_catalogues_heights(height_m):
    # Heights that the relief knows nothing of: the ground is lifted to them.
    catalog = scene.craters(
        [(0.0, 0.0, 900.0, 800.0, height_m, 0.5), (4000.0, 1000.0, 500.0, 400.0, height_m + 60.0, 1.0)]
    )
    view = renderer(catalog, scene.relief(slope=0.004))
    gTb = scene.pose(scene.place(2000.0, 0.0, 15e3))
    theta = np.linspace(0.0, 2.0 * np.pi, 40)
    for row, radius in ((0, 850.0), (1, 450.0)):
        rim = scene.rim(catalog, row, theta)
        assert heights(view, gTb, rim) == pytest.approx(scene.MOON.altitude_m(rim), abs=0.02 * radius)
        # The flank meets the ground a rim height below the crest.
        outside = scene.rim(catalog, row, theta, rho=2.4)
        drop = height_m + 60.0 * row - heights(view, gTb, outside).mean()
        assert drop == pytest.approx(rim_height_m(np.array([radius]))[0], rel=0.4)


def test_smaller_of_two_overlapping_craters_keeps_its_crest():
    catalog = scene.craters([(700.0, 0.0, 300.0, 260.0, 90.0, 0.2), (0.0, 0.0, 900.0, 900.0, 60.0, 0.0)])
    view = renderer(catalog, scene.relief(slope=0.0))
    gTb = scene.pose(scene.place(0.0, 0.0, 12e3))
    theta = np.linspace(0.0, 2.0 * np.pi, 40)
    rim = scene.rim(catalog, 0, theta)
    assert heights(view, gTb, rim) == pytest.approx(scene.MOON.altitude_m(rim), abs=2.0)
    # The larger one keeps its own where the smaller does not reach.
    rim = scene.rim(catalog, 1, np.linspace(1.0, 2.0 * np.pi - 1.0, 20))
    assert heights(view, gTb, rim) == pytest.approx(scene.MOON.altitude_m(rim), abs=2.0)


def test_bowl_has_the_depth_of_a_fresh_crater():
    catalog = scene.craters([(0.0, 0.0, 500.0, 500.0, 36.0, 0.0)])
    view = renderer(catalog, scene.relief(slope=0.0), TerrainOptions(cells=512, depth_scatter_share=0.0))
    gTb = scene.pose(scene.place(0.0, 0.0, 10e3))
    floor = heights(view, gTb, catalog.centres)[0]
    # Pike (1977): a fifth of the diameter.
    assert 36.0 - floor == pytest.approx(196.0, rel=0.02)


def test_large_rim_is_planar_though_the_ground_is_round():
    catalog = scene.craters([(0.0, 0.0, 30e3, 27e3, 400.0, 0.3)])
    view = renderer(catalog, scene.relief(slope=0.0))
    gTb = scene.pose(scene.place(0.0, 0.0, 140e3))
    rim = scene.rim(catalog, 0, np.linspace(0.0, 2.0 * np.pi, 40))
    # The sphere falls away by 210 to 260 m.
    assert np.ptp(scene.MOON.altitude_m(rim)) > 40.0
    assert heights(view, gTb, rim) == pytest.approx(scene.MOON.altitude_m(rim), abs=5.0)


def test_normals_are_those_of_the_ground_far_from_the_site():
    catalog = scene.craters([(600e3, -400e3, 2000.0, 1800.0, 120.0, 0.3)])
    view = renderer(catalog, scene.relief(), TerrainOptions(cells=1024))
    gTb = scene.pose(scene.place(600e3, -400e3, 20e3), 10.0)
    centre = scene.project(gTb, catalog.centres)[0]
    px = centre + np.random.default_rng(0).uniform(-110.0, 110.0, (200, 2))
    steps = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    right, left, down, up = (view.ground_points(gTb, px + step)[0] for step in steps)
    _, normals = view.ground_points(gTb, px)
    expected = np.cross(up - down, left - right)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    angle = np.linalg.norm(np.cross(normals, expected), axis=1)
    assert np.median(angle) < 0.01
    # No common tilt, which a wrong transformation from the map plane would give.
    assert np.abs(np.mean(normals - expected, axis=0)).max() < 0.002


def test_empty_catalogue_is_smooth_ground():
    view = renderer(scene.craters([]), scene.relief(slope=0.0))
    gTb = scene.pose(scene.place(3e4, -2e4, 9e3), 30.0)
    ground, normals = view.ground_points(gTb, np.array([[10.0, 20.0], [600.0, 900.0]]))
    assert scene.MOON.altitude_m(ground) == pytest.approx([0.0, 0.0], abs=0.02)
    assert normals == pytest.approx(ground / np.linalg.norm(ground, axis=1, keepdims=True), abs=1e-9)
