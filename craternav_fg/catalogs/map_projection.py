"""Map projections of elevation models: geographic, equirectangular, and polar stereographic on a sphere.

A raster's frame is an array (9,): plane coordinates of the first point, along the columns and the rows; steps
of columns and rows; 1 where the columns go round the body, else 0; the pole's sign, 0 for geographic
coordinates; cosine and sine of the stereographic longitude of origin; twice its scale at the pole. Plane
coordinates are longitude and latitude, rad, or stereographic ones over the sphere's radius. Equirectangular
coordinates are geographic ones in other units.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Closest approach of 1 + sin(latitude) to 0 at the pole opposite to a stereographic projection's.
_OPPOSITE = 1e-6
# Offsets of projections' origins that count as none, m and deg.
_NONE = 1e-6


class Plane(NamedTuple):
    """How the coordinates of a raster become those of its frame."""

    offset: tuple[float, float]
    """Frame's coordinates where the raster's are 0."""
    unit: tuple[float, float]
    """Frame's coordinates over the raster's, along x and y."""
    pole: float
    """1 and -1 for stereographic maps of the north and of the south, 0 for the others."""
    origin_rad: float
    """Longitude of origin of a stereographic map."""
    scale: float
    """Scale of a stereographic map at the pole."""


GEOGRAPHIC = Plane((0.0, 0.0), (math.radians(1.0), math.radians(1.0)), 0.0, 0.0, 1.0)


def plane_of(projection: dict[str, Any], radius_m: float, unit_m: float) -> Plane | None:
    """Interpret a map projection.

    Parameters
    ----------
    projection : dict
        PROJ's parameters.
    radius_m : float
        Radius of its sphere.
    unit_m : float
        Unit of the raster's coordinates, m.

    Returns
    -------
    Plane or None
        None for a projection that is not supported.
    """
    kind = projection.get("proj")
    latitude, longitude, true = (float(projection.get(name, 0.0)) for name in ("lat_0", "lon_0", "lat_ts"))
    x, y = (float(projection.get(name, 0.0)) for name in ("x_0", "y_0"))
    share = unit_m / radius_m
    if kind == "eqc":
        along = radius_m * math.cos(math.radians(true))
        offset = (math.radians(longitude) - x / along, math.radians(latitude) - y / radius_m)
        return Plane(offset, (unit_m / along, share), 0.0, 0.0, 1.0)
    if kind == "stere" and abs(abs(latitude) - 90.0) < _NONE:
        scale = float(projection.get("k", projection.get("k_0", 1.0)))
        if "lat_ts" in projection:
            scale = 0.5 * (1.0 + abs(math.sin(math.radians(true))))
        offset = (-x / radius_m, -y / radius_m)
        return Plane(offset, (share, share), math.copysign(1.0, latitude), math.radians(longitude), scale)
    return None


def frame_of(
    plane: Plane, first: tuple[float, float], steps: tuple[float, float], columns: int
) -> FloatArray:
    """Compute the frame of a raster.

    Parameters
    ----------
    plane : Plane
    first : tuple of float
        Raster coordinates of the first point.
    steps : tuple of float
        Steps of columns and rows in these.
    columns : int
        Number of columns.

    Returns
    -------
    ndarray, shape (9,)
    """
    places = (zero + unit * value for zero, unit, value in zip(plane.offset, plane.unit, first, strict=True))
    dx, dy = (unit * step for unit, step in zip(plane.unit, steps, strict=True))
    around = plane.pole == 0.0 and abs(abs(dx) * columns - 2.0 * math.pi) < 0.5 * abs(dx)
    origin = (math.cos(plane.origin_rad), math.sin(plane.origin_rad))
    return np.array([*places, dx, dy, float(around), plane.pole, *origin, 2.0 * plane.scale])


@njit(cache=True, nogil=True, error_model="numpy")
def stretch(direction: FloatArray, frame: FloatArray) -> float:
    """Compute lengths in the plane over those on the body, across the rows.

    Parameters
    ----------
    direction : ndarray, shape (3,)
        Unit vector in g.
    frame : ndarray, shape (9,)
        Angles in rad.

    Returns
    -------
    float
    """
    if frame[5] == 0.0:
        return 1.0
    return frame[8] / max(1.0 + frame[5] * direction[2], _OPPOSITE)


def directions_of(frame: FloatArray, columns: FloatArray, rows: FloatArray) -> FloatArray:
    """Compute where points of a raster lie on the body.

    Parameters
    ----------
    frame : ndarray, shape (9,)
        Angles in rad.
    columns, rows : ndarray, shape (n,)
        Positions in the raster.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors in g.
    """
    u, v = frame[0] + frame[2] * columns, frame[1] + frame[3] * rows
    if frame[5] == 0.0:
        level = np.cos(v)
        return np.stack([level * np.cos(u), level * np.sin(u), np.sin(v)], axis=-1)
    # Distance from the pole over 2 k: tangent of half the colatitude.
    pole, cos, sin, scale = frame[5:]
    east, toward = u / scale, -pole * v / scale
    square = east**2 + toward**2
    level, up = 2.0 / (1.0 + square), (1.0 - square) / (1.0 + square)
    x, y = level * (toward * cos - east * sin), level * (toward * sin + east * cos)
    return np.stack([x, y, pole * up], axis=-1)


@njit(cache=True, nogil=True, error_model="numpy")
def position(direction: FloatArray, frame: FloatArray, columns: int) -> tuple[float, float]:
    """Compute the position of a place in a raster.

    Parameters
    ----------
    direction : ndarray, shape (3,)
        Unit vector in g.
    frame : ndarray, shape (9,)
        Angles in rad.
    columns : int
        Number of columns.

    Returns
    -------
    tuple of float
        Column and row.
    """
    x, y, z = direction
    if frame[5] == 0.0:
        v = (np.arctan2(z, np.sqrt(x * x + y * y)) - frame[1]) / frame[3]
        # Within half a turn of the raster's middle, whether its longitudes begin at 0 or at -180 deg.
        middle = frame[0] + 0.5 * (columns - 1) * frame[2]
        off = np.arctan2(y, x) - middle
        off -= 2.0 * np.pi * np.rint(off / (2.0 * np.pi))
        return (middle + off - frame[0]) / frame[2], v
    scale = stretch(direction, frame)
    east, toward = y * frame[6] - x * frame[7], x * frame[6] + y * frame[7]
    return (scale * east - frame[0]) / frame[2], (-frame[5] * scale * toward - frame[1]) / frame[3]


@njit(cache=True, nogil=True, error_model="numpy")
def positions(directions: FloatArray, frame: FloatArray, columns: int, out: FloatArray) -> None:
    """Compute the positions of places in a raster.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors in g.
    frame : ndarray, shape (9,)
        Angles in rad.
    columns : int
        Number of columns.
    out : ndarray, shape (n, 2)
        Written: column and row.
    """
    for k in range(directions.shape[0]):
        out[k, 0], out[k, 1] = position(directions[k], frame, columns)
