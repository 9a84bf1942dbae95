"""Which craters lie near a direction, or may be seen from a place: by size, then latitude, then longitude.

Craters are sorted by octave of their size, by band of latitude within the octave, and by longitude within
the band: a cap on the sphere is then one or two runs of each band, found by bisection. How small a crater
can be seen depends on its distance, so each octave has a cap of its own, and the smallest, which are nearly
all of a catalogue, the smallest.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


# A band holds about so many times as many craters as its octave has bands.
_BAND_SPACINGS = 2.0
_MOST_BANDS = 2048
# What is found may be a rounding too much, never too little.
_SLACK_RAD = 1e-9


@dataclass(frozen=True)
class SphereIndex:
    """Index of craters on a sphere; all arrays but `firsts` and `starts` are in its order.

    Attributes
    ----------
    order : ndarray of int, shape (n,)
        Rows of the catalogue.
    longitude_rad : ndarray, shape (n,)
        0 to 2 pi, increasing within a band.
    directions : ndarray, shape (n, 3)
        Unit vectors to the rims' centres in g.
    size_m, range_m : ndarray, shape (n,)
        Semi-major axis; distance of the rim's centre from the body's.
    firsts : ndarray of int, shape (t + 1,)
        Number of the first band of each octave of sizes, counted over all.
    starts : ndarray of int, shape (bands + 1,)
        Where each band begins.
    limits_m : ndarray, shape (t, 3)
        For each octave: largest `size_m`, least and largest `range_m`; zeros for one without craters.
    """

    order: IntArray
    longitude_rad: FloatArray
    directions: FloatArray
    size_m: FloatArray
    range_m: FloatArray
    firsts: IntArray
    starts: IntArray
    limits_m: FloatArray

    @classmethod
    def of(
        cls, latitude_rad: FloatArray, longitude_rad: FloatArray, size_m: FloatArray, range_m: FloatArray
    ) -> "SphereIndex":
        """Sort craters, given by arrays (n,); those that are in order already are not moved."""
        n = len(size_m)
        octave = np.floor(np.log2(size_m / size_m.min())).astype(np.int64) if n else np.empty(0, np.int64)
        counts = np.bincount(octave)
        bands = np.clip(np.sqrt(counts) / _BAND_SPACINGS, 1, _MOST_BANDS).astype(np.int64)
        firsts = np.concatenate([[0], np.cumsum(bands)])
        height = np.pi / bands[octave]
        band = np.clip(((latitude_rad + 0.5 * np.pi) / height).astype(np.int64), 0, bands[octave] - 1)
        key = firsts[octave] + band
        longitude = np.mod(longitude_rad, 2.0 * np.pi)
        step = np.diff(key)
        if np.all((step > 0) | ((step == 0) & (np.diff(longitude) >= 0.0))):
            order = np.arange(n)
        else:
            order = np.lexsort((longitude, key))
            longitude, key, octave = longitude[order], key[order], octave[order]
            latitude_rad, size_m, range_m = latitude_rad[order], size_m[order], range_m[order]
        starts = np.searchsorted(key, np.arange(firsts[-1] + 1))
        limits = np.zeros((len(counts), 3))
        for t, (first, last) in enumerate(pairwise(firsts)):
            part = slice(starts[first], starts[last])
            if counts[t]:
                limits[t] = np.max(size_m[part]), np.min(range_m[part]), np.max(range_m[part])
        return cls(
            order, longitude, _directions(latitude_rad, longitude), np.ascontiguousarray(size_m),
            np.ascontiguousarray(range_m), firsts, starts, limits,
        )  # fmt: skip

    def near(self, direction: FloatArray, angle_rad: float, least_size_m: float = 0.0) -> IntArray:
        """Rows of the craters of some size whose centres lie within an angle of a unit vector (3,) in g."""
        found = _near(
            np.ascontiguousarray(direction, dtype=np.float64), float(angle_rad), float(least_size_m),
            self.longitude_rad, self.directions, self.size_m, self.firsts, self.starts, self.limits_m,
        )  # fmt: skip
        return self.order[found]

    def in_view(self, gPc: FloatArray, axis: FloatArray, cos_field: float, reach_per_size: float) -> IntArray:
        """Rows of the craters that a camera may see.

        Parameters
        ----------
        gPc : ndarray, shape (3,)
            Position of the camera in g, m.
        axis : ndarray, shape (3,)
            Unit vector along which it looks, in g.
        cos_field : float
            Of the half-angle of its field of view.
        reach_per_size : float
            How far a crater may be for each metre of its semi-major axis; inf for no limit.

        Returns
        -------
        ndarray of int, shape (k,)
            Those with their centre in the field, seen from above, near enough for their size.
        """
        found = _in_view(
            np.ascontiguousarray(gPc, dtype=np.float64), np.ascontiguousarray(axis, dtype=np.float64),
            float(cos_field), float(reach_per_size),
            self.longitude_rad, self.directions, self.size_m, self.range_m, self.firsts, self.starts,
            self.limits_m,
        )  # fmt: skip
        return self.order[found]

    def overlaps(self, alike: float) -> tuple[IntArray, IntArray]:
        """How craters meet each other, the rims taken for circles.

        Parameters
        ----------
        alike : float
            Two craters are taken for one when their sizes differ by less than this share of the smaller's,
            and their centres by less than this share of its radius.

        Returns
        -------
        crossings : ndarray of int, shape (m, 2)
            Pairs of rows of the catalogue whose rims cross, the larger first.
        twins : ndarray of int, shape (k, 2)
            Pairs of rows that are taken for one crater, the larger first.
        """
        crossings, twins = _overlaps(
            float(alike), self.longitude_rad, self.directions, self.size_m, self.range_m, self.firsts,
            self.starts, self.limits_m,
        )  # fmt: skip
        return self.order[crossings], self.order[twins]


@njit(cache=True, nogil=True, error_model="numpy")
def _directions(latitude_rad: FloatArray, longitude_rad: FloatArray) -> FloatArray:
    out = np.empty((latitude_rad.shape[0], 3))
    for i in range(latitude_rad.shape[0]):
        c = np.cos(latitude_rad[i])
        out[i, 0] = c * np.cos(longitude_rad[i])
        out[i, 1] = c * np.sin(longitude_rad[i])
        out[i, 2] = np.sin(latitude_rad[i])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _half_width(sin0: float, cos0: float, cos_cap: float, south: float, north: float) -> float:
    """Largest difference in longitude of a cap's points in a band of latitude from its centre; < 0: none."""
    if cos_cap <= 0.0:
        return np.pi
    # The cap is widest where a meridian touches it, or at the pole that it holds.
    widest = np.arcsin(min(max(sin0 / cos_cap, -1.0), 1.0))
    latitude = min(max(widest, south), north)
    cos = max(np.cos(latitude) * cos0, 1e-300)
    c = (cos_cap - sin0 * np.sin(latitude)) / cos
    if c >= 1.0:
        return 0.0 if c < 1.0 + 1e-12 else -1.0
    return np.pi if c <= -1.0 else np.arccos(c) + _SLACK_RAD / max(np.cos(latitude), 1e-9)


