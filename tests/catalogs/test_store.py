import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog, read_catalog, write_catalog
from craternav_fg.catalogs.heights import implausible_heights, with_rim_heights
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from tests.catalogs.population import power_law_population
from tests.catalogs.test_dem import GLOBE, write
from tests.dataset.conftest import folder, with_images  # noqa: F401

BODY = Body("ball", 250e3, 1.0, (0.0, 0.0, 0.0))
NUMBERS = ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m")


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "craters.parquet"
    write_catalog(path, power_law_population(np.random.default_rng(1), BODY, 500, (400.0, 60e3)))
    return path


def test_numbers_read_back_exactly_in_the_order_of_the_index(tmp_path):
    catalog = power_law_population(np.random.default_rng(2), BODY, 3000, (400.0, 60e3))
    path = tmp_path / "craters.parquet"
    write_catalog(path, catalog)
    again = read_catalog(path, BODY)
    order = catalog.index.order
    assert again.identifiers == tuple(catalog.identifiers[row] for row in order)
    for name in NUMBERS:
        np.testing.assert_array_equal(getattr(again, name), getattr(catalog, name)[order])
    np.testing.assert_array_equal(again.index.order, np.arange(3000))
    assert import_catalog(path, BODY)[0].identifiers == again.identifiers
    assert import_catalog(path)[0].body == BODY


def test_another_body(stored):
    with pytest.raises(
        InputError, match=r"craters\.parquet: radius_m: .* 561400 m \(Dione\), found one of ball on 250000 m"
    ):
        read_catalog(stored, Body("Dione", 561400.0, 1.0, (0.0, 0.0, 0.0)))


def changed(path, name, column):
    table = pq.read_table(path)
    at = table.column_names.index(name)
    table = table.remove_column(at) if column is None else table.set_column(at, name, column)
    pq.write_table(table, path)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("latitude_rad", 1.6, r"latitude_rad: expected -pi/2 to pi/2, found 1\.6 in row 8"),
        ("longitude_rad", 200.0, r"longitude_rad: expected .* found 200 in row 8"),
        ("semi_major_m", 3e5, r"semi_major_m: expected 0 to 250000, found 300000 in row 8"),
        ("semi_minor_m", 2e5, "semi_minor_m: expected more than 0, at most semi_major_m"),
        ("angle_rad", np.inf, "angle_rad: expected a finite number"),
        ("height_m", np.nan, "height_m: expected a rim above"),
        ("angle_rad", None, "angle_rad: expected a value, found none in row 8"),
        ("crater_id", "twice", "crater_id: expected each identifier once"),
    ],
)
def test_values_that_are_none(stored, name, value, match):
    values = pq.read_table(stored)[name].to_pylist()
    values[7] = value
    if value == "twice":
        values[9] = value
    changed(stored, name, pa.array(values))
    with pytest.raises(InputError, match=r"craters\.parquet: " + match):
        read_catalog(stored, BODY)


def test_a_missing_column(stored):
    changed(stored, "angle_rad", None)
    with pytest.raises(InputError, match=r"craters\.parquet: .*angle_rad"):
        read_catalog(stored, BODY)


def test_files_of_another_kind(tmp_path):
    path = tmp_path / "craters.parquet"
    path.write_text("CRATER_ID\n")
    with pytest.raises(InputError, match=r"craters\.parquet: expected a Parquet file"):
        read_catalog(path, BODY)
    pq.write_table(pa.table({"crater_id": ["A"]}), path)
    with pytest.raises(InputError, match="that `craternav catalog import` wrote"):
        read_catalog(path, BODY)
    with pytest.raises(InputError, match="file is missing"):
        read_catalog(tmp_path / "none.parquet", BODY)


def test_a_damaged_file_is_refused_wherever_the_damage_is(stored):
    whole = stored.read_bytes()
    right = read_catalog(stored, BODY)
    rng = np.random.default_rng(2)
    refused = 0
    # Most of the file are numbers, in which a wrong bit is another number.
    for place in [*rng.integers(0, len(whole), 150), *range(len(whole) - 1200, len(whole), 8)]:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(0, 8))
        stored.write_bytes(damaged)
        try:
            found = read_catalog(stored, BODY)
        except InputError:
            refused += 1
            continue
        assert found.identifiers == right.identifiers
        for name in NUMBERS:
            np.testing.assert_array_equal(getattr(found, name), getattr(right, name))
    assert refused > 150
    for size in rng.integers(0, len(whole), 30):
        stored.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"craters\.parquet: "):
            read_catalog(stored, BODY)


