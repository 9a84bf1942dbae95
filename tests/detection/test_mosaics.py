"""Detection in mosaics: recall and places on maps of known craters, windows, resuming, bad input."""

import csv
import json

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio

from craternav_fg import frames
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import read_parquet
from craternav_fg.detection import mosaics
from craternav_fg.detection.images import Where
from craternav_fg.detection.mosaics import detect_mosaic
from craternav_fg.detection.raster import read_window
from craternav_fg.detection.settings import DetectionSettings
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.mosaic import Window
from tests.campaign import inline
from tests.cli.calls import call
from tests.detection.mosaic_scene import CORNERS, EQUIRECTANGULAR, POLAR, RADIUS_M, STEP_M, shaded_map
from tests.peak_memory import run_measured

SETTINGS = DetectionSettings()
HERE = Where(1)
# The first is a fifth of the mosaic's shorter side; the largest are found on reduced copies.
RADII_PX = np.concatenate([[160.0, 110.0, 60.0], np.linspace(11.0, 40.0, 20)])


@pytest.fixture(scope="module", params=[POLAR, EQUIRECTANGULAR], ids=["polar", "equirectangular"])
def any_map(request):
    return shaded_map(request.param, 800, 1100, RADII_PX)


@pytest.fixture(scope="module")
def polar():
    return shaded_map(POLAR, 800, 1100, RADII_PX)


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """Work without other processes."""
    monkeypatch.setattr(mosaics, "processes", inline.processes)


def nearest(catalog, made):
    """Rows of the craters next to the true ones, and their distances, m."""
    up = frames.up(catalog.latitude_rad, catalog.longitude_rad)
    away = RADIUS_M * np.linalg.norm(up[:, None] - made.directions[None], axis=-1)
    return away.argmin(axis=0), away.min(axis=0)


def test_craters_of_all_sizes_are_found_where_they_are(any_map, tmp_path):
    path = any_map.write(tmp_path / "map.tif")
    found = detect_mosaic(path, tmp_path / "out", SETTINGS, HERE, core_px=512)
    catalog = read_parquet(tmp_path / "out" / "catalog.parquet", None)
    assert found.craters == len(catalog) == len(found.rims) <= len(RADII_PX) + 1
    rows, away_m = nearest(catalog, any_map)
    assert len(set(rows.tolist())) == len(RADII_PX)
    assert catalog.body.name == "Moon"
    assert catalog.body.radius_m == RADIUS_M
    assert not catalog.has_heights
    # Both components of a place: the radius of 3 sigma holds 99 %.
    assert np.max(away_m / catalog.errors.place_m[rows]) < 3.0
    assert np.median(away_m / catalog.errors.place_m[rows]) > 0.3
    size = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)[rows] / any_map.radius_m
    np.testing.assert_allclose(size, 1.0, atol=0.03)
    # On the equirectangular map they are ellipses of 0.85.
    assert np.all(catalog.semi_minor_m[rows] / catalog.semi_major_m[rows] > 0.96)


def test_windows_of_other_sizes_find_the_same(polar, tmp_path):
    path = polar.write(tmp_path / "map.tif")
    tables = []
    for core_px in (384, 1536):
        found = detect_mosaic(path, tmp_path / str(core_px), SETTINGS, HERE, core_px=core_px)
        tables.append(found.rims.charts_px[np.lexsort(found.rims.charts_px[:, :1].T)])
    parts, whole = tables
    radius = np.exp(whole[:, 2])
    assert parts.shape == whole.shape
    assert np.max(np.abs(parts[:, :2] - whole[:, :2]) / radius[:, None]) < 0.02
    assert np.max(np.abs(parts[:, 2:] - whole[:, 2:])) < 0.03


