import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.nested_dem import read_nested_dem
from craternav_fg.dataset import Dataset
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.simulation.craters import CraterFieldOptions, random_craters
from craternav_fg.simulation.crests import crest_offsets_px
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer, RenderOptions
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import built_in_scenarios, load_scenario
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from tests.shared_data import shared
from tests.simulation import scene

rasterio = pytest.importorskip("rasterio")
warp = pytest.importorskip("rasterio.warp")
MOON = "+proj=longlat +R=1737400 +no_defs"
GLOBE = (-180.0, 90.0, 0.5, 0.5)
ROWS = np.radians(90.0 - 0.5 * (np.arange(360) + 0.5))
COLUMNS = np.radians(0.5 * (np.arange(720) + 0.5) - 180.0)


def hills(lat, lon):
    """Smooth on the sphere, also across the date line; m."""
    return 900.0 * np.cos(3.0 * lat) * np.sin(7.0 * lon + 0.4) + 500.0 * np.sin(11.0 * lat)


def write(path, values, corner=GLOBE, crs=MOON, **more):
    west, north, dx, dy = corner
    transform = rasterio.Affine(dx, 0.0, west, 0.0, -dy, north)
    bands = np.atleast_3d(values.T).T
    with rasterio.open(
        path, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2], count=len(bands),
        dtype=bands.dtype, crs=crs, transform=transform, **more,
    ) as raster:  # fmt: skip
        raster.write(bands)
    return path


@pytest.fixture(scope="module")
def globe(tmp_path_factory):
    values = hills(ROWS[:, None], COLUMNS[None]).astype(np.float32)
    return write(tmp_path_factory.mktemp("dem") / "globe.tif", values)


def test_heights_are_the_rasters(globe):
    dem = read_dem(globe)
    rng = np.random.default_rng(1)
    lat, lon = rng.uniform(-1.5, 1.5, 500), rng.uniform(-np.pi, np.pi, 500)
    lon[:50] = np.pi + rng.uniform(-0.01, 0.01, 50)
    found = dem.heights_m(frames.up(lat, lon))
    np.testing.assert_allclose(found, hills(lat, lon), atol=0.5)
    np.testing.assert_allclose(read_dem(globe, 0.5).heights_m(frames.up(lat, lon)), 0.5 * found, atol=1e-3)


def test_a_part_of_the_body_with_longitudes_to_the_east(tmp_path):
    """From 340 to 370 deg, whole numbers with a scale."""
    lat = np.radians(20.0 - 0.1 * (np.arange(300) + 0.5))
    lon = np.radians(340.0 + 0.1 * (np.arange(300) + 0.5))
    values = np.round(hills(lat[:, None], lon[None]) * 2.0).astype(np.int16)
    path = write(tmp_path / "part.tif", values, (340.0, 20.0, 0.1, 0.1))
    with rasterio.open(path, "r+") as raster:
        raster.scales = (0.5,)
    rng = np.random.default_rng(2)
    lat, lon = np.radians(rng.uniform(-9.0, 19.0, 300)), np.radians(rng.uniform(-19.0, 9.0, 300))
    np.testing.assert_allclose(read_dem(path).heights_m(frames.up(lat, lon)), hills(lat, lon), atol=0.5)


def test_a_model_that_ends_at_a_pole_covers_it(globe, tmp_path):
    dem = read_dem(globe)
    degrees = np.array([90.0, 89.99, -89.9, -90.0])
    places = frames.up(np.radians(degrees), np.radians([0.0, 100.0, 20.0, 0.0]))
    assert dem.covers(places).all()
    np.testing.assert_allclose(dem.heights_m(places), hills(*frames.latitude_longitude(places)), atol=15.0)
    # Half a step short of the poles, there is ground beyond.
    short = write(tmp_path / "short.tif", np.zeros((359, 720), np.float32), (-180.0, 89.75, 0.5, 0.5))
    assert not read_dem(short).covers(places).any()


def write_with_unit(path, unit):
    write(path, np.full((8, 8), 2.0, np.float32))
    with rasterio.open(path, "r+") as raster:
        raster.units = (unit,)
    return path


def projected(path, crs, corner, shape=(200, 240)):
    """Hills on a map whose coordinates the library behind rasterio converts."""
    west, north, dx, dy = corner
    x, y = np.meshgrid(west + dx * (np.arange(shape[1]) + 0.5), north - dy * (np.arange(shape[0]) + 0.5))
    lon, lat = np.radians(warp.transform(crs, MOON, x.ravel(), y.ravel()))
    return write(path, hills(lat, lon).reshape(shape).astype(np.float32), corner, crs), lat, lon