def test_a_data_set_with_a_large_catalogue(folder):  # noqa: F811
    small = Dataset.open(folder.path)
    write_catalog(folder.path / "craters.parquet", small.catalog)
    with pytest.raises(InputError, match=r"craters\.parquet: expected either .* craters\.csv, found both"):
        Dataset.open(folder.path)
    (folder.path / "craters.csv").unlink()
    large = Dataset.open(folder.path)
    assert sorted(large.catalog.identifiers) == sorted(small.catalog.identifiers)
    (folder.path / "craters.parquet").unlink()
    with pytest.raises(InputError, match=r"craters\.csv: file is missing"):
        Dataset.open(folder.path)


def test_an_elevation_model_of_another_body_or_unit(tmp_path):
    heights = np.full((360, 720), 3000.0, dtype=np.float32)
    # Coordinates of the Moon; the Earth's are on many rasters of other bodies, and tell nothing.
    path = write(tmp_path / "a.tif", heights, GLOBE)
    assert read_dem(path, radius_m=1737400.0).heights_m(np.eye(3)) == pytest.approx(3000.0)
    # Heights above a sphere that is 600 m lower would put all rims too low.
    with pytest.raises(
        InputError, match=r"a\.tif: expected heights above a sphere of 1738000 m, found .* 1737400"
    ):
        read_dem(path, radius_m=1738000.0)
    with pytest.raises(
        InputError, match=r"a\.tif: expected an elevation model of a body of 561400 m, .* 1737400"
    ):
        read_dem(path, radius_m=561400.0)
    earth = write(tmp_path / "b.tif", heights, GLOBE, crs="EPSG:4326")
    catalog = power_law_population(np.random.default_rng(1), BODY, 20, (400.0, 60e3))
    assert implausible_heights(with_rim_heights(catalog, read_dem(earth, radius_m=BODY.radius_m))) is None
    wrong = with_rim_heights(catalog, read_dem(earth, 1000.0))
    assert "wrong unit" in implausible_heights(wrong)


def test_planes_of_rims_lie_below_the_mean_height_along_them(tmp_path):
    # Heights that grow with latitude: the mean along a rim is that of its centre.
    step = 0.125
    rows = 90.0 - step * (np.arange(180 / step) + 0.5)
    heights = np.repeat(20.0 * rows[:, None], 2 * len(rows), axis=1).astype(np.float32)
    dem = read_dem(write(tmp_path / "slope.tif", heights, (-180.0, 90.0, step, step)), unit_m=2.0)
    n = 50
    rng = np.random.default_rng(4)
    latitude = rng.uniform(-60.0, 60.0, n)
    catalog = Catalog(
        tuple(map(str, range(n))), np.radians(latitude), rng.uniform(-np.pi, np.pi, n), np.full(n, 20e3),
        np.full(n, 15e3), rng.uniform(0.0, np.pi, n), np.full(n, 1e9), BODY,
    )  # fmt: skip
    found = with_rim_heights(catalog, dem)
    # Parallels are bent: the mean latitude along a rim lies a little off its centre's. The sphere lies below
    # its tangent plane by rho^2 / 2R; half of each square is the mean around.
    depth_m = 0.5 * (20e3**2 + 15e3**2) / (2.0 * 250e3)
    np.testing.assert_allclose(found.height_m, 40.0 * latitude - depth_m, atol=12.0)
    # A bowl is seen by its rim, not by its floor.
    place = frames.up(np.array(0.5), np.array(1.0))
    columns = np.radians(step * (np.arange(2 * len(rows)) + 0.5) - 180.0)
    away = np.arccos(
        np.clip(frames.up(*np.meshgrid(np.radians(rows), columns, indexing="ij")) @ place, -1, 1)
    )
    bowl = read_dem(
        write(tmp_path / "bowl.tif", (250e3 * away).astype(np.float32), (-180.0, 90.0, step, step))
    )
    one = Catalog(
        ("A",),
        np.array([0.5]),
        np.array([1.0]),
        np.array([30e3]),
        np.array([30e3]),
        np.zeros(1),
        np.zeros(1),
        BODY,
    )
    assert with_rim_heights(one, bowl).height_m[0] == pytest.approx(30e3 - 30e3**2 / 500e3, rel=0.01)
