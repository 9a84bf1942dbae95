"""How much each place of an image looks like a crater of a given size, against what it shows by chance.

A crater is a bowl: from its centre, brightness falls towards the sun. The response is the derivative of the
image along the sun's axis, smoothed to the crater's size. It needs no rim, and sees craters too worn or too
smeared to be detected: a detector must hold against a million places, a predicted crater against chance at
its own. Chance is the image itself: the share of its places that respond at least as much. At the places of
craters that are there, small shares are frequent; elsewhere all are equally frequent, whatever the ground.

The sun's axis is that along which the image varies most: slopes of any ground are seen along it only. It
leaves two directions, both of which are given.
"""

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.vision.pyramid import level
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

# Radii for which there are maps, px, and levels of an octave.
LEAST_RADIUS_PX, MOST_RADIUS_PX = 5.0, 120.0
_LEVELS_OF_OCTAVE = 3
# Smoothing, px of the level, and its share of the radius; the background is smoothed by a factor more.
# Chosen: over the craters of nine rendered images of plains, of which six had no answer, the sum of the
# logarithms of the densities is 454; 389 and 398 at a share of 0.3 and 0.6, 459 and 404 at a factor of 1.6
# and 4.
_SMOOTH_PX, _SMOOTH_SHARE, _BACKGROUND = 2.0, 0.45, 2.0
# Distances within which a place may respond, px of the level: places are predicted with errors.
_REACH_PX = np.array([1, 2, 4, 8])
# Exponent a of the distribution a s^(a - 1) of the shares s at craters that are seen; likewise 409 and 440
# at 0.1 and 0.3.
_EXPONENT = 0.2
# Places of a map by which its chance is measured: smaller shares than one of them are not told apart.
_SAMPLES = 20_000
# Least number of places of a map.
_LEAST_PLACES = 100
# Percentiles at which derivatives are cut when the axis is sought: of shadows and lit walls.
_CUT = (1.0, 99.0)


class ShadingMaps(NamedTuple):
    """Maps of one image, for compiled code: of each side of the sun's axis, level and reach."""

    density: Float32Array
    """Density of the share at a crater over that by chance, of all maps, row by row, shape (n,)."""
    first: IntArray
    """Where each map begins, shape (2, levels, 4)."""
    shapes: IntArray
    """Rows and columns of each map, shape (levels, 4, 2)."""
    steps_px: FloatArray
    """Pixels of the image from place to place, along rows and columns, shape (levels, 4, 2)."""


# Of an image that is not known: all densities are 1.
NO_SHADING = ShadingMaps(
    np.empty(0, np.float32), np.empty((2, 0, len(_REACH_PX)), np.int64),
    np.empty((0, len(_REACH_PX), 2), np.int64), np.empty((0, len(_REACH_PX), 2)),
)  # fmt: skip


def shading_maps(image: Float32Array) -> ShadingMaps:
    """Compute the maps of an image.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.

    Returns
    -------
    ShadingMaps
        Of radii that the image is large enough for.
    """
    axis_rad = sun_axis(image)
    maps: list[Float32Array] = []
    shapes, steps = [], []
    for k in range(int(np.log2(MOST_RADIUS_PX / LEAST_RADIUS_PX) * _LEVELS_OF_OCTAVE) + 1):
        number = np.log2(_SMOOTH_SHARE * LEAST_RADIUS_PX / _SMOOTH_PX) + k / _LEVELS_OF_OCTAVE
        seen = level(image, float(number))
        if seen.size < _LEAST_PLACES * int(_REACH_PX[-1]) ** 2:
            break
        response = _response(seen, axis_rad)
        for side in (response, -response):
            maps += [_density(side, int(reach)) for reach in _REACH_PX]
        shapes.append([one.shape for one in maps[-len(_REACH_PX) :]])
        scale = np.array(image.shape) / seen.shape
        steps.append([scale * _stride(int(reach)) for reach in _REACH_PX])
    if not maps:
        return NO_SHADING
    begins = np.cumsum([0, *(one.size for one in maps[:-1])]).reshape(-1, 2, len(_REACH_PX))
    return ShadingMaps(
        np.concatenate([one.ravel() for one in maps]), np.ascontiguousarray(begins.swapaxes(0, 1)),
        np.array(shapes, np.int64), np.array(steps),
    )  # fmt: skip


