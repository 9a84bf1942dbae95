"""Images without any crater, in which a detector must find none."""

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]

# Correlation length of the noise, px: from white (0) to as coarse as craters; one image of each.
_GRAIN_PX = (
    0.0, 0.0, 0.0, 0.0, 0.7, 1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0, 20.0, 30.0,
)  # fmt: skip
# Standard deviation of the noise, grey levels, in turns.
_NOISE_SIGMAS = (4.0, 12.0, 25.0)
_GRADIENT_IMAGES = 20


def noise_images(rng: np.random.Generator, size_px: int = 320) -> Iterator[Image]:
    """Return 20 images of noise from white to as coarse as craters, every other one with sensor noise.

    Parameters
    ----------
    rng : Generator
    size_px : int
        Side of the images.

    Yields
    ------
    ndarray of uint8, shape (size_px, size_px)
    """
    for k, grain_px in enumerate(_GRAIN_PX):
        noise = rng.normal(size=(size_px, size_px))
        if grain_px > 0.0:
            noise = cv2.GaussianBlur(noise, (0, 0), grain_px).astype(np.float64)
        image = 100.0 + _NOISE_SIGMAS[k % 3] * noise / noise.std() + (k % 2) * rng.normal(size=noise.shape)
        yield np.clip(np.rint(image), 0, 255).astype(np.uint8)


def gradient_images(rng: np.random.Generator, size_px: int = 320) -> Iterator[Image]:
    """Return 20 planes, bowls, saddles and waves larger than the image, some with sensor noise.

    Parameters
    ----------
    rng : Generator
    size_px : int
        Side of the images.

    Yields
    ------
    ndarray of uint8, shape (size_px, size_px)
    """
    y, x = np.mgrid[0:size_px, 0:size_px] / size_px
    for k in range(_GRADIENT_IMAGES):
        c = rng.normal(size=6)
        height = c[0] * x + c[1] * y
        if k % 4:
            height = height + c[2] * x * x + c[3] * x * y + c[4] * y * y
        if k % 4 == 3:
            height = height + c[5] * np.sin(5.0 * x + 3.0 * y)
        height = (height - height.min()) / np.ptp(height)
        image = 20.0 + (200.0 if k % 2 else 60.0) * height + (k % 3 == 1) * rng.normal(size=x.shape)
        yield np.clip(np.rint(image), 0, 255).astype(np.uint8)
