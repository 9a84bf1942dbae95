"""Real ground: nested elevation models as terrain, a published catalogue as the map."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from craternav_fg import frames
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.nested_dem import NestedDem
from craternav_fg.cli.app import app
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.simulation.ground_views import RealGround
from craternav_fg.simulation.published import published_craters
from craternav_fg.simulation.render import Renderer
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from craternav_fg.simulation.scenario_tables import PublishedCraters
from craternav_fg.simulation.world import World, make_world
from factors.arrays import FloatArray
from tests.catalogs.test_dem import hills, write
from tests.shared_data import shared

pytest.importorskip("rasterio")

# The bowls that the fine model has, and the catalogue does not know well: centre and radius in deg.
BOWLS = [(-40.4 - 0.6 * i, -17.6 + 0.4 * j, 0.05) for i in range(3) for j in range(4)]
SHIFT_DEG = 0.01
DETAIL_M = 100.0

CASE = """
base = "gld100_highlands"
[camera]
width_px = 128
height_px = 128
[trajectory]
duration_s = 16.0
[trajectory.start]
altitude_m = 60000.0
downrange_m = -10000.0
ground_speed_m_s = 700.0
[trajectory.end]
altitude_m = 56600.0
"""


def fine(lat: FloatArray, lon: FloatArray) -> FloatArray:
    """Hills, with bowls 10 % of their diameter deep; m, from rad."""
    out = np.asarray(hills(lat, lon), dtype=np.float64)
    for y, x, r in BOWLS:
        off = np.hypot(np.degrees(lat) - y, (np.degrees(lon) - x) * np.cos(lat)) / r
        out = out - 0.2 * r * np.pi / 180.0 * 1737.4e3 * np.clip(1.0 - off**2, 0.0, None)
    return out


def raster(
    path: Path, west: float, north: float, steps: tuple[int, int], step: float, coarse: bool = False
) -> Path:
    lat = np.radians(north - step * (np.arange(steps[0]) + 0.5))[:, None]
    lon = np.radians(west + step * (np.arange(steps[1]) + 0.5))[None]
    values = hills(lat, lon) + DETAIL_M if coarse else fine(lat, lon)
    write(path, values.astype(np.float32), (west, north, step, step))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder as the public one: the same names, an own Moon."""
    out = tmp_path_factory.mktemp("data")
    (out / "gld100").mkdir()
    raster(out / "gld100/gld100_256ppd_southern_highlands.tif", -19.0, -38.0, (500, 400), 0.01)
    raster(out / "gld100/gld100_16ppd_global.tif", -180.0, 90.0, (360, 720), 0.5, coarse=True)
    rows = [f"{k},{y},{x + SHIFT_DEG},{2 * r * np.pi / 180 * 1737.4}" for k, (y, x, r) in enumerate(BOWLS)]
    # The catalogue has craters on the other side of the Moon as well.
    rows.append("far,40.0,160.0,3.0")
    text = "ID,LAT_DEG,LON_E_DEG,DIAMETER_KM\n" + "\n".join(rows) + "\n"
    (out / "lu1319381.csv").write_text(text)
    return out


@pytest.fixture(scope="module")
def case(folder: Path) -> Scenario:
    path = folder / "case.toml"
    path.write_text(CASE + '[craters]\nsource = "published"\npath = "lu1319381.csv"\n')
    return load_scenario(path).with_data(folder)


@pytest.fixture(scope="module")
def world(case: Scenario) -> World:
    return make_world(case, np.random.default_rng(1), trial=False)


def test_a_model_gives_way_to_a_coarser_one_without_a_cliff(folder: Path) -> None:
    inner, outer = (
        read_dem(folder / f"gld100/gld100_{name}.tif")
        for name in ("256ppd_southern_highlands", "16ppd_global")
    )
    nested = NestedDem((inner, outer))
    # Across the eastern border, at 15 deg W.
    lon = np.radians(np.arange(-17.0, -14.0, 0.005))
    places = frames.up(np.full(len(lon), np.radians(-40.2)), lon)
    heights = nested.heights_m(places)
    outside = lon > np.radians(-15.0)
    np.testing.assert_allclose(heights[outside], outer.heights_m(places[outside]), atol=1e-9)
    assert np.abs(heights - outer.heights_m(places))[~outside].max() > 50.0
    # A cliff would be 100 m.
    assert np.abs(np.diff(heights)).max() < 25.0
    at = frames.up(np.radians([-40.3]), np.radians([-17.2]))
    np.testing.assert_allclose(nested.heights_m(at), inner.heights_m(at), atol=1e-9)
    assert nested.covers(places).all()
    assert not inner.covers(places).all()