def sun_axis(image: Float32Array) -> float:
    """Find the axis along which the image varies most.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.

    Returns
    -------
    float
        Angle from x towards y, rad, from -pi/2 to pi/2.
    """
    dx, dy = _derivatives(_smooth(image, _SMOOTH_SHARE * LEAST_RADIUS_PX))
    dx, dy = (np.clip(one, *np.percentile(one, _CUT)) for one in (dx, dy))
    return float(0.5 * np.arctan2(2.0 * np.mean(dx * dy), np.mean(dx * dx) - np.mean(dy * dy)))


def _smooth(values: Float32Array, sigma_px: float) -> Float32Array:
    blurred = cv2.GaussianBlur(values, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float32)


def _derivatives(values: Float32Array) -> tuple[Float32Array, Float32Array]:
    dy, dx = np.gradient(values)
    return np.asarray(dx, np.float32), np.asarray(dy, np.float32)


def _response(seen: Float32Array, axis_rad: float) -> Float32Array:
    """Fall of the brightness along the axis at a level."""
    local = _smooth(seen, _SMOOTH_PX) - _smooth(seen, _BACKGROUND * _SMOOTH_PX)
    dx, dy = _derivatives(local)
    return np.asarray(-np.cos(axis_rad) * dx - np.sin(axis_rad) * dy, np.float32)


def _stride(reach: int) -> int:
    return max(reach // 2, 1)


def _density(response: Float32Array, reach: int) -> Float32Array:
    """Density, over that by chance, of the share of places that respond at least as much within a reach."""
    stride = _stride(reach)
    most = cv2.dilate(response, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    most = np.ascontiguousarray(most[stride // 2 :: stride, stride // 2 :: stride])
    apart = int(np.ceil(np.sqrt(most.size / _SAMPLES)))
    ordered = np.sort(most[::apart, ::apart].ravel())
    count = len(ordered)
    above = count - np.searchsorted(ordered, most, side="right")
    below = count + 1 - np.searchsorted(ordered, most, side="left")
    # Averaged over the shares that the samples do not tell apart: the mean over all places is 1.
    powers = np.arange(count + 2.0) ** _EXPONENT
    density = (count + 1.0) ** (1.0 - _EXPONENT) * (powers[below] - powers[above]) / (below - above)
    return np.asarray(density, np.float32)


@njit(cache=True, error_model="numpy")
def shading_density(
    maps: ShadingMaps, side: int, x_px: float, y_px: float, radius_px: float, error_px: float
) -> float:
    """Look up the density at a predicted crater.

    Parameters
    ----------
    maps : ShadingMaps
    side : int
        Side of the sun's axis, 0 or 1.
    x_px, y_px : float
        Centre.
    radius_px : float
        Mean radius.
    error_px : float
        Error of the centre that is allowed for.

    Returns
    -------
    float
        1, which tells nothing, beside the image, for other sizes, and where the place is too uncertain.
    """
    k = int(np.rint(np.log2(radius_px / LEAST_RADIUS_PX) * _LEVELS_OF_OCTAVE))
    if not 0 <= k < maps.first.shape[1]:
        return 1.0
    level_px = radius_px * _SMOOTH_SHARE / _SMOOTH_PX
    m = 0
    while m < _REACH_PX.shape[0] and _REACH_PX[m] * level_px < error_px:
        m += 1
    if m == _REACH_PX.shape[0]:
        return 1.0
    row = int(np.floor((y_px + 0.5) / maps.steps_px[k, m, 0]))
    column = int(np.floor((x_px + 0.5) / maps.steps_px[k, m, 1]))
    if not (0 <= row < maps.shapes[k, m, 0] and 0 <= column < maps.shapes[k, m, 1]):
        return 1.0
    return float(maps.density[maps.first[side, k, m] + row * maps.shapes[k, m, 1] + column])
