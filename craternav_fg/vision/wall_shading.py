"""Direction towards the sun from the shading of known craters' walls.

A bowl whose rim is an ellipse has the slope (cos t / a, sin t / b) f(r) at the affine angle t of its rim. So
the brightness around rings inside it varies with the components of the slope contrast along the axes, divided
by a and b (see `photometry`), whatever f is. Each crater gives a direction with its sense. The catalogue and
the pose account for the ellipse, the perspective and the view.
"""

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.photometry import LunarLambert, flat_terrain_brightness
from craternav_fg.vision.image_sampling import SATURATED_BRIGHTNESS
from craternav_fg.vision.robust_scale import median, robust_sigma
from factors.arrays import FloatArray

# Rings on the wall, in radii: below the rim crest, where texture and the outline count, and above the flat
# floor.
_WALL_RING_RADII = np.array([0.6, 0.7, 0.8])
_RING_ANGLES_RAD = 2.0 * np.pi * (np.arange(48) + 0.5) / 48.0
# Scatter of single craters' directions that is expected before they are seen, rad, and its weight in craters.
_PRIOR_SCATTER_RAD, _PRIOR_SCATTER_COUNT = float(np.deg2rad(2.0)), 3.0
# Largest saturated share of a wall: like a shadow, saturation is symmetric about the illumination direction.
_MAX_SATURATED_SHARE = 0.35
# Laws between which the ground's lies as a rule. Where they turn the slope contrast by more, as with the sun
# behind the camera, a crater tells nothing of the sun.
_LAWS, _LARGEST_TURN_RAD = (LunarLambert(0.25), LunarLambert(0.75)), float(np.deg2rad(30.0))
# Fewer craters are no better than the relief.
_MIN_CRATERS = 3
# Iterations of the robust mean, and its scale in standard deviations.
_ITERATIONS, _SCALE_SIGMAS = 10, 2.0


def sun_azimuth_offset(
    image: npt.NDArray[np.float32], camera: Camera, craters: Catalog, gTb: FloatArray, sun_g: FloatArray
) -> tuple[float, float]:
    """Measure how much the azimuth of the sun differs from the predicted one.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Grey levels up to 255.
    camera : Camera
    craters : Catalog
        Those whose whole rims are in the image.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, good enough to find them by.
    sun_g : ndarray, shape (3,)
        Predicted unit vector towards the sun in g.

    Returns
    -------
    offset_rad : float
        Robust mean over the craters of the rotation about the ground's normal; NaN with too few.
    sigma_rad : float
        Its standard deviation, from the scatter of the craters; infinite with fewer than three that tell it.
    """
    centres, gRl, gTc = craters.centres, craters.gRl, camera.gTc(gTb)
    a, b = craters.semi_major_m[:, None], craters.semi_minor_m[:, None]
    c, s = np.cos(_RING_ANGLES_RAD), np.sin(_RING_ANGLES_RAD)
    u, v = np.outer(_WALL_RING_RADII, c).ravel(), np.outer(_WALL_RING_RADII, s).ravel()
    points = (
        centres[:, None] + (a * u)[..., None] * gRl[:, None, :, 0] + (b * v)[..., None] * gRl[:, None, :, 1]
    )
    x, y = np.moveaxis(camera.project((points - gTc[:3, 3]) @ gTc[:3, :3]).astype(np.float32), -1, 0)
    border = cv2.BORDER_CONSTANT
    value = np.asarray(
        cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=border, borderValue=float("nan")), np.float64
    )
    view = gTc[:3, 3] - centres
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    normals = gRl[:, :, 2]
    _, contrast = flat_terrain_brightness(normals, sun_g, view)
    first, last = (flat_terrain_brightness(normals, sun_g, view, law)[1] for law in _LAWS)
    turn = _turn(first, last, normals)
    # The wall that rises towards the sun is the dark one.
    along = -a * np.mean(value * np.tile(c, len(_WALL_RING_RADII)), axis=1, keepdims=True) * gRl[:, :, 0]
    along -= b * np.mean(value * np.tile(s, len(_WALL_RING_RADII)), axis=1, keepdims=True) * gRl[:, :, 1]
    offset = _turn(contrast, along, normals)
    saturated = np.mean(value > SATURATED_BRIGHTNESS, axis=1)
    lit = np.linalg.norm(contrast, axis=1) > 0.0
    told = np.isfinite(offset) & (np.abs(turn) < _LARGEST_TURN_RAD)
    offset = offset[told & lit & (saturated < _MAX_SATURATED_SHARE)]
    if len(offset) < _MIN_CRATERS:
        return float("nan"), float("inf")
    # Angles are taken from a middle direction: they must not wrap around.
    middle = float(np.angle(median(np.cos(offset)) + 1j * median(np.sin(offset))))
    off = np.angle(np.exp(1j * (offset - middle)))
    best, scatter = 0.0, 0.0
    for _ in range(_ITERATIONS):
        found = robust_sigma(off - best)
        scatter = float(
            np.sqrt(
                (len(off) * found**2 + _PRIOR_SCATTER_COUNT * _PRIOR_SCATTER_RAD**2)
                / (len(off) + _PRIOR_SCATTER_COUNT)
            )
        )
        weight = 1.0 / (1.0 + ((off - best) / (_SCALE_SIGMAS * scatter)) ** 2) ** 2
        best = float(weight @ off / weight.sum())
    return middle + best, scatter / float(np.sqrt(weight.sum()))


def _turn(before: FloatArray, after: FloatArray, normals: FloatArray) -> FloatArray:
    """Angles (n,) about the ground's normals from vectors (n, 3) along the ground to others."""
    return np.arctan2(np.sum(np.cross(before, after) * normals, axis=1), np.sum(before * after, axis=1))
