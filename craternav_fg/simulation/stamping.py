"""Kernels that lift a grid of heights to the catalogue's, and stamp craters into it."""

import numpy as np
import numpy.typing as npt

from craternav_fg.simulation.crater_shape import (
    PEAK_WIDTH,
    REACH,
    coverage,
    crater_profile,
    crest_height,
    outline,
    protection,
    roughness,
    smoothstep,
)
from craternav_fg.simulation.relief import Window
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

# Where the catalogue's heights differ from the relief, the terrain is lifted within this many radii of a
# crater.
LEVEL_REACH = 6.0
# Weight of the common lift beside that of the craters, and softening of the craters' weights near their
# centres.
_FAR_WEIGHT, _SOFTENING = 0.01, 0.03
# Smallest crater on a grid, and smallest one that the next coarser grid has as well, in cells.
_SMALLEST_CELLS, _SHARED_CELLS = 2.0, 4.0
# A crater's flank gives way to older crests from this distance on, over this width, in radii.
_OWN_REACH, _OWN_FADE = 1.1, 0.15

# Columns of a crater in `stamp`: centre x, y; axes l1, l2, n in the site frame; semi-axes, height of the
# rim's plane, depth, height of the crest over the terrain; relief at the centre and its gradient; reach in
# the plane, all in m; half-width of the crest, radii; height of the central peak, m; harmonics of the
# outline.
COL_X, COL_Y, COL_L1, COL_L2, COL_N = 0, 1, 2, 5, 8
COL_A, COL_B, COL_HEIGHT, COL_DEPTH, COL_RIM = 11, 12, 13, 14, 15
COL_RELIEF, COL_GRADIENT, COL_REACH, COL_CREST, COL_PEAK, COL_HARMONICS = 16, 17, 19, 20, 21, 22


@njit(cache=True, nogil=True, error_model="numpy")
def lift(
    heights: Float32Array,
    craters: FloatArray,
    offsets: FloatArray,
    far: float,
    frame: FloatArray,
    window: Window,
) -> None:
    """Lift a window of a grid to the catalogue's heights.

    Parameters
    ----------
    heights : ndarray of float32, shape (cells, cells)
        Heights of the grid, m, rows along y; changed.
    craters : ndarray, shape (n, 34)
        Columns `COL_X` to `COL_HARMONICS`; lengths in m, in the site frame.
    offsets : ndarray, shape (n,)
        Lift near each crater, m.
    far : float
        Lift away from all craters, m: the same for every grid, or the terrain would have steps where two
        grids meet.
    frame : ndarray, shape (3,)
        Spacing, and plane coordinates x, y of the first point, m.
    window : Window
    """
    cell, x0, y0 = frame
    left, right, low, high = window
    weight = np.full((high - low, right - left), _FAR_WEIGHT)
    total = np.full((high - low, right - left), _FAR_WEIGHT * far)
    for k in range(craters.shape[0]):
        reach = craters[k, COL_REACH] * LEVEL_REACH / REACH
        xc, yc = craters[k, COL_X], craters[k, COL_Y]
        for j in range(
            max(low, int(np.ceil((yc - reach - y0) / cell))), min(high, int((yc + reach - y0) / cell) + 1)
        ):
            for i in range(
                max(left, int(np.ceil((xc - reach - x0) / cell))),
                min(right, int((xc + reach - x0) / cell) + 1),
            ):
                r2 = ((x0 + i * cell - xc) ** 2 + (y0 + j * cell - yc) ** 2) / (reach * reach)
                if r2 < 1.0:
                    w = (1.0 - r2) ** 2 / (r2 + _SOFTENING)
                    weight[j - low, i - left] += w
                    total[j - low, i - left] += w * offsets[k]
    for j in range(low, high):
        for i in range(left, right):
            heights[j, i] += total[j - low, i - left] / weight[j - low, i - left]


