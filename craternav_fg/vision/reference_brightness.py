"""An image's brightness over that of level ground: exposure, albedo and what the Lunar-Lambert law misses."""

import numpy as np
import numpy.typing as npt

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.photometry import level_ground
from craternav_fg.vision.edges import noise_level

FloatArray = npt.NDArray[np.float64]

# An image has at least so many blocks along a side; fewer in all tell no quadratic.
_MIN_BLOCKS_PER_SIDE, _MIN_BLOCKS_QUADRATIC = 6, 24


class ReferenceBrightness:
    """Ratio of an image's brightness to the Lunar-Lambert law's on level ground, smooth over the image.

    A quadratic in the image coordinates through the medians of blocks, under a redescending loss:
    exposure, albedo and what the law misses of the phase angle. Where few blocks show lit ground it is the
    same all over.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : Camera
    radius_m : float
        Of the ground's sphere about the origin of g.
    gTb : ndarray, shape (4, 4)
        Predicted pose.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    block_px : int
        Side of the blocks, at most: small images have smaller ones.

    Attributes
    ----------
    noise : float
        Standard deviation of the pixels' noise.
    """

    def __init__(
        self,
        image: npt.NDArray[np.float32],
        camera: Camera,
        radius_m: float,
        gTb: FloatArray,
        sun_g: FloatArray,
        block_px: int = 32,
    ) -> None:
        self.noise = noise_level(image)
        gTc = camera.gTc(gTb)
        block_px = min(block_px, max(2 * (min(image.shape) // (2 * _MIN_BLOCKS_PER_SIDE)), 2))
        rows, columns = image.shape[0] // block_px, image.shape[1] // block_px
        blocks = image[: rows * block_px : 2, : columns * block_px : 2]
        side = block_px // 2
        blocks = blocks.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows * columns, -1)
        median = np.median(blocks, axis=1).astype(np.float64)
        centre_px = np.stack(
            np.meshgrid(
                (np.arange(columns) + 0.5) * block_px - 0.5, (np.arange(rows) + 0.5) * block_px - 0.5
            ),
            axis=-1,
        ).reshape(-1, 2)
        points = camera.normalised(centre_px)
        ground, hit = ground_points(gTc[:3, :3], gTc[:3, 3], points, radius_m)
        view = gTc[:3, 3] - ground
        view /= np.linalg.norm(view, axis=-1, keepdims=True)
        brightness, _ = level_ground(ground / np.linalg.norm(ground, axis=-1, keepdims=True), sun_g, view)
        keep = hit & (brightness > 0.02) & (median < 250.0)
        self._coefficients = np.zeros(6)
        ratio = median[keep] / brightness[keep]
        if len(ratio) >= _MIN_BLOCKS_QUADRATIC:
            self._coefficients = _robust_quadratic(_powers(points[keep]), ratio)
        elif len(ratio) > 0:
            self._coefficients[0] = np.median(ratio)

    def ratio(self, points: FloatArray) -> FloatArray:
        """Ratio (n,) at normalised image coordinates (n, 2); 0 where the image has no lit ground."""
        return np.maximum(_powers(points) @ self._coefficients, 0.0)


def _powers(points: FloatArray) -> FloatArray:
    u, v = points[:, 0], points[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _robust_quadratic(A: FloatArray, values: FloatArray) -> FloatArray:
    weight = np.ones(len(values))
    out: FloatArray = np.zeros(6)
    for _ in range(10):
        out = np.asarray(np.linalg.lstsq(A * weight[:, None], values * weight, rcond=None)[0], np.float64)
        residual = values - A @ out
        scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-12
        t = residual / (3.0 * scale)
        weight = np.where(np.abs(t) < 1.0, 1.0 - t * t, 0.0)
    return out
