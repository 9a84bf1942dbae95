"""Height field of the terrain: relief and craters on nested grids around the view.

Grids lie in the gnomonic plane of the landing site (see `relief`); their points are integer multiples of a
power of two of metres. A grid of one spacing always samples the same points, however the camera moves.

The crest of a catalogue crater lies exactly on the catalogue's rim: there the surface is tangent to the rim's
plane, and roughness and the flanks of smaller craters fade out quadratically within a quarter radius of it.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.crater_shape import (
    CREST,
    DEGRADED_CREST,
    DEGRADED_DEPTH,
    PEAK,
    PEAK_WIDTH,
    REACH,
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
from factors.kernels.compiled import njit

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

# Largest slope for which rays are stepped; steeper walls of small craters are passed through at their edges.
MAX_SLOPE = 0.8
# Offset of a grid from the centre of its view, as a share of its half-width, at most.
SLACK = 0.12
# Where the catalogue's heights differ from the relief, the terrain is lifted within this many radii of a
# crater.
LEVEL_REACH = 6.0
# Catalogue and relief agree when their heights differ by less, m.
_SAME_HEIGHT_M = 1e-3
# Weight of the common lift beside that of the craters, and softening of the craters' weights near their
# centres.
_FAR_WEIGHT, _SOFTENING = 0.01, 0.03
# Smallest crater on a grid, and smallest one that the next coarser grid has as well, in cells.
_SMALLEST_CELLS, _SHARED_CELLS = 2.0, 4.0
# A crater's flank gives way to older crests from this distance on, over this width, in radii.
_OWN_REACH, _OWN_FADE = 1.1, 0.15
# A crater below the flanks of larger ones tells the lift only where this share of the relief is left.
_MIN_SHARE = 0.3
# Craters beyond 60 deg from the site are left out: the plane stretches them too much.
_SITE_COSINE = 0.5

# Columns of a crater in `_stamp`: centre x, y; axes l1, l2, n in the site frame; semi-axes, height of the
# rim's plane, depth, height of the crest over the terrain; relief at the centre and its gradient; reach in
# the plane, all in m; half-width of the crest, radii; height of the central peak, m; harmonics of the
# outline.
_X, _Y, _L1, _L2, _N = 0, 1, 2, 5, 8
_A, _B, _HEIGHT, _DEPTH, _RIM = 11, 12, 13, 14, 15
_RELIEF, _GRADIENT, _REACH, _CREST, _PEAK, _HARMONICS = 16, 17, 19, 20, 21, 22


@dataclass(frozen=True)
class TerrainOptions:
    """How the height field is built.

    Attributes
    ----------
    cells : int
        Points along the side of a grid; even. More cover a wider view at the finest spacing.
    cell_px : float
        Largest spacing of the finest grid, in pixels on the ground; the smallest is half of it.
    levels : int
        Largest number of grids, each twice as wide as the one before. Beyond the last the body is smooth.
    depth_scatter : float
        Largest share of the depth by which floors are raised at random: 0 gives fresh craters only.
    irregularity : float
        RMS deviation of the rims from their ellipses, as a share of the radius.
    degradation : float
        Largest degradation, drawn at random: crests are rounded and floors filled by this share of the most
        that `crater_shape` has. The crests keep their position and height.
    peaks_from_m : float
        Diameter from which craters have a central peak.
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
        Heights over the reference sphere, m, rows along y.
    slots : ndarray of int, shape (n,)
        Which of `heights_m` each grid is.
    frames_m : ndarray, shape (n, 4)
        Spacing, plane coordinates x, y of the first point, lowest height along the border, m.
    top_m : float
        Highest point.
    slope : float
        Steepest slope, at most `MAX_SLOPE`.
    """

    heights_m: Float32Array
    slots: IntArray
    frames_m: FloatArray
    top_m: float
    slope: float


@dataclass
class _Grid:
    """Grid in a slot: spacing exponent, first point, lowest height of the border, top, steepest slope."""

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
    """Lift the rows first..last of a grid to the catalogue's heights.

    The lift is `offsets` (n,) near each crater and `far` away from all. `far` is the same for every grid, or
    the terrain would have steps where two grids meet.
    """
    cell, x0, y0 = frame
    n = heights.shape[1]
    weight = np.full((last - first, n), _FAR_WEIGHT)
    total = np.full((last - first, n), _FAR_WEIGHT * far)
    for k in range(craters.shape[0]):
        reach = craters[k, _REACH] * LEVEL_REACH / REACH
        xc, yc = craters[k, _X], craters[k, _Y]
        for j in range(
            max(first, int(np.ceil((yc - reach - y0) / cell))), min(last, int((yc + reach - y0) / cell) + 1)
        ):
            for i in range(
                max(0, int(np.ceil((xc - reach - x0) / cell))), min(n, int((xc + reach - x0) / cell) + 1)
            ):
                r2 = ((x0 + i * cell - xc) ** 2 + (y0 + j * cell - yc) ** 2) / (reach * reach)
                if r2 < 1.0:
                    w = (1.0 - r2) ** 2 / (r2 + _SOFTENING)
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

    Craters too small for the next coarser grid fade out over `fade` cells from the border. `heights` is the
    terrain with, `relief` without the lift to the catalogue's heights, both (cells, cells).
    """
    cell, x0, y0 = frame
    n = heights.shape[1]
    free = np.ones((last - first, n), dtype=np.float32)
    for k in range(craters.shape[0]):
        c = craters[k]
        xc, yc, a, b, reach = c[_X], c[_Y], c[_A], c[_B], c[_REACH]
        height, depth, rim, crest, peak = c[_HEIGHT], c[_DEPTH], c[_RIM], c[_CREST], c[_PEAK]
        harmonics = c[_HARMONICS:]
        # An outline deviates by at most the sum of its harmonics.
        widest = 1.0 + np.sum(np.abs(harmonics))
        irregular = np.any(harmonics != 0.0)
        radius = np.sqrt(a * b)
        sunk = np.isnan(height)
        base = 0.0 if sunk else height
        # Smaller craters would only be aliased.
        if b < _SMALLEST_CELLS * cell:
            continue
        shared = b >= _SHARED_CELLS * cell
        for j in range(
            max(first, int(np.ceil((yc - reach - y0) / cell))), min(last, int((yc + reach - y0) / cell) + 1)
        ):
            y = y0 + j * cell
            for i in range(
                max(0, int(np.ceil((xc - reach - x0) / cell))), min(n, int((xc + reach - x0) / cell) + 1)
            ):
                x = x0 + i * cell
                # The direction (x, y, R) meets the rim's plane at (X, Y) of the crater's frame.
                scale = (radius_m + base) / (c[_N] * x + c[_N + 1] * y + c[_N + 2] * radius_m)
                X = scale * (c[_L1] * x + c[_L1 + 1] * y + c[_L1 + 2] * radius_m)
                Y = scale * (c[_L2] * x + c[_L2 + 1] * y + c[_L2 + 2] * radius_m)
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
                rough = relief[j, i] - (c[_RELIEF] + c[_GRADIENT] * (x - xc) + c[_GRADIENT + 1] * (y - yc))
                target = plane + crater_profile(rho, depth, rim, crest) + roughness(rho - 1.0, rough, radius)
                if peak > 0.0:
                    target += peak * np.exp(-0.5 * (rho / PEAK_WIDTH) ** 2)
                weight = share * coverage(rho)
                # The flank gives way to the crests of larger craters, the crest does not.
                own = 1.0 - smoothstep((rho - _OWN_REACH) / _OWN_FADE)
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
    """The terrain of a descent: relief and craters.

    Parameters
    ----------
    catalog : Catalog
        Its crests have its heights. Where these differ from the relief (a catalogue that was not made by
        `random_craters` on the same relief), the terrain around each crater is lifted to them. Overlapping
        craters are stamped largest first.
    relief : Relief
        Terrain between craters; its site is the origin of the map plane.
    options : TerrainOptions
    clutter : Catalog, optional
        Small craters that are added after the others; their heights are ignored. They fade out towards the
        crests of the catalogue.
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
        self._lifted = bool(np.any(np.abs(known) > _SAME_HEIGHT_M))
        self._far_offset_m = float(np.median(known)) if self._lifted else 0.0
        if clutter is not None:
            small = self._rows(clutter)
            # Clutter has no height of its own.
            small[:, _HEIGHT] = np.nan
            self._craters = np.concatenate([self._craters, small])
            self._offsets_m = np.concatenate([self._offsets_m, np.full(len(small), np.nan)])
        slots = options.levels + 2
        self._heights = np.empty((slots, options.cells, options.cells), np.float32)
        self._grids: list[_Grid | None] = [None] * slots
        self._oldest = list(range(slots))
        self._workers = os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._workers)

    def _rows(self, catalog: Catalog) -> FloatArray:
        """Craters (n, 34) for `_stamp`, largest first."""
        axes = self.relief.gRs.T @ catalog.gRl
        rows = np.flatnonzero(axes[:, 2, 2] > _SITE_COSINE)
        rows = rows[np.argsort(-catalog.semi_major_m[rows], kind="stable")]
        axes = axes[rows]
        a, b = catalog.semi_major_m[rows], catalog.semi_minor_m[rows]
        radius = np.sqrt(a * b)
        xy = self.relief.plane(catalog.centres[rows])
        level, gradient = self.relief.at(xy, radius)
        scatter = np.random.default_rng(self.relief.options.seed).uniform(size=len(catalog))[rows]
        depth = depth_m(radius) * (1.0 - self.options.depth_scatter * scatter)
        # Streams of their own: each option leaves the random numbers of the others unchanged.
        outlines, wear = (np.random.default_rng([self.relief.options.seed, k]) for k in (1, 2))
        harmonics = random_outlines(outlines, len(catalog), self.options.irregularity)[rows]
        degraded = self.options.degradation * wear.uniform(size=len(catalog))[rows]
        depth *= 1.0 - DEGRADED_DEPTH * degraded
        out = np.zeros((len(rows), _HARMONICS + harmonics.shape[1]))
        out[:, _X : _Y + 1] = xy
        out[:, _L1 : _N + 3] = np.swapaxes(axes, 1, 2).reshape(-1, 9)
        out[:, _A : _RIM + 1] = np.stack([a, b, catalog.height_m[rows], depth, rim_height_m(radius)], axis=-1)
        out[:, _RELIEF] = level
        out[:, _GRADIENT : _GRADIENT + 2] = gradient
        # The gnomonic plane stretches lengths by up to 1 / cos^2.
        out[:, _REACH] = 1.05 * REACH * a / (axes[:, 2, 2] - 2.0 * a / self.body.radius_m).clip(0.3) ** 2
        out[:, _REACH] *= 1.0 + np.abs(harmonics).sum(axis=1)
        out[:, _CREST] = CREST * (1.0 + DEGRADED_CREST * degraded)
        out[:, _PEAK] = np.where(2.0 * radius > self.options.peaks_from_m, PEAK * depth, 0.0)
        out[:, _HARMONICS:] = harmonics
        return out

    def _offsets(self, c: FloatArray) -> FloatArray:
        """Heights (n,) of craters in the catalogue over those by the relief, m; NaN inside larger ones."""
        crest = crest_height_over_centre_ground_m(c[:, _A], c[:, _B], self.body)
        axes = np.stack([c[:, [_A]] * c[:, _L1:_L2], c[:, [_B]] * c[:, _L2:_N]], axis=1)
        share, flank = ground_levels(
            np.ascontiguousarray(c[:, _N : _N + 3]),
            axes,
            np.ascontiguousarray(c[:, [_DEPTH, _RIM]]),
            crest,
            np.ascontiguousarray(c[:, [_X, _Y, _RELIEF, _GRADIENT, _GRADIENT + 1]]),
            self.body.radius_m,
            np.ascontiguousarray(c[:, _HEIGHT]),
        )
        offset = (c[:, _HEIGHT] - crest - flank) / np.maximum(share, _MIN_SHARE) - c[:, _RELIEF]
        return np.where(share > _MIN_SHARE, offset, np.nan)

    def lift_m(self, xy: FloatArray) -> float:
        """Height by which the terrain at a plane point is lifted to the catalogue's heights, m.

        Parameters
        ----------
        xy : ndarray, shape (2,)
            Plane coordinates, m.

        Returns
        -------
        float
        """
        height = np.zeros((1, 1), np.float32)
        if self._lifted:
            known = ~np.isnan(self._offsets_m)
            frame = np.array([1.0, xy[0], xy[1]])
            _lift(height, self._craters[known], self._offsets_m[known], self._far_offset_m, frame, 0, 1)
        return float(height[0, 0])

    def run(self, work: Callable[[int, int], object], n: int, chunks: int = 4) -> list[object]:
        """Run `work(first, last)` on parts of range(n) in threads; the kernels release the lock."""
        edges = np.linspace(0, n, chunks * self._workers + 1).astype(int)
        return list(self._pool.map(work, edges[:-1], edges[1:]))

    def levels(self, low: FloatArray, high: FloatArray, nearest: FloatArray, pixel_m: float) -> Levels:
        """Give grids that cover a view; those of earlier views are used again where they fit.

        Parameters
        ----------
        low, high : ndarray, shape (2,)
            Plane coordinates of the rectangle in view, m.
        nearest : ndarray, shape (2,)
            Plane coordinates of its point nearest to the camera, m: the finest grid lies there.
        pixel_m : float
            Smallest size of a pixel on the ground.

        Returns
        -------
        Levels
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
        """Slot of the grid of a spacing around a point; built if there is none."""
        cells, cell_m = self.options.cells, 2.0**exponent
        # Grids have few possible positions: one serves several frames, and an image depends on its pose
        # alone.
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
            (c[:, :2] + LEVEL_REACH * c[:, [_REACH]] > frame[1:])
            & (c[:, :2] - LEVEL_REACH * c[:, [_REACH]] < frame[1:] + extent),
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
