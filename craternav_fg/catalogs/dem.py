"""Elevation models: rasters of heights, read from GeoTIFF, as smooth functions of the place on the body."""

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

# It loads its parts where they are first used: most commands read no elevation model.
import scipy

from craternav_fg.catalogs.bodies import SAME_BODY, SAME_SPHERE
from craternav_fg.catalogs.map_projection import (
    GEOGRAPHIC,
    Plane,
    directions_of,
    frame_of,
    plane_of,
    position,
    positions,
    stretch,
)
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, check_input
from factors.arrays import BoolArray, FloatArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

# Larger rasters take more than a gigabyte while they are read: crop them.
MAX_POINTS = 100_000_000
# Equatorial radius of WGS 84, which stands on many rasters of other bodies.
_EARTH_M = 6378137.0
# Heights next to a gap, up to so many steps from it, are interpolated with points that have none.
_GAP_STEPS = 1.5
# A raster ends at a pole if its outermost points' cells end within this share of a step from it.
_POLE_STEPS = 0.01
# Heights above the sphere beyond this share of its radius are radii, or in another unit.
_MAX_HEIGHT_RADII = 0.4
# Units that rasters state for their heights, m.
_UNITS_M = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometer", "kilometres", "kilometers"), 1000.0),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
# Values that stand for no height, as raster programs write them, and often without saying so.
_VOIDS = (-9999.0, -99999.0, -32768.0, -32767.0, 32767.0)
# Ground is continuous: a void has no other value within this share of it.
_VOID_MARGIN = 0.01


@dataclass(frozen=True)
class Dem:
    """Heights above the sphere on a raster of map coordinates, interpolated by cubic B-splines.

    Attributes
    ----------
    coefficients : ndarray of float32, shape (rows, columns)
        Coefficients of the B-splines, m.
    frame : ndarray, shape (9,)
        How places become positions in the raster, see `map_projection`.
    gap_steps : ndarray of float32, shape (rows, columns), optional
        Distance of each point from the nearest one without a height, in steps; None where all have one.
    """

    coefficients: Float32Array
    frame: FloatArray
    gap_steps: Float32Array | None = None

    @property
    def step_rad(self) -> float:
        """Distance of neighbouring rows in the raster's middle, as an angle."""
        return abs(float(self.frame[3] / stretch(self.middle, self.frame)))

    @property
    def middle(self) -> FloatArray:
        """Unit vector (3,) to the raster's middle, in g."""
        rows, columns = self.coefficients.shape
        return directions_of(self.frame, np.array([0.5 * (columns - 1)]), np.array([0.5 * (rows - 1)]))[0]

    def heights_m(self, directions: FloatArray) -> FloatArray:
        """Interpolate heights.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors from the body's centre, in g.

        Returns
        -------
        ndarray, shape (n,)
            Heights above the sphere, m; beyond the raster those of its border, mirrored; in a gap those of
            its border.
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
        return np.asarray(self.inside_rad(directions) >= 0.0)

    def inside_rad(self, directions: FloatArray) -> FloatArray:
        """Measure how far inside the raster places lie.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors from the body's centre, in g.

        Returns
        -------
        ndarray, shape (n,)
            Distance from the nearest border or gap, rad along rows and columns; negative outside. A border
            at a pole does not count, and where there is none, the distance is infinite.
        """
        directions = np.ascontiguousarray(directions)
        shape = self.coefficients.shape
        near = np.empty(0)
        if self.gap_steps is not None:
            places = np.empty((len(directions), 2))
            positions(directions, self.frame, shape[1], places)
            near = scipy.ndimage.map_coordinates(self.gap_steps, places.T[::-1], order=1, mode="nearest")
        inside = np.empty(len(directions))
        _inside(directions, shape, self.frame, self._rows_end(), near - _GAP_STEPS, inside)
        return inside

    def _rows_end(self) -> tuple[bool, bool]:
        """Whether there is ground beyond the first row and beyond the last: there is none beyond a pole."""
        if self.frame[5] != 0.0:
            return True, True
        first, step = self.frame[1], self.frame[3]
        edges = np.abs([first - 0.5 * step, first + (len(self.coefficients) - 0.5) * step])
        ends = edges < 0.5 * np.pi - _POLE_STEPS * abs(step)
        return bool(ends[0]), bool(ends[1])

    def gaps(self) -> FloatArray:
        """Return the places that have no height.

        Returns
        -------
        ndarray, shape (n, 3)
            Unit vectors in g.
        """
        if self.gap_steps is None:
            return np.empty((0, 3))
        rows, columns = np.nonzero(self.gap_steps == 0.0)
        return directions_of(self.frame, columns.astype(np.float64), rows.astype(np.float64))


def read_dem(path: Path, unit_m: float = 1.0, radius_m: float | None = None, *, gaps: bool = False) -> Dem:
    """Read an elevation model.

    Parameters
    ----------
    path : Path
        GeoTIFF with one band, in longitude and latitude, equirectangular or polar stereographic coordinates
        of a sphere.
    unit_m : float
        Unit of its values, m.
    radius_m : float, optional
        Radius of the body it must be of, as far as its coordinates state one.
    gaps : bool
        Whether points may have no height.

    Returns
    -------
    Dem

    Raises
    ------
    CraternavError
        When rasterio is not installed.
    InputError
        When the file is missing or not such a raster, is of another body, too large, or has points without
        heights; when its heights are in another unit than it states, or not above the sphere.
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
            _check_unit(path, raster.units[0], raster.scales[0], unit_m)
            plane = _plane(path, raster.crs, radius_m)
            transform = raster.transform
            values = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
            _check_voids(path, values)
            heights = unit_m * (values * raster.scales[0] + raster.offsets[0])
    except rasterio.errors.RasterioError as error:
        raise InputError(path, f"expected a GeoTIFF: {' '.join(str(error).split())}") from None
    known = np.isfinite(heights)
    _check_heights(path, heights, known, radius_m, gaps=gaps)
    # Centre of the first point.
    first = (transform.c + 0.5 * transform.a, transform.f + 0.5 * transform.e)
    frame = frame_of(plane, first, (transform.a, transform.e), heights.shape[1])
    gap_steps = None
    if not known.all():
        gap_steps = scipy.ndimage.distance_transform_edt(known).astype(np.float32)
        nearest = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        heights = heights[tuple(nearest)]
    rows = scipy.ndimage.spline_filter1d(heights, 3, axis=0, mode="mirror")
    coefficients = scipy.ndimage.spline_filter1d(
        rows, 3, axis=1, mode="grid-wrap" if frame[4] > 0.0 else "mirror"
    )
    return Dem(np.ascontiguousarray(coefficients, dtype=np.float32), frame, gap_steps)


