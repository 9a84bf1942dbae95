"""Photographs of a height map: sun, cast shadows, albedo, and what camera and archive do to the image."""

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.training.relief import fractal
from craternav_fg.training.terrain import SIDE_PX, Terrain
from factors.arrays import BoolArray

Float32Array = npt.NDArray[np.float32]
ImageArray = npt.NDArray[np.uint8]

# Slope of the ground below which a shadow's border is noise, in px of height.
_SHADOW_MARGIN_PX = 0.2
# Height above which a terrain of any roughness casts no longer shadow than the map, px.
_LONGEST_SHADOW_PX = 512


class Photograph(NamedTuple):
    """An image of a terrain.

    Attributes
    ----------
    image : ndarray of uint8, shape (SIDE_PX, SIDE_PX)
    lit : ndarray of bool, shape (SIDE_PX, SIDE_PX)
        False in shadow.
    elevation_rad : float
        Of the sun above the horizon.
    """

    image: ImageArray
    lit: BoolArray
    elevation_rad: float


def photograph(rng: np.random.Generator, ground: Terrain, sun_angle_rad: float) -> Photograph:
    """Take an image of a terrain from above.

    Parameters
    ----------
    rng : Generator
        Draws the height of the sun, the albedo, and what camera and archive do.
    ground : Terrain
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.

    Returns
    -------
    Photograph
    """
    low_sun = rng.random() < 0.7
    elevation_rad = np.radians(rng.uniform(4.0, 40.0) if low_sun else rng.uniform(40.0, 82.0))
    light = lit(ground.heights * np.float32(rng.uniform(0.7, 1.2)), sun_angle_rad, elevation_rad, rng)
    shown = light > 0.0
    albedo = rng.uniform(0.0, 0.1) * fractal(rng, SIDE_PX, rng.uniform(1.0, 1.8))
    light *= np.exp(albedo) * (1.0 + np.float32(rng.uniform(0.0, 1.0)) * ground.rays)
    return Photograph(_archived(rng, light), shown, float(elevation_rad))


def lit(
    heights: Float32Array, sun_angle_rad: float, elevation_rad: float, rng: np.random.Generator
) -> Float32Array:
    """Compute how bright ground is under the sun, with cast shadows.

    Parameters
    ----------
    heights : ndarray of float32, shape (H, W)
        In pixels.
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.
    elevation_rad : float
        Of the sun above the horizon.
    rng : Generator
        Draws the share of the two laws, Lommel-Seeliger's and Lambert's.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Relative to full light.
    """
    x, y = np.cos(sun_angle_rad), np.sin(sun_angle_rad)
    gx = cv2.Scharr(heights, cv2.CV_32F, 1, 0) / 32.0
    gy = cv2.Scharr(heights, cv2.CV_32F, 0, 1) / 32.0
    mu = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
    towards = np.float32(x) * gx + np.float32(y) * gy
    mu0 = np.maximum(
        (np.float32(np.sin(elevation_rad)) - towards * np.float32(np.cos(elevation_rad))) * mu, 0
    )
    share = np.float32(rng.uniform(0.2, 0.9))
    light = share * 2.0 * mu0 / (mu0 + mu + 1e-6) + (1.0 - share) * mu0
    # Highest ray towards the sun, by steps that double: along it the height falls by tan(elevation) per px.
    highest, step = heights, 1.0
    while step < _LONGEST_SHADOW_PX:
        move = np.array([[1.0, 0.0, step * x], [0.0, 1.0, step * y]])
        ahead = cv2.warpAffine(
            highest, move, heights.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT, borderValue=-1e6,
        )  # fmt: skip
        highest = np.maximum(highest, ahead - np.float32(step * np.tan(elevation_rad)))
        step *= 2.0
    light[highest > heights + _SHADOW_MARGIN_PX] = 0.0
    return np.asarray(light, dtype=np.float32)


def _archived(rng: np.random.Generator, light: Float32Array) -> ImageArray:
    """Blur, stretch, clip, grain, quantise and compress."""
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), rng.uniform(0.4, 1.3)), np.float32)
    if rng.random() < 0.1:
        light = np.asarray(cv2.blur(light, (1, int(rng.integers(2, 5)))), np.float32)
    sample = light[::4, ::4]
    if rng.random() < 0.5:
        # By the light of level ground, as of a whole strip: walls saturate.
        middle = float(np.median(sample))
        low, high = 0.0, max(middle, 0.05) * rng.uniform(1.4, 3.5)
    else:
        low, high = np.percentile(sample, [rng.uniform(0.0, 3.0), rng.uniform(96.0, 100.0)])
    grey = (light - low) / (high - low + 1e-6)
    if rng.random() < 0.5:
        black = rng.uniform(0.0, 0.25)
        grey = black + (0.97 - black) * grey
    grey = 255.0 * np.clip(grey, 0.0, 1.0) ** rng.uniform(0.7, 1.4)
    grain = rng.standard_normal(grey.shape, np.float32)
    if rng.random() < 0.3:
        grain = 2.0 * cv2.GaussianBlur(grain, (0, 0), 0.7)
    grey += grain * 10.0 ** rng.uniform(-0.5, 1.1)
    image = np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)
    if rng.random() < 0.4:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(50, 97))]
        decoded = cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_GRAYSCALE)
        image = np.asarray(decoded, np.uint8)
    return image.reshape(SIDE_PX, SIDE_PX)
