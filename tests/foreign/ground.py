"""Ground around a site: a height map over the tangent plane, with craters on fractal and rolling relief."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import scipy.fft

from factors.arrays import FloatArray
from tests.foreign.profiles import FAMILIES, draw_profile

MapArray = npt.NDArray[np.float32]

MOON_RADIUS_M = 1737400.0
# Blur of the map, cells: that of its last filter, and that of the slopes' differences and interpolation.
_FILTER_CELLS = 0.7
_BLUR_CELLS = float(np.sqrt(_FILTER_CELLS**2 + 1.0 / 3.0 + 1.0 / 6.0))
RING = 2.0 * np.pi * np.arange(96) / 96


@dataclass(frozen=True)
class GroundKind:
    """How ground is drawn.

    Roughness is the root mean square slope at the scale of a cell; `rolling` that of hills as large as the
    largest craters. Outlines deviate from ellipses by `outline` radii; `clutter` is the number of craters
    that no catalogue has, per catalogue crater.
    """

    roughness: float
    rolling: float
    outline: float
    wear: tuple[float, float]
    clutter: float
    albedo: float
    families: tuple[str, ...] = FAMILIES


@dataclass(frozen=True)
class Craters:
    """Catalogue craters: the ellipse of the crest in the tangent plane, and the crest's line in space."""

    centres: FloatArray
    semi_axes: FloatArray
    angles: FloatArray
    crests: FloatArray
    wear: FloatArray
    family: tuple[str, ...]


@dataclass(frozen=True)
class Ground:
    """Height map above the tangent plane, m; rows run north, columns east, (0, 0) at the corner `first`."""

    heights: MapArray
    albedo: MapArray
    cell_m: float
    craters: Craters

    @property
    def first(self) -> float:
        return -0.5 * self.cell_m * (self.heights.shape[0] - 1)