def test_the_terrain_is_the_model_and_the_map_the_catalogue(world: World, folder: Path) -> None:
    assert len(world.catalog) == len(BOWLS)
    # The rendered ground has the bowls where the model has them, not where the catalogue has them.
    renderer, gTb = world.renderer(), world.descent.evaluate(np.array([8.0])).gTb[0]
    x, y = np.meshgrid(np.linspace(2.0, 125.0, 60), np.linspace(2.0, 125.0, 60))
    ground, _ = renderer.ground_points(gTb, np.stack([x, y], axis=-1).reshape(-1, 2))
    lat, lon = frames.latitude_longitude(ground)
    near = np.min([np.hypot(lat - np.radians(y), lon - np.radians(x)) for y, x, _ in BOWLS], axis=0)
    seen = near < np.radians(0.03)
    assert seen.sum() > 20
    off = world.descent.body.altitude_m(ground) - fine(lat, lon)
    assert np.abs(np.median(off[seen])) < 20.0
    shifted = world.descent.body.altitude_m(ground) - fine(lat, lon - np.radians(5.0 * SHIFT_DEG))
    assert np.abs(shifted[seen]).max() > 3.0 * np.abs(off[seen]).max()


def test_the_map_has_errors_and_heights_of_the_coarse_model(world: World) -> None:
    catalog = world.catalog
    assert catalog.has_heights
    assert catalog.errors is not None
    level = hills(catalog.latitude_rad, catalog.longitude_rad) + DETAIL_M
    np.testing.assert_allclose(catalog.height_m, level, atol=60.0)
    assert np.all(catalog.errors.place_m > 80.0)
    assert catalog.common_shift is not None
    assert np.all(catalog.common_shift.place_m > 20.0)
    # Bowls drawn below the model's resolution are no craters of the map.
    assert world.clutter is not None


def test_heights_of_rims_are_in_the_unit_of_the_terrain(case: Scenario, folder: Path, tmp_path: Path) -> None:
    import rasterio

    terrain, craters = case.terrain, case.craters
    assert terrain is not None
    assert isinstance(craters, PublishedCraters)
    assert craters.heights is not None
    halves, models = [], [*terrain.models(), craters.heights]
    for k, path in enumerate(models):
        with rasterio.open(path) as raster:
            corner = (raster.transform.c, raster.transform.f, raster.transform.a, -raster.transform.e)
            halves.append(str(write(tmp_path / f"{k}.tif", 2.0 * raster.read(1), corner)))
    tables = {
        "terrain": terrain.model_copy(update={"dem": tuple(halves[:-1]), "dem_unit_m": 0.5}),
        "craters": craters.model_copy(update={"heights": halves[-1]}),
    }
    one, other = (
        make_world(scenario, np.random.default_rng(1), trial=False).catalog
        for scenario in (case, case.model_copy(update=tables))
    )
    np.testing.assert_allclose(other.height_m, one.height_m, atol=0.1)


def test_heights_of_rims_must_cover_the_map_and_be_plausible(case: Scenario, tmp_path: Path) -> None:
    craters, track = case.craters, frames.up(np.radians([-41.0]), np.radians([-17.0])) * 1.8e6
    assert isinstance(craters, PublishedCraters)
    body = case.body.body()
    # The bowls lie from 40.4 to 41.6 deg S.
    part = write(tmp_path / "part.tif", np.zeros((40, 40), np.float32), (-20.0, -39.5, 0.2, 0.04))
    craters = craters.model_copy(update={"heights": str(part)})
    with pytest.raises(
        InputError, match=r"part\.tif: expected heights of all 12 craters .*, 4 reach beyond it"
    ):
        published_craters(craters, body, track)
    high = write(tmp_path / "high.tif", np.full((360, 720), 1500.0, np.float32), (-180.0, 90.0, 0.5, 0.5))
    craters = craters.model_copy(update={"heights": str(high)})
    assert np.all(published_craters(craters, body, track).height_m > 1400.0)
    with pytest.raises(InputError, match=r"high\.tif: expected heights above a sphere .*wrong unit"):
        published_craters(craters, body, track, 1000.0)


