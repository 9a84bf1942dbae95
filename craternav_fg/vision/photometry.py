"""How bright level ground is, and how a slope changes it: the Lunar-Lambert law.

I = 2 L mu0 / (mu0 + mu) + (1 - L) mu0, mu0 and mu the cosines of incidence and emission, L falling
with the phase angle (McEwen 1991, Icarus 92, 298).
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.vision.edges import noise_level

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# An image has at least so many blocks along a side; fewer in all tell no quadratic.
_BLOCKS, _MIN_BLOCKS = 6, 24


def lunar_lambert_share(phase_rad: FloatArray) -> FloatArray:
    """Share L of the Lommel-Seeliger term at a phase angle, McEwen's cubic."""
    g = np.rad2deg(phase_rad)
    return np.asarray(np.clip(1.0 - 0.019 * g + 2.42e-4 * g**2 - 1.46e-6 * g**3, 0.0, 1.0))


def level_ground(normals: FloatArray, sun: FloatArray, view: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Brightness of level ground and the slope's effect on it.

    Parameters
    ----------
    normals : ndarray, shape (n, 3)
        Outward unit normals of the ground.
    sun : ndarray, shape (3,)
        Unit vector towards the sun, same frame.
    view : ndarray, shape (n, 3)
        Unit vectors from the ground to the camera.

    Returns
    -------
    brightness : ndarray, shape (n,)
        Of level ground, up to a common factor; 0 where the sun is down.
    gain : ndarray, shape (n, 3)
        Tangent vectors G = (dI/dmu0 s + dI/dmu v) / I: a height gradient grad h changes the
        brightness by the share -G . grad h. Zero where the sun is down.
    """
    mu0 = normals @ sun
    mu = np.sum(normals * view, axis=-1)
    lit = (mu0 > 0.01) & (mu > 0.01)
    m0, m = np.where(lit, mu0, 1.0), np.where(lit, mu, 1.0)
    share = lunar_lambert_share(np.arccos(np.clip(view @ sun, -1.0, 1.0)))
    total = m0 + m
    brightness = 2.0 * share * m0 / total + (1.0 - share) * m0
    d0 = 2.0 * share * m / total**2 + (1.0 - share)
    d1 = -2.0 * share * m0 / total**2
    s_t = sun - mu0[:, None] * normals
    v_t = view - mu[:, None] * normals
    gain = (d0[:, None] * s_t + d1[:, None] * v_t) / brightness[:, None]
    return np.where(lit, brightness, 0.0), np.where(lit[:, None], gain, 0.0)


def ground_points(
    gRc: FloatArray, gPc: FloatArray, points: FloatArray, radius_m: float
) -> tuple[FloatArray, BoolArray]:
    """Where lines of sight meet the sphere.

    Parameters
    ----------
    gRc, gPc : ndarray, shape (3, 3) and (3,)
        Pose of the camera in g.
    points : ndarray, shape (n, 2)
        Normalised image coordinates.
    radius_m : float
        Of the sphere about the origin of g.

    Returns
    -------
    ground : ndarray, shape (n, 3)
        The nearer intersections in g; the point nearest to the sphere where there is none.
    hit : ndarray of bool, shape (n,)
        Whether the line meets the sphere ahead of the camera.
    """
    rays = np.concatenate([points, np.ones((len(points), 1))], axis=-1) @ gRc.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ gPc)
    off2 = gPc @ gPc - along**2
    root2 = radius_m**2 - off2
    hit = (root2 > 0.0) & (along > 0.0)
    range_m = along - np.sqrt(np.maximum(root2, 0.0))
    return gPc + range_m[:, None] * rays, np.asarray(hit)


class LevelMap:
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
        block_px = min(block_px, max(2 * (min(image.shape) // (2 * _BLOCKS)), 2))
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
        if len(ratio) >= _MIN_BLOCKS:
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
