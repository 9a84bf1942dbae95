"""Check of poses against an elevation model: shaded ground correlated with the photograph.

The model, the sun and the law of reflectance do not depend on craters or on their catalogue. Around the
estimated pose the altitude, a shift of the image and its rotation are sought that correlate best. A shift of
the image may be a tilt or a shift of the camera alike, so only the altitude is compared with the estimate.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.optimize import minimize

from craternav_fg import frames
from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.catalogs.dem import Dem
from craternav_fg.dataset.images import ImageArray
from craternav_fg.photometry import flat_terrain_brightness
from factors.arrays import FloatArray

# Iterations that move a line of sight's end from the sphere to the ground: each shrinks the error by the
# product of the ground's slope and the tangent of the view's angle.
_GROUND_ITERATIONS = 4
# Step of the slopes, as a share of the model's own.
_SLOPE_STEP = 0.5
# Half-width, in blocks, of what counts as detail: wider changes are albedo, vignetting and film.
_DETAIL_BLOCKS = 12.0
# Simplex of the search: altitude (m), image shift (px), rotation (rad).
_ALTITUDE_STEP_M, _SHIFT_STEP_PX, _ROTATION_STEP_RAD = 600.0, 3.0, 3e-3
_TOLERANCES = {"xatol": 0.02, "fatol": 5e-5, "maxfev": 100}


@dataclass(frozen=True)
class DemCheck:
    """Correlation of one photograph with the shaded elevation model.

    Attributes
    ----------
    correlation : float
        At the estimated pose.
    best : float
        At the pose that correlates best.
    altitude_m : float
        Altitude of that pose minus the estimated one.
    shift_px : ndarray, shape (2,)
        Shift of the image of that pose, px.
    rotation_rad : float
        Rotation about the optical axis of that pose.
    """

    correlation: float
    best: float
    altitude_m: float
    shift_px: FloatArray
    rotation_rad: float


def shaded(
    camera: Camera, gTc: FloatArray, sun_g: FloatArray, dem: Dem, radius_m: float, step_px: int
) -> FloatArray:
    """Shade an elevation model as a camera sees it, without cast shadows.

    Parameters
    ----------
    camera : Camera
    gTc : ndarray, shape (4, 4)
        Pose of the camera in g, m.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    dem : Dem
    radius_m : float
        Radius of the sphere above which the model's heights are given.
    step_px : int
        Side of the square blocks of pixels that get one value each.

    Returns
    -------
    ndarray, shape (h, w)
        One value per block, h and w whole ones. Brightness up to a common factor; NaN beside the body.
    """
    rows, columns = camera.height_px // step_px, camera.width_px // step_px
    middle = 0.5 * (step_px - 1)
    y, x = np.mgrid[:rows, :columns] * float(step_px) + middle
    points = camera.normalised(np.stack([x.ravel(), y.ravel()], axis=1))
    R, P = gTc[:3, :3], gTc[:3, 3]
    X, hit = ground_points(R, P, points, radius_m)
    rays = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ R.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for _ in range(_GROUND_ITERATIONS):
        up = X / np.linalg.norm(X, axis=1, keepdims=True)
        rise = radius_m + dem.heights_m(up) - np.linalg.norm(X, axis=1)
        X = X + (rise / np.minimum(np.sum(rays * up, axis=1), -0.05))[:, None] * rays
    normals = _normals(X, dem, radius_m)
    brightness, _ = flat_terrain_brightness(normals, sun_g, -rays)
    return np.asarray(np.where(hit, brightness, np.nan)).reshape(rows, columns)


def _normals(X: FloatArray, dem: Dem, radius_m: float) -> FloatArray:
    """Outward unit normals (n, 3) of the ground at points (n, 3)."""
    lat, lon = frames.latitude_longitude(X)
    enu = frames.east_north_up(lat, lon)
    up = enu[:, :, 2]
    step = _SLOPE_STEP * dem.step_rad
    slopes = []
    for axis in (0, 1):
        side = step * enu[:, :, axis]
        ahead, behind = (up + side, up - side)
        rise = dem.heights_m(ahead / np.linalg.norm(ahead, axis=1, keepdims=True))
        rise = rise - dem.heights_m(behind / np.linalg.norm(behind, axis=1, keepdims=True))
        slopes.append(rise / (2.0 * step * radius_m))
    normals = up - slopes[0][:, None] * enu[:, :, 0] - slopes[1][:, None] * enu[:, :, 1]
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def check_against_dem(
    image: ImageArray,
    camera: Camera,
    gTb: FloatArray,
    sun_g: FloatArray,
    dem: Dem,
    radius_m: float,
    step_px: int = 8,
) -> DemCheck:
    """Correlate a photograph with the shaded elevation model around an estimated pose.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
        Grey levels.
    camera : Camera
    gTb : ndarray, shape (4, 4)
        Estimated pose of the body in g, m.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    dem : Dem
        That covers the ground in view.
    radius_m : float
        Radius of the sphere above which the model's heights are given.
    step_px : int
        Side of the blocks of pixels that are compared.

    Returns
    -------
    DemCheck
    """
    rows, columns = camera.height_px // step_px, camera.width_px // step_px
    cut = np.asarray(image[: rows * step_px, : columns * step_px], dtype=np.float64)
    seen = cut.reshape(rows, step_px, columns, step_px).mean(axis=(1, 3))
    gTc = camera.gTc(gTb)
    up = gTc[:3, 3] / np.linalg.norm(gTc[:3, 3])

    def moved(q: FloatArray) -> FloatArray:
        """Pose (4, 4) with another altitude and attitude; q in steps of the search."""
        shift = q[1:3] * _SHIFT_STEP_PX / camera.focal_px
        turn = frames.rotation_exp(np.array([shift[1], -shift[0], q[3] * _ROTATION_STEP_RAD]))
        T = gTc.copy()
        T[:3, :3] = gTc[:3, :3] @ turn
        T[:3, 3] += q[0] * _ALTITUDE_STEP_M * up
        return T

    def correlation(q: FloatArray) -> float:
        return correlate(seen, shaded(camera, moved(q), sun_g, dem, radius_m, step_px))

    start = np.zeros(4)
    # scipy's type declarations lack the simplex.
    search: Any = minimize
    options = {**_TOLERANCES, "initial_simplex": np.vstack([start, np.eye(4)])}
    result = search(lambda q: -correlation(q), start, method="Nelder-Mead", options=options)
    found = result.x
    return DemCheck(
        correlation(start),
        -float(result.fun),
        float(found[0] * _ALTITUDE_STEP_M),
        np.asarray(found[1:3] * _SHIFT_STEP_PX),
        float(found[3] * _ROTATION_STEP_RAD),
    )


def correlate(one: FloatArray, other: FloatArray) -> float:
    """Correlate the detail of two images.

    Parameters
    ----------
    one, other : ndarray, shape (H, W)
        In any unit; NaN where there is nothing.

    Returns
    -------
    float
        Correlation coefficient of what differs from the wider surroundings; 0 without detail.
    """
    good = np.isfinite(one) & np.isfinite(other)
    details = []
    for image in (one, other):
        filled = np.where(good, image, np.mean(image[good]) if good.any() else 0.0)
        details.append((filled - cv2.GaussianBlur(filled, (0, 0), _DETAIL_BLOCKS))[good])
    a, b = (detail - detail.mean() for detail in details)
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0