def test_killed_and_resumed_it_is_bit_by_bit_the_same(polar, tmp_path):
    path = polar.write(tmp_path / "map.tif", polar.image[:520, :780])
    whole = detect_mosaic(path, tmp_path / "whole", SETTINGS, HERE, core_px=256)

    def killed(_what, done, _total):
        if done == 4:
            raise KeyboardInterrupt

    folder = tmp_path / "killed"
    with pytest.raises(KeyboardInterrupt):
        detect_mosaic(path, folder, SETTINGS, HERE, core_px=256, progress=killed)
    assert not (folder / "catalog.parquet").exists()
    kept = sorted((folder / "windows").iterdir())
    assert 2 < len(kept) < whole.windows
    # One that was cut off, as by a full disk.
    kept[1].write_bytes(kept[1].read_bytes()[:200])
    before = {one: one.stat().st_mtime_ns for one in kept}
    detect_mosaic(path, folder, SETTINGS, HERE, core_px=256)
    assert [one for one, time in before.items() if one.stat().st_mtime_ns != time] == [kept[1]]
    for name in ("catalog.parquet", "rims.csv"):
        assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_rims_on_missing_data_are_dropped_and_others_stay(polar, tmp_path):
    image = polar.image.copy()
    # The right part, through some craters.
    image[:, 800:] = 0
    path = polar.write(tmp_path / "map.tif", image, nodata=0)
    found = detect_mosaic(path, tmp_path / "out", SETTINGS, HERE, core_px=512)
    x, y = found.rims.charts_px[:, :2].T
    assert x.max() < 800.0
    radius = polar.radius_m / STEP_M
    whole = polar.xy_px[:, 0] + 1.2 * radius < 800.0
    away = np.hypot(x[:, None] - polar.xy_px[whole, 0], y[:, None] - polar.xy_px[whole, 1]).min(axis=0)
    assert whole.sum() >= 10
    assert np.all(away < 0.2 * radius[whole])
    grey = np.full((800, 1100), np.nan, np.float32)
    path = polar.write(tmp_path / "none.tif", grey)
    assert len(detect_mosaic(path, tmp_path / "none", SETTINGS, HERE).rims) == 0
    assert not (tmp_path / "none" / "catalog.parquet").exists()


