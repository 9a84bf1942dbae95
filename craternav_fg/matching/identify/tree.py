"""A k-d tree of points of five 16-bit numbers, as arrays that are stored and loaded without a copy.

SciPy's tree has no form on disk but a pickle, takes a metric of equal weights, and is asked from Python, one
call for each set of points. Here every query brings its own weights, from within a compiled search, and a
point takes 14 bytes.

Node k has the children 2k and 2k + 1; its points are the first and the second half of its range.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
Points = npt.NDArray[np.uint16]
Codes = npt.NDArray[np.uint32]

DIMENSIONS = 5
_LEAF = 24
_DEPTH = 40


def levels_of(count: int) -> int:
    """Levels of inner nodes of a tree of some points."""
    levels = 0
    while count > _LEAF << levels:
        levels += 1
    return levels


@njit(cache=True, error_model="numpy")
def _swap(points: Points, codes: Codes, i: int, j: int) -> None:
    for d in range(DIMENSIONS):
        points[i, d], points[j, d] = points[j, d], points[i, d]
    codes[i], codes[j] = codes[j], codes[i]


@njit(cache=True, error_model="numpy")
def _select(points: Points, codes: Codes, lo: int, hi: int, middle: int, d: int) -> None:
    """Order the rows lo to hi so that none before `middle` is above it in dimension d, none after below."""
    hi -= 1
    while hi > lo:
        # The median of three keeps ordered rows from costing the square of their number.
        mid = (lo + hi) // 2
        if points[mid, d] < points[lo, d]:
            _swap(points, codes, mid, lo)
        if points[hi, d] < points[lo, d]:
            _swap(points, codes, hi, lo)
        if points[hi, d] < points[mid, d]:
            _swap(points, codes, hi, mid)
        pivot = points[mid, d]
        i, j = lo, hi
        while i <= j:
            while points[i, d] < pivot:
                i += 1
            while points[j, d] > pivot:
                j -= 1
            if i <= j:
                _swap(points, codes, i, j)
                i += 1
                j -= 1
        if middle <= j:
            hi = j
        elif middle >= i:
            lo = i
        else:
            return


@njit(cache=True, error_model="numpy")
def build(
    points: Points, codes: Codes, weights: FloatArray, levels: int
) -> tuple[npt.NDArray[np.uint8], Points]:
    """Order points and codes into a tree, in place; give each inner node's dimension and value.

    Parameters
    ----------
    points : ndarray of uint16, shape (n, 5)
    codes : ndarray of uint32, shape (n,)
        What each point stands for.
    weights : ndarray, shape (5,)
        Per dimension: the widest weighted spread is halved.
    levels : int
        From `levels_of`.
    """
    dims = np.zeros(1 << levels, dtype=np.uint8)
    splits = np.zeros(1 << levels, dtype=np.uint16)
    n = points.shape[0]
    for level in range(levels):
        first = 1 << level
        for node in range(first, 2 * first):
            # The range of a node follows from its number: halves of halves.
            lo, hi = 0, n
            for k in range(level - 1, -1, -1):
                half = (lo + hi) // 2
                if (node >> k) & 1:
                    lo = half
                else:
                    hi = half
            best, widest = 0, -1.0
            for d in range(DIMENSIONS):
                least, most = points[lo, d], points[lo, d]
                # A sample tells the spread of a large node.
                for i in range(lo, hi, 1 + (hi - lo) // 512):
                    least = min(least, points[i, d])
                    most = max(most, points[i, d])
                spread = weights[d] * (float(most) - float(least))
                if spread > widest:
                    best, widest = d, spread
            middle = (lo + hi) // 2
            _select(points, codes, lo, hi, middle, best)
            dims[node] = best
            splits[node] = points[middle, best]
    return dims, splits


@njit(cache=True, error_model="numpy")
def _sink(d2: FloatArray, codes: Codes, count: int) -> None:
    """Restore the heap, largest first, below its changed root."""
    i = 0
    while True:
        child = 2 * i + 1
        if child >= count:
            return
        if child + 1 < count and d2[child + 1] > d2[child]:
            child += 1
        if d2[child] <= d2[i]:
            return
        d2[i], d2[child] = d2[child], d2[i]
        codes[i], codes[child] = codes[child], codes[i]
        i = child


@njit(cache=True, error_model="numpy")
def nearest(
    points: Points, codes: Codes, dims: npt.NDArray[np.uint8], splits: Points, levels: int,
    query: FloatArray, weights: FloatArray, reach2: float, found_d2: FloatArray, found: Codes,
) -> int:  # fmt: skip
    """Write the codes of the nearest points, in no order, and their squared distances; give their number.

    Parameters
    ----------
    points, codes, dims, splits, levels
        Of the tree.
    query : ndarray, shape (5,)
        In the points' units.
    weights : ndarray, shape (5,)
        Per dimension, on differences.
    reach2 : float
        Points at this squared distance or beyond are not sought.
    found_d2, found : ndarray, shape (m,)
        Room for the m nearest.
    """
    room = found.shape[0]
    count = 0
    nodes = np.empty(_DEPTH, dtype=np.int64)
    bounds = np.empty((_DEPTH, 2), dtype=np.int64)
    sides = np.empty((_DEPTH, DIMENSIONS))
    away = np.empty(_DEPTH)
    nodes[0], bounds[0, 0], bounds[0, 1], away[0] = 1, 0, points.shape[0], 0.0
    sides[0] = 0.0
    top = 1
    near = np.empty(DIMENSIONS)
    while top:
        top -= 1
        if away[top] >= reach2:
            continue
        node, lo, hi = nodes[top], bounds[top, 0], bounds[top, 1]
        total = away[top]
        for d in range(DIMENSIONS):
            near[d] = sides[top, d]
        while node < 1 << levels:
            d = dims[node]
            middle = (lo + hi) // 2
            delta = weights[d] * (query[d] - float(splits[node]))
            other = total - near[d] * near[d] + delta * delta
            after = delta >= 0.0
            if other < reach2:
                nodes[top] = 2 * node + (0 if after else 1)
                bounds[top, 0] = lo if after else middle
                bounds[top, 1] = middle if after else hi
                for k in range(DIMENSIONS):
                    sides[top, k] = near[k]
                sides[top, d] = abs(delta)
                away[top] = other
                top += 1
            if after:
                lo = middle
            else:
                hi = middle
            node = 2 * node + (1 if after else 0)
        for i in range(lo, hi):
            d2 = 0.0
            for d in range(DIMENSIONS):
                e = weights[d] * (query[d] - float(points[i, d]))
                d2 += e * e
            if d2 >= reach2:
                continue
            if count < room:
                # Sift up.
                k = count
                found_d2[k], found[k] = d2, codes[i]
                while k and found_d2[(k - 1) // 2] < found_d2[k]:
                    parent = (k - 1) // 2
                    found_d2[k], found_d2[parent] = found_d2[parent], found_d2[k]
                    found[k], found[parent] = found[parent], found[k]
                    k = parent
                count += 1
            else:
                found_d2[0], found[0] = d2, codes[i]
                _sink(found_d2, found, count)
            if count == room:
                reach2 = min(reach2, found_d2[0])
    return count
