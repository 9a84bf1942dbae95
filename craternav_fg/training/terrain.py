"""Height maps with craters of all ages: the ground that the detector is trained on.

Craters of a power law of sizes fall in the order of time; between epochs the ground creeps (diffusion), so
that old craters are shallow and small ones vanish. What is left of each is measured on the final map. It
shares no code with `craternav_fg.simulation`: the detector is judged there.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.training.digging import dig, raise_hills
from craternav_fg.training.relief import fractal, relief
from factors.arrays import BoolArray, FloatArray

Float32Array = npt.NDArray[np.float32]

SIDE_PX = 1024
# Radii of the craters, px; those below the last are texture.
_LEAST_PX, _MOST_PX, _LISTED_PX = 1.3, 320.0, 3.5
_EPOCHS = 10
# More craters would bury the larger ones.
_MOST_CRATERS = 40_000
# Share of terrains with a chain of craters, and the largest number of craters in one.
_CHAIN_SHARE, _LONGEST_CHAIN = 0.3, 9
# Radius above which worn craters are older than the small ones inside, px.
_OLD_PX = 8.0
# Share of terrains with hills, and the largest number of them.
_HILL_SHARE, _MOST_HILLS = 0.4, 150
# Radius above which young craters have rays, px.
_RAYED_PX = 4.0
# Growth of the square of a rim's radius with the variance of the creep, to between the wall's end and the
# crest; and the share of their creep in the radius above which craters have vanished.
_CREST_CREEP, _MOST_CREEP = 4.0, 0.9
# Share of its rim above which a crater that later ones cut counts as buried.
_MOST_CUT = 0.5
# Sparse terrains: share of those with craters, more than their largest number, and their radii, px.
_SPARSE_SHARE, _MOST_SPARSE, _SPARSE_PX = 0.5, 32.0, (6.0, 80.0)


@dataclass(frozen=True)
class Terrain:
    """A height map and its craters.

    Attributes
    ----------
    heights : ndarray of float32, shape (SIDE_PX, SIDE_PX)
        In pixels.
    circles_px : ndarray, shape (n, 3)
        Centre x, y and radius in the image, px.
    depth_radii : ndarray, shape (n,)
        What is left of each crater's depth below its rim, in radii.
    buried : ndarray of bool, shape (n,)
        Whether a later crater took its place: the depth may be that one's.
    rays : ndarray of float32, shape (SIDE_PX, SIDE_PX)
        Brightening of the ground by the ejecta of young craters, relative: dimensionless.
    """

    heights: Float32Array
    circles_px: FloatArray
    depth_radii: FloatArray
    buried: BoolArray
    rays: Float32Array


def terrain(rng: np.random.Generator) -> Terrain:
    """Make a terrain.

    Parameters
    ----------
    rng : Generator

    Returns
    -------
    Terrain
    """
    heights = relief(rng, SIDE_PX)
    if rng.random() < _HILL_SHARE:
        raise_hills(heights, _hills(rng), rng)
    radius = _radii(rng)
    n = len(radius)
    circles = np.column_stack([_places(rng, radius), radius])
    # Most large craters are old: their creep is far longer than what a map of this resolution can follow.
    wear = np.where(rng.random(n) < rng.uniform(0.3, 0.97), rng.beta(1.5, 1.0, n), 0.0)
    worn = (wear > 0.0) & (radius > _OLD_PX)
    epoch = (_EPOCHS * rng.random(n) * np.where(worn, 1.0 - wear * rng.random(n), 1.0)).astype(np.int64)
    order = np.argsort(epoch, kind="stable")
    circles, wear, epoch = circles[order], wear[order], epoch[order]
    creep_px = 10.0 ** rng.uniform(-0.7, 0.35)
    for age in range(_EPOCHS):
        now = slice(*np.searchsorted(epoch, (age, age + 1)))
        dig(heights, circles[now], wear[now], rng)
        if age < _EPOCHS - 1:
            heights = np.asarray(cv2.GaussianBlur(heights, (0, 0), creep_px), np.float32)
    heights += np.float32(10.0 ** rng.uniform(-2.0, -0.4)) * fractal(rng, SIDE_PX, rng.uniform(0.8, 1.5))
    # Creep moves rims outwards.
    crept2 = creep_px**2 * (_EPOCHS - 1 - epoch)
    left = crept2 < (_MOST_CREEP * circles[:, 2]) ** 2
    circles[:, 2] = np.sqrt(circles[:, 2] ** 2 + _CREST_CREEP * crept2)
    young = (epoch == _EPOCHS - 1) & (wear == 0.0) & (circles[:, 2] > _RAYED_PX)
    listed = circles[left & (circles[:, 2] > _LISTED_PX)]
    return Terrain(
        heights, listed, _remaining_depth(heights, listed), _buried(listed), _rays(rng, circles[young])
    )


def sparse_terrain(rng: np.random.Generator) -> Terrain:
    """Make a terrain with few craters, or without any in half of the cases.

    Parameters
    ----------
    rng : Generator

    Returns
    -------
    Terrain
    """
    heights = relief(rng, SIDE_PX)
    count = int(np.exp(rng.uniform(0.0, np.log(_MOST_SPARSE)))) if rng.random() < _SPARSE_SHARE else 0
    radius = np.exp(rng.uniform(np.log(_SPARSE_PX[0]), np.log(_SPARSE_PX[1]), count))
    circles = np.column_stack([rng.uniform(0.0, SIDE_PX, (count, 2)), radius])
    dig(heights, circles, np.where(rng.random(count) < 0.5, rng.beta(1.5, 1.0, count), 0.0), rng)
    buried = np.zeros(count, dtype=np.bool_)
    return Terrain(heights, circles, _remaining_depth(heights, circles), buried, np.zeros_like(heights))


def _radii(rng: np.random.Generator) -> FloatArray:
    """Draw radii of a power law, 15 to 150 of 12 px and more per 800 x 800 px, and some large ones."""
    power = rng.uniform(1.8, 3.0)
    larger = 60.0 * 10.0 ** rng.uniform(-0.6, 0.4) * (SIDE_PX / 800.0) ** 2 * 12.0**power
    count = min(int(larger * _LEAST_PX**-power), _MOST_CRATERS)
    share = 1.0 - (_LEAST_PX / _MOST_PX) ** power
    small = _LEAST_PX * (1.0 - share * rng.random(count)) ** (-1.0 / power)
    large = np.exp(rng.uniform(np.log(25.0), np.log(_MOST_PX), rng.integers(0, 16)))
    return np.asarray(np.concatenate([small, large]))


def _places(rng: np.random.Generator, radius: FloatArray) -> FloatArray:
    """Draw centres (n, 2); in some terrains similar craters stand in a chain."""
    n = len(radius)
    place = rng.uniform(-0.05, 1.05, (n, 2)) * SIDE_PX
    if rng.random() < _CHAIN_SHARE:
        (like,) = np.nonzero((radius > 5.0) & (radius < 20.0))
        like = like[: rng.integers(3, _LONGEST_CHAIN + 1)]
        angle, start = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.2, 0.8, 2) * SIDE_PX
        along = np.cumsum(radius[like]) * rng.uniform(1.2, 2.2)
        place[like] = start + along[:, None] * (np.cos(angle), np.sin(angle))
    return place


def _remaining_depth(heights: Float32Array, circles_px: FloatArray) -> FloatArray:
    """Height of the rim above the floor, in radii: median of eight directions."""
    angles = np.arange(8) * np.pi / 4.0
    rings = []
    for share in (0.0, 0.3, 1.0):
        x = circles_px[:, :1] + share * circles_px[:, 2:] * np.cos(angles)
        y = circles_px[:, 1:2] + share * circles_px[:, 2:] * np.sin(angles)
        rows, columns = (np.clip(np.rint(v).astype(np.int64), 0, SIDE_PX - 1) for v in (y, x))
        rings.append(heights[rows, columns])
    floor = np.minimum(rings[0].mean(axis=1), rings[1].mean(axis=1))
    # Opposite points of the rim: a slope of the ground is no depth.
    rim = 0.5 * (rings[2][:, :4] + rings[2][:, 4:])
    return np.asarray(np.median(rim, axis=1) - floor, dtype=np.float64) / circles_px[:, 2]


def _buried(circles_px: FloatArray) -> BoolArray:
    """Which circles (n, 3), in the order of time, have lost much of their rim to later ones."""
    cut = np.zeros(len(circles_px))
    for k, (x, y, radius) in enumerate(circles_px):
        before = circles_px[:k, 2]
        off = np.maximum(np.hypot(circles_px[:k, 0] - x, circles_px[:k, 1] - y), 1e-6)
        # Cosine of half the arc that lies inside the later circle.
        cos = (before**2 + off**2 - radius**2) / (2.0 * before * off)
        arc = np.arccos(np.clip(cos, -1.0, 1.0)) / np.pi
        cut[:k] += np.where(radius > 0.3 * before, arc, 0.0)
        # One that stands inside it, and fills it, leaves a rim but no bowl.
        cut[:k] += (off < 0.4 * before) & (radius > 0.7 * before)
    return np.asarray(cut > _MOST_CUT)


def _hills(rng: np.random.Generator) -> FloatArray:
    """Draw the circles (n, 3) of hills."""
    n = rng.integers(1, _MOST_HILLS)
    radius = 3.0 * 10.0 ** rng.uniform(0.0, 1.0, n)
    return np.column_stack([rng.uniform(0.0, SIDE_PX, (n, 2)), radius])


def _rays(rng: np.random.Generator, circles_px: FloatArray) -> Float32Array:
    """Bright ejecta of some young craters."""
    out = np.zeros((SIDE_PX, SIDE_PX), np.float32)
    if not len(circles_px) or rng.random() < 0.4:
        return out
    y, x = np.mgrid[0:SIDE_PX, 0:SIDE_PX].astype(np.float32)
    for k in rng.permutation(len(circles_px))[: rng.integers(1, 6)]:
        u, v = x - circles_px[k, 0], y - circles_px[k, 1]
        r, angle = np.hypot(u, v) / circles_px[k, 2], np.arctan2(v, u)
        count, turn = rng.integers(4, 12), rng.uniform(0.0, 6.3)
        streaks = 1.0 + rng.uniform(0.0, 0.9) * np.cos(count * angle + turn)
        out += (rng.uniform(0.1, 0.6) * streaks * np.exp(-r / rng.uniform(1.0, 2.5))).astype(np.float32)
    return out
