"""Spatial index of craters on a sphere, sorted by size and place and queried from Python and compiled code.

Craters are sorted by octave of their size, within an octave by band of latitude, within a band by longitude.
Each band is divided into cells of equal width in longitude, about one crater per cell, and the index stores
where each cell begins. The craters of neighbouring cells are therefore contiguous, and a spherical cap
overlaps one or two contiguous runs per band. How small a crater can be seen depends on its distance, so each
octave has a cap of its own; the smallest craters, nearly all of a catalogue, have the smallest cap.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Int32Array = npt.NDArray[np.int32]

_LN2 = float(np.log(2.0))
# Caps are enlarged by this angle, so that rounding never loses a crater; candidates are tested exactly.
_SLACK_RAD = 1e-9


class SphereIndex(NamedTuple):
    """Index of n craters in t octaves of size; a named tuple, so that compiled code takes it as it is."""

    order: IntArray
    """Rows of the catalogue, shape (n,): all arrays of craters below are in this order."""
    directions: FloatArray
    """Unit vectors to the rims' centres in g, shape (n, 3)."""
    log_size: FloatArray
    """Natural logarithms of the geometric mean of the semi-axes in m, shape (n,): the octaves are of it."""
    semi_major_m: FloatArray
    """Semi-major axes, shape (n,)."""
    range_m: FloatArray
    """Distances of the rims' centres from the body's, shape (n,)."""
    least_log_size: float
    """Lower end of the first octave."""
    octave_bands: Int32Array
    """Index of the first band of each octave, counted over all octaves, shape (t + 1,)."""
    band_cells: Int32Array
    """Index of the first cell of each band, counted over all bands, shape (bands + 1,)."""
    cell_starts: Int32Array
    """Index of the first crater of each cell, shape (cells + 1,)."""
    limits_m: FloatArray
    """Largest semi-major axis, least and largest range from the body's centre of each octave, shape (t, 3);
    zeros for an octave without craters."""

    @classmethod
    def of(
        cls,
        latitude_rad: FloatArray,
        longitude_rad: FloatArray,
        semi_major_m: FloatArray,
        semi_minor_m: FloatArray,
        range_m: FloatArray,
    ) -> "SphereIndex":
        """Build the index; craters that are in its order already are not moved.

        Parameters
        ----------
        latitude_rad, longitude_rad : ndarray, shape (n,)
            Position of the rims' centres.
        semi_major_m, semi_minor_m : ndarray, shape (n,)
            Semi-axes of the rims.
        range_m : ndarray, shape (n,)
            Distances of the rims' centres from the body's.
        """
        n = len(semi_major_m)
        log_size = 0.5 * np.log(semi_major_m * semi_minor_m)
        least = float(log_size.min()) if n else 0.0
        octave = np.floor((log_size - least) / _LN2).astype(np.int64)
        counts = np.bincount(octave)
        octave_bands, band_cells = _layout(counts)
        bands = np.diff(octave_bands)[octave]
        band = np.minimum(((latitude_rad / np.pi + 0.5) * bands).astype(np.int64), bands - 1)
        band = octave_bands[octave] + np.maximum(band, 0)
        longitude = np.mod(longitude_rad, 2.0 * np.pi)
        step = np.diff(band)
        if np.all((step > 0) | ((step == 0) & (np.diff(longitude) >= 0.0))):
            order = np.arange(n)
        else:
            order = np.lexsort((longitude, band))
            longitude, band, log_size = longitude[order], band[order], log_size[order]
            latitude_rad, semi_major_m, range_m = latitude_rad[order], semi_major_m[order], range_m[order]
        columns = np.diff(band_cells)[band]
        column = np.minimum((longitude / (2.0 * np.pi) * columns).astype(np.int64), columns - 1)
        in_cell = np.bincount(band_cells[band] + column, minlength=band_cells[-1])
        cell_starts = np.concatenate([[0], np.cumsum(in_cell)])
        limits = np.zeros((len(counts), 3))
        for t, (first, last) in enumerate(pairwise(cell_starts[band_cells[octave_bands]])):
            if last > first:
                part = slice(first, last)
                limits[t] = np.max(semi_major_m[part]), np.min(range_m[part]), np.max(range_m[part])
        return cls(
            order, _directions(latitude_rad, longitude), log_size, np.ascontiguousarray(semi_major_m),
            np.ascontiguousarray(range_m), least, octave_bands, band_cells, cell_starts.astype(np.int32),
            limits,
        )  # fmt: skip

    def near(self, direction: FloatArray, angle_rad: float, least_semi_major_m: float = 0.0) -> IntArray:
        """Find the craters around a direction.

        Parameters
        ----------
        direction : ndarray, shape (3,)
            Unit vector in g.
        angle_rad : float
            Largest angle between it and a rim's centre.
        least_semi_major_m : float
            Smaller craters are left out.

        Returns
        -------
        ndarray of int, shape (k,)
            Rows of the catalogue, in no particular order.
        """
        direction = np.ascontiguousarray(direction, dtype=np.float64)
        return self.order[_near(self, direction, float(angle_rad), float(least_semi_major_m))]

    def in_view(self, gPc: FloatArray, axis: FloatArray, cos_field: float, reach_per_size: float) -> IntArray:
        """Find the craters that a camera may see.

        Parameters
        ----------
        gPc : ndarray, shape (3,)
            Position of the camera in g, m.
        axis : ndarray, shape (3,)
            Unit vector along the optical axis, in g.
        cos_field : float
            Cosine of the half-angle of the field of view.
        reach_per_size : float
            Largest distance of a crater in units of its semi-major axis; inf for no limit.

        Returns
        -------
        ndarray of int, shape (k,)
            Rows of the catalogue, in no particular order: craters whose centre lies in the field of view and
            above the horizon, and which are near enough for their size.
        """
        found = _in_view(
            self, np.ascontiguousarray(gPc, dtype=np.float64), np.ascontiguousarray(axis, dtype=np.float64),
            float(cos_field), float(reach_per_size),
        )  # fmt: skip
        return self.order[found]

    def overlaps(self, same: float) -> tuple[IntArray, IntArray]:
        """Find pairs of craters that overlap, the rims taken for circles of their semi-major axes.

        Parameters
        ----------
        same : float
            Two craters are duplicates when their sizes differ by less than this share of the smaller one's,
            and their centres by less than this share of its radius.

        Returns
        -------
        crossings : ndarray of int, shape (m, 2)
            Pairs of rows of the catalogue whose rims cross, the larger crater first.
        duplicates : ndarray of int, shape (k, 2)
            Pairs of rows that are taken for one crater, the larger first.
        """
        crossings, duplicates = _overlaps(self, float(same))
        return self.order[crossings], self.order[duplicates]


