"""Fractal relief of the terrain: a function of seed and position on the body, the same for every frame.

Heights are a sum of octaves of cubic B-spline noise. The lattices of all octaves lie in one gnomonic plane,
the plane that touches the sphere at the landing site. A straight line of sight is a straight line there, so
rays through the height field need no approximation of the body's curvature.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.nested_dem import NestedDem
from factors.arrays import FloatArray, IntArray

Float32Array = npt.NDArray[np.float32]

# RMS slope of unit-variance B-spline noise on a lattice of spacing 1: sqrt(int B'^2 int B^2) for the cubic
# B-spline B.
SLOPE_OF_UNIT_NOISE = float(np.sqrt(2.0 / 3.0 * 151.0 / 315.0))
# Wavelength at which `ReliefOptions.slope` holds, m.
_REFERENCE_M = 100.0
# Longest spacing at which an elevation model is sampled, as a share of its own; samples that the spline needs
# before the first point and behind the last one; number of samples that are computed at once.
_SAMPLE_SHARE, _SAMPLES_BEFORE, _SAMPLES_BEHIND, _SAMPLES_AT_ONCE = 0.4, 3, 4, 1 << 15
# Shortest octave: 2 to the power of this, m; nothing sees shorter ones.
_SHORTEST_OCTAVE = -15


class Window(NamedTuple):
    """Part of a grid: its columns from `left` to before `right`, its rows from `low` to before `high`."""

    left: int
    right: int
    low: int
    high: int


@dataclass(frozen=True)
class ReliefOptions:
    """Roughness of the terrain.

    Attributes
    ----------
    slope : float
        RMS slope that the octave of 100 m contributes along one axis; 0 gives a smooth sphere.
    hurst : float
        Hurst exponent: heights grow with the length to this power; below 1, slopes are steeper at short
        lengths.
    coarsest_m : float
        Lattice spacing of the coarsest octave, rounded down to a power of two.
    seed : int
        Seed of the lattice values.
    """

    slope: float = 0.012
    hurst: float = 0.85
    coarsest_m: float = 8192.0
    seed: int = 0


def _noise(i: IntArray, j: IntArray, octave: int, seed: int) -> Float32Array:
    """Unit-variance random numbers of lattice points, hashed from their integer coordinates."""
    h = i.astype(np.uint32) * np.uint32(0x9E3779B1)
    h = h ^ (j.astype(np.uint32) * np.uint32(0x85EBCA77))
    h = h + np.uint32((octave * 0xC2B2AE3D + seed * 0x27D4EB2F) & 0xFFFFFFFF)
    h ^= h >> np.uint32(16)
    h *= np.uint32(0x7FEB352D)
    h ^= h >> np.uint32(15)
    h *= np.uint32(0x846CA68B)
    h ^= h >> np.uint32(16)
    scale = 2.0 * np.sqrt(3.0) / 2.0**32
    return (h.astype(np.float64) * scale - np.sqrt(3.0)).astype(np.float32)


def _refine(c: Float32Array) -> Float32Array:
    """Halve the spacing of B-spline control points along axis 0 (Lane-Riesenfeld), ends dropped.

    Row 0 of the result lies at row 1 of the input.
    """
    out = np.empty((2 * (len(c) - 2), *c.shape[1:]), np.float32)
    out[0::2] = 0.125 * (c[:-2] + c[2:]) + 0.75 * c[1:-1]
    out[1::2] = 0.5 * (c[1:-1] + c[2:])
    return out


def _evaluate_half(c: Float32Array) -> Float32Array:
    """Values along axis 0 at control points and half-way between them; row 0 lies at row 1 of the input."""
    out = np.empty((2 * (len(c) - 3), *c.shape[1:]), np.float32)
    out[0::2] = (c[:-3] + c[2:-1]) * np.float32(1 / 6) + c[1:-2] * np.float32(4 / 6)
    out[1::2] = (c[:-3] + c[3:]) * np.float32(1 / 48) + (c[1:-2] + c[2:-1]) * np.float32(23 / 48)
    return out


def _control_points(values: Float32Array) -> Float32Array:
    """Control points along axis 0 of the cubic B-spline near values; row 0 lies at row 1 of the input.

    It passes through cubics exactly, and misses other curves by the fourth power of the spacing.
    """
    return (4.0 / 3.0) * values[1:-1] - (1.0 / 6.0) * (values[:-2] + values[2:])


def _spline_weights(f: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights and their derivatives (4, n) of the four control points around a fraction f (n,)."""
    g = 1.0 - f
    w = np.stack([g**3, 3 * f**3 - 6 * f**2 + 4, 3 * g**3 - 6 * g**2 + 4, f**3]) / 6.0
    d = np.stack([-3 * g**2, 9 * f**2 - 12 * f, -9 * g**2 + 12 * g, 3 * f**2]) / 6.0
    return w, d


