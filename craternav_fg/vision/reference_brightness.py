"""Reference brightness of an image: that of locally flat terrain under the local illumination and view."""

from copy import copy

import numpy as np
import numpy.typing as npt

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.photometry import MCEWEN, LunarLambert, flat_terrain_brightness
from craternav_fg.vision.image_sampling import SATURATED_BRIGHTNESS, noise_level
from craternav_fg.vision.robust_scale import median, robust_sigma
from factors.arrays import FloatArray

# Reference brightness, of 255, below which the terrain is too dark to show edges.
MIN_REFERENCE_BRIGHTNESS = 6.0
# Blocks along the shorter side of an image, at least, and blocks of lit ground that determine a quadratic.
_MIN_BLOCKS_PER_SIDE, _MIN_BLOCKS_QUADRATIC = 6, 24
# Blocks count if the photometric law gives them at least this brightness, which is 1 at the zenith.
_MIN_FLAT = 0.02
# Scatter of the ground's brightness where too few blocks show it: more than images of rendered ground have.
_UNKNOWN_SCATTER = 0.1
# Least ratio to relate the scatter to, of 255.
_MIN_RATIO = 1.0
# Iterations of the robust fit, and its cut-off in standard deviations.
_ITERATIONS, _CUTOFF_SIGMAS = 10, 3.0


class ReferenceBrightness:
    """Ratio of an image's brightness to the Lunar-Lambert law's on flat terrain, smooth over the image.

    The ratio holds exposure, albedo, and what the law misses of the phase angle. It is a quadratic in the
    image coordinates, fitted robustly to the medians of blocks; a constant where too few blocks show lit
    ground.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    camera : Camera
    radius_m : float
        Radius of the ground's sphere about the origin of g.
    gTb : ndarray, shape (4, 4)
        Predicted pose of the body in g.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    block_px : int
        Largest side of the blocks; small images have smaller ones.

    Attributes
    ----------
    noise : float
        Standard deviation of the pixel noise.
    scatter : float
        Standard deviation of the blocks' brightness about it, relative to it: slopes and albedo of the ground
        at the size of a block.
    law : LunarLambert
        The ground's photometric law: McEwen's, until another is known.
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
        brightness = median(blocks).astype(np.float64)
        x_px, y_px = ((np.arange(n) + 0.5) * block_px - 0.5 for n in (columns, rows))
        points = camera.normalised(np.stack(np.meshgrid(x_px, y_px), axis=-1).reshape(-1, 2))
        ground, hit = ground_points(gTc[:3, :3], gTc[:3, 3], points, radius_m)
        view = gTc[:3, 3] - ground
        view /= np.linalg.norm(view, axis=-1, keepdims=True)
        normals = ground / np.linalg.norm(ground, axis=-1, keepdims=True)
        self._blocks = points, normals, sun_g, view, hit, brightness
        self._fit(MCEWEN)

    def under(self, law: LunarLambert) -> "ReferenceBrightness":
        """Return that of ground with another photometric law."""
        out = copy(self)
        out._fit(law)
        return out

    def _fit(self, law: LunarLambert) -> None:
        points, normals, sun_g, view, hit, brightness = self._blocks
        self.law = law
        flat, _ = flat_terrain_brightness(normals, sun_g, view, law)
        keep = hit & (flat > _MIN_FLAT) & (brightness < SATURATED_BRIGHTNESS)
        self._coefficients = np.zeros(6)
        self.scatter = _UNKNOWN_SCATTER
        ratio = brightness[keep] / flat[keep]
        if len(ratio) >= _MIN_BLOCKS_QUADRATIC:
            self._coefficients = _robust_quadratic(_powers(points[keep]), ratio)
            self.scatter = robust_sigma(ratio / np.maximum(self.ratio(points[keep]), _MIN_RATIO) - 1.0)
        elif len(ratio) > 0:
            self._coefficients[0] = median(ratio)

    def ratio(self, points: FloatArray) -> FloatArray:
        """Compute the ratio of the image's brightness to that of the photometric law.

        Parameters
        ----------
        points : ndarray, shape (n, 2)
            Normalised image coordinates.

        Returns
        -------
        ndarray, shape (n,)
            0 where the image has no lit ground.
        """
        return np.maximum(_powers(points) @ self._coefficients, 0.0)


def _powers(points: FloatArray) -> FloatArray:
    u, v = points[:, 0], points[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _robust_quadratic(A: FloatArray, values: FloatArray) -> FloatArray:
    # Columns of like size, for the normal equations: a narrow field of view has small squares.
    size = np.abs(A).max(axis=0)
    size[size == 0.0] = 1.0
    # A row each: numpy's inner loops are as long as there are blocks.
    rows = np.ascontiguousarray((A / size).T)
    weight2 = np.ones(len(values))
    out: FloatArray = np.zeros(6)
    for _ in range(_ITERATIONS):
        weighted = rows * weight2
        # Of least norm where all blocks that count lie on a line.
        out = np.asarray(np.linalg.lstsq(weighted @ rows.T, weighted @ values, rcond=None)[0], np.float64)
        residual = values - out @ rows
        scale = robust_sigma(residual) + 1e-12
        t = residual / (_CUTOFF_SIGMAS * scale)
        weight2 = np.maximum(1.0 - t * t, 0.0) ** 2
    return out / size
