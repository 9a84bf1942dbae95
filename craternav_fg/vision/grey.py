"""Images as the detectors take them, whatever their bit depth and their lens."""

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.dataset.images import ImageArray

GreyArray = npt.NDArray[np.uint8] | npt.NDArray[np.float32]


def on_8_bit_scale(image: ImageArray, camera: Camera) -> GreyArray:
    """Scale an image's grey levels to 0 to 255.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
    camera : Camera
        Gives the full scale of the image.

    Returns
    -------
    ndarray of uint8 or float32, shape (H, W)
        With fractions if the image has more than 8 bits.
    """
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    return image.astype(np.float32) * np.float32(255.0 / camera.full_scale)


def undistorted(image: GreyArray, camera: Camera) -> GreyArray:
    """Resample an image to the pixels of the camera without lens distortion.

    For detectors that need not be exact: the guided front end measures in the image itself.

    Parameters
    ----------
    image : ndarray of uint8 or float32, shape (H, W)
    camera : Camera

    Returns
    -------
    ndarray of uint8 or float32, shape (H, W)
        As `camera.pinhole` would have taken it; the nearest border where the image ends.
    """
    if not camera.distorts:
        return image
    rows, columns = np.indices(image.shape, dtype=np.float64)
    directions = camera.pinhole.normalised(np.stack([columns, rows], axis=-1))
    x, y = np.moveaxis(camera.pixels(directions).astype(np.float32), -1, 0)
    straight = cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return straight.astype(np.float32, copy=False)