def test_it_is_simulated_and_the_data_set_has_the_map(case: Scenario, tmp_path: Path) -> None:
    from craternav_fg.dataset import Dataset

    data = Dataset.open(simulate(case, tmp_path / "data"))
    assert len(data.catalog) == len(BOWLS)
    assert data.catalog.errors is not None
    assert data.image(1).std() > 2.0


def test_single_views_have_the_light_and_the_craters_of_the_scenario(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "worn.toml"
    worn = "[terrain]\nirregularity = 0.05\ndegradation = 0.8\npeaks_from_m = 900.0\n"
    law = "single_scattering_albedo = 0.3\nasymmetry = -0.2\n"
    law += "opposition_amplitude = 1.0\nopposition_width = 0.05\n"
    path.write_text(CASE + worn + "[render.hapke]\n" + law + '[craters]\npath = "lu1319381.csv"\n')
    made: list[Renderer] = []

    def kept(self: Renderer, *_: object) -> npt.NDArray[np.uint8]:
        made.append(self)
        return np.zeros((2, 2), dtype=np.uint8)

    monkeypatch.setattr(Renderer, "render", kept)
    RealGround(path, folder).view(np.random.default_rng(1))
    world = make_world(load_scenario(path).with_data(folder), np.random.default_rng(1), trial=False)
    expected = world.renderer()
    assert made[0].options == expected.options
    assert made[0].options.hapke is not None
    assert made[0].terrain.options == expected.terrain.options
    assert made[0].terrain.options.degradation == 0.8


def test_missing_public_files_are_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CRATERNAV_DATA", raising=False)
    done = CliRunner().invoke(app, ["simulate", "gld100_highlands", "-o", str(tmp_path / "data")])
    assert isinstance(done.exception, InputError)
    line = str(done.exception)
    assert "LU1319381" in line
    assert "--data" in line
    assert "\n" not in line
    monkeypatch.setenv("CRATERNAV_DATA", str(tmp_path))
    with pytest.raises(InputError, match=f"not in {tmp_path}"):
        load_scenario("gld100_highlands").with_data()
    # The folder holds all but the catalogue.
    monkeypatch.setenv("CRATERNAV_DATA", str(folder))
    with pytest.raises(InputError, match=r"lu1319381\.parquet"):
        load_scenario("gld100_highlands").with_data()


def test_measured_rims_of_a_published_catalogue_are_refused(case: Scenario, tmp_path: Path) -> None:
    from craternav_fg.campaign.run import as_measured

    with pytest.raises(CraternavError, match="--images"):
        as_measured(case, images=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gld100_highlands", "gld100_mare", "gld100_mixed"])
def test_the_real_moon(name: str, tmp_path: Path) -> None:
    """From public files alone: the ground is there, the sun casts shadows, and the map has its craters."""
    folder = shared("lu1319381.parquet").parent
    scenario = load_scenario(name).with_data(folder)
    few = {"trajectory": scenario.trajectory.model_copy(update={"frame_interval_s": 200.0})}
    world = make_world(scenario.model_copy(update=few), np.random.default_rng(2), trial=False)
    renderer = world.renderer()
    for k, stamp in enumerate(world.stamps_ns.tolist()):
        gTb = world.descent.evaluate(np.array([1e-9 * stamp])).gTb[0]
        rows, _ = world.catalog.visible(world.camera, gTb, min_semi_minor_px=8.0, margin_px=4.0)
        assert k == 2 or len(rows) >= 10
        image = renderer.render(gTb, world.sun.at(stamp), np.random.default_rng(k))
        assert image.std() > 4.0
