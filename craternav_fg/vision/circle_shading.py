"""Shading inside given circles: how much each looks like a lit bowl, from where it is lit, and how strongly.

The same measures as those of `candidates`, at circles of any place and size.
"""

from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from craternav_fg.vision import crater_profile
from craternav_fg.vision.candidates import (
    MIN_BRIGHTNESS_STEP,
    MIN_RELATIVE_CONTRAST,
    TEMPLATE_REACH_RADII,
    Candidates,
)
from factors.arrays import FloatArray

Float32Array = npt.NDArray[np.float32]

# Samples along a side of the square around a circle, which is sampled at the resolution that gives it between
# this radius and twice as much, px.
_SIDE, _OCTAVE_RADIUS_PX = 20, 6.0
# Minimum distance from the centre, in radii, at which the canonical crater has a slope.
_LEAST_RHO = 0.02


def shaded(image: Float32Array, circles_px: FloatArray) -> Candidates:
    """Measure the shading of circles.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    circles_px : ndarray, shape (n, 3)
        Centre x, y and radius in the image.

    Returns
    -------
    Candidates
        In the order of the circles.
    """
    places, along = _template()
    u, v = places.T
    square = 0.5 * float(np.sum(along * along))
    contrast, correlation = np.zeros((len(circles_px), 2)), np.zeros(len(circles_px))
    octave = np.log2(np.maximum(circles_px[:, 2], _OCTAVE_RADIUS_PX) / _OCTAVE_RADIUS_PX).astype(np.int64)
    for level in np.unique(octave):
        shape = [max(round(n / 2.0**level), 1) for n in image.shape]
        small = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA) if level else image
        rows = octave == level
        x, y, radius = circles_px[rows].T[..., None]
        sampled = [
            (middle + radius * off + 0.5) * size / whole - 0.5
            for middle, off, size, whole in zip((y, x), (v, u), shape, image.shape, strict=True)
        ]
        value = map_coordinates(small, sampled, order=1, mode="nearest")
        mean = value.mean(axis=1, keepdims=True)
        relative = value / np.maximum(mean, MIN_BRIGHTNESS_STEP / MIN_RELATIVE_CONTRAST)
        contrast[rows] = -((relative - relative.mean(axis=1, keepdims=True)) @ along) / square
        deviation = np.sqrt(relative.var(axis=1) + 2.0 * MIN_RELATIVE_CONTRAST**2)
        explained = np.hypot(*contrast[rows].T) * np.sqrt(square / len(u))
        correlation[rows] = np.minimum(explained / deviation, 1.0)
    angle = np.arctan2(contrast[:, 1], contrast[:, 0])
    return Candidates(circles_px[:, :2], circles_px[:, 2], correlation, angle, np.hypot(*contrast.T))


@cache
def _template() -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) of the samples around the unit circle, and the canonical crater's slopes (n, 2) there."""
    side = TEMPLATE_REACH_RADII * np.linspace(-1.0, 1.0, _SIDE)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    rho = np.hypot(*places.T)
    places, rho = places[rho < TEMPLATE_REACH_RADII], rho[rho < TEMPLATE_REACH_RADII, None]
    return places, crater_profile.slopes(np.maximum(rho, _LEAST_RHO)) * places / rho
