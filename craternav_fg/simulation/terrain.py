"""Height field of the terrain: relief and craters on nested grids around the view.

Grids lie in the gnomonic plane of the landing site (see `relief`); their points are integer multiples of a
power of two of metres. A grid of one spacing always samples the same points, however the camera moves.

The crest of a catalogue crater lies exactly on the catalogue's rim: there the surface is level across
it, and roughness and the flanks of smaller craters fade out quadratically within a quarter radius of it.
"""

import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.crater_shape import (
    CREST,
    DEGRADED_CREST,
    DEGRADED_DEPTH,
    PEAK,
    REACH,
    crest_height_over_centre_ground_m,
    depth_m,
    ground_levels,
    random_outlines,
    rim_height_m,
)
from craternav_fg.simulation.relief import Relief, Window
from craternav_fg.simulation.stamping import (
    COL_A,
    COL_B,
    COL_CREST,
    COL_DEPTH,
    COL_GRADIENT,
    COL_HARMONICS,
    COL_HEIGHT,
    COL_L1,
    COL_L2,
    COL_N,
    COL_PEAK,
    COL_REACH,
    COL_RELIEF,
    COL_RIM,
    COL_X,
    COL_Y,
    LEVEL_REACH,
    extremes,
    lift,
    stamp,
)
from factors.arrays import FloatArray, IntArray

Float32Array = npt.NDArray[np.float32]

