"""Cross-sections of craters: four families of walls, ejecta, and wear by diffusion."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from factors.arrays import FloatArray

FAMILIES = ("polynomial", "exponential", "flat floor", "terraced")
_STEP, _LAST = 0.0025, 3.0


@dataclass(frozen=True)
class Profile:
    """Height over the distance from the centre, both in radii of the crest, which is at 1."""

    rho: FloatArray
    height: FloatArray

    def __call__(self, rho: FloatArray) -> FloatArray:
        return np.interp(rho, self.rho, self.height, right=0.0)


def draw_profile(rng: np.random.Generator, family: str, wear: float, blur: float = 0.0) -> Profile:
    """Draw a crater of a family; `wear` is 0 for a fresh one and 1 for an old one.

    Its crest is at 1 once the height map has blurred it by `blur`, in radii: a blurred crest moves outward.
    """
    rho = np.arange(0.0, _LAST, _STEP)
    depth = rng.uniform(0.3, 0.42)
    rim = rng.uniform(0.06, 0.1)
    wall = _wall(rng, family, np.minimum(rho, 1.0))
    fall = rng.uniform(2.2, 4.5)
    ejecta = rim * np.maximum(rho, 1.0) ** -fall * np.clip(2.4 - rho, 0.0, 1.0)
    height = np.where(rho < 1.0, rim - depth * (1.0 - wall), ejecta)
    # Diffusion: lower, and with a rounder crest. The mirrored branch keeps the centre flat.
    width = rng.uniform(0.008, 0.02) + 0.11 * wear * rng.uniform(0.7, 1.3)
    both = np.concatenate([height[:0:-1], height])
    height, drawn = (
        (1.0 - 0.35 * wear) * gaussian_filter1d(both, sigma / _STEP)[len(rho) - 1 :]
        for sigma in (width, np.hypot(width, blur))
    )
    crest = _crest(rho, drawn)
    return Profile(rho / crest, height / crest)


def _crest(rho: FloatArray, height: FloatArray) -> float:
    """Place of the highest point between 0.6 and 1.6: the vertex of the parabola through three samples."""
    first = int(np.searchsorted(rho, 0.6))
    i = first + int(np.argmax(height[first : int(np.searchsorted(rho, 1.6))]))
    before, here, after = height[i - 1 : i + 2]
    return float(rho[i] + 0.5 * _STEP * (before - after) / (before - 2.0 * here + after))


def _wall(rng: np.random.Generator, family: str, rho: FloatArray) -> FloatArray:
    """Height of the wall from 0 on the floor to 1 at the crest."""
    if family == "polynomial":
        mix = rng.uniform(0.0, 0.6)
        return (1.0 - mix) * rho**2 + mix * rho**4
    if family == "exponential":
        steep = rng.uniform(2.0, 3.5)
        return np.expm1(steep * rho) / np.expm1(steep)
    if family == "flat floor":
        floor = rng.uniform(0.3, 0.5)
        return np.clip((rho - floor) / (1.0 - floor), 0.0, 1.0) ** rng.uniform(1.1, 1.5)
    turns, size = rng.uniform(3.0, 4.5), rng.uniform(0.4, 0.8)
    phase = 2.0 * np.pi * turns * rho
    wall = rho**2 + size * np.sin(phase) / (2.0 * np.pi * turns)
    return wall / wall[-1]