@njit(cache=True, nogil=True, error_model="numpy")
def _bisect(values: FloatArray, lo: int, hi: int, value: float) -> int:
    """First place in values[lo:hi] that is not below a value."""
    while lo < hi:
        middle = (lo + hi) // 2
        if values[middle] < value:
            lo = middle + 1
        else:
            hi = middle
    return lo


@njit(cache=True, nogil=True, error_model="numpy")
def _runs(
    direction: FloatArray, cos_cap: float, first: int, last: int, longitude: FloatArray, starts: IntArray,
    out: IntArray,
) -> int:  # fmt: skip
    """Write the runs [begin, end) of an octave's craters that hold those in a cap, and give their number."""
    sin0 = min(max(direction[2], -1.0), 1.0)
    latitude, cos0 = np.arcsin(sin0), np.sqrt(max(1.0 - sin0 * sin0, 0.0))
    around = np.arctan2(direction[1], direction[0])
    turn = 2.0 * np.pi
    around -= turn * np.floor(around / turn)
    angle = np.arccos(min(max(cos_cap, -1.0), 1.0)) + _SLACK_RAD
    cos_cap = np.cos(angle) if angle < np.pi else -1.0
    height = np.pi / (last - first)
    lowest = max(int(np.floor((latitude - angle + 0.5 * np.pi) / height)), 0)
    highest = min(int(np.floor((latitude + angle + 0.5 * np.pi) / height)), last - first - 1)
    count = 0
    for band in range(lowest, highest + 1):
        lo, hi = starts[first + band], starts[first + band + 1]
        if lo == hi:
            continue
        south = band * height - 0.5 * np.pi
        half = _half_width(sin0, cos0, cos_cap, south, south + height)
        if half < 0.0:
            continue
        if half >= np.pi - _SLACK_RAD:
            out[count, 0], out[count, 1] = lo, hi
            count += 1
            continue
        west, east = around - half, around + half
        out[count, 0], out[count, 1] = _bisect(longitude, lo, hi, west), _bisect(longitude, lo, hi, east)
        count += 1
        if west < 0.0:
            out[count, 0], out[count, 1] = _bisect(longitude, lo, hi, west + turn), hi
            count += 1
        elif east > turn:
            out[count, 0], out[count, 1] = lo, _bisect(longitude, lo, hi, east - turn)
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _near(
    direction: FloatArray, angle: float, least: float, longitude: FloatArray, directions: FloatArray,
    size: FloatArray, firsts: IntArray, starts: IntArray, limits: FloatArray,
) -> IntArray:  # fmt: skip
    runs = np.empty((2 * _MOST_BANDS + 2, 2), dtype=np.int64)
    found = np.empty(size.shape[0], dtype=np.int64)
    count = 0
    cos_cap = np.cos(min(angle, np.pi))
    for t in range(limits.shape[0]):
        if limits[t, 0] < least:
            continue
        for r in range(_runs(direction, cos_cap, firsts[t], firsts[t + 1], longitude, starts, runs)):
            for k in range(runs[r, 0], runs[r, 1]):
                # The chord, as the cosine of a small angle has no digits left.
                chord = 0.0
                for i in range(3):
                    chord += (directions[k, i] - direction[i]) ** 2
                if size[k] >= least and 2.0 * np.arcsin(min(0.5 * np.sqrt(chord), 1.0)) <= angle:
                    found[count] = k
                    count += 1
    return found[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _in_view(
    P: FloatArray, axis: FloatArray, cos_field: float, reach: float, longitude: FloatArray,
    directions: FloatArray, size: FloatArray, range_m: FloatArray, firsts: IntArray, starts: IntArray,
    limits: FloatArray,
) -> IntArray:  # fmt: skip
    runs = np.empty((2 * _MOST_BANDS + 2, 2), dtype=np.int64)
    found = np.empty(1024, dtype=np.int64)
    count = 0
    D2 = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    D = np.sqrt(D2)
    if not D > 0.0:
        return found[:0].copy()
    nadir = P / D
    for t in range(limits.shape[0]):
        low, high = limits[t, 1], limits[t, 2]
        if not low > 0.0:
            continue
        # Over the horizon of the deepest crater, and no farther than its octave's largest may be.
        cos_cap = low / D
        farthest = reach * limits[t, 0]
        if farthest < np.inf:
            gap = D2 - farthest * farthest
            at = min(max(np.sqrt(max(gap, 0.0)), low), high)
            cos_cap = max(cos_cap, 0.5 * (gap / at + at) / D)
        if cos_cap > 1.0:
            continue
        for r in range(_runs(nadir, cos_cap, firsts[t], firsts[t + 1], longitude, starts, runs)):
            for k in range(runs[r, 0], runs[r, 1]):
                nx, ny, nz = directions[k, 0], directions[k, 1], directions[k, 2]
                if nx * P[0] + ny * P[1] + nz * P[2] <= range_m[k]:
                    continue
                vx = range_m[k] * nx - P[0]
                vy = range_m[k] * ny - P[1]
                vz = range_m[k] * nz - P[2]
                distance = np.sqrt(vx * vx + vy * vy + vz * vz)
                if distance > reach * size[k]:
                    continue
                if vx * axis[0] + vy * axis[1] + vz * axis[2] < cos_field * distance:
                    continue
                if count == found.shape[0]:
                    larger = np.empty(2 * count, dtype=np.int64)
                    larger[:count] = found
                    found = larger
                found[count] = k
                count += 1
    return found[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _overlaps(
    alike: float, longitude: FloatArray, directions: FloatArray, size: FloatArray, range_m: FloatArray,
    firsts: IntArray, starts: IntArray, limits: FloatArray,
) -> tuple[IntArray, IntArray]:  # fmt: skip
    runs = np.empty((2 * _MOST_BANDS + 2, 2), dtype=np.int64)
    crossings, twins = np.empty((1024, 2), dtype=np.int64), np.empty((1024, 2), dtype=np.int64)
    crossed = count = 0
    for t in range(limits.shape[0]):
        for i in range(starts[firsts[t]], starts[firsts[t + 1]]):
            # Each pair once: with the smaller octaves, and within its own those not larger.
            for s in range(t + 1):
                # The distance is a chord; the arc above it is longer.
                chord = (size[i] + limits[s, 0]) / range_m[i]
                angle = 2.0 * np.arcsin(min(0.5 * chord, 1.0))
                m = _runs(directions[i], np.cos(angle), firsts[s], firsts[s + 1], longitude, starts, runs)
                for r in range(m):
                    for k in range(runs[r, 0], runs[r, 1]):
                        if size[k] > size[i] or (size[k] == size[i] and k <= i):
                            continue
                        d2 = 0.0
                        for j in range(3):
                            d2 += (directions[k, j] - directions[i, j]) ** 2
                        d2 *= range_m[i] * range_m[i]
                        a, b = size[i], size[k]
                        if d2 < (alike * b) ** 2 and a - b < alike * b:
                            twins = _with_pair(twins, count, i, k)
                            count += 1
                        elif (a - b) ** 2 < d2 < (a + b) ** 2:
                            crossings = _with_pair(crossings, crossed, i, k)
                            crossed += 1
    return crossings[:crossed].copy(), twins[:count].copy()


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
