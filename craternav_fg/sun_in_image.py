"""The direction towards the sun in an image, as a known pose and sun show it."""

import numpy as np

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.photometry import flat_terrain_brightness
from factors.arrays import FloatArray

# Step along the ground whose image gives the direction, as a share of the range.
_STEP_SHARE = 1e-3


def sun_angle_in_image(camera: Camera, gTc: FloatArray, sun_g: FloatArray, radius_m: float) -> float | None:
    """Compute the direction towards the sun at the image's centre: there, walls of craters are darkest.

    Parameters
    ----------
    camera : Camera
    gTc : ndarray, shape (4, 4)
        Pose of the camera in g, m.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    radius_m : float
        Radius of the body.

    Returns
    -------
    float or None
        From x towards y, rad. None where the image's centre does not show ground in the sun.
    """
    centre_px = np.array([[0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)]])
    middle, hit = ground_points(gTc[:3, :3], gTc[:3, 3], camera.normalised(centre_px), radius_m)
    if not hit[0]:
        return None
    view = gTc[:3, 3] - middle
    range_m = float(np.linalg.norm(view))
    _, contrast = flat_terrain_brightness(middle / np.linalg.norm(middle), sun_g, view / range_m)
    length = float(np.linalg.norm(contrast[0]))
    if length == 0.0:
        return None
    ground = middle + np.outer([0.0, _STEP_SHARE * range_m], contrast[0] / length)
    begin, end = camera.project((ground - gTc[:3, 3]) @ gTc[:3, :3])
    return float(np.arctan2(*(end - begin)[::-1]))
