"""Elevation models: rasters of heights, read from GeoTIFF, as smooth functions of the place on the body."""

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import spline_filter1d

from craternav_fg.catalogs.bodies import SAME_BODY
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, check_input
from craternav_fg.frames import latitude_longitude
from factors.kernels.compiled import njit

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Float32Array = npt.NDArray[np.float32]

# Larger rasters take more than a gigabyte while they are read: crop them.
MAX_POINTS = 100_000_000
# Equatorial radius of WGS 84, which stands on many rasters of other bodies.
_EARTH_M = 6378137.0


@dataclass(frozen=True)
class Dem:
    """Heights above the sphere on a raster of latitude and longitude, interpolated by cubic B-splines.

    Attributes
    ----------
    coefficients : ndarray of float32, shape (rows, columns)
        Of the B-splines, m.
    frame : ndarray, shape (5,)
        Longitude and latitude of the first point, steps of the columns and of the rows, rad; 1 when the
        columns go round the body, else 0.
    """

    coefficients: Float32Array
    frame: FloatArray

    @property
    def step_rad(self) -> float:
        """Distance of neighbouring rows, as an angle."""
        return abs(float(self.frame[3]))

    def heights_m(self, directions: FloatArray) -> FloatArray:
        """Interpolate heights.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors from the body's centre, in g.

        Returns
        -------
        ndarray, shape (n,)
            Heights above the sphere, m; beyond the raster those of its border, mirrored.
        """
        out = np.empty(len(directions))
        _sample(np.ascontiguousarray(directions), self.coefficients, self.frame, out)
        return out

    def covers(self, directions: FloatArray) -> BoolArray:
        """Tell which places the raster covers.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors from the body's centre, in g.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        lon0, lat0, dlon, dlat, around = self.frame
        rows, columns = self.coefficients.shape
        latitude, longitude = latitude_longitude(directions)
        row = (latitude - lat0) / dlat
        middle = lon0 + 0.5 * (columns - 1) * dlon
        off = np.remainder(longitude - middle + np.pi, 2.0 * np.pi) - np.pi
        inside = (row >= 0.0) & (row <= rows - 1)
        if around:
            return np.asarray(inside)
        return np.asarray(inside & (np.abs(off) <= 0.5 * (columns - 1) * abs(dlon)))


def read_dem(path: Path, unit_m: float = 1.0, radius_m: float | None = None) -> Dem:
    """Read an elevation model.

    Parameters
    ----------
    path : Path
        GeoTIFF with one band, in geographic coordinates: longitude and latitude in degrees.
    unit_m : float
        Unit of its values, m.
    radius_m : float, optional
        Radius of the body it must be of, as far as its coordinates state one.

    Returns
    -------
    Dem

    Raises
    ------
    CraternavError
        When rasterio is not installed.
    InputError
        When the file is missing or not such a raster, is of another body, too large, or has points without
        heights.
    """
    try:
        import rasterio
    except ImportError:
        raise CraternavError("elevation models need rasterio: pip install 'craternav_fg[geo]'") from None
    check_input(path, SizeLimit.RASTER)
    try:
        with warnings.catch_warnings():
            # A raster without coordinates is refused below.
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            opened = rasterio.open(path)
        with opened as raster:
            _check(path, raster)
            _check_body(path, raster.crs.to_wkt(), radius_m)
            transform = raster.transform
            values = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
            heights = values * raster.scales[0] + raster.offsets[0]
    except rasterio.errors.RasterioError as error:
        raise InputError(path, f"expected a GeoTIFF: {' '.join(str(error).split())}") from None
    holes = int(np.count_nonzero(~np.isfinite(heights)))
    if holes:
        raise InputError(path, f"expected heights everywhere, {holes} points have none")
    # Centre of the first point.
    longitude, latitude = transform.c + 0.5 * transform.a, transform.f + 0.5 * transform.e
    frame = np.radians([longitude, latitude, transform.a, transform.e])
    around = abs(abs(transform.a) * heights.shape[1] - 360.0) < 0.5 * abs(transform.a)
    rows = spline_filter1d(unit_m * heights, 3, axis=0, mode="mirror")
    coefficients = spline_filter1d(rows, 3, axis=1, mode="grid-wrap" if around else "mirror")
    return Dem(np.ascontiguousarray(coefficients, dtype=np.float32), np.append(frame, float(around)))


def _check(path: Path, raster: object) -> None:
    count, crs, transform, shape = (getattr(raster, name) for name in ("count", "crs", "transform", "shape"))
    if count != 1:
        raise InputError(path, f"expected one band, found {count}")
    if crs is None or not crs.is_geographic:
        found = "none" if crs is None else "projected ones"
        raise InputError(path, f"expected geographic coordinates (longitude and latitude), found {found}")
    if transform.b != 0.0 or transform.d != 0.0:
        raise InputError(path, "expected rows along parallels, found a turned raster")
    if min(shape) < 4 or shape[0] * shape[1] > MAX_POINTS:
        problem = f"expected 4 x 4 to {MAX_POINTS} points, found {shape[0]} x {shape[1]}: crop it to the site"
        raise InputError(path, problem)


def _check_body(path: Path, wkt: str, radius_m: float | None) -> None:
    """Refuse coordinates of another body; those of the Earth are ignored, see `_EARTH_M`."""
    found = re.search(r'(?:SPHEROID|ELLIPSOID)\["([^"]*)",\s*([\d.]+)', wkt)
    if found is None or radius_m is None:
        return
    sphere_m = float(found[2])
    earth = abs(sphere_m - _EARTH_M) < SAME_BODY * _EARTH_M
    if not earth and abs(sphere_m - radius_m) > SAME_BODY * radius_m:
        problem = f"expected an elevation model of a body of {radius_m:.9g} m, found one of {sphere_m:.9g} m"
        raise InputError(path, f"{problem} ({found[1]})")


@njit(cache=True, nogil=True, error_model="numpy")
def _within(i: int, n: int, around: bool) -> int:
    """Index of a point that may be beyond the raster: wrapped around, or mirrored at the border."""
    if around:
        return i % n
    i = abs(i)
    return i if i < n else max(2 * n - 2 - i, 0)


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(directions: FloatArray, coefficients: Float32Array, frame: FloatArray, out: FloatArray) -> None:
    rows, columns = coefficients.shape
    around = frame[4] > 0.0
    w = np.empty(4)
    for k in range(directions.shape[0]):
        x, y, z = directions[k]
        v = (np.arctan2(z, np.sqrt(x * x + y * y)) - frame[1]) / frame[3]
        # Within half a turn of the raster's middle, whether its longitudes begin at 0 or at -180 deg.
        middle = frame[0] + 0.5 * (columns - 1) * frame[2]
        off = np.arctan2(y, x) - middle
        off -= 2.0 * np.pi * np.rint(off / (2.0 * np.pi))
        u = (middle + off - frame[0]) / frame[2]
        u = min(max(u, -1.0), float(columns)) if not around else u
        v = min(max(v, -1.0), float(rows))
        i, j = int(np.floor(u)), int(np.floor(v))
        f, g = u - i, v - j
        w[0] = (1.0 - f) ** 3 / 6.0
        w[1] = (3.0 * f**3 - 6.0 * f * f + 4.0) / 6.0
        w[3] = f**3 / 6.0
        w[2] = 1.0 - w[0] - w[1] - w[3]
        total = 0.0
        for b in range(4):
            if b == 0:
                weight = (1.0 - g) ** 3 / 6.0
            elif b == 1:
                weight = (3.0 * g**3 - 6.0 * g * g + 4.0) / 6.0
            elif b == 2:
                weight = (3.0 * (1.0 - g) ** 3 - 6.0 * (1.0 - g) ** 2 + 4.0) / 6.0
            else:
                weight = g**3 / 6.0
            row = _within(j - 1 + b, rows, False)
            for a in range(4):
                total += weight * w[a] * coefficients[row, _within(i - 1 + a, columns, around)]
        out[k] = total