class Relief:
    """Heights of the terrain without craters, in the gnomonic plane of the landing site.

    Plane coordinates are x east and y north at the site, m: the direction (x, y, R) of the site frame s.

    Parameters
    ----------
    body : Body
    site_g : ndarray, shape (3,)
        Any point above the landing site in g, m. The terrain is valid up to 45 deg from it.
    options : ReliefOptions
    dem : NestedDem, optional
        Elevation models to which the roughness is added.
    """

    def __init__(
        self, body: Body, site_g: FloatArray, options: ReliefOptions, dem: NestedDem | None = None
    ) -> None:
        self.body = body
        self.dem = dem
        self.options = options
        self.gRs = frames.east_north_up(*frames.latitude_longitude(np.asarray(site_g, dtype=np.float64)))
        self._coarsest = int(np.floor(np.log2(options.coarsest_m)))
        # From there on heights need few digits.
        self._site_m = float(self.base_m(np.zeros((1, 2)))[0])

    def plane(self, gP: FloatArray) -> FloatArray:
        """Project points to the gnomonic plane.

        Parameters
        ----------
        gP : ndarray, shape (..., 3)
            In g, m or unit length.

        Returns
        -------
        ndarray, shape (..., 2)
            Plane coordinates, m; NaN beyond the site's hemisphere.
        """
        s = np.asarray(gP) @ self.gRs
        depth = np.where(s[..., 2:] > 0.0, s[..., 2:], np.nan)
        return np.asarray(self.body.radius_m * s[..., :2] / depth)

    def amplitude_m(self, octave: int) -> float:
        """Return the standard deviation of the lattice values of the octave with spacing 2**octave m."""
        spacing_m = 2.0**octave
        slope = self.options.slope * (spacing_m / _REFERENCE_M) ** (self.options.hurst - 1.0)
        return float(slope * spacing_m / SLOPE_OF_UNIT_NOISE)

    def at(self, xy: FloatArray, shortest_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights and gradients at plane points, of the longer octaves only.

        Parameters
        ----------
        xy : ndarray, shape (n, 2)
            Plane coordinates, m.
        shortest_m : ndarray, shape (n,)
            Octaves with a smaller lattice spacing are left out.

        Returns
        -------
        height : ndarray, shape (n,)
            Metres.
        gradient : ndarray, shape (n, 2)
            Metres per metre of the plane.
        """
        height = np.zeros(len(xy))
        gradient = np.zeros((len(xy), 2))
        for octave in range(self._coarsest, _SHORTEST_OCTAVE - 1, -1):
            rows = np.flatnonzero(2.0**octave >= shortest_m)
            if len(rows) == 0 or self.options.slope == 0.0:
                break
            base = np.floor(xy[rows] / 2.0**octave)
            wx, dx = _spline_weights(xy[rows, 0] / 2.0**octave - base[:, 0])
            wy, dy = _spline_weights(xy[rows, 1] / 2.0**octave - base[:, 1])
            first = base.astype(np.int64) - 1
            steps = np.arange(4)[:, None]
            c = _noise(
                (first[:, 0] + steps)[None], (first[:, 1] + steps)[:, None], octave, self.options.seed
            ) * self.amplitude_m(octave)
            height[rows] += np.einsum("yxn,yn,xn->n", c, wy, wx)
            gradient[rows, 0] += np.einsum("yxn,yn,xn->n", c, wy, dx) / 2.0**octave
            gradient[rows, 1] += np.einsum("yxn,yn,xn->n", c, dy, wx) / 2.0**octave
        if self.dem is not None:
            height += self.base_m(xy)
            half_m = np.maximum(0.5 * shortest_m, 0.1 * self.dem.step_rad * self.body.radius_m)
            for axis in (0, 1):
                step = np.zeros_like(xy)
                step[:, axis] = half_m
                gradient[:, axis] += (self.base_m(xy + step) - self.base_m(xy - step)) / (2.0 * half_m)
        return height, gradient

    def base_m(self, xy: FloatArray) -> FloatArray:
        """Heights of the elevation model.

        Parameters
        ----------
        xy : ndarray, shape (n, 2)
            Plane coordinates, m.

        Returns
        -------
        ndarray, shape (n,)
            Metres; 0 without an elevation model.
        """
        if self.dem is None:
            return np.zeros(len(xy))
        s = np.concatenate([xy / self.body.radius_m, np.ones((len(xy), 1))], axis=1)
        s /= np.sqrt(np.sum(s * s, axis=1, keepdims=True))
        return self.dem.heights_m(s @ self.gRs.T)

    def grid(
        self, exponent: int, first: tuple[int, int], cells: int, fade: int, window: Window | None = None
    ) -> Float32Array:
        """Return heights on a grid: at the plane points 2**exponent * (first + index).

        Parameters
        ----------
        exponent : int
            Grid spacing 2**exponent m; the shortest octave has twice that.
        first : tuple of int
            Column and row of the first grid point.
        cells : int
            Even number of grid points along a side.
        fade : int
            The shortest octave fades out over this many cells from the border, so that a coarser
            grid continues this one without a step.
        window : Window, optional
            Part of the grid; all of it by default.

        Returns
        -------
        ndarray of float32, shape (rows, columns)
            Metres, rows along y.
        """
        part = Window(0, cells, 0, cells) if window is None else window
        heights = self._roughness(exponent, first, cells, fade, part)
        if self.dem is not None:
            heights += self._base(exponent, first, part)
        return heights

    def _base(self, exponent: int, first: tuple[int, int], window: Window) -> Float32Array:
        """Heights of the elevation model on a window of a grid: on fine ones a spline of coarser samples."""
        assert self.dem is not None
        longest = int(np.floor(np.log2(_SAMPLE_SHARE * self.dem.step_rad * self.body.radius_m)))
        halvings = max(longest - exponent, 0)
        begin = np.add(first, (window.left, window.low))
        size = np.array((window.right - window.left, window.high - window.low))
        if halvings == 0:
            return self._samples(exponent, begin, size) + np.float32(self._site_m)
        low = np.floor_divide(begin, 2**halvings) - _SAMPLES_BEFORE
        high = np.floor_divide(begin + size, 2**halvings) + _SAMPLES_BEHIND
        values = self._samples(exponent + halvings, low, high + 1 - low)
        values, low = _control_points(_control_points(values).T).T, low + 1
        for left in range(halvings, 0, -1):
            halve = _refine if left > 1 else _evaluate_half
            values, low = halve(halve(values).T).T, 2 * (low + 1)
        x, y = begin - low
        return values[y : y + size[1], x : x + size[0]] + np.float32(self._site_m)

    def _samples(self, exponent: int, first: IntArray, size: IntArray) -> Float32Array:
        """Heights of the elevation model over that at the site: at 2**exponent (first + index) m."""
        out = np.empty((size[1], size[0]), np.float32)
        x = 2.0**exponent * (first[0] + np.arange(size[0]))
        rows = max(_SAMPLES_AT_ONCE // len(x), 1)
        for low in range(0, len(out), rows):
            part = out[low : low + rows]
            y = 2.0**exponent * (first[1] + low + np.arange(len(part)))
            xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            part[:] = (self.base_m(xy) - self._site_m).reshape(part.shape)
        return out

    def _roughness(
        self, exponent: int, first: tuple[int, int], cells: int, fade: int, window: Window
    ) -> Float32Array:
        columns, rows = window.right - window.left, window.high - window.low
        if self.options.slope == 0.0 or exponent >= self._coarsest:
            return np.zeros((rows, columns), np.float32)
        begin = np.add(first, (window.left, window.low))
        # The lattice of each octave begins and ends two points beyond the window, for the splines.
        octaves = range(self._coarsest, exponent, -1)
        total: Float32Array | None = None
        lo = np.zeros(2, dtype=np.int64)
        for octave in octaves:
            step = 2 ** (octave - exponent)
            need_lo = np.floor_divide(begin, step) - 3
            need_hi = np.floor_divide(np.add(begin, (columns, rows)), step) + 4
            shape = need_hi - need_lo
            if total is None:
                total = np.zeros((int(shape[1]), int(shape[0])), np.float32)
            else:
                total = _refine(_refine(total).T).T
                cut = need_lo - 2 * (lo + 1)
                total = np.ascontiguousarray(total[cut[1] : cut[1] + shape[1], cut[0] : cut[0] + shape[0]])
            lo = need_lo
            i = lo[0] + np.arange(shape[0])
            j = lo[1] + np.arange(shape[1])
            noise = _noise(i[None, :], j[:, None], octave, self.options.seed)
            noise *= np.float32(self.amplitude_m(octave))
            if octave == exponent + 1:
                noise *= _border(i * step - first[0], cells, fade)
                noise *= _border(j * step - first[1], cells, fade)[:, None]
            total += noise
        assert total is not None
        values = _evaluate_half(_evaluate_half(total).T).T
        x0, y0 = begin - 2 * (lo + 1)
        return np.ascontiguousarray(values[y0 : y0 + rows, x0 : x0 + columns])


def _border(position: IntArray, cells: int, fade: int) -> Float32Array:
    """Weight 0 at the border of a grid, 1 from `fade` cells inside it."""
    inside = np.minimum(position - 4, cells - 5 - position)
    return np.clip(inside / fade, 0.0, 1.0).astype(np.float32)
