"""Brightness between pixels, and the noise of pixels."""

import numpy as np

from craternav_fg.vision.robust_scale import robust_sigma
from factors.arrays import ImageArray
from factors.kernels.compiled import njit

# Brightness, of 255, above which a pixel counts as saturated.
SATURATED_BRIGHTNESS = 250.0
# Rows that the noise is estimated from: enough for a median.
_NOISE_ROWS = 128
# Standard deviation of the difference operator's response to white noise of standard deviation 1.
_OPERATOR_GAIN = 6.0


def noise_level(image: ImageArray) -> float:
    """Estimate the standard deviation of an image's pixel noise; edges and slopes hardly count.

    Immerkaer, "Fast noise variance estimation", CVIU 64 (2), 1996, with the median instead of the mean.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.

    Returns
    -------
    float
        In the image's brightness.
    """
    step = max(1, image.shape[0] // _NOISE_ROWS)
    return robust_sigma(_second_differences(image, step)) / _OPERATOR_GAIN


@njit(cache=True, error_model="numpy")
def _second_differences(image: ImageArray, step: int) -> ImageArray:
    """Differentiate every `step`th row twice along both axes."""
    height, width = image.shape
    rows = (height - 2 + step - 1) // step
    out = np.empty((rows, width - 2), dtype=np.float32)
    two = np.float32(2.0)
    for k in range(rows):
        above, row, below = image[k * step], image[1 + k * step], image[2 + k * step]
        for j in range(width - 2):
            before = above[j] - two * above[j + 1] + above[j + 2]
            here = row[j] - two * row[j + 1] + row[j + 2]
            after = below[j] - two * below[j + 1] + below[j + 2]
            out[k, j] = before - two * here + after
    return out


@njit(cache=True, error_model="numpy")
def bilinear(image: ImageArray, x: float, y: float) -> float:
    """Interpolate the brightness bilinearly.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    x, y : float
        Position, px.

    Returns
    -------
    float
        NaN outside the image.
    """
    i, j = int(np.floor(x)), int(np.floor(y))
    if i < 0 or j < 0 or i + 1 >= image.shape[1] or j + 1 >= image.shape[0]:
        return np.nan
    u, v = x - i, y - j
    return (1.0 - v) * ((1.0 - u) * image[j, i] + u * image[j, i + 1]) + v * (
        (1.0 - u) * image[j + 1, i] + u * image[j + 1, i + 1]
    )


@njit(cache=True, error_model="numpy")
def cubic(image: ImageArray, i: int, j: int, u: float, v: float) -> float:
    """Interpolate the brightness by Catmull-Rom splines where the pixels around are known to exist.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    i, j : int
        Column, 1 to W - 3, and row, 1 to H - 3, of the pixel above and to the left.
    u, v : float
        From there to the position, 0 to 1 px.

    Returns
    -------
    float
    """
    a0 = 0.5 * u * (-1.0 + u * (2.0 - u))
    a1 = 1.0 + 0.5 * u * u * (-5.0 + 3.0 * u)
    a2 = 0.5 * u * (1.0 + u * (4.0 - 3.0 * u))
    a3 = 0.5 * u * u * (u - 1.0)
    b0 = 0.5 * v * (-1.0 + v * (2.0 - v))
    b1 = 1.0 + 0.5 * v * v * (-5.0 + 3.0 * v)
    b2 = 0.5 * v * (1.0 + v * (4.0 - 3.0 * v))
    b3 = 0.5 * v * v * (v - 1.0)
    total = 0.0
    for k in range(4):
        b = b0 if k == 0 else (b1 if k == 1 else (b2 if k == 2 else b3))
        row = j - 1 + k
        total += b * (
            a0 * image[row, i - 1] + a1 * image[row, i] + a2 * image[row, i + 1] + a3 * image[row, i + 2]
        )
    return total
