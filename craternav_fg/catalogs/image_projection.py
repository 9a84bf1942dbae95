"""Georeferenced images in any map projection: rims in pixels as rims on the ground.

The outline of a rim is followed point by point from the image through the projection onto the body, and there
onto the tangent plane at its centre: the distortion of the projection is accounted for along the whole rim.
"""

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.bodies import SAME_BODY, SPHERES_M, named_body
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, chart_of_outline, mean_radius, points_on
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, check_input
from factors.arrays import BoolArray, FloatArray

# Equatorial radius of WGS 84, which stands on many geographic rasters of other bodies.
_EARTH_M = 6378137.0
# Relative difference of the sides of a pixel up to which it is a square, and of its turn.
_SQUARE = 0.01
# Points that follow a rim, and steps of its derivatives: in radii, and in the logarithms of its axes.
_RIM_POINTS, _STEP = 32, 1e-3
# Rims that are projected at a time.
_CHUNK = 2000
# Relative difference of radii by which a body is known without a name.
_KNOWN_RADIUS = 2e-4


@dataclass(frozen=True)
class ImageProjection:
    """Where the pixels of a georeferenced image lie on the body.

    Attributes
    ----------
    wkt : str
        Coordinates of the map as WKT.
    longitude_latitude : bool
        Whether they are longitude and latitude, deg.
    affine : tuple of float
        Map coordinates of a pixel's corner: x = c + a column, y = f + e row; these are a, c, e, f.
    semi_axes_m : tuple of float
        Equatorial and polar semi-axis of the body in the map.
    body : Body
        Body of the catalogue, a sphere.
    """

    wkt: str
    longitude_latitude: bool
    affine: tuple[float, float, float, float]
    semi_axes_m: tuple[float, float]
    body: Body

    def ground(self, xy_px: FloatArray) -> FloatArray:
        """Compute the points of the body that pixels show.

        Parameters
        ----------
        xy_px : ndarray, shape (..., 2)
            (0, 0) is the middle of the first pixel.

        Returns
        -------
        ndarray, shape (..., 3)
            Points on the ellipsoid of the map in g, m; not finite beyond the projection.
        """
        a, c, e, f = self.affine
        x, y = c + a * (xy_px[..., 0] + 0.5), f + e * (xy_px[..., 1] + 0.5)
        if not self.longitude_latitude:
            x, y = self._longitude_latitude(x, y)
        longitude, latitude = np.radians(x), np.radians(y)
        equator, pole = self.semi_axes_m
        cos, sin = np.cos(latitude), np.sin(latitude)
        normal = equator**2 / np.sqrt((equator * cos) ** 2 + (pole * sin) ** 2)
        across = normal * cos
        height = normal * (pole / equator) ** 2 * sin
        return np.stack([across * np.cos(longitude), across * np.sin(longitude), height], axis=-1)

    def _longitude_latitude(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        from rasterio.crs import CRS

        equator, pole = self.semi_axes_m
        geographic = CRS.from_proj4(f"+proj=longlat +a={equator!r} +b={pole!r} +no_defs")
        found = _transformed(CRS.from_wkt(self.wkt), geographic, np.stack([x.ravel(), y.ravel()]))
        return found[0].reshape(x.shape), found[1].reshape(x.shape)


@dataclass(frozen=True)
class GroundRims:
    """Rims on the ground.

    Attributes
    ----------
    catalog : Catalog
        Without heights; with the errors of the rims.
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the rims' charts in the tangent plane, east and north: m, and logarithms.
    rows : ndarray of bool, shape (m,)
        Which of the given rims they are; the others lie beyond the projection.
    """

    catalog: Catalog
    covariance: FloatArray
    rows: BoolArray


def read_projection(path: Path, body: Body | None) -> ImageProjection | None:
    """Read where the pixels of an image lie.

    Parameters
    ----------
    path : Path
        An image that rasterio reads.
    body : Body or None
        Body that it must show; None for that of its coordinates.

    Returns
    -------
    ImageProjection or None
        None when the image has no coordinates.

    Raises
    ------
    CraternavError
        When rasterio is not installed.
    InputError
        When the file is no image, its rows do not run along the map, its pixels are no squares, its
        coordinates are of another body, or no coordinates of any place on it.
    """
    crs, affine, shape = _georeference(path)
    if crs is None:
        return None
    if crs.is_geographic == crs.is_projected:
        raise InputError(path, "expected coordinates of a map, or longitude and latitude, found others")
    side = abs(affine.a)
    if max(abs(affine.b), abs(affine.d)) > 1e-9 * side:
        raise InputError(path, "expected rows along the map's x axis, found a turned image: warp it")
    if abs(abs(affine.e) - side) > _SQUARE * side:
        raise InputError(
            path, f"expected square pixels, found {side:g} x {abs(affine.e):g} units of the map: warp it"
        )
    semi_axes, of_body = _body_of(path, crs, body)
    projection = ImageProjection(
        crs.to_wkt(), crs.is_geographic, (affine.a, affine.c, affine.e, affine.f), semi_axes, of_body
    )
    unit_m = 1.0 if crs.is_geographic else crs.linear_units_factor[1]
    _check_places(path, projection, shape, unit_m)
    return projection


def _transformed(source: Any, target: Any, xy: FloatArray) -> FloatArray:
    """Transform coordinates (2, n); not a number where there are none."""
    from rasterio._err import CPLE_BaseError
    from rasterio.warp import transform

    try:
        found = np.array(transform(source, target, *xy.tolist())[:2])
        return np.where(np.isfinite(found).all(axis=0), found, np.nan)
    except CPLE_BaseError:
        # One point beyond the projection fails all.
        half = xy.shape[1] // 2
        if half == 0:
            return np.full(xy.shape, np.nan)
        halves = [_transformed(source, target, part) for part in (xy[:, :half], xy[:, half:])]
        return np.concatenate(halves, axis=1)


def has_coordinates(path: Path) -> bool:
    """Return whether an image is georeferenced.

    Parameters
    ----------
    path : Path
        An image that rasterio reads.

    Returns
    -------
    bool
    """
    return _georeference(path)[0] is not None


def _georeference(path: Path) -> tuple[Any, Any, tuple[int, int]]:
    """Coordinate system, affine transform and shape of an image."""
    try:
        import rasterio
    except ImportError:
        raise CraternavError("mosaics need rasterio: pip install 'craternav_fg[geo]'") from None
    check_input(path, SizeLimit.BAG)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            opened = rasterio.open(path)
        with opened as raster:
            return raster.crs, raster.transform, raster.shape
    except (rasterio.errors.RasterioError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read as an image: {' '.join(str(error).split())}") from None


def _body_of(path: Path, crs: Any, body: Body | None) -> tuple[tuple[float, float], Body]:
    """Semi-axes of the body of the coordinates, and the body of the catalogue."""
    found = re.search(r'(?:SPHEROID|ELLIPSOID)\["([^"]*)",\s*([\d.eE+-]+),\s*([\d.eE+-]+)', crs.to_wkt())
    if found is None:
        raise InputError(path, "expected coordinates with an ellipsoid, found none")
    name, equator, flattening = found[1], float(found[2]), float(found[3])
    pole = equator * (1.0 - 1.0 / flattening) if flattening else equator
    if abs(equator - _EARTH_M) < SAME_BODY * _EARTH_M and (body is None or body.name != "Earth"):
        if crs.is_geographic and body is not None:
            # Longitude and latitude hold on any sphere.
            return (body.radius_m, body.radius_m), body
        problem = "expected coordinates of a planetary body, found those of the Earth"
        raise InputError(path, problem + (": give --body" if crs.is_geographic else ""))
    if body is None:
        mean_m = equator if pole == equator else (2.0 * equator + pole) / 3.0
        return (equator, pole), named_body(_name_of(path, name, (mean_m, equator)), mean_m)
    if abs(equator - body.radius_m) > SAME_BODY * body.radius_m:
        raise InputError(
            path,
            f"expected coordinates of {body.name or 'a body'} with a radius of {body.radius_m:.9g} m, found "
            f"{equator:.9g} m ({name})",
        )
    return (equator, pole), body


def _name_of(path: Path, ellipsoid: str, radii_m: tuple[float, float]) -> str:
    """Name of the body of an ellipsoid, by its name or else by its mean or equatorial radius."""
    words = re.split(r"[^a-z]+", ellipsoid.lower())
    for name, known_m in SPHERES_M.items():
        if name.lower() in words and abs(known_m - radii_m[0]) < SAME_BODY * known_m:
            return name
    near = [
        name
        for name, known_m in SPHERES_M.items()
        if any(abs(known_m - radius_m) < _KNOWN_RADIUS * known_m for radius_m in radii_m)
    ]
    if len(near) == 1:
        return near[0]
    raise InputError(path, f"is of a body of {radii_m[0]:.9g} m ({ellipsoid}) that is not known: give --body")


def _check_places(path: Path, projection: ImageProjection, shape: tuple[int, int], unit_m: float) -> None:
    """Refuse coordinates that are of no place on the body: those in a wrong unit."""
    a, c, e, f = projection.affine
    height, width = shape
    x, y = np.array([c, c + a * width]), np.array([f, f + e * height])
    if projection.longitude_latitude:
        if np.abs(x).max() > 720.0 or np.abs(y).max() > 90.0 + abs(e):
            raise InputError(
                path,
                f"expected longitudes and latitudes in degrees, found {x.min():g} to {x.max():g} and "
                f"{y.min():g} to {y.max():g}: wrong unit or coordinates",
            )
        return
    # No map is longer than twice around the body.
    if max(np.ptp(x), np.ptp(y)) * unit_m > 4.0 * np.pi * projection.semi_axes_m[0]:
        found = f"x {x.min():g} to {x.max():g}, y {y.min():g} to {y.max():g}"
        raise InputError(path, f"expected coordinates on the map of the body, found {found}: wrong unit?")


def ground_rims(
    projection: ImageProjection, charts_px: FloatArray, covariance_px: FloatArray, prefix: str
) -> GroundRims:
    """Put rims in pixels on the ground.

    Parameters
    ----------
    projection : ImageProjection
    charts_px : ndarray, shape (n, 5)
        Charts of the rims; (0, 0) is the middle of the image's first pixel.
    covariance_px : ndarray, shape (n, 5, 5)
        Their covariances.
    prefix : str
        Begins their identifiers, which number the given rims from 1 on.

    Returns
    -------
    GroundRims
    """
    chunks = [slice(first, first + _CHUNK) for first in range(0, max(len(charts_px), 1), _CHUNK)]
    parts = [_on_ground(projection, charts_px[chunk], covariance_px[chunk]) for chunk in chunks]
    centres, charts, covariance = (np.concatenate(one) for one in zip(*parts, strict=True))
    rows = np.isfinite(charts).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    centres, charts, covariance = centres[rows], charts[rows], covariance[rows]
    latitude, longitude = frames.latitude_longitude(centres)
    axes = axes_of_chart(charts)
    variances = np.einsum("nii->ni", covariance)
    errors = MapErrors(
        np.sqrt(0.5 * (variances[:, 0] + variances[:, 1])),
        np.sqrt(0.5 * (variances[:, 2] + variances[:, 4])),
        np.zeros(len(charts)),
    )
    numbers = np.flatnonzero(rows) + 1
    catalog = Catalog(
        tuple(f"{prefix}_{number:06d}" for number in numbers.tolist()), latitude, longitude, axes[:, 2],
        axes[:, 3], axes[:, 4], np.zeros(len(charts)), projection.body, errors, has_heights=False,
    )  # fmt: skip
    return GroundRims(catalog, covariance, rows)


def _on_ground(
    projection: ImageProjection, charts_px: FloatArray, covariance_px: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres (n, 3) in g, charts (n, 5) in the tangent plane and their covariances (n, 5, 5) of rims."""
    base = projection.ground(charts_px[:, :2])
    enu = frames.east_north_up(*frames.latitude_longitude(base))
    step = np.full_like(charts_px, _STEP)
    step[:, :2] *= mean_radius(charts_px)[:, None]
    charts = _in_plane(projection, charts_px, base, enu)
    J = np.empty((len(charts), 5, 5))
    for k in range(5):
        off = np.zeros_like(step)
        off[:, k] = step[:, k]
        ahead, behind = (_in_plane(projection, charts_px + s * off, base, enu) for s in (1.0, -1.0))
        J[:, :, k] = (ahead - behind) / (2.0 * step[:, k, None])
    centres = base + np.einsum("nij,nj->ni", enu[:, :, :2], charts[:, :2])
    return centres, charts, J @ covariance_px @ np.swapaxes(J, 1, 2)


def _in_plane(
    projection: ImageProjection, charts_px: FloatArray, base: FloatArray, enu: FloatArray
) -> FloatArray:
    """Charts (n, 5) of rims in the tangent planes at `base`, east and north, m."""
    points = projection.ground(points_on(charts_px, _RIM_POINTS)) - base[:, None]
    return chart_of_outline(np.einsum("nkj,nji->nki", points, enu[:, :, :2]))
