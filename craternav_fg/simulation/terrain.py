"""Height field of the ground: relief with craters stamped into it, on nested grids around the view.

Grids lie in the gnomonic plane of the landing site (see `relief`), their points at integer multiples of
a power of two of metres: however the camera moves, a grid of one spacing always samples the same points.

Near its crest a catalogue crater is its planar ellipse and nothing else: the crest runs exactly through
the catalogue's rim, the surface there is tangent to the rim's plane, and roughness and the flanks of
smaller craters fade out quadratically within a quarter radius of it.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.crater_shape import (
    CREST,
    PEAK,
    PEAK_WIDTH,
    REACH,
    WORN_CREST,
    WORN_DEPTH,
    coverage,
    crater_profile,
    crest_height_over_centre_ground_m,
    depth_m,
    ground_levels,
    outline,
    protection,
    random_outlines,
    rim_height_m,
    roughness,
    smoothstep,
)
from craternav_fg.simulation.relief import Relief

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

# Rays are stepped as if no ground were steeper; where it is, in small craters on walls, they cut corners.
MAX_SLOPE = 0.8
# A grid lies off the middle of its view by up to this part of its half-width.
SLACK = 0.12
# Where the catalogue's heights do not fit the relief, the ground is lifted over this many radii.
LEVEL_REACH = 6.0


@dataclass(frozen=True)
class TerrainOptions:
    """How the height field is built.

    Attributes
    ----------
    cells : int
        Points along the side of a grid; even. More cover a wider view at the finest spacing.
    cell_px : float
        Spacing of the finest grid in ground pixels, at most; at least half of this.
    levels : int
        Grids at most, each twice as wide as the one before. Beyond the last the body is smooth.
    depth_scatter : float
        Floors are raised by up to this part of their depth, at random: 0 gives fresh craters only.
    irregularity : float
        RMS deviation of the rims from their ellipses, as a part of the radius.
    degradation : float
        Crests are worn round and floors filled by up to this much of what `crater_shape` allows, at random.
        The crests keep their place and height.
    peaks_from_m : float
        Craters of a larger diameter have a central peak.
    """

    cells: int = 2048
    cell_px: float = 0.5
    levels: int = 6
    depth_scatter: float = 0.35
    irregularity: float = 0.0
    degradation: float = 0.0
    peaks_from_m: float = np.inf


@dataclass(frozen=True)
class Levels:
    """Nested grids of heights, finest first.

    Attributes
    ----------
    heights_m : ndarray of float32, shape (slots, cells, cells)
        Heights over the reference sphere, rows along y.
    slots : ndarray of int, shape (n,)
        Which of `heights_m` each grid is.
    frames_m : ndarray, shape (n, 4)
        Spacing, plane coordinates x, y of its first point, the lowest height along its border, m.
    top_m : float
        No point is higher.
    slope : float
        Few slopes are steeper.
    """

    heights_m: Float32Array
    slots: IntArray
    frames_m: FloatArray
    top_m: float
    slope: float


@dataclass
class _Grid:
    """What a slot holds: spacing exponent, first point, border's lowest, highest point, steepest slope."""

    exponent: int
    first: tuple[int, int]
    border_m: float
    top_m: float
    slope: float


