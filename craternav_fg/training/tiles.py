"""Tiles that a step of the training sees: rendered, of several levels, with what is known of them."""

from collections import deque
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.training.light import photograph
from craternav_fg.training.targets import Target, marking, target
from craternav_fg.training.terrain import SIDE_PX, Terrain, terrain
from craternav_fg.vision.pyramid import STRIDE_PX, level, normalised

Float32Array = npt.NDArray[np.float32]

TILE_PX = 256
# Tiles of each level of an image's pyramid that a step sees.
_TILES = (6, 3, 1, 1)
# Terrains from which the images of a step are taken, steps between new ones, and images of a step.
_POOL, _NEW_EVERY, _IMAGES = 16, 4, 2
# Directions towards the sun: within a quarter turn about the right, and a margin.
_MOST_SUN_RAD = np.deg2rad(58.0)


class Tiles(NamedTuple):
    """Tiles and what is known of their cells; n tiles.

    Attributes
    ----------
    inputs : ndarray of float32, shape (n, TILE_PX, TILE_PX)
        See `pyramid.normalised`.
    targets : list of Target
        One for each tile.
    """

    inputs: Float32Array
    targets: list[Target]


class TileMaker:
    """Makes the tiles of one step after another; each step's are determined by seed and number.

    Parameters
    ----------
    seed : int
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._pool: deque[Terrain] = deque(maxlen=_POOL)

    def tiles(self, step: int) -> Tiles:
        """Make the tiles of a step: the first asked for, or that after the last.

        Parameters
        ----------
        step : int

        Returns
        -------
        Tiles
        """
        newest = step // _NEW_EVERY
        if not self._pool:
            first = max(newest - _POOL + 1, 0)
            self._pool.extend(self._terrain(k) for k in range(first, newest + 1))
        elif step % _NEW_EVERY == 0:
            self._pool.append(self._terrain(newest))
        rng = np.random.default_rng([self._seed, 1, step])
        # One image is of the newest terrain, which has been seen least, the others are of any.
        chosen = [len(self._pool) - 1, *rng.integers(0, len(self._pool), _IMAGES - 1)]
        parts = [cut_tiles(rng, self._pool[int(k)]) for k in chosen]
        return Tiles(
            np.concatenate([part.inputs for part in parts]),
            [known for part in parts for known in part.targets],
        )

    def _terrain(self, number: int) -> Terrain:
        return terrain(np.random.default_rng([self._seed, 0, number]))


def cut_tiles(rng: np.random.Generator, ground: Terrain) -> Tiles:
    """Photograph a terrain, and cut tiles from the levels of its pyramid.

    Parameters
    ----------
    rng : Generator
    ground : Terrain

    Returns
    -------
    Tiles
    """
    photo = photograph(rng, ground, float(rng.uniform(-_MOST_SUN_RAD, _MOST_SUN_RAD)))
    probability = marking(ground, photo)
    cells = TILE_PX // STRIDE_PX
    inputs, targets = [], []
    for number, count in enumerate(_TILES):
        values = normalised(level(photo.image.astype(np.float32), number))
        circles = ground.circles_px / 2.0**number
        circles[:, :2] += 0.5 / 2.0**number - 0.5
        spare = max(SIDE_PX // 2**number - TILE_PX, 0)
        for _ in range(count):
            x, y = rng.integers(0, spare // STRIDE_PX + 1, 2) * STRIDE_PX
            tile = np.zeros((TILE_PX, TILE_PX), np.float32)
            part = values[y : y + TILE_PX, x : x + TILE_PX]
            tile[: part.shape[0], : part.shape[1]] = part
            known = target(circles - (x, y, 0.0), probability, (cells, cells))
            known.weight[part.shape[0] // STRIDE_PX :] = 0.0
            known.weight[:, part.shape[1] // STRIDE_PX :] = 0.0
            inputs.append(tile)
            targets.append(known)
    return Tiles(np.stack(inputs), targets)