MAPS = {
    "north": ("+proj=stere +lat_0=90 +lon_0=30 +k=0.994 +x_0=2e6 +R=1737400", (1.6e6, 4e5, 4e3, 4e3)),
    "south": (
        "+proj=stere +lat_0=-90 +lat_ts=-75 +lon_0=-70 +R=1737400 +units=km",
        (-250.0, 420.0, 4.0, 4.0),
    ),
    "equirectangular": (
        "+proj=eqc +lat_ts=40 +lon_0=180 +y_0=1e5 +R=1737400 +units=m",
        (-4.5e5, 8e5, 4e3, 4e3),
    ),
}


@pytest.mark.parametrize("case", MAPS)
def test_projected_models(case, tmp_path):
    crs, corner = MAPS[case]
    path, lat, lon = projected(tmp_path / "map.tif", crs, corner)
    dem = read_dem(path, 1.0, 1737400.0)
    rng = np.random.default_rng(3)
    inner = np.zeros((200, 240), bool)
    inner[10:-10, 10:-10] = True
    rows = rng.choice(np.flatnonzero(inner), 400)
    # Points of the raster, and places between them.
    places = frames.up(lat[rows], lon[rows]) + rng.normal(scale=1e-3, size=(400, 3))
    places[:200] = frames.up(lat[rows[:200]], lon[rows[:200]])
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    np.testing.assert_allclose(dem.heights_m(places), hills(*frames.latitude_longitude(places)), atol=1.0)
    assert dem.covers(places).all()
    # The raster's step on the ground: the scale differs from that of the map by some percent.
    unit_m = 1e3 if "km" in crs else 1.0
    middle, beside = (frames.up(lat[k], lon[k]) for k in (100 * 240 + 120, 101 * 240 + 120))
    assert dem.step_rad == pytest.approx(np.arccos(middle @ beside), rel=0.002)
    assert dem.step_rad * 1737400.0 == pytest.approx(corner[3] * unit_m, rel=0.07)
    assert np.linalg.norm(dem.middle - middle) < 1.5 * dem.step_rad
    # One step beyond each side is outside, and so is the other hemisphere.
    west, north, dx, dy = corner
    x = np.array([west - dx, west + 241 * dx, west + 50 * dx, west + 50 * dx])
    y = np.array([north - 50 * dy, north - 50 * dy, north + dy, north - 201 * dy])
    outside = frames.up(*np.radians(warp.transform(crs, MOON, x, y))[::-1])
    assert not dem.covers(outside).any()
    assert not dem.covers(-places).any()


def test_a_coarser_model_fills_gaps(globe, tmp_path):
    lat = np.radians(20.0 - 0.1 * (np.arange(200) + 0.5))
    lon = np.radians(0.1 * (np.arange(200) + 0.5))
    values = (hills(lat[:, None], lon[None]) + 40.0).astype(np.float32)
    values[80:110, 120:140] = -9999.0
    part = write(tmp_path / "part.tif", values, (0.0, 20.0, 0.1, 0.1), nodata=-9999.0)
    with pytest.raises(InputError, match="expected heights everywhere, 600 points have none"):
        read_dem(part)
    alone = read_dem(part, gaps=True)
    hole, beside, far = frames.up(np.radians([10.5, 11.95, 5.0]), np.radians([13.0, 13.0, 3.0]))
    assert alone.covers(np.stack([hole, beside, far])).tolist() == [False, False, True]
    nested = read_nested_dem([part, globe])
    model = hills(*frames.latitude_longitude(np.stack([hole, far])))
    # The coarser one in the gap, the finer one elsewhere.
    np.testing.assert_allclose(
        nested.heights_m(np.stack([hole, far])), model + np.array([0.0, 40.0]), atol=1.0
    )
    # No cliff on the way out of the gap.
    way = frames.up(np.radians(np.linspace(5.0, 10.5, 400)), np.radians(np.full(400, 13.0)))
    off = nested.heights_m(way) - hills(*frames.latitude_longitude(way))
    assert off[0] == pytest.approx(40.0, abs=1.0)
    assert np.abs(np.diff(off)).max() < 2.0
    with pytest.raises(InputError, match=r"part\.tif: expected heights everywhere, 600 points"):
        read_nested_dem([part])
    elsewhere = write(tmp_path / "other.tif", np.zeros((40, 40), np.float32), (100.0, 20.0, 0.5, 0.5))
    with pytest.raises(InputError, match=r"part\.tif: 600 points have no height, in it and in the coarser"):
        read_nested_dem([part, elsewhere])
    with pytest.raises(
        InputError, match=r"part\.tif: is finer than .*globe\.tif, expected the finest model first"
    ):
        read_nested_dem([globe, part, globe])