@njit(cache=True, nogil=True, error_model="numpy")
def _distances(
    rho: FloatArray, offset2: FloatArray, c: FloatArray, x0: float, y: float, cell: float, radius_m: float
) -> None:
    """Write the distances of a row's points from a crater's centre, in radii, and their squares in m^2.

    The direction (x, y, R) meets the plane of the rim at (X, Y) of the crater's frame; `radius_m` is that of
    the body. In `rho` X and Y are in semi-axes.
    """
    height = c[COL_HEIGHT]
    base = 0.0 if np.isnan(height) else height
    nx, n0 = c[COL_N], c[COL_N + 1] * y + c[COL_N + 2] * radius_m
    ax, a0 = c[COL_L1], c[COL_L1 + 1] * y + c[COL_L1 + 2] * radius_m
    bx, b0 = c[COL_L2], c[COL_L2 + 1] * y + c[COL_L2 + 2] * radius_m
    per_a2, per_b2 = 1.0 / c[COL_A] ** 2, 1.0 / c[COL_B] ** 2
    for i in range(rho.shape[0]):
        x = x0 + i * cell
        scale = (radius_m + base) / (nx * x + n0)
        X, Y = scale * (ax * x + a0), scale * (bx * x + b0)
        offset2[i] = X * X + Y * Y
        rho[i] = np.sqrt(X * X * per_a2 + Y * Y * per_b2)


@njit(cache=True, nogil=True, error_model="numpy")
def _deform(rho: FloatArray, c: FloatArray, x0: float, y: float, cell: float, radius_m: float) -> None:
    """Divide the distances of a row's points from the centre by the outline of an irregular crater."""
    for i in range(rho.shape[0]):
        x = x0 + i * cell
        # The outline depends on the direction in the rim's plane alone.
        X = c[COL_L1] * x + c[COL_L1 + 1] * y + c[COL_L1 + 2] * radius_m
        Y = c[COL_L2] * x + c[COL_L2 + 1] * y + c[COL_L2 + 2] * radius_m
        norm = np.sqrt((X / c[COL_A]) ** 2 + (Y / c[COL_B]) ** 2)
        scale = rho[i] / norm if norm > 0.0 else 0.0
        rho[i] /= outline(scale * X / c[COL_A], scale * Y / c[COL_B], c[COL_HARMONICS:])


@njit(cache=True, nogil=True, error_model="numpy")
def _raise(
    heights: Float32Array, free: Float32Array, share: FloatArray, rho: FloatArray, c: FloatArray
) -> None:
    """Add a crater that has no height of its own to a row of the terrain."""
    depth, rim, crest = c[COL_DEPTH], c[COL_RIM], c[COL_CREST]
    for i in range(heights.shape[0]):
        raised = share[i] * coverage(rho[i]) * (rim + crater_profile(rho[i], depth, rim, crest))
        heights[i] += free[i] * raised