@pytest.mark.parametrize("level", [0, 1, 3])
def test_special_pixels_that_the_file_does_not_declare_are_missing_at_each_level(level, polar, tmp_path):
    """ISIS writes missing pixels as -3.4e38; averaged with others they are no longer as large."""
    rows, columns = polar.image.shape
    step = 2**level
    image, mosaic = polar.image.astype(np.float32), tmp_path / "map.tif"
    image[100:140, 203:300] = image[301, 77] = np.float32(-3.4028227e38)
    polar.write(mosaic, image)
    whole = (0, 0, columns // step, rows // step)
    pixels = read_window(mosaic, Window(level, 0, 0, whole, whole, (1.0, 2.0)))
    cells = image[: whole[3] * step, : whole[2] * step].astype(np.float64)
    cells = cells.reshape(whole[3], step, whole[2], step).swapaxes(1, 2).reshape(*whole[:1:-1], -1)
    expected = (cells > -1.0).all(axis=2)
    np.testing.assert_array_equal(pixels.known, expected)
    np.testing.assert_allclose(pixels.values[..., 0][expected], cells.mean(axis=2)[expected], rtol=1e-5)
    seen = brightness(pixels.values)
    np.testing.assert_array_equal(np.isfinite(seen), expected)
    assert np.nanstd(seen) > 5.0


def test_parts_that_are_lit_from_other_sides_keep_their_light(tmp_path):
    """The left part is turned by half a turn: lit from the right."""
    made = shaded_map(POLAR, 450, 800, np.linspace(11.0, 20.0, 40))
    image = made.image.copy()
    image[:, :400] = image[::-1, 399::-1]
    path = made.write(tmp_path / "map.tif", image)
    found = detect_mosaic(path, tmp_path / "out", SETTINGS, HERE, core_px=400)
    sun = found.rims.local_sun_angles_rad
    x, radius = found.rims.charts_px[:, 0], found.rims.ellipses_px[:, 2]
    left, right = x + 2.0 * radius < 400.0, x - 2.0 * radius > 400.0
    assert min(left.sum(), right.sum()) >= 8
    assert np.all(np.cos(sun[left]) > 0.9)
    assert np.all(np.cos(sun[right]) < -0.9)


def test_the_command_and_what_takes_the_catalogue(polar, tmp_path):
    path, folder = polar.write(tmp_path / "map.tif"), tmp_path / "out"
    done = call("detect", path, "-o", folder, "--workers", 1, "--json")
    assert (done.code, done.err) == (0, "")
    values = json.loads(done.out)
    assert values["catalog"] == str(folder / "catalog.parquet")
    with (folder / "rims.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == values["rims"] == values["craters"]
    overlay = cv2.imread(str(folder / "overlay.png"))
    assert overlay.shape == (800, 1100, 3)
    x, y = polar.xy_px[0].astype(int)
    bottom = y + int(polar.radius_m[0] / STEP_M)
    below = overlay[bottom - 6 : bottom + 7, x].astype(int)
    assert np.ptp(below, axis=1).max() > 40
    table = pq.read_table(folder / "catalog.parquet")
    found_x = sorted(float(row["ellipseCenterX(px)"]) for row in rows)
    np.testing.assert_allclose(sorted(table["x_px"].to_pylist()), found_x, atol=1e-3)
    assert set(table["source"].to_pylist()) == {"map.tif"}
    assert min(table["quality"].to_pylist()) >= 0.5
    done = call("catalog", "info", folder / "catalog.parquet", "--json")
    assert json.loads(done.out)["craters"] == len(rows)
    # A published table of the same craters, some missing: circles in the columns of Robbins (2018).
    some = slice(0, 15)
    latitude, longitude = frames.latitude_longitude(polar.directions[some])
    radius = polar.radius_m[some]
    names = tuple(f"00-1-{k:06d}" for k in range(len(radius)))
    flat = np.zeros(len(radius))
    published = Catalog(names, latitude, longitude, radius, radius, flat, flat, named_body("Moon"))
    write_catalog(tmp_path / "robbins.csv", published)
    merged = tmp_path / "merged.parquet"
    done = call("catalog", "merge", tmp_path / "robbins.csv", folder / "catalog.parquet", "-o", merged)
    assert done.code == 0
    assert "15 shared craters" in done.out
    assert len(read_parquet(merged, None)) == len(rows)


def test_without_coordinates_there_is_a_table_only(polar, tmp_path, monkeypatch):
    monkeypatch.setattr(mosaics, "MAX_PIXELS", 100_000)
    path = polar.write(tmp_path / "map.tif", polar.image[:400, :600], crs=None)
    done = call("detect", path, "-o", tmp_path / "out", "--workers", 1)
    assert done.code == 0
    assert "no catalogue: the image has no coordinates" in done.out
    assert (tmp_path / "out" / "rims.csv").exists()
    assert not (tmp_path / "out" / "catalog.parquet").exists()
    done = call("detect", path, "-o", tmp_path / "other", "--body", "Moon")
    assert done.code == 2
    assert "map.tif: expected coordinates on Moon, found none" in done.err


def test_a_damaged_block_is_told_and_the_others_are_done(polar, tmp_path):
    path = polar.write(tmp_path / "map.tif", compress="deflate")
    path.write_bytes(path.read_bytes()[:-20_000] + bytes(20_000))
    done = call("detect", path, "-o", tmp_path / "out", "--workers", 1)
    assert done.code == 2
    *told, last = done.err.splitlines()
    assert all("map.tif: cannot be read, columns " in line for line in told)
    assert f"{len(told)} of " in last
    assert last.endswith(" windows failed; the others are done")
    assert len((tmp_path / "out" / "rims.csv").read_text().splitlines()) > 3
    with pytest.raises(CraternavError, match="cannot be read, columns 0 to 1100, rows 0 to 800"):
        detect_mosaic(path, tmp_path / "all", SETTINGS, HERE, core_px=1536)
    path.write_bytes(b"no image")
    done = call("detect", path, "-o", tmp_path / "no", "--body", "Moon")
    assert done.code == 2
    assert "map.tif: cannot be read as an image" in done.err
    assert done.err.count("\n") == 1


MARS = "+proj=longlat +R=3396190 +no_defs"
WEST, NORTH = CORNERS[POLAR]


@pytest.mark.parametrize(
    ("options", "body", "message"),
    [
        ({"crs": MARS, "transform": rasterio.Affine(0.01, 0, 10, 0, -0.01, 20)}, "Moon",
         "expected coordinates of Moon with a radius of 1737400 m, found 3396190 m"),
        ({"transform": rasterio.Affine(99.0, 9.0, WEST, 9.0, -99.0, NORTH)}, None, "found a turned image"),
        ({"transform": rasterio.Affine(99.0, 0.0, WEST, 0.0, -150.0, NORTH)}, None, "square pixels"),
        ({"crs": "+proj=longlat +R=1737400 +no_defs"}, None, "expected longitudes and latitudes in degrees"),
        ({"transform": rasterio.Affine(1e5, 0.0, WEST, 0.0, -1e5, NORTH)}, None, "wrong unit"),
        ({"crs": "EPSG:32633"}, "Moon", "found those of the Earth"),
        ({"crs": "EPSG:4326", "transform": rasterio.Affine(0.01, 0, 10, 0, -0.01, 20)}, None, "give --body"),
    ],
    ids=["body", "turned", "pixels", "degrees", "unit", "Earth", "no body"],
)  # fmt: skip
def test_wrong_coordinates_are_one_line(polar, tmp_path, options, body, message):
    path = polar.write(tmp_path / "map.tif", **options)
    with pytest.raises(InputError, match=message) as caught:
        detect_mosaic(path, tmp_path / "out", SETTINGS, HERE, body=None if body is None else named_body(body))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_damaged_header_is_one_line(polar, tmp_path):
    path = polar.write(tmp_path / "map.tif", polar.image[:64, :64])
    whole = path.read_bytes()
    assert b"Datum = unknown" in whole
    path.write_bytes(whole.replace(b"Datum = unknown", b"Datum = \x82nknown"))
    with pytest.raises(InputError, match="cannot be read as an image"):
        detect_mosaic(path, tmp_path / "out", SETTINGS, HERE)
    blocks = {"blockxsize": 32_768, "blockysize": 32_768, "sparse_ok": True, "bigtiff": "YES"}
    with rasterio.open(
        path, "w", driver="GTiff", height=2_000_000, width=2_000_000, count=1, dtype="uint8", crs=POLAR,
        transform=rasterio.Affine(1.0, 0.0, WEST, 0.0, -1.0, NORTH), tiled=True, **blocks,
    ):  # fmt: skip
        pass
    with pytest.raises(InputError, match=r"expected at most 1e\+12 pixels, found 2000000 x 2000000"):
        detect_mosaic(path, tmp_path / "out", SETTINGS, HERE)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_mosaic(tmp_path):
    """A hundred megapixels of one map again and again, by the command with one process."""
    made = shaded_map(POLAR, 1000, 1000, np.linspace(11.0, 60.0, 40))
    west, north = CORNERS[POLAR]
    path = tmp_path / "large.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=10_000, width=10_000, count=1, dtype="uint8", crs=POLAR, tiled=True,
        transform=rasterio.Affine(10.0, 0.0, west, 0.0, -10.0, north),
    ) as raster:  # fmt: skip
        for row in range(10):
            for column in range(10):
                window = rasterio.windows.Window(1000 * column, 1000 * row, 1000, 1000)
                raster.write(made.image, 1, window=window)
    done, peak_mb = run_measured("-m", "craternav_fg", "detect", path, "-o", tmp_path / "out", "--workers", 1)
    assert done.returncode == 0, done.stderr
    assert peak_mb < 1200.0
    catalog = read_parquet(tmp_path / "out" / "catalog.parquet", None)
    assert 0.97 * 4000 < len(catalog) < 1.05 * 4000
