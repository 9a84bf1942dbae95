from dataclasses import replace

import cv2
import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.simulation import sunlight
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.crests import crest_offsets_px
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from tests.simulation import scene

OPTIONS = CraterFieldOptions(focal_px=scene.FOCAL)
CLEAN = RenderOptions(psf_sigma_px=0.0, full_well_e=0.0)


@pytest.fixture(scope="module")
def relief():
    return scene.relief()


@pytest.fixture(scope="module")
def catalog(relief):
    return random_craters(np.random.default_rng(1), scene.MOON, scene.track(), OPTIONS, relief)


@pytest.fixture(scope="module")
def clutter(catalog):
    return random_clutter(np.random.default_rng(2), scene.MOON, scene.track(), OPTIONS, catalog)


@pytest.fixture(scope="module")
def terrain(catalog, relief, clutter):
    return Terrain(catalog, relief, TerrainOptions(), clutter)


@pytest.fixture(scope="module")
def renderer(terrain):
    return Renderer(scene.CAMERA, terrain, RenderOptions())


@pytest.fixture(scope="module")
def smooth():
    """Locally flat terrain without relief or craters."""
    terrain = Terrain(scene.craters([]), scene.relief(slope=0.0), TerrainOptions(cells=512))
    return Renderer(scene.CAMERA, terrain, RenderOptions())


@pytest.mark.parametrize(
    ("frame", "tilt_deg", "heading_deg"),
    [(0, 0.0, 90.0), (0, 20.0, 200.0), (45, 12.0, 30.0), (59, 20.0, 90.0)],
)
def test_crest_lies_on_the_projected_ellipse(renderer, catalog, frame, tilt_deg, heading_deg):
    gTb = scene.pose(scene.track()[frame], tilt_deg, heading_deg)
    rows, _ = catalog.visible(scene.CAMERA, gTb, min_semi_minor_px=8.0, margin_px=4.0)
    offsets = crest_offsets_px(renderer, catalog, gTb, rows)
    assert len(rows) >= 10
    assert np.isnan(offsets).mean() < 0.02
    assert np.nanmean(np.abs(offsets)) < 0.04
    assert abs(np.nanmean(offsets)) < 0.04
    assert np.nanpercentile(np.abs(offsets), 99.0) < 0.2


def test_ground_points_lie_on_their_rays_and_on_one_ground(renderer):
    rng = np.random.default_rng(4)
    px = rng.uniform(0.0, 1023.0, (300, 2))
    gTb = scene.pose(scene.place(-60e3, 9e3, 15e3), 18.0, 50.0)
    ground, normals = renderer.ground_points(gTb, px)
    assert scene.project(gTb, ground) == pytest.approx(px, abs=0.01)
    assert np.all(np.sum(normals * (gTb[:3, 3] - ground), axis=1) > 0.0)
    # The same ground from elsewhere, with other grids: the same height to a fraction of a pixel.
    other = scene.pose(scene.place(-58e3, 7e3, 19e3), 5.0, 250.0)
    seen = scene.project(other, ground)
    inside = scene.CAMERA.contains(seen)
    again, _ = renderer.ground_points(other, seen[inside])
    assert np.sum(inside) > 100
    miss = np.abs(scene.MOON.altitude_m(again) - scene.MOON.altitude_m(ground[inside]))
    assert np.percentile(miss, 90.0) < 0.1 * 15e3 / scene.FOCAL


def test_same_seed_same_image(renderer, terrain, clutter):
    gTb = scene.pose(scene.track()[30], 8.0)
    toward = scene.sun(30.0, 70.0)
    image = renderer.render(gTb, toward, np.random.default_rng(5))
    assert image.dtype == np.uint8
    assert image.shape == (1024, 1024)
    # Also after other views have replaced the grids, and in a renderer that never had them.
    renderer.render(scene.pose(scene.track()[0]), toward, np.random.default_rng(0))
    np.testing.assert_array_equal(renderer.render(gTb, toward, np.random.default_rng(5)), image)
    ground = Terrain(terrain.catalog, terrain.relief, terrain.options, clutter)
    fresh = Renderer(scene.CAMERA, ground, RenderOptions())
    np.testing.assert_array_equal(fresh.render(gTb, toward, np.random.default_rng(5)), image)
    assert np.mean(renderer.render(gTb, toward, np.random.default_rng(6)) != image) > 0.3


