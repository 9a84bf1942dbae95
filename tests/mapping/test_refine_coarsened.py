"""Rims of real ground, refined on a model of half the resolution, are those of the whole model."""

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.ndimage import gaussian_filter

from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.model import Catalog
from craternav_fg.frames import up
from craternav_fg.mapping.refine import RefineOptions, refine_on_dem
from tests.shared_data import shared

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.slow
MOON = named_body("Moon", None)
TIMES = 2


def coarsened(path, fine):
    """Write a model whose step and blur are twice those of another."""
    with rasterio.open(fine) as source:
        heights, place, crs = source.read(1).astype(float), source.transform, source.crs
    blur_steps = RefineOptions().resolution_steps * np.sqrt(TIMES**2 - 1.0)
    rows, columns = (TIMES * (n // TIMES) for n in heights.shape)
    blurred = gaussian_filter(heights, blur_steps)[:rows, :columns]
    mean = blurred.reshape(rows // TIMES, TIMES, columns // TIMES, TIMES).mean(axis=(1, 3))
    with rasterio.open(
        path, "w", driver="GTiff", height=len(mean), width=mean.shape[1], count=1, dtype="float32", crs=crs,
        transform=place @ rasterio.Affine.scale(TIMES),
    ) as raster:  # fmt: skip
        raster.write(mean.astype(np.float32), 1)
    return read_dem(path)


@pytest.mark.parametrize("place", ["southern_highlands", "imbrium_copernicus"])
def test_a_model_of_half_the_resolution_shows_the_same_rims(tmp_path, place):
    file = shared(f"gld100/gld100_256ppd_{place}.tif")
    fine, coarse = read_dem(file), coarsened(tmp_path / "coarse.tif", file)
    table = pq.read_table(shared("lu1319381.parquet"))
    latitude, longitude = (np.radians(table[name].to_numpy()) for name in ("LAT_DEG", "LON_E_DEG"))
    radius = 500.0 * table["DIAMETER_KM"].to_numpy()
    rows = np.flatnonzero(fine.covers(up(latitude, longitude)) & (radius > 1180.0) & (radius < 3000.0))
    names, zero = tuple(str(k) for k in rows), np.zeros(len(rows))
    circles = Catalog(
        names, latitude[rows], longitude[rows], radius[rows], radius[rows], zero, zero, MOON
    )  # fmt: skip
    whole = refine_on_dem(circles, fine)
    # Circles that err as much, relative to the model, as those of the catalogue.
    again = whole.catalog.take(np.flatnonzero(whole.refined))
    size = np.sqrt(again.semi_major_m * again.semi_minor_m)
    rng = np.random.default_rng(4)
    off = TIMES * 127.0 / MOON.radius_m * rng.standard_normal((2, len(size)))
    drawn = size * np.exp(0.1 * rng.standard_normal(len(size)))
    start = replace(
        again, latitude_rad=again.latitude_rad + off[0], angle_rad=np.zeros(len(size)),
        longitude_rad=again.longitude_rad + off[1] / np.cos(again.latitude_rad),
        semi_major_m=drawn, semi_minor_m=drawn,
    )  # fmt: skip
    found = refine_on_dem(start, coarse)
    kept = found.refined
    assert kept.sum() > 150
    ratio = np.log(np.sqrt(found.catalog.semi_major_m * found.catalog.semi_minor_m) / size)[kept]
    assert abs(np.median(ratio)) < 0.03, np.median(ratio)
    north = found.catalog.latitude_rad - again.latitude_rad
    east = (found.catalog.longitude_rad - again.longitude_rad) * np.cos(again.latitude_rad)
    off_m = MOON.radius_m * np.hypot(east, north)[kept]
    assert np.median(off_m) < 0.55 * np.median(MOON.radius_m * np.hypot(*off)[kept]), np.median(off_m)
