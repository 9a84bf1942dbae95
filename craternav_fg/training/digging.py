"""Craters of any profile, outline and wear, dug into a height map; and hills, which are none."""

import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

# Smallest radius with an irregular outline, and of terraces and central peaks, px; and the share with these.
_IRREGULAR_PX, _COMPLEX_PX, _COMPLEX_SHARE = 4.0, 25.0, 0.08
_HARMONICS = 5
# Steepest wall of a fresh crater, height over distance.
_STEEPEST = 1.0
# Square of the scale of the softest profile: its crest is at 1.06 radii.
_SOFTEST = 1.25**2
# Columns of a crater's shape.
_SHAPE = 11


def dig(heights: Float32Array, circles_px: FloatArray, wear: FloatArray, rng: np.random.Generator) -> None:
    """Dig craters one after another: bowls and flat floors, rims, aprons, terraces, central peaks.

    Parameters
    ----------
    heights : ndarray of float32, shape (H, W)
        In pixels; changed in place.
    circles_px : ndarray, shape (n, 3)
        Centre x, y and radius in the image, px.
    wear : ndarray, shape (n,)
        Dimensionless: 0 of fresh craters to 1 of those that are hardly there.
    rng : Generator
        Draws the profiles.
    """
    radius, n = circles_px[:, 2], len(circles_px)
    fresh = (1.0 - wear) ** 1.3
    complex_ = (radius > _COMPLEX_PX) & (rng.random(n) < _COMPLEX_SHARE)
    shape = np.empty((n, _SHAPE))
    depth = shape[:, 0] = radius * rng.uniform(0.16, 0.45, n) * (0.05 + 0.95 * fresh)
    rim = shape[:, 1] = radius * rng.uniform(0.03, 0.11, n) * fresh
    floor = shape[:, 2] = np.maximum(rng.uniform(-1.2, 0.6, n), 0.0)
    # No wall is much steeper than loose rock lies.
    steepest = _STEEPEST * (1.0 - floor) * radius / (depth + rim)
    shape[:, 3] = np.maximum(np.minimum(rng.uniform(1.6, 3.2, n), steepest), 1.0)
    shape[:, 4] = rng.uniform(2.5, 4.0, n)
    # A rim may be soft while the bowl is still deep.
    shape[:, 5] = wear ** rng.uniform(0.25, 1.0, n)
    shape[:, 6] = np.where(complex_, 0.3 * depth, 0.0)
    shape[:, 7] = np.where(complex_, rng.uniform(0.0, 0.05, n) * radius, 0.0)
    _set_axes(shape, rng)
    outline = rng.normal(0.0, 0.008, (n, 2, _HARMONICS)) * (radius > _IRREGULAR_PX)[:, None, None]
    _dig_all(heights, circles_px, shape, outline)


def raise_hills(heights: Float32Array, circles_px: FloatArray, rng: np.random.Generator) -> None:
    """Raise hills, which under the opposite sun would look like craters.

    Parameters
    ----------
    heights : ndarray of float32, shape (H, W)
        In pixels; changed in place.
    circles_px : ndarray, shape (n, 3)
        Centre x, y and radius in the image, px.
    rng : Generator
        Draws their heights and outlines.
    """
    n = len(circles_px)
    shape = np.zeros((n, _SHAPE))
    shape[:, 0] = -circles_px[:, 2] * rng.uniform(0.05, 0.4, n)
    shape[:, 3:6] = 1.0
    _set_axes(shape, rng)
    _dig_all(heights, circles_px, shape, rng.normal(0.0, 0.03, (n, 2, _HARMONICS)))


def _set_axes(shape: FloatArray, rng: np.random.Generator) -> None:
    ratio, turn = np.sqrt(rng.uniform(0.85, 1.0, len(shape))), rng.uniform(0.0, np.pi, len(shape))
    shape[:, 8], shape[:, 9], shape[:, 10] = ratio * np.cos(turn), ratio * np.sin(turn), ratio


@njit(cache=True, fastmath=True)
def _dig_all(heights: Float32Array, circles_px: FloatArray, shapes: FloatArray, outlines: FloatArray) -> None:
    for k in range(len(circles_px)):
        _dig(heights, circles_px[k], shapes[k], outlines[k])


@njit(cache=True, fastmath=True)
def _ground(heights: Float32Array, circle_px: FloatArray) -> tuple[float, float, float]:
    """Height and slopes at the centre of the plane through what is there."""
    x, y, radius = circle_px
    height, width = heights.shape
    n, level, slope_x, slope_y, spread = 0, 0.0, 0.0, 0.0, 1e-9
    base = float(heights[min(max(int(y), 0), height - 1), min(max(int(x), 0), width - 1)])
    reach = int(1.2 * radius + 1.0)
    for row in range(max(int(y) - reach, 0), min(int(y) + reach + 1, height)):
        for column in range(max(int(x) - reach, 0), min(int(x) + reach + 1, width)):
            u, v, h = column - x, row - y, float(heights[row, column]) - base
            if u * u + v * v < 1.44 * radius * radius:
                n += 1
                level += h
                slope_x += u * h
                slope_y += v * h
                spread += 0.5 * (u * u + v * v)
    return base + level / max(n, 1), slope_x / spread, slope_y / spread


@njit(cache=True, fastmath=True)
def _dig(heights: Float32Array, circle_px: FloatArray, shape: FloatArray, outline: FloatArray) -> None:
    x, y, radius = circle_px
    depth, rim, floor, wall_power, apron_power, soft, peak, terrace, c, s, ratio = shape
    reach = int(3.0 * radius + 3.0)
    level, slope_x, slope_y = _ground(heights, circle_px)
    irregular = outline[0, 0] != 0.0
    for row in range(max(int(y) - reach, 0), min(int(y) + reach + 1, heights.shape[0])):
        for column in range(max(int(x) - reach, 0), min(int(x) + reach + 1, heights.shape[1])):
            u, v = column - x, row - y
            a, b = c * u + s * v, (c * v - s * u) / (ratio * ratio)
            r = np.sqrt(a * a + b * b) / radius
            if irregular and r > 0.0:
                # Cosine and sine of multiples of the direction, the first two times it.
                cos1, sin1 = a / (r * radius), b / (r * radius)
                cos, sin, swell = cos1, sin1, 1.0
                for k in range(outline.shape[1]):
                    cos, sin = cos * cos1 - sin * sin1, sin * cos1 + cos * sin1
                    swell += outline[0, k] * cos + outline[1, k] * sin
                r *= swell
            if r >= 3.0:
                continue
            end = min(3.0 - r, 1.0)
            if r < 1.0:
                wall = max((r - floor) / (1.0 - floor), 0.0) ** wall_power
                bowl = (depth + rim) * wall - depth
                if terrace > 0.0:
                    bowl += terrace * np.sin(12.0 * r) * min(4.0 * (1.0 - r), 1.0)
            else:
                bowl = rim * r**-apron_power
            if soft > 0.0:
                q = _SOFTEST * r * r
                bowl += soft * (-depth * (1.0 - 1.1 * q) * np.exp(-1.2 * q) - bowl)
            if peak > 0.0:
                bowl += peak * np.exp(-0.5 * (r / 0.15) ** 2)
            # Most of what was there before is blown away.
            inside = min(max((1.35 - r) / 0.7, 0.0), 1.0)
            gone = 0.8 * (1.0 - 0.6 * soft) * inside * inside * (3.0 - 2.0 * inside)
            old = heights[row, column]
            heights[row, column] = old + gone * (level + slope_x * u + slope_y * v - old) + bowl * end