def test_neighbouring_frames_show_one_terrain(terrain):
    clean = Renderer(scene.CAMERA, terrain, CLEAN)
    toward = scene.sun(25.0, 200.0)
    first = scene.pose(scene.place(-40e3, 0.0, 16e3), 0.0)
    second = scene.pose(scene.place(-38.8e3, 300.0, 15.2e3), 6.0, 70.0)
    a, b = (clean.render(T, toward, np.random.default_rng(0)).astype(np.float32) for T in (first, second))
    step = 4
    grid = np.stack(np.meshgrid(np.arange(0, 1024, step), np.arange(0, 1024, step)), axis=-1)
    ground, _ = clean.ground_points(first, grid.reshape(-1, 2).astype(float))
    seen = scene.project(second, ground)
    warped = cv2.remap(
        b,
        seen.reshape(*grid.shape).astype(np.float32),
        None,
        cv2.INTER_LINEAR,
    ).ravel()
    inside = scene.CAMERA.contains(seen, 2.0)
    assert inside.mean() > 0.6
    assert np.corrcoef(warped[inside], a[::step, ::step].ravel()[inside])[0, 1] > 0.97
    shifted = np.roll(a, 12, axis=1)[::step, ::step].ravel()
    assert np.corrcoef(warped[inside], shifted[inside])[0, 1] < 0.7


def test_level_ground_has_the_chosen_brightness(smooth):
    gTb = scene.pose(scene.place(0.0, 0.0, 10e3))
    for elevation_deg in (15.0, 30.0, 60.0):
        image = smooth.render(gTb, scene.sun(elevation_deg, 80.0), np.random.default_rng(0))
        assert image[480:544, 480:544].mean() == pytest.approx(0.4 * 255.0, abs=1.5)


def test_noise_is_that_of_the_electrons(smooth):
    gTb, toward = scene.pose(scene.place(0.0, 0.0, 10e3)), scene.sun(30.0, 80.0)
    for well_e, read_e in ((15000.0, 20.0), (3000.0, 5.0), (15000.0, 150.0)):
        options = replace(RenderOptions(), full_well_e=well_e, read_noise_e=read_e)
        noisy = Renderer(scene.CAMERA, smooth.terrain, options)
        image = noisy.render(gTb, toward, np.random.default_rng(1))[460:560, 460:560].astype(float)
        # 0.4 of the well, Poisson, and the rounding to whole grey levels.
        expected = np.hypot(255.0 / well_e * np.hypot(np.sqrt(0.4 * well_e), read_e), np.sqrt(1.0 / 12.0))
        assert (image - cv2.GaussianBlur(image, (0, 0), 12.0)).std() == pytest.approx(expected, rel=0.05)


def test_sky_beyond_the_horizon_is_black(smooth):
    altitude_m = 20e3
    gTb = scene.pose(scene.place(0.0, 0.0, altitude_m), 80.0, 130.0)
    light = smooth.radiance(gTb, scene.sun(30.0, 80.0))
    toward = scene.CAMERA.normalised(np.stack(np.meshgrid(np.arange(1024.0), np.arange(1024.0)), axis=-1))
    toward = np.concatenate([toward, np.ones((1024, 1024, 1))], axis=-1) @ gTb[:3, :3].T
    P = gTb[:3, 3]
    nadir = np.arccos(-(toward @ P) / np.linalg.norm(toward, axis=-1) / np.linalg.norm(P))
    limb = np.arcsin(scene.MOON.radius_m / np.linalg.norm(P))
    pixel = 1.0 / scene.FOCAL
    assert np.all(light[nadir > limb + 1e-6] == 0.0)
    assert np.all(light[nadir < limb - pixel] > 0.0)
    assert 0.1 < np.mean(light == 0.0) < 0.9


@pytest.mark.parametrize("tilt_deg", [20.0, 75.0])
def test_a_ray_meets_the_terrain_where_it_does_alone(renderer, tilt_deg):
    # Beside others a ray begins where the one before it ended.
    gTb = scene.pose(scene.place(-20e3, 0.0, 8e3), tilt_deg, 30.0)
    for row in (340.0, 1000.0):
        pixels = np.stack([np.arange(300.0, 700.0), np.full(400, row)], axis=-1)
        beside, _ = renderer.ground_points(gTb, pixels)
        alone = np.concatenate([renderer.ground_points(gTb, one[None])[0] for one in pixels])
        # A pixel is 6 m and more.
        assert beside == pytest.approx(alone, abs=0.1, nan_ok=True)


