"""Pyramid of an image for the crater network: octaves of sizes, each freed of its local mean and contrast.

The network sees craters of one octave of radii at a time. Images are turned by quarters so that the sun is
within 45 deg of the right: the network knows craters lit from there alone.
"""

import cv2
import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray

Float32Array = npt.NDArray[np.float32]

# Cells of the network's output, px of its level.
STRIDE_PX = 4
# Radii that a level is asked for, px of the level; neighbouring levels overlap.
LEAST_PX, MOST_PX = 5.2, 13.0
# Standard deviation of the window of the local mean and contrast, px of the level, and the minimum contrast,
# of 255.
_WINDOW_PX, _LEAST_CONTRAST = 20.0, 2.0
# Values beyond are clipped: shadows and saturated walls.
_MOST_VALUE = 4.0


def levels(shape: tuple[int, int], max_radius_px: float) -> int:
    """Count the levels of an image's pyramid, the image itself the first.

    Parameters
    ----------
    shape : tuple of int
        Height and width, px.
    max_radius_px : float
        Radius of the largest craters searched.

    Returns
    -------
    int
        At least 1; each has half the resolution of the one before.
    """
    count = 1
    while LEAST_PX * 2.0**count < max_radius_px and min(shape) >= STRIDE_PX * 2.0 ** (count + 1):
        count += 1
    return count


def level(image: Float32Array, number: float) -> Float32Array:
    """Compute a level of an image's pyramid.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    number : float
        0 is the image itself; need not be whole.

    Returns
    -------
    ndarray of float32, shape (h, w)
        Brightness of half the resolution for each number.
    """
    if number == 0.0:
        return image
    shape = [max(round(n / 2.0**number), 1) for n in image.shape]
    method = cv2.INTER_AREA if number > 0.0 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=method), dtype=np.float32)


def normalised(brightness: Float32Array) -> Float32Array:
    """Free a level of its local mean and contrast.

    Parameters
    ----------
    brightness : ndarray of float32, shape (h, w)
        0 to 255.

    Returns
    -------
    ndarray of float32, shape (h, w)
        In local standard deviations.
    """
    size = (2 * round(_WINDOW_PX) + 1,) * 2

    def smooth(values: Float32Array) -> Float32Array:
        return np.asarray(cv2.blur(cv2.blur(values, size), size), np.float32)

    off = brightness - smooth(brightness)
    # Sums of the blur may fall below zero by rounding.
    contrast = np.sqrt(np.maximum(smooth(off * off), 0.0)) + np.float32(_LEAST_CONTRAST)
    return np.asarray(np.clip(off / contrast, -_MOST_VALUE, _MOST_VALUE), dtype=np.float32)


def quarters_to_right(sun_angle_rad: float) -> int:
    """Quarter turns, of `numpy.rot90`, that bring the sun to within 45 deg of the right.

    Parameters
    ----------
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.

    Returns
    -------
    int
        0 to 3.
    """
    return int(np.rint(sun_angle_rad / (0.5 * np.pi))) % 4


def turned_back(xy_px: FloatArray, quarters: int, shape: tuple[int, int]) -> FloatArray:
    """Bring points of a turned image back into the image.

    Parameters
    ----------
    xy_px : ndarray, shape (n, 2)
        In the image turned by `numpy.rot90`.
    quarters : int
    shape : tuple of int
        Height and width of the image that was turned, px.

    Returns
    -------
    ndarray, shape (n, 2)
        Pixels of the image.
    """
    x, y = xy_px.T
    height, width = shape
    if quarters == 1:
        x, y = width - 1.0 - y, x
    elif quarters == 2:
        x, y = width - 1.0 - x, height - 1.0 - y
    elif quarters == 3:
        x, y = y, height - 1.0 - x
    return np.column_stack([x, y])