@njit(cache=True, nogil=True, error_model="numpy")
def _lift(
    heights: Float32Array,
    craters: FloatArray,
    offsets: FloatArray,
    far: float,
    frame: FloatArray,
    first: int,
    last: int,
) -> None:
    """Raise the rows first..last of a grid to the catalogue's level.

    By `offsets` (n,) near each crater, by `far` away from all: the same for every grid, whichever craters
    are near it, or the ground would step where two grids meet.
    """
    cell, x0, y0 = frame
    n = heights.shape[1]
    weight = np.full((last - first, n), 0.01)
    total = np.full((last - first, n), 0.01 * far)
    for k in range(craters.shape[0]):
        reach = craters[k, 19] * LEVEL_REACH / REACH
        xc, yc = craters[k, 0], craters[k, 1]
        for j in range(
            max(first, int(np.ceil((yc - reach - y0) / cell))), min(last, int((yc + reach - y0) / cell) + 1)
        ):
            for i in range(
                max(0, int(np.ceil((xc - reach - x0) / cell))), min(n, int((xc + reach - x0) / cell) + 1)
            ):
                r2 = ((x0 + i * cell - xc) ** 2 + (y0 + j * cell - yc) ** 2) / (reach * reach)
                if r2 < 1.0:
                    w = (1.0 - r2) ** 2 / (r2 + 0.03)
                    weight[j - first, i] += w
                    total[j - first, i] += w * offsets[k]
    for j in range(first, last):
        for i in range(n):
            heights[j, i] += total[j - first, i] / weight[j - first, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _stamp(
    heights: Float32Array,
    relief: Float32Array,
    craters: FloatArray,
    frame: FloatArray,
    radius_m: float,
    fade: int,
    first: int,
    last: int,
) -> None:
    """Stamp craters (n, 34), in their order, into the rows first..last of a grid.

    Those too small for the next coarser grid fade out over `fade` cells from the border.

    `heights` holds the ground with, `relief` (both (cells, cells)) without the lift to the catalogue's
    level; columns of `craters` as in `Terrain._rows`.
    """
    cell, x0, y0 = frame
    n = heights.shape[1]
    free = np.ones((last - first, n), dtype=np.float32)
    for k in range(craters.shape[0]):
        c = craters[k]
        xc, yc, a, b, height, depth, rim, reach = c[0], c[1], c[11], c[12], c[13], c[14], c[15], c[19]
        crest, peak, harmonics = c[20], c[21], c[22:]
        # The largest deviation of an outline is under the sum of its harmonics.
        widest = 1.0 + np.sum(np.abs(harmonics))
        irregular = np.any(harmonics != 0.0)
        radius = np.sqrt(a * b)
        sunk = np.isnan(height)
        base = 0.0 if sunk else height
        # A crater under two cells would only be aliased.
        if b < 2.0 * cell:
            continue
        shared = b >= 4.0 * cell
        for j in range(
            max(first, int(np.ceil((yc - reach - y0) / cell))), min(last, int((yc + reach - y0) / cell) + 1)
        ):
            y = y0 + j * cell
            for i in range(
                max(0, int(np.ceil((xc - reach - x0) / cell))), min(n, int((xc + reach - x0) / cell) + 1)
            ):
                x = x0 + i * cell
                # The direction (x, y, R) meets the rim's plane at (X, Y) of the crater's frame.
                scale = (radius_m + base) / (c[8] * x + c[9] * y + c[10] * radius_m)
                X = scale * (c[2] * x + c[3] * y + c[4] * radius_m)
                Y = scale * (c[5] * x + c[6] * y + c[7] * radius_m)
                rho2 = (X / a) ** 2 + (Y / b) ** 2
                if rho2 >= REACH * REACH * widest * widest:
                    continue
                rho = np.sqrt(rho2)
                if irregular:
                    rho /= outline(X / a, Y / b, harmonics)
                    if rho >= REACH:
                        continue
                inside = min(min(i, j), n - 1 - max(i, j)) - 4
                share = 1.0 if shared else min(max(inside / fade, 0.0), 1.0)
                if sunk:
                    low = share * coverage(rho) * (rim + crater_profile(rho, depth, rim, crest))
                    heights[j, i] += free[j - first, i] * low
                    continue
                plane = np.sqrt((radius_m + height) ** 2 + X * X + Y * Y) - radius_m
                clear = protection(rho - 1.0)
                rough = relief[j, i] - (c[16] + c[17] * (x - xc) + c[18] * (y - yc))
                target = plane + crater_profile(rho, depth, rim, crest) + roughness(rho - 1.0, rough, radius)
                if peak > 0.0:
                    target += peak * np.exp(-0.5 * (rho / PEAK_WIDTH) ** 2)
                weight = share * coverage(rho)
                # Its flank gives way to the crests already there, its own crest does not.
                own = 1.0 - smoothstep((rho - 1.1) / 0.15)
                weight *= own + (1.0 - own) * free[j - first, i]
                heights[j, i] += weight * (target - heights[j, i])
                free[j - first, i] *= 1.0 - share * (1.0 - clear)


@njit(cache=True, nogil=True, error_model="numpy")
def _extremes(heights: Float32Array, first: int, last: int) -> tuple[float, float]:
    """Highest point and the largest squared difference between neighbours in rows first..last."""
    top = -np.inf
    steep = 0.0
    for j in range(first, min(last, heights.shape[0] - 1)):
        for i in range(heights.shape[1] - 1):
            h = heights[j, i]
            d = (heights[j, i + 1] - h) ** 2 + (heights[j + 1, i] - h) ** 2
            top = max(top, h)
            steep = max(steep, d)
    return top, steep


class Terrain:
    """The ground of a landing: relief and the catalogue's craters.

    Parameters
    ----------
    catalog : Catalog
        Crests stand at its heights. Where these differ from the relief (a catalogue not made with
        `random_craters` on the same relief), the ground around each crater is lifted to fit.
        Overlapping craters are stamped largest first.
    relief : Relief
        The ground between craters; its site is the middle of the height field's map plane.
    options : TerrainOptions
        Grids.
    clutter : Catalog, optional
        Small craters sunk into the ground after the others; its heights are ignored. They fade out
        towards the crests of the catalogue.
    """

    def __init__(
        self, catalog: Catalog, relief: Relief, options: TerrainOptions, clutter: Catalog | None = None
    ) -> None:
        self.catalog = catalog
        self.relief = relief
        self.options = options
        self.body = catalog.body
        self._craters = self._rows(catalog)
        self._offsets_m = self._offsets(self._craters)
        known = self._offsets_m[~np.isnan(self._offsets_m)]
        self._lifted = bool(np.any(np.abs(known) > 1e-3))
        self._far_offset_m = float(np.median(known)) if self._lifted else 0.0
        if clutter is not None:
            small = self._rows(clutter)
            # No height of its own: it lies in whatever ground there is.
            small[:, 13] = np.nan
            self._craters = np.concatenate([self._craters, small])
            self._offsets_m = np.concatenate([self._offsets_m, np.full(len(small), np.nan)])
        slots = options.levels + 2
        self._heights = np.empty((slots, options.cells, options.cells), np.float32)
        self._grids: list[_Grid | None] = [None] * slots
        self._oldest = list(range(slots))
        self._workers = os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._workers)

    def _rows(self, catalog: Catalog) -> FloatArray:
        """Craters (n, 34) for `_stamp`, largest first.

        Columns: 0-1 centre x, y; 2-10 axes l1, l2, n in the site frame; 11-15 a, b, height, depth, crest
        over the ground; 16-18 relief at the centre and its gradient; 19 reach in the plane, all in m;
        20 half-width of the crest in radii; 21 height of the central peak, m; 22-33 harmonics of the outline.
        """
        axes = self.relief.gRs.T @ catalog.gRl
        rows = np.flatnonzero(axes[:, 2, 2] > 0.5)
        rows = rows[np.argsort(-catalog.semi_major_m[rows], kind="stable")]
        axes = axes[rows]
        a, b = catalog.semi_major_m[rows], catalog.semi_minor_m[rows]
        radius = np.sqrt(a * b)
        xy = self.relief.plane(catalog.centres[rows])
        level, gradient = self.relief.at(xy, radius)
        scatter = np.random.default_rng(self.relief.options.seed).uniform(size=len(catalog))[rows]
        depth = depth_m(radius) * (1.0 - self.options.depth_scatter * scatter)
        # Streams of their own: what is random already stays as it is.
        outlines, wear = (np.random.default_rng([self.relief.options.seed, k]) for k in (1, 2))
        harmonics = random_outlines(outlines, len(catalog), self.options.irregularity)[rows]
        worn = self.options.degradation * wear.uniform(size=len(catalog))[rows]
        depth *= 1.0 - WORN_DEPTH * worn
        out = np.zeros((len(rows), 22 + harmonics.shape[1]))
        out[:, 0:2] = xy
        out[:, 2:11] = np.swapaxes(axes, 1, 2).reshape(-1, 9)
        out[:, 11:16] = np.stack([a, b, catalog.height_m[rows], depth, rim_height_m(radius)], axis=-1)
        out[:, 16] = level
        out[:, 17:19] = gradient
        # The gnomonic plane stretches lengths by up to 1 / cos^2.
        out[:, 19] = 1.05 * REACH * a / (axes[:, 2, 2] - 2.0 * a / self.body.radius_m).clip(0.3) ** 2
        out[:, 19] *= 1.0 + np.abs(harmonics).sum(axis=1)
        out[:, 20] = CREST * (1.0 + WORN_CREST * worn)
        out[:, 21] = np.where(2.0 * radius > self.options.peaks_from_m, PEAK * depth, 0.0)
        out[:, 22:] = harmonics
        return out

    def _offsets(self, c: FloatArray) -> FloatArray:
        """How much higher the catalogue sets craters (n, 34) than the relief, m; NaN inside larger ones."""
        crest = crest_height_over_centre_ground_m(c[:, 11], c[:, 12], self.body)
        axes = np.stack([c[:, 11:12] * c[:, 2:5], c[:, 12:13] * c[:, 5:8]], axis=1)
        share, flank = ground_levels(
            np.ascontiguousarray(c[:, 8:11]),
            axes,
            np.ascontiguousarray(c[:, 14:16]),
            crest,
            np.ascontiguousarray(c[:, [0, 1, 16, 17, 18]]),
            self.body.radius_m,
            np.ascontiguousarray(c[:, 13]),
        )
        offset = (c[:, 13] - crest - flank) / np.maximum(share, 0.3) - c[:, 16]
        return np.where(share > 0.3, offset, np.nan)

    def lift_m(self, xy: FloatArray) -> float:
        """How much higher the catalogue sets the ground around a plane point (2,) than the relief, m."""
        height = np.zeros((1, 1), np.float32)
        if self._lifted:
            known = ~np.isnan(self._offsets_m)
            frame = np.array([1.0, xy[0], xy[1]])
            _lift(height, self._craters[known], self._offsets_m[known], self._far_offset_m, frame, 0, 1)
        return float(height[0, 0])

    def run(self, work: Callable[[int, int], object], n: int, chunks: int = 4) -> list[object]:
        """Run `work(first, last)` on pieces of range(n), in threads: the kernels release the lock."""
        edges = np.linspace(0, n, chunks * self._workers + 1).astype(int)
        return list(self._pool.map(work, edges[:-1], edges[1:]))

    def levels(self, low: FloatArray, high: FloatArray, nearest: FloatArray, pixel_m: float) -> Levels:
        """Grids that cover a view; those of an earlier view are used again where they still fit.

        Parameters
        ----------
        low, high : ndarray, shape (2,)
            Plane coordinates of the rectangle in view, m.
        nearest : ndarray, shape (2,)
            Point of it nearest to the camera, where the finest grid should lie.
        pixel_m : float
            Smallest ground pixel.
        """
        options = self.options
        finest = int(np.floor(np.log2(options.cell_px * pixel_m)))
        used: list[int] = []
        for exponent in range(finest, finest + options.levels):
            cell_m = 2.0**exponent
            half_m = 0.5 * options.cells * cell_m
            inner_m = (1.0 - SLACK) * half_m
            middle = 0.5 * (low + high)
            tight = np.clip(nearest, low + inner_m, np.maximum(high - inner_m, low + inner_m))
            centre = np.where(high - low > 2.0 * inner_m, tight, middle)
            used.append(self._level(exponent, centre, used))
            if np.all(high - low <= 2.0 * inner_m):
                break
        self._oldest = [s for s in self._oldest if s not in used] + used
        grids = [grid for slot in used if (grid := self._grids[slot]) is not None]
        return Levels(
            heights_m=self._heights,
            slots=np.array(used, dtype=np.int64),
            frames_m=np.array([[*self._frame(g.exponent, g.first), g.border_m] for g in grids]),
            top_m=max(g.top_m for g in grids),
            slope=min(MAX_SLOPE, max(g.slope for g in grids)),
        )

    @staticmethod
    def _frame(exponent: int, first: tuple[int, int]) -> FloatArray:
        cell_m = 2.0**exponent
        return np.array([cell_m, first[0] * cell_m, first[1] * cell_m])

    def _level(self, exponent: int, centre: FloatArray, used: list[int]) -> int:
        """Slot of the grid of this spacing around a point, built if there is none."""
        cells, cell_m = self.options.cells, 2.0**exponent
        # Few places to put a grid: it serves several frames, and an image depends on its own pose alone.
        stride = int(2.0 * SLACK * 0.5 * cells)
        i, j = (np.round(centre / cell_m / stride).astype(int) * stride - cells // 2).tolist()
        for slot, grid in enumerate(self._grids):
            if grid is not None and grid.exponent == exponent and grid.first == (i, j):
                return slot
        slot = next(s for s in self._oldest if s not in used)
        self._build(slot, exponent, (i, j))
        return slot

    def _build(self, slot: int, exponent: int, first: tuple[int, int]) -> None:
        cells, R = self.options.cells, self.body.radius_m
        frame = self._frame(exponent, first)
        fade = cells // 16
        relief = self.relief.grid(exponent, first, cells, fade)
        heights = self._heights[slot]
        heights[:] = relief
        c = self._craters
        extent = cells * frame[0]
        near: npt.NDArray[np.bool_] = np.all(
            (c[:, :2] + LEVEL_REACH * c[:, 19:20] > frame[1:])
            & (c[:, :2] - LEVEL_REACH * c[:, 19:20] < frame[1:] + extent),
            axis=1,
        )
        craters = np.ascontiguousarray(c[near])
        known = near & ~np.isnan(self._offsets_m)
        offsets = np.ascontiguousarray(self._offsets_m[known])
        if self._lifted:
            lifted, far = np.ascontiguousarray(c[known]), self._far_offset_m
            self.run(lambda lo, hi: _lift(heights, lifted, offsets, far, frame, lo, hi), cells)
        self.run(lambda lo, hi: _stamp(heights, relief, craters, frame, R, fade, lo, hi), cells)
        found = self.run(lambda lo, hi: _extremes(heights, lo, hi), cells)
        top, steep = np.array(found, dtype=np.float64).max(axis=0)
        sides = (heights[1], heights[-2], heights[:, 1], heights[:, -2])
        border_m = float(min(side.min() for side in sides))
        self._grids[slot] = _Grid(exponent, first, border_m, float(top), float(np.sqrt(steep)) / frame[0])
