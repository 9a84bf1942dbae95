"""What the network is asked for at each level of a rendered image's pyramid."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.training.light import Photograph
from craternav_fg.training.terrain import Terrain
from craternav_fg.vision.pyramid import LEAST_PX, MOST_PX, STRIDE_PX
from factors.arrays import FloatArray

Float32Array = npt.NDArray[np.float32]

# Between these a crater's probability to be marked by people rises from 0 to 1: its depth in radii; the depth
# over the tangent of the sun's elevation, which is about the contrast; the lit share of its rim.
_DEPTH, _CONTRAST, _LIT = (0.015, 0.06), (0.03, 0.2), (0.1, 0.4)
# Smaller probabilities are none.
_LEAST = 0.02
# Cells with the centre this close, in radii, are the crater's; farther ones, to the second, are no example.
CENTRE_RADII, NEAR_RADII = 0.25, 0.45
# Radii outside those of a level, by this factor, are no example there.
_MARGIN = 1.15
_RIM_POINTS = 16


class Target(NamedTuple):
    """What is known of the cells of a level.

    Attributes
    ----------
    crater : ndarray of float32, shape (rows, columns)
        Probability that people mark a crater there: 0 but at centres.
    weight : ndarray of float32, shape (rows, columns)
        0 where nothing is known.
    circle : ndarray of float32, shape (3, rows, columns)
        From the cell to the crater's centre, x and y, in cells, and logarithm of its radius over the
        geometric mean of the level's radii.
    """

    crater: Float32Array
    weight: Float32Array
    circle: Float32Array


def marking(ground: Terrain, photo: Photograph) -> FloatArray:
    """Estimate how probable it is that people would mark craters.

    Parameters
    ----------
    ground : Terrain
    photo : Photograph

    Returns
    -------
    ndarray, shape (n,)
        Probabilities; NaN for buried craters, of which nothing is known.
    """
    contrast = ground.depth_radii / max(np.tan(photo.elevation_rad), 0.3)
    angles = np.arange(_RIM_POINTS) * 2.0 * np.pi / _RIM_POINTS
    lit = np.zeros(len(ground.circles_px))
    for share in (0.5, 1.0):
        x = ground.circles_px[:, :1] + share * ground.circles_px[:, 2:] * np.cos(angles)
        y = ground.circles_px[:, 1:2] + share * ground.circles_px[:, 2:] * np.sin(angles)
        rows, columns = (
            np.clip(np.rint(v).astype(np.int64), 0, n - 1)
            for v, n in zip((y, x), photo.lit.shape, strict=True)
        )
        lit = np.maximum(lit, photo.lit[rows, columns].mean(axis=1))
    probability = _rise(ground.depth_radii, _DEPTH) * _rise(contrast, _CONTRAST) * _rise(lit, _LIT)
    return np.where(ground.buried, np.nan, probability)


def _rise(values: FloatArray, ends: tuple[float, float]) -> FloatArray:
    share = np.clip((values - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def target(circles_px: FloatArray, probability: FloatArray, shape: tuple[int, int]) -> Target:
    """Compute what the network is asked for at one level.

    Parameters
    ----------
    circles_px : ndarray, shape (n, 3)
        Centre x, y and radius in the image of the level, px.
    probability : ndarray, shape (n,)
        See `marking`.
    shape : tuple of int
        Rows and columns of cells.

    Returns
    -------
    Target
    """
    crater, weight = np.zeros(shape, np.float32), np.ones(shape, np.float32)
    circle = np.zeros((3, *shape), np.float32)
    radius = circles_px[:, 2]
    inside = (radius >= LEAST_PX) & (radius <= MOST_PX)
    near = (radius >= LEAST_PX / _MARGIN) & (radius <= MOST_PX * _MARGIN)
    middle = 0.5 * np.log(LEAST_PX * MOST_PX)
    unknown = np.isnan(probability)
    # The unknown first, so that what is known overwrites it; then the clearer wins, of two the smaller.
    for k in np.lexsort((-radius, probability, ~unknown)):
        if not near[k] or probability[k] < _LEAST:
            continue
        x, y = (circles_px[k, :2] + 0.5) / STRIDE_PX - 0.5
        reach = NEAR_RADII * radius[k] / STRIDE_PX
        row0, row1 = max(int(np.ceil(y - reach)), 0), min(int(y + reach) + 1, shape[0])
        column0, column1 = max(int(np.ceil(x - reach)), 0), min(int(x + reach) + 1, shape[1])
        if row0 >= row1 or column0 >= column1:
            continue
        u, v = np.meshgrid(x - np.arange(column0, column1), y - np.arange(row0, row1))
        off = np.hypot(u, v)
        at = (slice(row0, row1), slice(column0, column1))
        # At least the cell that holds the centre.
        own = (off <= max(CENTRE_RADII * radius[k] / STRIDE_PX, 0.0)) | (np.maximum(abs(u), abs(v)) <= 0.5)
        weight[at] = np.where((off <= reach) & (crater[at] == 0.0), 0.0, weight[at])
        if inside[k] and not unknown[k]:
            crater[at] = np.where(own, probability[k], crater[at])
            weight[at] = np.where(own, 1.0, weight[at])
            for part, value in enumerate((u, v, np.full_like(u, np.log(radius[k]) - middle))):
                circle[part][at] = np.where(own, value, circle[part][at])
    return Target(crater, weight, circle)