def _check(path: Path, raster: Any) -> None:
    if raster.count != 1:
        raise InputError(path, f"expected one band, found {raster.count}")
    if raster.crs is None or not (raster.crs.is_geographic or raster.crs.is_projected):
        raise InputError(path, "expected coordinates (a CRS), found none")
    if raster.transform.b != 0.0 or raster.transform.d != 0.0:
        raise InputError(path, "expected rows along the first axis of the map, found a turned raster")
    kind = np.dtype(raster.dtypes[0])
    plain = raster.scales[0] == 1.0 and raster.offsets[0] == 0.0
    if kind.kind == "c" or (kind.itemsize == 1 and plain):
        image = "" if kind.kind == "c" else ", as of an image"
        raise InputError(path, f"expected heights, found {kind} numbers{image}")
    shape = raster.shape
    if min(shape) < 4 or shape[0] * shape[1] > MAX_POINTS:
        problem = f"expected 4 x 4 to {MAX_POINTS} points, found {shape[0]} x {shape[1]}: crop it to the site"
        raise InputError(path, problem)


def _check_unit(path: Path, stated: str | None, scale: float, unit_m: float) -> None:
    """Refuse a unit that is not the one that the raster states, or that its scale already contains."""
    if scale != 1.0 and scale == unit_m:
        problem = f"states a scale of {scale:g}, which is applied"
        raise InputError(path, f"{problem}: --dem-unit-m {unit_m:g} would apply it again")
    known_m = _UNITS_M.get((stated or "").strip().lower())
    if known_m is not None and known_m != unit_m:
        problem = f"states heights in {stated}, expected a unit of {unit_m:g} m (--dem-unit-m)"
        raise InputError(path, problem)


def _check_voids(path: Path, values: FloatArray) -> None:
    """Refuse values that stand for no height although the raster does not say so."""
    for void in _VOIDS:
        count = int(np.count_nonzero(values == void))
        if count and count == np.count_nonzero(np.abs(values - void) < _VOID_MARGIN * abs(void)):
            problem = f"expected heights, {count} points are {void:g} and none near"
            remedy = f"gaps that it does not state (gdal_edit.py -a_nodata {void:g})"
            raise InputError(path, f"{problem}: {remedy}")


def _check_heights(
    path: Path, heights: FloatArray, known: BoolArray, radius_m: float | None, *, gaps: bool
) -> None:
    """Refuse gaps where there may be none, and radii or wrong units in place of heights."""
    holes = int(np.count_nonzero(~known))
    if holes and not (gaps and known.any()):
        raise InputError(path, f"expected heights everywhere, {holes} points have none")
    if radius_m is None:
        return
    low, high = float(heights[known].min()), float(heights[known].max())
    if max(-low, high) > _MAX_HEIGHT_RADII * radius_m:
        found = f"found {low:.9g} to {high:.9g} m: radii, or a wrong unit (--dem-unit-m)"
        raise InputError(path, f"expected heights above a sphere of {radius_m:.9g} m, {found}")


