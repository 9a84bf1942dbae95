"""Where the light comes from, as the walls of known craters show it.

A bowl whose rim is an ellipse has a slope of (cos t / a, sin t / b) f(r) at the affine angle t of its rim:
brightness around rings inside it varies with the shading gain's components along the axes divided by a
and b (see `photometry`), whatever f is. Each crater so gives a direction with its sign; what the ellipse,
the perspective and the view make of it is known from the catalogue and the pose.
"""

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.photometry import level_ground

FloatArray = npt.NDArray[np.float64]

# Rings on the wall: below the crest, where texture and the outline count, and above the flat floor.
_WALL_RING_RADII = np.array([0.6, 0.7, 0.8])
_RING_ANGLES_RAD = 2.0 * np.pi * (np.arange(48) + 0.5) / 48.0
# Scatter of single craters' directions, rad, before they are seen, and how many craters that counts for.
_PRIOR_SCATTER_RAD, _PRIOR_SCATTER_COUNT = float(np.deg2rad(2.0)), 3.0
# Brighter than this, of 255, is saturated; so much of a wall may be: like a shadow it lies alike on both
# sides of the light's direction.
_SATURATED_BRIGHTNESS, _MAX_SATURATED_SHARE = 250.0, 0.35


def sun_azimuth_offset(
    image: npt.NDArray[np.float32], camera: Camera, craters: Catalog, gTb: FloatArray, sun_g: FloatArray
) -> tuple[float, float]:
    """Turn of the light's azimuth against its prediction, about the ground's normal, and its scatter.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Grey levels up to 255.
    camera : Camera
    craters : Catalog
        Those whose rims are in the image, whole.
    gTb : ndarray, shape (4, 4)
        Pose, good enough to find them by.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.

    Returns
    -------
    turn_rad : float
        A weighted median of all craters'; NaN without any that is lit.
    sigma_rad : float
        Its standard deviation from their scatter; infinite without any.
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
    _, gain = level_ground(normals, sun_g, view)
    # The wall that rises towards the light is the dark one.
    along = -a * np.mean(value * np.tile(c, len(_WALL_RING_RADII)), axis=1, keepdims=True) * gRl[:, :, 0]
    along -= b * np.mean(value * np.tile(s, len(_WALL_RING_RADII)), axis=1, keepdims=True) * gRl[:, :, 1]
    turn = np.arctan2(np.sum(np.cross(gain, along) * normals, axis=1), np.sum(gain * along, axis=1))
    saturated = np.mean(value > _SATURATED_BRIGHTNESS, axis=1)
    turn = turn[np.isfinite(turn) & (saturated < _MAX_SATURATED_SHARE) & (np.linalg.norm(gain, axis=1) > 0.0)]
    if len(turn) == 0:
        return float("nan"), float("inf")
    # About their middle direction, which has no end as the median of angles has.
    middle = float(np.angle(np.median(np.cos(turn)) + 1j * np.median(np.sin(turn))))
    off = np.angle(np.exp(1j * (turn - middle)))
    best, scatter = 0.0, 0.0
    for _ in range(10):
        found = 1.4826 * float(np.median(np.abs(off - best)))
        scatter = float(
            np.sqrt(
                (len(off) * found**2 + _PRIOR_SCATTER_COUNT * _PRIOR_SCATTER_RAD**2)
                / (len(off) + _PRIOR_SCATTER_COUNT)
            )
        )
        weight = 1.0 / (1.0 + ((off - best) / (2.0 * scatter)) ** 2) ** 2
        best = float(weight @ off / weight.sum())
    return middle + best, scatter / float(np.sqrt(weight.sum()))