def test_rough_horizon_is_traced(renderer):
    gTb = scene.pose(scene.place(-20e3, 0.0, 8e3), 75.0)
    light = renderer.radiance(gTb, scene.sun(35.0, 300.0))
    dark = light == 0.0
    sky = int(np.argmin(dark[:, 512]))
    assert 20 < sky < 900
    assert dark[: sky - 12].all()
    # Nothing but shadows is dark on the ground.
    assert dark[sky + 12 :].mean() < 0.12


def test_shadows_are_cast_by_what_stands_towards_the_sun():
    catalog = scene.craters([(0.0, 0.0, 800.0, 800.0, 57.0, 0.0)])
    options = TerrainOptions(cells=1024, depth_scatter_share=0.0)
    clean = Renderer(scene.CAMERA, Terrain(catalog, scene.relief(slope=0.0), options), CLEAN)
    gTb = scene.pose(scene.place(0.0, 0.0, 6e3), 0.0, 0.0)
    for elevation_deg, azimuth_deg in ((12.0, 60.0), (20.0, 200.0)):
        light = clean.radiance(gTb, scene.sun(elevation_deg, azimuth_deg))
        # A line over the crater's centre towards the sun; image x is east, y is south.
        s = np.arange(-300.0, 300.0, 0.5)
        az = np.radians(azimuth_deg)
        px = 511.5 + s[:, None] * np.array([np.sin(az), -np.cos(az)])
        ground, normals = clean.ground_points(gTb, px)
        east, north, _ = np.moveaxis(ground @ scene.SITE, -1, 0)
        x = east * np.sin(az) + north * np.cos(az)
        h = scene.MOON.altitude_m(ground)
        climb = np.tan(np.radians(elevation_deg))
        lit = np.array([np.all(h[i + 1 :] - h[i] < climb * (x[i + 1 :] - x[i])) for i in range(len(x))])
        lit &= normals @ scene.sun(elevation_deg, azimuth_deg) > 0.0
        found = cv2.remap(light, px.astype(np.float32)[None], None, cv2.INTER_LINEAR)[0] > 0.02
        assert 0.1 < np.mean(~lit) < 0.5
        assert np.mean(found != lit) < 0.02
        # In a bowl the dark lies towards the sun.
        assert x[~lit].mean() > 100.0


def test_a_point_is_as_bright_as_it_is_alone(terrain):
    half_m = np.array([2e3, 2e3])
    with terrain.levels(-half_m, half_m, np.zeros(2), 4.0) as levels:
        # No other view follows.
        pass
    hits = np.random.default_rng(0).uniform(-2e3, 2e3, (500, 2))
    hits[::7] = np.nan
    elevation = np.radians(4.0)
    sun = np.array([np.cos(elevation), 0.0, np.sin(elevation)])
    P, law = np.array([0.0, 0.0, scene.MOON.radius_m + 6e3]), np.array([0.55, 0.0, 0.0, 0.0, 0.0])

    def brightness(points):
        light = np.full(len(points), np.nan, np.float32)
        sunlight.shade(
            P, points, sun, 0.00465, law, levels.heights_m, levels.slots, levels.frames_m,
            scene.MOON.radius_m, levels.top_m, levels.slope, light,
        )  # fmt: skip
        return light

    # Shadow rays of many points are stepped together.
    together = brightness(hits)
    np.testing.assert_array_equal(together, np.concatenate([brightness(one[None]) for one in hits]))
    assert np.all(together[::7] == 0.0)
    # In the dark, in the edge of a shadow, or in full light.
    ground = together[~np.isnan(hits[:, 0])]
    assert 0.05 < np.mean(ground == 0.0) < 0.5