BAD = {
    "two bands": (lambda p: write(p, np.zeros((2, 8, 8), np.float32)), "one band, found 2"),
    "projected": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="+proj=merc +R=1737400 +units=m"),
        "found projection 'merc'",
    ),
    "an ellipsoid": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="+proj=eqc +a=1737400 +b=1730000"),
        "found an ellipsoid",
    ),
    "latitudes on an ellipsoid": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="+proj=longlat +a=1737400 +rf=169.9"),
        r"expected longitude and latitude.* of a sphere, found an ellipsoid \(.*1/f = 169\.9",
    ),
    "not about a pole": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="+proj=stere +lat_0=60 +R=1737400"),
        "found projection 'stere'",
    ),
    "another body": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="+proj=stere +lat_0=90 +R=3396190"),
        r"expected an elevation model of a body of 1737400 m, found one of 3396190 m",
    ),
    "the Earth, in metres": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="EPSG:3413"),
        r"expected an elevation model of a body of 1737400 m, found one of 6378137 m",
    ),
    "radii": (
        lambda p: write(p, np.full((8, 8), 1737400.0, np.float32)),
        "expected heights above a sphere of 1737400 m, found 1737400 to 1737400 m: radii",
    ),
    "kilometres, stated": (
        lambda p: write_with_unit(p, "km"),
        r"states heights in km, expected a unit of 1 m \(--dem-unit-m\)",
    ),
    "feet, stated": (
        lambda p: write_with_unit(p, "ft"),
        r"states heights in ft, expected a unit of 1 m \(--dem-unit-m\)",
    ),
    "gaps that it does not state": (
        lambda p: write(p, np.where(np.eye(8) > 0.0, -32768, 1000).astype(np.int16)),
        r"8 points are -32768 and none near: gaps that it does not state \(gdal_edit.py -a_nodata -32768\)",
    ),
    "an image": (lambda p: write(p, np.ones((8, 8), np.uint8)), "expected heights, found uint8 numbers"),
    "complex": (lambda p: write(p, np.ones((8, 8), np.complex64)), "found complex64 numbers$"),
    "another sphere of the body": (
        lambda p: write(p, np.zeros((8, 8), np.float32), crs="+proj=longlat +R=1738000 +no_defs"),
        r"above a sphere of 1737400 m, found .* one of 1738000 m: .*catalog import --body-radius-m 1738000\)",
    ),
    "no coordinates": (lambda p: write(p, np.zeros((8, 8), np.float32), crs=None), "found none"),
    "holes": (lambda p: write(p, np.full((8, 8), -1, np.int16), nodata=-1), "64 points have none"),
    "not a number": (lambda p: write(p, np.full((8, 8), np.nan, np.float32)), "64 points have none"),
    "a line": (lambda p: write(p, np.zeros((2, 8), np.float32)), "found 2 x 8"),
    "no raster": (lambda p: p.write_text("x"), "expected a GeoTIFF"),
    "missing": (lambda p: None, "file is missing"),
}


def test_latitudes_of_the_earth_are_those_of_other_bodies_only(tmp_path):
    path = write(tmp_path / "dem.tif", np.zeros((8, 8), np.float32), crs="EPSG:4326")
    assert read_dem(path, radius_m=1737400.0).heights_m(np.eye(3)) == pytest.approx(0.0)
    with pytest.raises(InputError, match=r"found an ellipsoid \(WGS 84, 1/f = 298\.257"):
        read_dem(path, radius_m=6371e3)


def test_a_scale_is_applied_once(tmp_path):
    path = write(tmp_path / "dem.tif", np.full((8, 8), 2000, np.int16))
    with rasterio.open(path, "r+") as raster:
        raster.scales, raster.offsets = (0.5,), (-100.0,)
    assert read_dem(path).heights_m(np.eye(3)) == pytest.approx(900.0)
    with pytest.raises(InputError, match=r"states a scale of 0\.5, which is applied: --dem-unit-m 0\.5"):
        read_dem(path, 0.5)


