"""Craters by place and size: a grid on the sphere for each octave of size, asked from compiled code.

Each octave ("tier") has rows of latitude and, in each, columns of longitude, of about one crater a cell;
the craters of a row's neighbouring columns lie next to each other.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]
IntArray = npt.NDArray[np.int64]

_LN2 = float(np.log(2.0))
# Steps in the logarithm of the size, of the table of numbers.
_BIN = 0.05


class Grid(NamedTuple):
    """Craters by place and size, as arrays; rows of these are those of the catalogue."""

    units: FloatArray
    """Directions from the body's centre (n, 3)."""
    log_size: FloatArray
    """Natural logarithm (n,) of the geometric mean of the semi-axes in m."""
    first_size: float
    """Of the smallest tier."""
    tier_rows: Int32Array
    """First row of each tier in `row_cells` (tiers + 1,)."""
    row_cells: Int32Array
    """First cell of each row (rows + 1,)."""
    starts: Int32Array
    """First crater of each cell in `order` (cells + 1,)."""
    order: Int32Array
    """Craters, cell by cell (n,)."""
    placed: FloatArray
    """Direction and logarithm of the size of the craters in this order (n, 4): read one after the other."""
    larger: FloatArray
    """Craters per steradian larger than `first_size` + k `_BIN`."""


def build_grid(units: FloatArray, log_size: FloatArray) -> Grid:
    """Sort craters into a grid.

    Parameters
    ----------
    units : ndarray, shape (n, 3)
    log_size : ndarray, shape (n,)
    """
    n = len(units)
    first = float(log_size.min())
    tier = np.floor((log_size - first) / _LN2).astype(np.int64)
    tiers = int(tier.max()) + 1
    counts = np.bincount(tier, minlength=tiers)
    rows = np.maximum(1, np.floor(np.sqrt(np.pi * np.maximum(counts, 1) / 4.0))).astype(np.int64)
    tier_rows = np.concatenate([[0], np.cumsum(rows)])
    in_tier = np.arange(tier_rows[-1]) - np.repeat(tier_rows[:-1], rows)
    rows_of = np.repeat(rows, rows)
    columns = np.maximum(1, np.floor(2.0 * rows_of * np.sin(np.pi * (in_tier + 0.5) / rows_of)))
    row_cells = np.concatenate([[0], np.cumsum(columns.astype(np.int64))])
    latitude = np.arcsin(np.clip(units[:, 2], -1.0, 1.0))
    turn = np.arctan2(units[:, 1], units[:, 0]) / (2.0 * np.pi)
    row = np.minimum((latitude / np.pi + 0.5) * rows[tier], rows[tier] - 1).astype(np.int64) + tier_rows[tier]
    width = columns[row]
    cell = row_cells[row] + np.minimum((turn % 1.0) * width, width - 1).astype(np.int64)
    order = np.argsort(cell, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=row_cells[-1]))])
    edges = first + _BIN * np.arange(int((log_size.max() - first) / _BIN) + 3)
    larger = (n - np.searchsorted(np.sort(log_size), edges)) / (4.0 * np.pi)
    return Grid(
        np.ascontiguousarray(units), np.ascontiguousarray(log_size), first, tier_rows.astype(np.int32),
        row_cells.astype(np.int32), starts.astype(np.int32), order.astype(np.int32),
        np.column_stack([units, log_size])[order], larger,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def density(grid: Grid, least: float, most: float) -> float:
    """Craters per steradian of sizes (logarithms) between two."""
    last = grid.larger.shape[0] - 1
    total = 0.0
    for k in range(2):
        x = ((least if k == 0 else most) - grid.first_size) / _BIN
        value = 0.0
        if x <= 0.0:
            value = grid.larger[0]
        elif x < last:
            i = int(x)
            value = grid.larger[i] + (x - i) * (grid.larger[i + 1] - grid.larger[i])
        total += value if k == 0 else -value
    return total


@njit(cache=True, error_model="numpy")
def within(
    grid: Grid, x: float, y: float, z: float, reach: float, least: float, most: float, out: IntArray
) -> int:
    """Write the craters around a place, of some sizes; give their number, at most the room in `out`.

    Parameters
    ----------
    grid : Grid
    x, y, z : float
        Unit vector to the place.
    reach : float
        Angle from it, rad, below pi / 2.
    least, most : float
        Logarithms of sizes.
    out : ndarray of int, shape (m,)
    """
    tiers = grid.tier_rows.shape[0] - 1
    first = max(0, int(np.floor((least - grid.first_size) / _LN2)))
    last = min(tiers - 1, int(np.floor((most - grid.first_size) / _LN2)))
    if last < first:
        return 0
    # The chord's square keeps its digits at small angles, the cosine does not.
    reach2 = 4.0 * np.sin(0.5 * reach) ** 2
    latitude = np.arcsin(min(max(z, -1.0), 1.0))
    turn = np.arctan2(y, x) / (2.0 * np.pi)
    if turn < 0.0:
        turn += 1.0
    # The widest meridians that the circle reaches.
    half_turn = 0.5
    if abs(latitude) + reach < 0.5 * np.pi:
        half_turn = np.arcsin(min(np.sin(reach) / np.cos(latitude), 1.0)) / (2.0 * np.pi)
    count = 0
    for tier in range(first, last + 1):
        row0 = grid.tier_rows[tier]
        rows = grid.tier_rows[tier + 1] - row0
        low = max(0, int(np.floor(((latitude - reach) / np.pi + 0.5) * rows)))
        high = min(rows - 1, int(np.floor(((latitude + reach) / np.pi + 0.5) * rows)))
        for row in range(row0 + low, row0 + high + 1):
            cell0 = grid.row_cells[row]
            columns = grid.row_cells[row + 1] - cell0
            west = int(np.floor((turn - half_turn) * columns))
            east = int(np.floor((turn + half_turn) * columns))
            if east - west + 1 >= columns:
                west, east = 0, columns - 1
            for column in range(west, east + 1):
                cell = cell0 + column % columns
                for k in range(grid.starts[cell], grid.starts[cell + 1]):
                    size = grid.placed[k, 3]
                    if size < least or size > most:
                        continue
                    dx = grid.placed[k, 0] - x
                    dy = grid.placed[k, 1] - y
                    dz = grid.placed[k, 2] - z
                    if dx * dx + dy * dy + dz * dz > reach2:
                        continue
                    out[count] = grid.order[k]
                    count += 1
                    if count == out.shape[0]:
                        return count
    return count