def make_ground(
    rng: np.random.Generator,
    kind: GroundKind,
    side: int,
    cell_m: float,
    sizes_m: tuple[float, float],
    count: int,
) -> Ground:
    """Draw a square map of `side` cells with `count` catalogue craters of semi-axes between `sizes_m`."""
    first = -0.5 * cell_m * (side - 1)
    heights = _relief(rng, side, cell_m, kind.roughness, 2.0 * sizes_m[1], 0.35)
    heights += _hills(rng, side, cell_m, kind.rolling, 3.0 * sizes_m[1])
    drawn = _draw_craters(rng, kind, 0.5 * cell_m * side, sizes_m, count)
    for crater in drawn:
        _stamp(rng, heights, cell_m, first, crater)
    known = [crater for crater in drawn if crater.known]
    heights = cv2.GaussianBlur(heights, (0, 0), _FILTER_CELLS)
    crests = []
    for crater in known:
        x, y = crater.ring(1.0)
        column, row = ((v - first) / cell_m for v in (x, y))
        z = cv2.remap(
            heights, column.astype(np.float32)[None], row.astype(np.float32)[None], cv2.INTER_LINEAR
        )[0]
        crests.append(np.stack([x, y, z - _drop(x, y)], axis=-1))
    line = first + cell_m * np.arange(side)
    heights -= _drop(line[None, :], line[:, None]).astype(np.float32)
    albedo = 1.0 + kind.albedo * _unit(_relief(rng, side, cell_m, 1.0, sizes_m[1], 0.35))
    return Ground(
        heights, np.clip(albedo, 0.3, 2.0).astype(np.float32), cell_m,
        Craters(
            np.array([c.centre for c in known]), np.array([c.semi_axes for c in known]),
            np.array([c.angle for c in known]), np.array(crests), np.array([c.wear for c in known]),
            tuple(c.family for c in known),
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class _Crater:
    centre: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float
    harmonics: FloatArray
    wear: float
    family: str
    known: bool

    def ring(self, scale: float) -> tuple[FloatArray, FloatArray]:
        """Ellipse of the crest, without the outline's harmonics."""
        u, v = scale * self.semi_axes[0] * np.cos(RING), scale * self.semi_axes[1] * np.sin(RING)
        c, s = np.cos(self.angle), np.sin(self.angle)
        return self.centre[0] + c * u - s * v, self.centre[1] + s * u + c * v


def _draw_craters(
    rng: np.random.Generator, kind: GroundKind, half_m: float, sizes_m: tuple[float, float], count: int
) -> list[_Crater]:
    """Old craters first. Those of the catalogue keep apart from one another, the others do not."""
    out: list[_Crater] = []
    places: list[tuple[float, float, float]] = []
    clutter = int(kind.clutter * count)
    for k in range(count + clutter):
        known = k < count
        low, high = sizes_m if known else (0.12 * sizes_m[0], 0.9 * sizes_m[0])
        power = 1.6 if known else 2.0
        a = (low**-power - rng.uniform() * (low**-power - high**-power)) ** (-1.0 / power)
        wear = rng.uniform(*kind.wear)
        for _ in range(60):
            x, y = rng.uniform(-1.0, 1.0, 2) * (half_m - (1.5 * a if known else 0.0))
            if not known or all(np.hypot(x - u, y - v) > 1.15 * (a + b) for u, v, b in places):
                break
        else:
            continue
        if known:
            places.append((x, y, a))
        orders = np.arange(3, 9)
        harmonics = (
            kind.outline * rng.normal(size=(2, len(orders))) / orders / np.sqrt(np.sum(1.0 / orders**2))
        )
        out.append(
            _Crater(
                (x, y), (a, a * rng.uniform(0.82, 1.0)), rng.uniform(0.0, np.pi), harmonics, wear,
                str(rng.choice(kind.families)), known,
            )
        )  # fmt: skip
    # A tenth of the small ones is younger than the craters of the catalogue, and lies on them.
    old = [c for c in out if not c.known]
    young = old[: len(old) // 10]
    return old[len(old) // 10 :] + sorted((c for c in out if c.known), key=lambda c: -c.wear) + young


def _stamp(rng: np.random.Generator, heights: MapArray, cell_m: float, first: float, crater: _Crater) -> None:
    """Replace the ground under a crater by the plane through its surroundings and the crater's profile."""
    a, b = crater.semi_axes
    profile = draw_profile(rng, crater.family, crater.wear, _BLUR_CELLS * cell_m / np.sqrt(a * b))
    side = heights.shape[0]
    x0, y0 = crater.centre
    low_x, low_y = (max(int((v - 2.6 * a - first) / cell_m), 0) for v in (x0, y0))
    high_x, high_y = (min(int((v + 2.6 * a - first) / cell_m) + 2, side) for v in (x0, y0))
    if min(high_x - low_x, high_y - low_y) < 3:
        return
    x, y = (
        (first + cell_m * np.arange(low, high) - at).astype(np.float32)
        for low, high, at in ((low_x, high_x, x0), (low_y, high_y, y0))
    )
    x, y = x[None, :], y[:, None]
    c, s = np.cos(crater.angle), np.sin(crater.angle)
    u, v = (c * x + s * y) / a, (c * y - s * x) / b
    rho = np.hypot(u, v)
    if crater.harmonics.any():
        angle = np.arctan2(v, u)
        for k, (p, q) in zip(range(3, 9), crater.harmonics.T, strict=True):
            rho /= 1.0 + p * np.cos(k * angle) + q * np.sin(k * angle)
    part = heights[low_y:high_y, low_x:high_x]
    ring = (rho > 0.95) & (rho < 1.25)
    if not ring.any():
        return
    xs, ys = np.broadcast_to(x, rho.shape)[ring], np.broadcast_to(y, rho.shape)[ring]
    A = np.stack([np.ones_like(xs), xs / a, ys / a], axis=-1)
    plane = np.linalg.lstsq(A, part[ring], rcond=None)[0]
    level = plane[0] + plane[1] * x / a + plane[2] * y / a
    weight = 0.9 / (1.0 + np.exp((rho - 1.15) / 0.08))
    part[:] = (1.0 - weight) * part + weight * level + np.sqrt(a * b) * profile(rho)


def _drop(x: FloatArray, y: FloatArray) -> FloatArray:
    """Depth of the sphere below the tangent plane, m."""
    return MOON_RADIUS_M - np.sqrt(MOON_RADIUS_M**2 - x * x - y * y)


def _relief(
    rng: np.random.Generator, side: int, cell_m: float, slope: float, longest_m: float, fall: float
) -> MapArray:
    """Fractal relief whose slopes have a root mean square of `slope`; rougher with a smaller `fall`."""
    spectrum = scipy.fft.rfft2(rng.standard_normal((side, side), dtype=np.float32))
    f2 = np.square(np.fft.fftfreq(side, cell_m)[:, None]) + np.square(np.fft.rfftfreq(side, cell_m)[None, :])
    f2 = f2.astype(np.float32)
    spectrum *= (f2 + np.float32(longest_m**-2.0)) ** (-1.0 - fall) * np.exp(-((2.5 * cell_m) ** 2) * f2)
    heights = np.asarray(scipy.fft.irfft2(spectrum, (side, side)), np.float32)
    found = np.sqrt(np.mean(np.diff(heights, axis=0) ** 2)) / cell_m
    return heights * np.float32(slope / found)


def _hills(rng: np.random.Generator, side: int, cell_m: float, slope: float, wave_m: float) -> MapArray:
    line = cell_m * np.arange(side)
    heights = np.zeros((side, side), dtype=np.float32)
    for _ in range(8):
        k = 2.0 * np.pi / (wave_m * rng.uniform(0.7, 2.0))
        turn, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        size = slope / (2.0 * k)
        wave = np.sin(k * (np.cos(turn) * line[None, :] + np.sin(turn) * line[:, None]) + phase)
        heights += (size * wave).astype(np.float32)
    return heights


def _unit(values: MapArray) -> MapArray:
    return np.asarray((values - values.mean()) / values.std(), np.float32)
