"""Examples for the judgement of candidates: what the detector finds on rendered ground, and what it is."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.training.scenes import Ground
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import Candidates, local_sun_angles
from craternav_fg.vision.judge import features
from craternav_fg.vision.learned import SUN_REACH_SHARE, LearnedOptions, lit_candidates

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

# Share of its depth that a crater keeps when people mark it, and below which nobody does; between them it is
# no example.
MARKED, ERASED = 0.25, 0.07
# A candidate is a crater's if its centre is within half a radius and 1 px, and its radius within this factor.
_CENTRE_SHARE, _CENTRE_PX, _SIZE_FACTOR = 0.5, 1.0, 1.5
# Largest error of the direction towards the sun that is a usable scene, rad.
_SUN_ERROR_RAD = np.deg2rad(30.0)


class Examples(NamedTuple):
    """Examples to train the network on.

    Attributes
    ----------
    inputs : ndarray of float32, shape (n, k)
        See `judge.features`, dimensionless.
    wanted : ndarray, shape (n,)
        Probabilities: 1 for a crater, 0 for none.
    """

    inputs: Float32Array
    wanted: FloatArray


def examples(ground: Ground) -> Examples | None:
    """Collect the examples of a scene.

    Parameters
    ----------
    ground : Ground

    Returns
    -------
    Examples or None
        None when the image does not show the direction towards the sun.
    """
    image, _ = filled(brightness(ground.image))
    candidates, vote = lit_candidates(image, None, LearnedOptions())
    off = np.angle(np.exp(1j * (vote.sun_angle_rad - ground.sun_angle_rad)))
    if not abs(off) < _SUN_ERROR_RAD or not len(candidates):
        return None
    marked, doubtful = ground.freshness > MARKED, (ground.freshness > ERASED) & (ground.freshness <= MARKED)
    wanted = _first_of_each(candidates, ground.circles_px[marked])
    near = _any_near(candidates, ground.circles_px[marked | doubtful])
    sun = local_sun_angles(candidates, SUN_REACH_SHARE * max(image.shape))
    usable = wanted | ~near
    return Examples(features(image, candidates, sun)[usable], wanted[usable].astype(np.float64))


def _agree(candidates: Candidates, circles_px: FloatArray) -> BoolArray:
    """Which candidates may be which circles, (candidates, circles)."""
    off = np.linalg.norm(candidates.xy_px[:, None] - circles_px[None, :, :2], axis=-1)
    size = np.abs(np.log(candidates.radius_px[:, None] / circles_px[None, :, 2]))
    return np.asarray((off < _CENTRE_SHARE * circles_px[:, 2] + _CENTRE_PX) & (size < np.log(_SIZE_FACTOR)))


def _first_of_each(candidates: Candidates, circles_px: FloatArray) -> BoolArray:
    """Mask (n,) of the best candidate of each circle; each candidate stands for one."""
    agree, free = _agree(candidates, circles_px), np.ones(len(circles_px), dtype=np.bool_)
    out = np.zeros(len(candidates), dtype=np.bool_)
    for k, row in enumerate(agree):
        (open_,) = np.nonzero(row & free)
        if len(open_):
            off = np.linalg.norm(circles_px[open_, :2] - candidates.xy_px[k], axis=1) / circles_px[open_, 2]
            free[open_[int(np.argmin(off))]] = False
            out[k] = True
    return out


def _any_near(candidates: Candidates, circles_px: FloatArray) -> BoolArray:
    """Mask (n,) of the candidates that may be some circle."""
    return np.asarray(_agree(candidates, circles_px).any(axis=1))
