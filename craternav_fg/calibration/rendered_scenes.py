"""Single images of rendered ground whose rims are known, of ground without any, and of noise."""

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.body import ground_points
from craternav_fg.simulation.empty_images import noise_images
from craternav_fg.simulation.render import RenderOptions
from craternav_fg.simulation.scenes import HARD, IRREGULAR, Ground, Scene, scene
from factors.arrays import FloatArray

Image = npt.NDArray[np.uint8]

SMOOTH = Ground()
# Rough ground that has no craters.
EMPTY = Ground(density=1e-9, slope=0.03)
GROUNDS = (SMOOTH, IRREGULAR, HARD)
SCENES = 12
# The front end was set up with seeds 200 to 530.
_FIRST_SEED, _SEEDS = 200, 100
# Patches of other brightness: smallest and largest standard deviation, over the brightness, and size, px.
_TEXTURE, _GRAIN_PX = (0.05, 0.1), (1.5, 3.0)
_NOISE_SIZE_PX = 1024
_FULL_SCALE = 255.0


@cache
def scenes(ground: Ground) -> tuple[Scene, ...]:
    """Render scenes of one kind of ground: some ten seconds, once in a process."""
    kind = (*GROUNDS, EMPTY).index(ground)
    first = _FIRST_SEED + _SEEDS * kind
    return tuple(scene(seed, ground) for seed in range(first, first + SCENES))


def textured(one: Scene, rng: np.random.Generator) -> Image:
    """Return a scene's image with patches of brighter and darker ground."""
    grain = cv2.GaussianBlur(rng.normal(size=one.image.shape), (0, 0), rng.uniform(*_GRAIN_PX))
    share = rng.uniform(*_TEXTURE) * np.asarray(grain) / np.std(grain)
    return np.clip(np.rint(one.image * (1.0 + share)), 0.0, _FULL_SCALE).astype(np.uint8)


def noise(rng: np.random.Generator) -> Iterator[Image]:
    """Return images of noise."""
    return noise_images(rng, _NOISE_SIZE_PX)


def true_reference_brightness(one: Scene) -> FloatArray:
    """Compute the brightness that level ground has at the wanted rims of a scene.

    Parameters
    ----------
    one : Scene

    Returns
    -------
    ndarray, shape (n,)
        0 to 255.
    """
    light = RenderOptions()
    gTc = one.camera.gTc(one.gTb)
    # The image's exposure is that of the site, which the camera looks at.
    site, _ = ground_points(gTc[:3, :3], gTc[:3, 3], np.zeros((1, 2)), one.catalog.body.radius_m)
    rows = one.craters[one.wanted]
    normals = np.concatenate([one.catalog.normals[rows], site / np.linalg.norm(site)])
    view = gTc[:3, 3] - one.catalog.centres[rows]
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    mu0 = normals @ one.sun_g
    mu = np.append(np.sum(normals[:-1] * view, axis=1), 1.0)
    law = mu0 * (2.0 * light.lunar_lambert / (mu0 + mu) + 1.0 - light.lunar_lambert)
    return np.asarray(_FULL_SCALE * light.flat_level_share * law[:-1] / law[-1])