# Largest slope for which rays are stepped; steeper walls of small craters are passed through at their edges.
MAX_SLOPE = 0.8
# Offset of a grid from the centre of its view, as a share of its half-width, at most.
SLACK = 0.12
# Catalogue and relief agree when their heights differ by less, m.
_SAME_HEIGHT_M = 1e-3
# A crater below the flanks of larger ones tells the lift only where this share of the relief is left.
_MIN_SHARE = 0.3
# The shortest octave and the smallest craters fade out over this share of a grid from its border; further
# inside by `_BORDER` cells, heights do not depend on where the border is.
_FADES, _BORDER = 16, 16
# Views whose grids are in use at the same time, at most: what one waits for, the other has time to do.
VIEWS_AT_ONCE = 2
# Parts into which a whole grid, or the rays of an image, are divided among threads.
_PARTS = 8
# Craters beyond 60 deg from the site are left out: the plane stretches them too much.
_SITE_COSINE = 0.5


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
    depth_scatter_share : float
        Largest share of the depth by which floors are raised at random: 0 gives fresh craters only.
    irregularity_share : float
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
    depth_scatter_share: float = 0.35
    irregularity_share: float = 0.0
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
    frames_m : ndarray, shape (n, 5)
        Spacing, plane coordinates x, y of the first point, lowest height along the border, m; cells per m.
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
            small[:, COL_HEIGHT] = np.nan
            self._craters = np.concatenate([self._craters, small])
            self._offsets_m = np.concatenate([self._offsets_m, np.full(len(small), np.nan)])
        slots = max(VIEWS_AT_ONCE * options.levels, options.levels + 2)
        self._heights = np.empty((slots, options.cells, options.cells), np.float32)
        self._grids: list[_Grid | None] = [None] * slots
        self._oldest = list(range(slots))
        self._pool = ThreadPoolExecutor(os.cpu_count() or 1)
        self._building = threading.Lock()
        # How many views use each slot.
        self._in_use: Counter[int] = Counter()

    def _rows(self, catalog: Catalog) -> FloatArray:
        """Craters (n, 34) for `stamping.stamp`, largest first."""
        axes = self.relief.gRs.T @ catalog.gRl
        rows = np.flatnonzero(axes[:, 2, 2] > _SITE_COSINE)
        rows = rows[np.argsort(-catalog.semi_major_m[rows], kind="stable")]
        axes = axes[rows]
        a, b = catalog.semi_major_m[rows], catalog.semi_minor_m[rows]
        radius = np.sqrt(a * b)
        xy = self.relief.plane(catalog.centres[rows])
        level, gradient = self.relief.at(xy, radius)
        scatter = np.random.default_rng(self.relief.options.seed).uniform(size=len(catalog))[rows]
        depth = depth_m(radius) * (1.0 - self.options.depth_scatter_share * scatter)
        # Streams of their own: each option leaves the random numbers of the others unchanged.
        outlines, wear = (np.random.default_rng([self.relief.options.seed, k]) for k in (1, 2))
        harmonics = random_outlines(outlines, len(catalog), self.options.irregularity_share)[rows]
        degraded = self.options.degradation * wear.uniform(size=len(catalog))[rows]
        depth *= 1.0 - DEGRADED_DEPTH * degraded
        out = np.zeros((len(rows), COL_HARMONICS + harmonics.shape[1]))
        out[:, COL_X : COL_Y + 1] = xy
        out[:, COL_L1 : COL_N + 3] = np.swapaxes(axes, 1, 2).reshape(-1, 9)
        out[:, COL_A : COL_RIM + 1] = np.stack(
            [a, b, catalog.height_m[rows], depth, rim_height_m(radius)], axis=-1
        )
        out[:, COL_RELIEF] = level
        out[:, COL_GRADIENT : COL_GRADIENT + 2] = gradient
        # The gnomonic plane stretches lengths by up to 1 / cos^2.
        out[:, COL_REACH] = 1.05 * REACH * a / (axes[:, 2, 2] - 2.0 * a / self.body.radius_m).clip(0.3) ** 2
        out[:, COL_REACH] *= 1.0 + np.abs(harmonics).sum(axis=1)
        out[:, COL_CREST] = CREST * (1.0 + DEGRADED_CREST * degraded)
        out[:, COL_PEAK] = np.where(2.0 * radius > self.options.peaks_from_m, PEAK * depth, 0.0)
        out[:, COL_HARMONICS:] = harmonics
        return out

    def _offsets(self, c: FloatArray) -> FloatArray:
        """Heights (n,) of craters in the catalogue over those by the relief, m; NaN inside larger ones."""
        crest = crest_height_over_centre_ground_m(c[:, COL_A], c[:, COL_B], self.body)
        axes = np.stack([c[:, [COL_A]] * c[:, COL_L1:COL_L2], c[:, [COL_B]] * c[:, COL_L2:COL_N]], axis=1)
        share, flank = ground_levels(
            np.ascontiguousarray(c[:, COL_N : COL_N + 3]),
            axes,
            np.ascontiguousarray(c[:, [COL_DEPTH, COL_RIM]]),
            crest,
            np.ascontiguousarray(c[:, [COL_X, COL_Y, COL_RELIEF, COL_GRADIENT, COL_GRADIENT + 1]]),
            self.body.radius_m,
            np.ascontiguousarray(c[:, COL_HEIGHT]),
        )
        offset = (c[:, COL_HEIGHT] - crest - flank) / np.maximum(share, _MIN_SHARE) - c[:, COL_RELIEF]
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
            lift(
                height, self._craters[known], self._offsets_m[known], self._far_offset_m, frame,
                Window(0, 1, 0, 1),
            )  # fmt: skip
        return float(height[0, 0])

    def run(self, work: Callable[[int, int], object], n: int) -> list[object]:
        """Run `work(first, last)` on parts of range(n) in threads; the kernels release the lock.

        Rays begin at the intersections of their neighbours in the same part: the same parts on all machines
        make the same image.
        """
        edges = np.linspace(0, n, _PARTS + 1).astype(int)
        return list(self._pool.map(work, edges[:-1], edges[1:]))

    @contextmanager
    def levels(
        self, low: FloatArray, high: FloatArray, nearest: FloatArray, pixel_m: float
    ) -> Iterator[Levels]:
        """Give grids that cover a view; those of earlier views are used again where they fit.

        They stay as they are within the block. Threads may call it, as many as `VIEWS_AT_ONCE` at a time.

        Parameters
        ----------
        low, high : ndarray, shape (2,)
            Plane coordinates of the rectangle in view, m.
        nearest : ndarray, shape (2,)
            Plane coordinates of its point nearest to the camera, m: the finest grid lies there.
        pixel_m : float
            Smallest size of a pixel on the ground.

        Yields
        ------
        Levels
        """
        with self._building:
            found = self._levels(low, high, nearest, pixel_m)
            self._in_use.update(found.slots.tolist())
        try:
            yield found
        finally:
            with self._building:
                self._in_use.subtract(found.slots.tolist())

    def _levels(self, low: FloatArray, high: FloatArray, nearest: FloatArray, pixel_m: float) -> Levels:
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
            frames_m=np.array(
                [[*self._frame(g.exponent, g.first), g.border_m, 2.0**-g.exponent] for g in grids]
            ),
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
        slot = next(s for s in self._oldest if s not in used and not self._in_use[s])
        self._build(slot, exponent, (i, j))
        return slot

    def _build(self, slot: int, exponent: int, first: tuple[int, int]) -> None:
        cells, R = self.options.cells, self.body.radius_m
        frame = self._frame(exponent, first)
        fade = cells // _FADES
        heights = self._heights[slot]
        c = self._craters
        extent = cells * frame[0]
        near: npt.NDArray[np.bool_] = np.all(
            (c[:, :2] + LEVEL_REACH * c[:, [COL_REACH]] > frame[1:])
            & (c[:, :2] - LEVEL_REACH * c[:, [COL_REACH]] < frame[1:] + extent),
            axis=1,
        )
        craters = np.ascontiguousarray(c[near])
        known = near & ~np.isnan(self._offsets_m)
        lifted, offsets = np.ascontiguousarray(c[known]), np.ascontiguousarray(self._offsets_m[known])

        def fill(window: Window) -> None:
            relief = self.relief.grid(exponent, first, cells, fade, window)
            heights[window.low : window.high, window.left : window.right] = relief
            if self._lifted:
                lift(heights, lifted, offsets, self._far_offset_m, frame, window)
            stamp(heights, relief, craters, frame, R, fade, window)

        kept = self._keep(slot, exponent, first)
        self._grids[slot] = None
        list(self._pool.map(fill, _around(kept, cells)))
        found = self.run(lambda lo, hi: extremes(heights, lo, hi), cells)
        top, steep = np.array(found, dtype=np.float64).max(axis=0)
        sides = (heights[1], heights[-2], heights[:, 1], heights[:, -2])
        border_m = float(min(side.min() for side in sides))
        self._grids[slot] = _Grid(exponent, first, border_m, float(top), float(np.sqrt(steep)) / frame[0])

    def _keep(self, slot: int, exponent: int, first: tuple[int, int]) -> Window:
        """Copy what an earlier grid of the spacing has of a new one, but for the borders of both."""
        cells = self.options.cells
        border = cells // _FADES + _BORDER
        kept, source, moved = Window(0, 0, 0, 0), slot, (0, 0)
        for old, grid in enumerate(self._grids):
            if grid is None or grid.exponent != exponent:
                continue
            dx, dy = first[0] - grid.first[0], first[1] - grid.first[1]
            columns, rows = (cells - 2 * border - abs(d) for d in (dx, dy))
            if min(columns, rows) > 0 and columns * rows > (kept.right - kept.left) * (kept.high - kept.low):
                left, low = border + max(0, -dx), border + max(0, -dy)
                kept, source, moved = Window(left, left + columns, low, low + rows), old, (dx, dy)
        left, right, low, high = kept
        dx, dy = moved
        self._heights[slot, low:high, left:right] = self._heights[
            source, low + dy : high + dy, left + dx : right + dx
        ]
        return kept


def _around(kept: Window, cells: int) -> list[Window]:
    """Windows that are the rest of a grid, small enough to occupy all threads."""
    left, right, low, high = kept
    strips = [
        Window(0, cells, 0, low), Window(0, cells, high, cells),
        Window(0, left, low, high), Window(right, cells, low, high),
    ]  # fmt: skip
    parts = []
    for one in strips:
        columns, rows = one.right - one.left, one.high - one.low
        if columns == 0 or rows == 0:
            continue
        count = -(-_PARTS * columns * rows // cells**2)
        if columns > rows:
            edges = np.linspace(one.left, one.right, count + 1).astype(int).tolist()
            parts += [Window(a, b, one.low, one.high) for a, b in pairwise(edges)]
        else:
            edges = np.linspace(one.low, one.high, count + 1).astype(int).tolist()
            parts += [Window(one.left, one.right, a, b) for a, b in pairwise(edges)]
    return sorted(parts, key=lambda w: (w.left - w.right) * (w.high - w.low))