def test_ground_as_deep_as_a_value_for_gaps(tmp_path):
    deep = np.linspace(-10050.0, -9900.0, 151, dtype=np.float32)
    path = write(tmp_path / "dem.tif", np.tile(deep, (8, 1)), (-180.0, 90.0, 360.0 / 151.0, 22.5))
    assert (deep == -9999.0).any()
    assert read_dem(path).heights_m(np.eye(3)).max() < -9900.0


@pytest.mark.parametrize("case", BAD)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_what_is_no_elevation_model_is_named(case, tmp_path):
    spoil, expected = BAD[case]
    path = tmp_path / "dem.tif"
    spoil(path)
    with pytest.raises(InputError, match=expected) as caught:
        read_dem(path, 1.0, 1737400.0)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_the_ground_is_the_models_and_craters_stand_in_it(globe):
    relief = Relief(scene.MOON, scene.SITE[:, 2], ReliefOptions(slope=0.004), read_dem(globe))
    options = CraterFieldOptions(focal_px=scene.FOCAL)
    catalog = random_craters(np.random.default_rng(1), scene.MOON, scene.track(), options, relief)
    renderer = Renderer(
        scene.CAMERA, Terrain(catalog, relief, TerrainOptions()), RenderOptions(psf_sigma_px=0.0)
    )
    # The whole view is covered although the ground is not level with the sphere.
    gTb = scene.pose(scene.place(-40e3, 3e3, 9e3), 10.0)
    x, y = np.meshgrid(np.linspace(0.0, 1023.0, 40), np.linspace(0.0, 1023.0, 40))
    ground, _ = renderer.ground_points(gTb, np.stack([x, y], axis=-1).reshape(-1, 2))
    off = scene.MOON.altitude_m(ground) - hills(*frames.latitude_longitude(ground))
    assert np.abs(np.median(off)) < 15.0
    assert np.percentile(np.abs(off), 80.0) < 60.0
    assert abs(hills(*frames.latitude_longitude(gTb[:3, 3]))) > 200.0
    rows, _ = catalog.visible(scene.CAMERA, gTb, min_semi_minor_px=8.0, margin_px=4.0)
    offsets = crest_offsets_px(renderer, catalog, gTb, rows)
    assert len(rows) >= 8
    assert np.nanmean(np.abs(offsets)) < 0.04


def test_a_scenario_with_a_model(globe, tmp_path):
    text = built_in_scenarios()["lunar_descent"].read_text().replace("slope = 0.012 ", "slope = 0.001 ")
    case = tmp_path / "case.toml"
    case.write_text(text.replace("[terrain]\n", '[terrain]\ndem = "globe.tif"\n'))
    (tmp_path / "globe.tif").write_bytes(globe.read_bytes())
    scenario = load_scenario(case)
    small = {
        "camera": scenario.camera.model_copy(update={"width_px": 96, "height_px": 96}),
        "craters": scenario.craters.model_copy(update={"min_apparent_px": 6.0, "max_apparent_px": 30.0}),
        "trajectory": scenario.trajectory.model_copy(update={"frame_interval_s": 300.0}),
    }
    data = Dataset.open(simulate(scenario.model_copy(update=small), tmp_path / "data"))
    level = hills(data.catalog.latitude_rad, data.catalog.longitude_rad)
    # Rims stand above the ground by less than a tenth of their radius, some on a larger one's flank.
    off = np.abs(data.catalog.height_m - level) / data.catalog.semi_major_m
    assert np.median(off) < 0.1
    assert np.median(np.abs(level) / data.catalog.semi_major_m) > 0.12
    assert data.image(1).std() > 2.0
    plateau = write(tmp_path / "high.tif", np.full((8, 8), 5000.0, np.float32), (-180.0, 90.0, 45.0, 22.5))
    high = scenario.terrain.model_copy(update={"dem": str(plateau)})
    with pytest.raises(CraternavError, match="1000 m below the elevation model"):
        simulate(scenario.model_copy(update={**small, "terrain": high}), tmp_path / "below")
    assert not (tmp_path / "below").exists()


def test_the_moon():
    """South Pole-Aitken is deep, the highlands of the far side are high."""
    dem = read_dem(shared("moon_dem.tif"))
    deep, high = dem.heights_m(frames.up(np.radians([-53.0, 5.0]), np.radians([-169.0, -158.0])))
    assert deep == pytest.approx(-6800.0, abs=200.0)
    assert high == pytest.approx(8700.0, abs=200.0)
