"""Images of the ground: rays on a height map, reflectance laws, shadows, optics and detector."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray
from tests.foreign.ground import Ground

MapArray = npt.NDArray[np.float32]
ImageArray = npt.NDArray[np.uint8]

_SAMPLES = 2
_ITERATIONS = 6


@dataclass(frozen=True)
class Optics:
    """Camera and detector: pixels, point-spread function, and what spoils the brightness."""

    side_px: int = 320
    focal_px: float = 430.0
    psf_px: float = 0.7
    gamma: float = 1.0
    jpeg: int | None = None
    vignetting: float = 0.0
    noise: float = 1.0


@dataclass(frozen=True)
class _Level:
    heights: MapArray
    east: MapArray
    north: MapArray
    albedo: MapArray
    cell_m: float


class Photographer:
    """Takes images of ground under one sun; `law` is lambert, lommel-seeliger or minnaert."""

    def __init__(self, ground: Ground, sun: FloatArray, law: str, optics: Optics) -> None:
        self.optics, self.sun, self.law = optics, sun, law
        self.first = ground.first
        north, east = np.gradient(ground.heights, ground.cell_m)
        lit = ground.albedo * _lit(ground.heights, ground.cell_m, sun)
        level = _Level(ground.heights, east, north, lit, ground.cell_m)
        self._levels = [level]
        while level.heights.shape[0] > 512:
            half = [cv2.resize(m, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for m in
                    (level.heights, level.east, level.north, level.albedo)]  # fmt: skip
            level = _Level(half[0], half[1], half[2], half[3], 2.0 * level.cell_m)
            self._levels.append(level)
        self._gain: float | None = None

    def take(self, rng: np.random.Generator, eye: FloatArray, axes: FloatArray) -> ImageArray:
        """Image from a place (3,) with camera axes (3, 3) as columns, both in the tangent frame."""
        o = self.optics
        fine = _SAMPLES * o.side_px
        line = ((np.arange(fine) + 0.5) / _SAMPLES - 0.5 - 0.5 * (o.side_px - 1)) / o.focal_px
        u, v = np.meshgrid(line.astype(np.float32), line.astype(np.float32))
        ray = np.stack([u, v, np.ones_like(u)], axis=-1) @ axes.T.astype(np.float32)
        slant = ray[..., :2] / ray[..., 2:]
        spacing_m = eye[2] / (o.focal_px * _SAMPLES)
        fit = [lv for lv in self._levels if lv.cell_m <= 1.2 * spacing_m]
        level = fit[-1] if fit else self._levels[0]
        z = np.zeros(u.shape, np.float32)
        for _ in range(_ITERATIONS):
            x, y = (eye[k] + slant[..., k] * (z - eye[2]) for k in (0, 1))
            z = self._at(level.heights, level, x, y)
        east, north, albedo = (self._at(m, level, x, y) for m in (level.east, level.north, level.albedo))
        view = -ray / np.linalg.norm(ray, axis=-1, keepdims=True)
        light = albedo * self._reflectance(east, north, view)
        light = cv2.GaussianBlur(light.astype(np.float32), (0, 0), _SAMPLES * o.psf_px) if o.psf_px else light
        light = cv2.resize(light, (o.side_px, o.side_px), interpolation=cv2.INTER_AREA)
        return self._detected(rng, light)

    def _at(self, values: MapArray, level: _Level, x: FloatArray, y: FloatArray) -> MapArray:
        # The first cell of a level is centred between those that it is the mean of.
        shift = 0.5 * (level.cell_m - self._levels[0].cell_m)
        columns, rows = (((v - self.first - shift) / level.cell_m).astype(np.float32) for v in (x, y))
        return np.asarray(cv2.remap(values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _reflectance(self, east: MapArray, north: MapArray, view: FloatArray) -> FloatArray:
        length = np.sqrt(1.0 + east * east + north * north)
        mu0 = np.maximum(self.sun[2] - east * self.sun[0] - north * self.sun[1], 0.0) / length
        mu = np.maximum(view[..., 2] - east * view[..., 0] - north * view[..., 1], 1e-3) / length
        if self.law == "lambert":
            return np.asarray(mu0)
        if self.law == "lommel-seeliger":
            return np.asarray(2.0 * mu0 / (mu0 + mu + 1e-9))
        return np.asarray(mu0**0.7 * mu**-0.3)

    def _detected(self, rng: np.random.Generator, light: FloatArray) -> ImageArray:
        o = self.optics
        if self._gain is None:
            self._gain = 110.0 / float(np.median(light))
        line = np.linspace(-1.0, 1.0, o.side_px)
        falloff = 1.0 - o.vignetting * (line[None, :] ** 2 + line[:, None] ** 2) / 2.0
        level = self._gain * light * falloff
        level = level + o.noise * np.sqrt(np.maximum(level, 0.0) / 110.0 + 0.3) * rng.standard_normal(
            light.shape
        )
        level = 255.0 * np.clip(level / 255.0, 0.0, 1.0) ** o.gamma
        image = np.asarray(np.rint(level), np.uint8)
        if o.jpeg is not None:
            packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, o.jpeg])[1]
            image = np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)
        return image


def _lit(heights: MapArray, cell_m: float, sun: FloatArray) -> MapArray:
    """1 in the sun, 0 in cast shadow, soft over a little height: the horizon by doubling steps."""
    flat = float(np.hypot(sun[0], sun[1]))
    if flat < 1e-6:
        return np.ones_like(heights)
    rows, columns = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in heights.shape), indexing="ij")
    reach, horizon = 1.0, heights - np.float32(1e3)
    while reach < heights.shape[0] / 4:
        away = [np.float32(reach * v / flat) for v in sun[:2]]
        source = heights if reach == 1.0 else np.maximum(heights, horizon)
        seen = cv2.remap(
            source, columns + away[0], rows + away[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        horizon = np.maximum(horizon, seen - np.float32(reach * cell_m * sun[2] / flat))
        reach *= 2.0
    return np.asarray(np.clip(0.5 + (heights - horizon) / np.float32(0.5 * cell_m), 0.0, 1.0), np.float32)