def _layout(counts: IntArray) -> tuple[Int32Array, Int32Array]:
    """First band of each octave (t + 1,) and first cell of each band, about as many cells as craters."""
    bands = np.maximum(1, np.floor(np.sqrt(0.25 * counts))).astype(np.int64)
    octave_bands = np.concatenate([[0], np.cumsum(bands)])
    in_octave = np.arange(octave_bands[-1]) - np.repeat(octave_bands[:-1], bands)
    of_octave = np.repeat(bands, bands)
    columns = np.maximum(1, np.floor(2.0 * np.pi * of_octave * np.sin(np.pi * (in_octave + 0.5) / of_octave)))
    band_cells = np.concatenate([[0], np.cumsum(columns)])
    return octave_bands.astype(np.int32), band_cells.astype(np.int32)


@njit(cache=True, nogil=True, error_model="numpy")
def _directions(latitude_rad: FloatArray, longitude_rad: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3); a compiled loop is several times as fast as NumPy here."""
    out = np.empty((latitude_rad.shape[0], 3))
    for i in range(latitude_rad.shape[0]):
        c = np.cos(latitude_rad[i])
        out[i, 0] = c * np.cos(longitude_rad[i])
        out[i, 1] = c * np.sin(longitude_rad[i])
        out[i, 2] = np.sin(latitude_rad[i])
    return out


class _Cap(NamedTuple):
    """Spherical cap, enlarged by `_SLACK_RAD`: longitudes are in turns, angles in rad."""

    latitude: float
    sin_latitude: float
    cos_latitude: float
    turn: float
    reach: float
    cos_reach: float
    widest: float
    """Latitude at which the cap extends farthest in longitude."""
    half_turn: float
    """Half of its extent in longitude there; one half when the cap holds a pole."""


@njit(cache=True, nogil=True, error_model="numpy")
def _cap(x: float, y: float, z: float, reach: float) -> _Cap:
    """Cap of an angular radius around a unit vector."""
    reach += _SLACK_RAD
    cos_latitude = np.sqrt(x * x + y * y)
    latitude = np.arctan2(z, cos_latitude)
    turn = np.arctan2(y, x) / (2.0 * np.pi)
    cos_reach = np.cos(reach) if reach < np.pi else -1.0
    widest, half_turn = 0.0, 0.5
    if abs(latitude) + reach < 0.5 * np.pi:
        widest = np.arcsin(z / cos_reach)
        half_turn = np.arcsin(min(np.sin(reach) / cos_latitude, 1.0)) / (2.0 * np.pi)
    elif cos_reach > 0.0:
        widest = 0.5 * np.pi if z > 0.0 else -0.5 * np.pi
    return _Cap(
        latitude, z, cos_latitude, turn if turn >= 0.0 else turn + 1.0, reach, cos_reach, widest, half_turn
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _half_turn(cap: _Cap, south: float, north: float) -> float:
    """Half of the extent in longitude, in turns, of the part of a cap between two latitudes."""
    if cap.cos_reach <= 0.0 or south <= cap.widest <= north:
        return cap.half_turn
    latitude = south if cap.widest < south else north
    cos = np.cos(latitude)
    c = (cap.cos_reach - cap.sin_latitude * np.sin(latitude)) / max(cos * cap.cos_latitude, 1e-300)
    if c <= -1.0:
        return 0.5
    return (np.arccos(min(c, 1.0)) + _SLACK_RAD / max(cos, 1e-9)) / (2.0 * np.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def _bands(index: SphereIndex, octave: int, cap: _Cap) -> tuple[int, int, int, float]:
    """First band of an octave, first band and last + 1 that a cap overlaps, and height of a band, rad."""
    first = index.octave_bands[octave]
    count = index.octave_bands[octave + 1] - first
    south = int(np.floor(((cap.latitude - cap.reach) / np.pi + 0.5) * count))
    north = int(np.floor(((cap.latitude + cap.reach) / np.pi + 0.5) * count))
    return first, first + max(south, 0), first + min(north, count - 1) + 1, np.pi / count


@njit(cache=True, nogil=True, error_model="numpy")
def _runs(index: SphereIndex, band: int, turn: float, half_turn: float) -> tuple[int, int, int, int]:
    """Begin and end of the one or two runs of craters in the cells of a band that a cap overlaps."""
    first = index.band_cells[band]
    columns = index.band_cells[band + 1] - first
    west = int(np.floor((turn - half_turn) * columns))
    east = int(np.floor((turn + half_turn) * columns)) + 1
    starts = index.cell_starts
    if east - west >= columns:
        return starts[first], starts[first + columns], 0, 0
    if west < 0:
        return starts[first], starts[first + east], starts[first + west + columns], starts[first + columns]
    if east > columns:
        return starts[first + west], starts[first + columns], starts[first], starts[first + east - columns]
    return starts[first + west], starts[first + east], 0, 0


@njit(cache=True, nogil=True, error_model="numpy")
def within(
    index: SphereIndex, x: float, y: float, z: float, reach: float, least: float, most: float, out: IntArray
) -> int:
    """Write the craters in a cap whose sizes lie in an interval; return their number, at most m.

    Parameters
    ----------
    index : SphereIndex
    x, y, z : float
        Unit vector to the cap's centre in g.
    reach : float
        Angular radius of the cap, rad.
    least, most : float
        Natural logarithms of the geometric mean of the semi-axes in m.
    out : ndarray of int, shape (m,)
        Rows of the catalogue; the search ends when it is full.
    """
    octaves = index.octave_bands.shape[0] - 1
    first = max(0, int(np.floor((least - index.least_log_size) / _LN2)))
    last = min(octaves - 1, int(np.floor((most - index.least_log_size) / _LN2)))
    if last < first:
        return 0
    # The square of the chord keeps its digits at small angles, the cosine does not.
    chord2 = 4.0 * np.sin(0.5 * reach) ** 2
    cap = _cap(x, y, z, reach)
    count = 0
    for octave in range(first, last + 1):
        _, south, north, _ = _bands(index, octave, cap)
        for band in range(south, north):
            # In a small cap a narrower extent for each band would cost more than it saves.
            begin, end, begin2, end2 = _runs(index, band, cap.turn, cap.half_turn)
            for _ in range(2):
                for k in range(begin, end):
                    size = index.log_size[k]
                    if size < least or size > most:
                        continue
                    dx = index.directions[k, 0] - x
                    dy = index.directions[k, 1] - y
                    dz = index.directions[k, 2] - z
                    if dx * dx + dy * dy + dz * dz > chord2:
                        continue
                    out[count] = index.order[k]
                    count += 1
                    if count == out.shape[0]:
                        return count
                begin, end = begin2, end2
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _near(index: SphereIndex, direction: FloatArray, angle: float, least: float) -> IntArray:
    """Evaluate `SphereIndex.near`; places in the index' order."""
    found = np.empty(1024, dtype=np.int64)
    count = 0
    chord2 = 4.0 * np.sin(0.5 * angle) ** 2 if angle < np.pi else np.inf
    cap = _cap(direction[0], direction[1], direction[2], angle)
    for octave in range(index.limits_m.shape[0]):
        if index.limits_m[octave, 0] < least:
            continue
        first, south, north, height = _bands(index, octave, cap)
        for band in range(south, north):
            low = (band - first) * height - 0.5 * np.pi
            begin, end, begin2, end2 = _runs(index, band, cap.turn, _half_turn(cap, low, low + height))
            for _ in range(2):
                while count + end - begin > found.shape[0]:
                    found = _doubled(found)
                for k in range(begin, end):
                    d2 = 0.0
                    for i in range(3):
                        d2 += (index.directions[k, i] - direction[i]) ** 2
                    if d2 <= chord2 and index.semi_major_m[k] >= least:
                        found[count] = k
                        count += 1
                begin, end = begin2, end2
    return found[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _in_view(index: SphereIndex, P: FloatArray, axis: FloatArray, cos_field: float, reach: float) -> IntArray:
    """Evaluate `SphereIndex.in_view`; places in the index' order."""
    found = np.empty(1024, dtype=np.int64)
    count = 0
    D2 = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    D = np.sqrt(D2)
    if not D > 0.0:
        return found[:0].copy()
    for octave in range(index.limits_m.shape[0]):
        low, high = index.limits_m[octave, 1], index.limits_m[octave, 2]
        if not low > 0.0:
            continue
        # The horizon of the deepest crater, or how far the octave's largest crater may be.
        cos_cap = low / D
        farthest = reach * index.limits_m[octave, 0]
        if farthest < np.inf:
            gap = D2 - farthest * farthest
            at = min(max(np.sqrt(max(gap, 0.0)), low), high)
            cos_cap = max(cos_cap, 0.5 * (gap / at + at) / D)
        if cos_cap > 1.0:
            continue
        cap = _cap(P[0] / D, P[1] / D, P[2] / D, np.arccos(max(cos_cap, -1.0)))
        first, south, north, height = _bands(index, octave, cap)
        for band in range(south, north):
            low = (band - first) * height - 0.5 * np.pi
            begin, end, begin2, end2 = _runs(index, band, cap.turn, _half_turn(cap, low, low + height))
            for _ in range(2):
                for k in range(begin, end):
                    nx, ny, nz = index.directions[k, 0], index.directions[k, 1], index.directions[k, 2]
                    range_m = index.range_m[k]
                    if nx * P[0] + ny * P[1] + nz * P[2] <= range_m:
                        continue
                    vx = range_m * nx - P[0]
                    vy = range_m * ny - P[1]
                    vz = range_m * nz - P[2]
                    distance = np.sqrt(vx * vx + vy * vy + vz * vz)
                    if distance > reach * index.semi_major_m[k]:
                        continue
                    if vx * axis[0] + vy * axis[1] + vz * axis[2] < cos_field * distance:
                        continue
                    if count == found.shape[0]:
                        found = _doubled(found)
                    found[count] = k
                    count += 1
                begin, end = begin2, end2
    return found[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _overlaps(index: SphereIndex, same: float) -> tuple[IntArray, IntArray]:
    """Evaluate `SphereIndex.overlaps`; places in the index' order."""
    size, range_m = index.semi_major_m, index.range_m
    crossings, duplicates = np.empty((1024, 2), dtype=np.int64), np.empty((1024, 2), dtype=np.int64)
    crossed = count = 0
    starts = index.cell_starts[index.band_cells[index.octave_bands]]
    for t in range(index.limits_m.shape[0]):
        for i in range(starts[t], starts[t + 1]):
            x, y, z = index.directions[i, 0], index.directions[i, 1], index.directions[i, 2]
            # Each pair once: with the smaller octaves, and within its own those not larger.
            for s in range(t + 1):
                if not index.limits_m[s, 0] > 0.0:
                    continue
                # The distance is a chord; the arc above it is longer.
                chord = (size[i] + index.limits_m[s, 0]) / min(range_m[i], index.limits_m[s, 1])
                cap = _cap(x, y, z, 2.0 * np.arcsin(min(0.5 * chord, 1.0)))
                first, south, north, height = _bands(index, s, cap)
                for band in range(south, north):
                    low = (band - first) * height - 0.5 * np.pi
                    begin, end, begin2, end2 = _runs(
                        index, band, cap.turn, _half_turn(cap, low, low + height)
                    )
                    for _ in range(2):
                        for k in range(begin, end):
                            if s == t and (size[k] > size[i] or (size[k] == size[i] and k <= i)):
                                continue
                            # A long crater of a smaller octave may have the larger semi-major axis.
                            large, small = (i, k) if size[i] >= size[k] else (k, i)
                            a, b = size[large], size[small]
                            dx = index.directions[k, 0] - x
                            dy = index.directions[k, 1] - y
                            dz = index.directions[k, 2] - z
                            d2 = (dx * dx + dy * dy + dz * dz) * range_m[large] * range_m[large]
                            if d2 < (same * b) ** 2 and a - b < same * b:
                                duplicates = _with_pair(duplicates, count, large, small)
                                count += 1
                            elif (a - b) ** 2 < d2 < (a + b) ** 2:
                                crossings = _with_pair(crossings, crossed, large, small)
                                crossed += 1
                        begin, end = begin2, end2
    return crossings[:crossed].copy(), duplicates[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _doubled(values: IntArray) -> IntArray:
    """Copy an array into one of twice its length."""
    larger = np.empty(2 * values.shape[0], dtype=np.int64)
    larger[: values.shape[0]] = values
    return larger


@njit(cache=True, nogil=True, error_model="numpy")
def _with_pair(pairs: IntArray, count: int, i: int, k: int) -> IntArray:
    """Pairs with one more in row `count`."""
    if count == pairs.shape[0]:
        larger = np.empty((2 * count, 2), dtype=np.int64)
        larger[:count] = pairs
        pairs = larger
    pairs[count, 0] = i
    pairs[count, 1] = k
    return pairs
