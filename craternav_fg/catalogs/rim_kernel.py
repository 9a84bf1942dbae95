"""Compiled geometry of rims: centres, semi-axes and normals in g, and their images in a camera.

Apart from `model`, which other kernels' modules import: they would be compiled again with every change of it.
"""

import numpy as np

from craternav_fg.ellipse import moments_kernel, semi_axes_kernel
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels import conic
from factors.kernels.compiled import njit


@njit(cache=True, nogil=True, error_model="numpy")
def rim_geometry(
    latitude: FloatArray, longitude: FloatArray, semi_major: FloatArray, semi_minor: FloatArray,
    angle: FloatArray, tilt: FloatArray, height: FloatArray, radius_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Compute rims in g.

    Parameters
    ----------
    latitude, longitude : ndarray, shape (n,)
        Of the centres, rad; longitude to the east.
    semi_major, semi_minor : ndarray, shape (n,)
        Semi-axes, m.
    angle : ndarray, shape (n,)
        Direction of the major axis, from local east towards north, rad.
    tilt : ndarray, shape (n, 2) or (0, 2)
        Slopes of the rims' planes towards east and north, rad; without rows all are level.
    height : ndarray, shape (n,)
        Height above the sphere, m.
    radius_m : float
        Radius of the sphere.

    Returns
    -------
    centres : ndarray, shape (n, 3)
        In g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes in g, m.
    normals : ndarray, shape (n, 3)
        Outward unit normals of the rims' planes in g.
    """
    n = latitude.shape[0]
    centres, axes, normals = np.empty((n, 3)), np.empty((n, 2, 3)), np.empty((n, 3))
    tilted = tilt.shape[0] > 0
    for i in range(n):
        _place(latitude[i], longitude[i], semi_major[i], semi_minor[i], angle[i], centres[i], axes[i])
        normals[i] = centres[i]
        if tilted:
            _tilt(latitude[i], longitude[i], tilt[i], normals[i], axes[i])
        centres[i] *= radius_m + height[i]
    return centres, axes, normals


@njit(cache=True, nogil=True, error_model="numpy")
def _place(
    latitude: float, longitude: float, semi_major: float, semi_minor: float, angle: float,
    up: FloatArray, axes: FloatArray,
) -> None:  # fmt: skip
    """Write a rim's direction from the body's centre (3,) and its semi-axes (2, 3), if it is level, in g."""
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    up[0], up[1], up[2] = cos_lat * cos_lon, cos_lat * sin_lon, sin_lat
    sin, cos = np.sin(angle), np.cos(angle)
    # Along a and b, in east and north.
    for j, east, north in (
        (0, semi_major * cos, semi_major * sin),
        (1, -semi_minor * sin, semi_minor * cos),
    ):
        axes[j, 0] = -sin_lon * east - sin_lat * cos_lon * north
        axes[j, 1] = cos_lon * east - sin_lat * sin_lon * north
        axes[j, 2] = cos_lat * north


@njit(cache=True, nogil=True, error_model="numpy")
def _tilt(latitude: float, longitude: float, tilt: FloatArray, normal: FloatArray, axes: FloatArray) -> None:
    """Tilt a level rim's normal (3,) and semi-axes (2, 3) by the smallest rotation between the normals."""
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    east, north = np.tan(tilt[0]), np.tan(tilt[1])
    up = 1.0 / np.sqrt(1.0 + east * east + north * north)
    level, tilted = normal.copy(), np.empty(3)
    tilted[0] = up * (level[0] + east * sin_lon + north * sin_lat * cos_lon)
    tilted[1] = up * (level[1] - east * cos_lon + north * sin_lat * sin_lon)
    tilted[2] = up * (level[2] - north * cos_lat)
    for j in range(2):
        along = 0.0
        for k in range(3):
            along += tilted[k] * axes[j, k] / (1.0 + up)
        for k in range(3):
            axes[j, k] -= along * (level[k] + tilted[k])
    normal[:] = tilted


@njit(cache=True, nogil=True, error_model="numpy")
def visible_rims(
    gTb: FloatArray, bTc: FloatArray, rows: IntArray, latitude: FloatArray, longitude: FloatArray,
    semi_major: FloatArray, semi_minor: FloatArray, angle: FloatArray, tilt: FloatArray, height: FloatArray,
    radius_m: float, lens: FloatArray, least_px: float,
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """Project some rims into a camera.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    bTc : ndarray, shape (4, 4)
        Mounting: pose of the camera in b, m.
    rows : ndarray of int, shape (k,)
        Rows of the catalogue.
    latitude, longitude, semi_major, semi_minor, angle, height : ndarray, shape (n,)
        Of all rims, see `rim_geometry`; rad and m.
    tilt : ndarray, shape (n, 2) or (0, 2)
        See `rim_geometry`.
    radius_m : float
        Radius of the sphere.
    lens : ndarray, shape (m,)
        `Camera.lens`: focal lengths first, px.
    least_px : float
        Least semi-minor axis, px.

    Returns
    -------
    charts : ndarray, shape (k, 5)
        In normalised image coordinates.
    seen : ndarray of bool, shape (k,)
        Whether they are visible ellipses of that size.
    """
    R, P = conic.camera_pose(gTb, bTc)
    charts = np.empty((rows.shape[0], 5))
    seen = np.zeros(rows.shape[0], dtype=np.bool_)
    centre, axes, normal = np.empty(3), np.empty((2, 3)), np.empty(3)
    tilted = tilt.shape[0] > 0
    p, c = np.empty(3), np.empty((2, 3))
    fx, fy = lens[0], lens[1]
    for k in range(rows.shape[0]):
        i = rows[k]
        _place(latitude[i], longitude[i], semi_major[i], semi_minor[i], angle[i], centre, axes)
        if tilted:
            normal[:] = centre
            _tilt(latitude[i], longitude[i], tilt[i], normal, axes)
        centre *= radius_m + height[i]
        conic.rim_in_camera(R, P, centre, axes, p, c)
        if not conic.chart(p, c, charts[k]):
            continue
        y = charts[k]
        sxx, sxy, syy = moments_kernel(y[2], y[3], y[4])
        _, minor_px = semi_axes_kernel(
            fx * fx * sxx, fx * fy * sxy, fy * fy * syy, fx * fy * np.exp(y[2] + y[4])
        )
        seen[k] = minor_px >= least_px
    return charts, seen