@pytest.mark.parametrize(("tilt_deg", "heading_deg", "altitude_m"), [(0.0, 90.0, 6e3), (20.0, 200.0, 4e3)])
def test_borders_of_grids_cast_no_shadow(tilt_deg, heading_deg, altitude_m):
    # Craters out of view, on levels the relief knows nothing of, so that the ground is lifted to them.
    around = np.arange(12) * np.pi / 6.0
    far = [
        (5.5e3 * np.cos(a), 5.5e3 * np.sin(a), 300.0, 300.0, h, 0.0)
        for a, h in zip(around, np.linspace(-450.0, -350.0, 12), strict=True)
    ]
    clean = Renderer(
        scene.CAMERA, Terrain(scene.craters(far), scene.relief(), TerrainOptions(cells=512)), CLEAN
    )
    gTb = scene.pose(scene.place(300.0, -200.0, altitude_m), tilt_deg, heading_deg)
    px = np.stack(np.meshgrid(*2 * [np.arange(0.0, 1024.0, 4.0)]), axis=-1).reshape(-1, 2)
    ground, _ = clean.ground_points(gTb, px)
    assert np.all(scene.MOON.altitude_m(ground) < -200.0)
    for azimuth_deg in (80.0, 260.0):
        light = clean.radiance(gTb, scene.sun(30.0, azimuth_deg))
        assert np.all(light > 0.7 * cv2.medianBlur(light, 5))


def test_blur_spreads_and_keeps_the_light(terrain):
    gTb, toward = scene.pose(scene.track()[40]), scene.sun(30.0, 80.0)
    sharp = Renderer(scene.CAMERA, terrain, CLEAN).render(gTb, toward, np.random.default_rng(0))
    soft = Renderer(scene.CAMERA, terrain, replace(CLEAN, psf_sigma_px=1.5)).render(
        gTb, toward, np.random.default_rng(0)
    )
    assert soft.mean() == pytest.approx(sharp.mean(), abs=0.3)
    assert np.abs(np.diff(soft.astype(float))).mean() < 0.7 * np.abs(np.diff(sharp.astype(float))).mean()


def test_more_samples_average_over_the_pixel(terrain):
    gTb, toward = scene.pose(scene.track()[40]), scene.sun(30.0, 80.0)
    one = Renderer(scene.CAMERA, terrain, CLEAN).radiance(gTb, toward)
    four = Renderer(scene.CAMERA, terrain, replace(CLEAN, samples=2)).radiance(gTb, toward)
    assert np.corrcoef(one.ravel(), four.ravel())[0, 1] > 0.99
    assert not np.array_equal(one, four)


def test_small_images_are_cut_outs_of_large_ones(terrain):
    # Their sides are no multiples of those of the tiles in which rays are traced.
    gTb, toward = scene.pose(scene.track()[40], 12.0, 30.0), scene.sun(30.0, 80.0)
    small = Camera(75, 50, scene.FOCAL, scene.FOCAL, 37.5, 25.5)
    large = Renderer(scene.CAMERA, terrain, CLEAN).radiance(gTb, toward)[486:536, 474:549]
    light = Renderer(small, terrain, CLEAN).radiance(gTb, toward)
    assert light.shape == (50, 75)
    assert np.std(large) > 0.03
    assert np.percentile(np.abs(light - large), 95.0) < 0.1 * np.std(large)


def test_an_image_does_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rays begin where those beside them ended: with other parts, light changed by up to 2e-5."""
    parts = []
    for cores in (1, 7):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        ground = Terrain(scene.craters([]), scene.relief(), TerrainOptions(cells=1024))
        seen: list[tuple[int, int]] = []
        ground.run(lambda low, high, seen=seen: seen.append((low, high)), 1000)
        parts.append(sorted(seen))
    assert parts[0] == parts[1]


def test_crests_of_craters_as_large_as_a_tenth_of_the_body_are_its_highest_lines():
    """Over the sphere, which is level ground: there the plane of the rim rises by a slope of 0.09."""
    radius_m = 160e3
    catalog = scene.craters([(0.0, 0.0, radius_m, radius_m, 0.0, 0.0)])
    smooth = Terrain(catalog, scene.relief(slope=0.0), TerrainOptions(cells=1024, depth_scatter_share=0.0))
    renderer = Renderer(scene.CAMERA, smooth, RenderOptions())
    gTb = scene.pose(scene.place(0.0, 0.0, 700e3))
    rho = np.linspace(0.94, 1.06, 61)
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        direction = np.cos(angle) * catalog.axes[0, 0] + np.sin(angle) * catalog.axes[0, 1]
        px = scene.project(gTb, catalog.centres[0] + rho[:, None] * direction)
        heights_m = np.linalg.norm(renderer.ground_points(gTb, px)[0], axis=1)
        top = np.polyfit(rho - 1.0, heights_m, 4)
        fine = np.linspace(-0.05, 0.05, 1001)
        assert fine[np.argmax(np.polyval(top, fine))] == pytest.approx(0.0, abs=0.004), angle