@njit(cache=True, nogil=True, error_model="numpy")
def _stand(
    heights: Float32Array,
    free: Float32Array,
    relief: Float32Array,
    share: FloatArray,
    rho: FloatArray,
    offset2: FloatArray,
    c: FloatArray,
    east: float,
    north: float,
    cell: float,
    radius_m: float,
) -> None:
    """Put a crater at its height into a row of the terrain.

    `east`, `north` are the plane coordinates of the row's first point from the crater's centre, m.
    """
    depth, rim, crest = c[COL_DEPTH], c[COL_RIM], c[COL_CREST]
    level, gradient = c[COL_RELIEF] + c[COL_GRADIENT + 1] * north, c[COL_GRADIENT]
    height, radius = c[COL_HEIGHT], np.sqrt(c[COL_A] * c[COL_B])
    for i in range(heights.shape[0]):
        rough = relief[i] - (level + gradient * (east + i * cell))
        target = crest_height(radius_m + height, offset2[i], rho[i], radius_m)
        target += crater_profile(rho[i], depth, rim, crest) + roughness(rho[i] - 1.0, rough, radius)
        # The flank gives way to the crests of larger craters, the crest does not.
        own = 1.0 - smoothstep((rho[i] - _OWN_REACH) / _OWN_FADE)
        weight = share[i] * coverage(rho[i]) * (own + (1.0 - own) * free[i])
        heights[i] += weight * (target - heights[i])
        free[i] *= 1.0 - share[i] * (1.0 - protection(rho[i] - 1.0))
    if c[COL_PEAK] > 0.0:
        for i in range(heights.shape[0]):
            if rho[i] < 1.0:
                heights[i] += share[i] * c[COL_PEAK] * np.exp(-0.5 * (rho[i] / PEAK_WIDTH) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def stamp(
    heights: Float32Array,
    relief: Float32Array,
    craters: FloatArray,
    frame: FloatArray,
    radius_m: float,
    fade: int,
    window: Window,
) -> None:
    """Stamp craters, in their order, into a window of a grid.

    Parameters
    ----------
    heights : ndarray of float32, shape (cells, cells)
        Heights of the grid with the lift to the catalogue's heights, m, rows along y; changed.
    relief : ndarray of float32, shape (rows, columns)
        Heights of the window without the lift, m.
    craters : ndarray, shape (n, 34)
        Columns `COL_X` to `COL_HARMONICS`; lengths in m, in the site frame.
    frame : ndarray, shape (3,)
        Spacing, and plane coordinates x, y of the first point, m.
    radius_m : float
        The body's radius.
    fade : int
        Craters too small for the next coarser grid fade out over so many cells from the border.
    window : Window
    """
    cell, x0, y0 = frame
    n = heights.shape[1]
    left, right, low, high = window
    free = np.ones((high - low, right - left), dtype=np.float32)
    rhos, offsets2, shares = np.empty(right - left), np.empty(right - left), np.empty(right - left)
    for k in range(craters.shape[0]):
        c = craters[k]
        xc, yc, b, reach = c[COL_X], c[COL_Y], c[COL_B], c[COL_REACH]
        # Smaller craters would only be aliased.
        if b < _SMALLEST_CELLS * cell:
            continue
        shared = b >= _SHARED_CELLS * cell
        first = max(left, int(np.ceil((xc - reach - x0) / cell)))
        last = min(right, int((xc + reach - x0) / cell) + 1)
        if first >= last:
            continue
        harmonics = c[COL_HARMONICS:]
        irregular = np.any(harmonics != 0.0)
        rho, offset2, share = rhos[: last - first], offsets2[: last - first], shares[: last - first]
        east = x0 + first * cell - xc
        for j in range(
            max(low, int(np.ceil((yc - reach - y0) / cell))), min(high, int((yc + reach - y0) / cell) + 1)
        ):
            y = y0 + j * cell
            _distances(rho, offset2, c, xc + east, y, cell, radius_m)
            if irregular:
                _deform(rho, c, xc + east, y, cell, radius_m)
            for i in range(last - first):
                inside = min(min(first + i, j), n - 1 - max(first + i, j)) - 4
                share[i] = 1.0 if shared else min(max(inside / fade, 0.0), 1.0)
            row, open_row = heights[j, first:last], free[j - low, first - left : last - left]
            if np.isnan(c[COL_HEIGHT]):
                _raise(row, open_row, share, rho, c)
            else:
                _stand(
                    row, open_row, relief[j - low, first - left : last - left], share, rho, offset2, c, east,
                    y - yc, cell, radius_m,
                )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def extremes(heights: Float32Array, first: int, last: int) -> tuple[float, float]:
    """Highest point and largest squared difference between neighbours.

    Parameters
    ----------
    heights : ndarray of float32, shape (cells, cells)
        Heights of a grid, m.
    first, last : int
        Rows from `first` to before `last` count.

    Returns
    -------
    top, steep : float
        m, and m^2.
    """
    top = -np.inf
    steep = 0.0
    for j in range(first, min(last, heights.shape[0] - 1)):
        for i in range(heights.shape[1] - 1):
            h = heights[j, i]
            d = (heights[j, i + 1] - h) ** 2 + (heights[j + 1, i] - h) ** 2
            top = max(top, h)
            steep = max(steep, d)
    return top, steep