def _plane(path: Path, crs: Any, radius_m: float | None) -> Plane:
    """Interpret the raster's coordinates, and refuse those of another body."""
    found = re.search(r'(?:SPHEROID|ELLIPSOID)\["([^"]*)",\s*([\d.]+),\s*([\d.]+)', crs.to_wkt())
    sphere_m = 0.0 if found is None else float(found[2])
    # WGS 84 stands on many rasters of other bodies: its longitude and latitude are taken for the body's.
    earth = crs.is_geographic and _is_earth(sphere_m) and not (radius_m and _is_earth(radius_m))
    if found and radius_m is not None and not earth and abs(sphere_m - radius_m) > SAME_BODY * radius_m:
        problem = f"expected an elevation model of a body of {radius_m:.9g} m, found one of {sphere_m:.9g} m"
        raise InputError(path, f"{problem} ({found[1]})")
    if earth:
        return GEOGRAPHIC
    projection = crs.to_dict()
    plane = GEOGRAPHIC if crs.is_geographic else None
    if crs.is_projected and sphere_m > 0.0:
        plane = plane_of(projection, sphere_m, crs.linear_units_factor[1])
    expected = "longitude and latitude, or equirectangular or polar stereographic coordinates, of a sphere"
    if plane is None:
        raise InputError(path, f"expected {expected}, found projection '{projection.get('proj', 'unknown')}'")
    if found is not None and float(found[3]) != 0.0:
        ellipsoid = f"an ellipsoid ({found[1]}, 1/f = {float(found[3]):g})"
        raise InputError(path, f"expected {expected}, found {ellipsoid}")
    if found and radius_m is not None and abs(sphere_m - radius_m) > SAME_SPHERE * radius_m:
        problem = f"expected heights above a sphere of {radius_m:.9g} m, found coordinates of one of"
        remedy = f"give the catalogue that sphere (catalog import --body-radius-m {sphere_m:.9g})"
        raise InputError(path, f"{problem} {sphere_m:.9g} m: {remedy}")
    return plane


def _is_earth(radius_m: float) -> bool:
    return abs(radius_m - _EARTH_M) < SAME_BODY * _EARTH_M


@njit(cache=True, nogil=True, error_model="numpy")
def _within(i: int, n: int, around: bool) -> int:
    """Index of a point that may be beyond the raster: wrapped around, or mirrored at the border."""
    if around:
        return i % n
    i = abs(i)
    return i if i < n else max(2 * n - 2 - i, 0)


@njit(cache=True, nogil=True, error_model="numpy")
def _inside(
    directions: FloatArray,
    shape: tuple[int, int],
    frame: FloatArray,
    ends: tuple[bool, bool],
    near: FloatArray,
    out: FloatArray,
) -> None:
    """Write `Dem.inside_rad`: `ends` as `_rows_end`, distances of gaps in steps if there are any."""
    rows, columns = shape
    for k in range(directions.shape[0]):
        column, row = position(directions[k], frame, columns)
        scale = 1.0 / stretch(directions[k], frame)
        step = abs(frame[3]) * scale
        inside = np.inf
        if ends[0]:
            inside = min(inside, row * step)
        if ends[1]:
            inside = min(inside, (rows - 1 - row) * step)
        # Beyond the raster, the border decides.
        if len(near):
            inside = min(inside, near[k] * step)
        if not frame[4] > 0.0:
            if frame[5] == 0.0:
                # Meridians converge on a map of longitude and latitude.
                scale = np.hypot(directions[k, 0], directions[k, 1])
            inside = min(inside, min(column, columns - 1 - column) * abs(frame[2]) * scale)
        out[k] = inside


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(directions: FloatArray, coefficients: Float32Array, frame: FloatArray, out: FloatArray) -> None:
    rows, columns = coefficients.shape
    around = frame[4] > 0.0
    w, weight = np.empty(4), np.empty(4)
    for k in range(directions.shape[0]):
        u, v = position(directions[k], frame, columns)
        u = min(max(u, -1.0), float(columns)) if not around else u
        v = min(max(v, -1.0), float(rows))
        i, j = int(np.floor(u)), int(np.floor(v))
        f, g = u - i, v - j
        w[0] = (1.0 - f) ** 3 / 6.0
        w[1] = (3.0 * f**3 - 6.0 * f * f + 4.0) / 6.0
        w[3] = f**3 / 6.0
        w[2] = 1.0 - w[0] - w[1] - w[3]
        weight[0] = (1.0 - g) ** 3 / 6.0
        weight[1] = (3.0 * g**3 - 6.0 * g * g + 4.0) / 6.0
        weight[3] = g**3 / 6.0
        weight[2] = 1.0 - weight[0] - weight[1] - weight[3]
        border = i < 1 or j < 1 or i > columns - 3 or j > rows - 3
        total = 0.0
        for b in range(4):
            row = _within(j - 1 + b, rows, False) if border else j - 1 + b
            for a in range(4):
                column = _within(i - 1 + a, columns, around) if border else i - 1 + a
                total += weight[b] * w[a] * coefficients[row, column]
        out[k] = total
