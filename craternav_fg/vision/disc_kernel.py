"""Means over discs around every pixel, compiled: differences of running sums along the rows of the disc.

A disc has few rows, so this takes less than half the time of Fourier transforms.
"""

import numpy as np
import numpy.typing as npt

from factors.arrays import IntArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]


@njit(cache=True, nogil=True, error_model="numpy")
def running_sums(values: Float32Array) -> Float32Array:
    """Add up an image and its square along the rows.

    Parameters
    ----------
    values : ndarray of float32, shape (h, w)
        Of about zero mean, in any unit.

    Returns
    -------
    ndarray of float32, shape (h, 2 w + 2)
        Sums of the pixels of a row before each, in the unit, then of their squares: side by side, so that one
        loop adds up both.
    """
    height, width = values.shape
    sums = np.empty((height, 2 * width + 2), np.float32)
    for y in range(height):
        total, total2 = 0.0, 0.0
        sums[y, 0] = sums[y, width + 1] = 0.0
        for x in range(width):
            value = np.float64(values[y, x])
            total += value
            total2 += value * value
            sums[y, x + 1] = total
            sums[y, width + x + 2] = total2
    return sums


@njit(cache=True, nogil=True, error_model="numpy")
def share_of_variance(
    sums: Float32Array, half_widths: IntArray, along_x: Float32Array, along_y: Float32Array, floor: np.float32
) -> Float32Array:
    """Divide what two templates explain around each pixel by the variance in a disc there.

    Parameters
    ----------
    sums : ndarray of float32, shape (rows, columns)
        `running_sums` of the image with a border, px, at least the disc's radius.
    half_widths : ndarray of int, shape (n,)
        Half widths, px, of the disc's rows, without the pixel in the middle; as many above as below.
    along_x, along_y : ndarray of float32, shape (h, w)
        Correlations with the templates, in the image's unit.
    floor : float32
        Added to the variance, in the unit's square.

    Returns
    -------
    ndarray of float32, shape (h, w)
        Sum of the squared correlations over the variance, dimensionless.
    """
    height, width = along_x.shape
    columns, radius = sums.shape[1] // 2, len(half_widths) // 2
    top, left = (sums.shape[0] - height) // 2, (columns - 1 - width) // 2
    share = np.float32(1.0 / np.sum(2 * half_widths + 1))
    n = columns + width
    total = np.empty(n, np.float32)
    mean, square = total[:width], total[columns:]
    out = np.empty((height, width), np.float32)
    for y in range(height):
        row, first, end = top + y, left - half_widths[radius], left + half_widths[radius] + 1
        before, until = sums[row, first : first + n], sums[row, end : end + n]
        for x in range(n):
            total[x] = until[x] - before[x]
        for k in range(radius):
            # Two rows of the same width, above and below.
            first, end = left - half_widths[k], left + half_widths[k] + 1
            row = top + y + k - radius
            before, until = sums[row, first : first + n], sums[row, end : end + n]
            row = top + y + radius - k
            before2, until2 = sums[row, first : first + n], sums[row, end : end + n]
            for x in range(n):
                total[x] += (until[x] - before[x]) + (until2[x] - before2[x])
        gx, gy, shares = along_x[y], along_y[y], out[y]
        for x in range(width):
            middle = mean[x] * share
            variance = max(square[x] * share - middle * middle, np.float32(0.0)) + floor
            shares[x] = (gx[x] * gx[x] + gy[x] * gy[x]) / variance
    return out
