"""Shaded maps of the Moon with known craters, in map projections, without the project's renderer."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rasterio
from scipy.ndimage import gaussian_filter

from craternav_fg.catalogs.map_projection import directions_of, frame_of, plane_of

RADIUS_M = 1_737_400.0
POLAR = "+proj=stere +lat_0=-90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"
EQUIRECTANGULAR = "+proj=eqc +lat_ts=0 +lat_0=0 +lon_0=0 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"
STEP_M = 100.0
# Upper left corners, m: at 79 S, and at 30 N, where a degree of longitude is 13 % shorter than on the map.
CORNERS = {POLAR: (200e3, 300e3), EQUIRECTANGULAR: (100e3, 950e3)}


@dataclass(frozen=True)
class Map:
    """A shaded map and its craters.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W)
    crs : str
    directions : ndarray, shape (n, 3)
        Unit vectors to the craters' centres.
    radius_m : ndarray, shape (n,)
        On the ground.
    xy_px : ndarray, shape (n, 2)
        Centres in the image.
    """

    image: npt.NDArray[np.uint8]
    crs: str
    directions: npt.NDArray[np.float64]
    radius_m: npt.NDArray[np.float64]
    xy_px: npt.NDArray[np.float64]

    def write(self, path: Path, image: npt.NDArray[np.generic] | None = None, **more: object) -> Path:
        """Write the map, or another image in its place, as GeoTIFF."""
        west, north = CORNERS[self.crs]
        options = {
            "crs": self.crs,
            "transform": rasterio.Affine(STEP_M, 0.0, west, 0.0, -STEP_M, north),
            **more,
        }
        bands = np.atleast_3d((self.image if image is None else image).T).T
        with rasterio.open(
            path, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2], count=len(bands),
            dtype=bands.dtype, tiled=True, blockxsize=256, blockysize=256, **options,
        ) as raster:  # fmt: skip
            raster.write(bands)
        return path


def shaded_map(crs: str, height: int, width: int, radii_px: npt.NDArray[np.float64], seed: int = 0) -> Map:
    """Shade a map with craters of these radii, px, none over another, lit from the left."""
    rng = np.random.default_rng(seed)
    projection = rasterio.crs.CRS.from_string(crs).to_dict()
    plane = plane_of(projection, RADIUS_M, 1.0)
    assert plane is not None
    west, north = CORNERS[crs]
    frame = frame_of(plane, (west + 0.5 * STEP_M, north - 0.5 * STEP_M), (STEP_M, -STEP_M), width)
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    grid = directions_of(frame, columns.ravel(), rows.ravel()).reshape(height, width, 3)
    places: list[npt.NDArray[np.float64]] = []
    for radius in np.sort(radii_px)[::-1]:
        while True:
            place = np.array([*rng.uniform(1.4 * radius, (width, height) - 1.4 * radius), radius])
            if all(np.hypot(*(place - one)[:2]) > 1.4 * (one[2] + radius) for one in places):
                break
        places.append(place)
    xy, radius_m = np.array(places)[:, :2], STEP_M * np.array(places)[:, 2]
    centres = directions_of(frame, xy[:, 0], xy[:, 1])
    heights = 4.0 * gaussian_filter(rng.normal(size=(height, width)), 3.0)
    for (x, y), r, centre in zip(xy, radius_m, centres, strict=True):
        reach = int(5.0 * r / STEP_M)
        part = (
            slice(max(int(y) - reach, 0), int(y) + reach + 1),
            slice(max(int(x) - reach, 0), int(x) + reach + 1),
        )
        away = RADIUS_M * np.linalg.norm(grid[part] - centre, axis=-1) / r
        crest = 0.06 * r
        bowl = crest + 0.28 * r * (away**2 - 1.0)
        heights[part] += np.where(away < 1.0, bowl, crest * np.maximum(away, 1.0) ** -4.0)
    points = grid * (RADIUS_M + heights)[..., None]
    along_row, along_column = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(along_column, along_row)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    left = -np.gradient(grid, axis=1)
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    elevation = np.deg2rad(35.0)
    light = np.cos(elevation) * left + np.sin(elevation) * grid
    grey = 180.0 * np.clip(np.sum(normal * light, axis=-1), 0.0, None) + rng.normal(0.0, 1.0, heights.shape)
    return Map(np.clip(grey, 0.0, 255.0).astype(np.uint8), crs, centres, radius_m, xy)
