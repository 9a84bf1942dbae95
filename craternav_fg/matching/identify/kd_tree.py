"""A k-d tree of points of five 16-bit numbers, as arrays that are stored and loaded without a copy.

SciPy's tree can be stored only as a pickle, has one metric for all queries, and is queried from Python. Here
every query has weights of its own and comes from compiled code, and a point takes 14 bytes.

Node 1 is the root; node k has the children 2k and 2k + 1, which hold the first and the second half of its
points.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

Points = npt.NDArray[np.uint16]
Codes = npt.NDArray[np.uint32]
Dims = npt.NDArray[np.uint8]

DIMENSIONS = 5
# Largest number of points in a leaf: a shorter scan would not pay for a deeper descent.
_LEAF_POINTS = 24
# Room for the nodes that a query has yet to visit: more than the tree can be deep.
_MAX_DEPTH = 40
# Levels of inner nodes: a tree of all numbers of 32 bits has as many.
MAX_LEVELS = 32
# Points by which the spread of a large node is judged.
_SPREAD_SAMPLE = 512


class Tree(NamedTuple):
    """Points, ordered so that each node's points are contiguous."""

    points: Points
    """Shape (n, 5)."""
    codes: Codes
    """What each point stands for, shape (n,)."""
    dims: Dims
    """Dimension in which each inner node is split, shape (2^levels,)."""
    splits: Points
    """Value at which each inner node is split, shape (2^levels,)."""
    levels: int
    """Levels of inner nodes."""


def build(points: Points, codes: Codes, weights: FloatArray) -> Tree:
    """Build a tree; the arrays given are reordered in place and belong to it.

    Parameters
    ----------
    points : ndarray of uint16, shape (n, 5)
    codes : ndarray of uint32, shape (n,)
        What each point stands for.
    weights : ndarray, shape (5,)
        Weights of the dimensions: each node is split where its weighted spread is largest.

    Returns
    -------
    Tree
    """
    levels = 0
    while len(points) > _LEAF_POINTS << levels:
        levels += 1
    dims, splits = _order(points, codes, weights, levels)
    return Tree(points, codes, dims, splits, levels)


@njit(cache=True, error_model="numpy")
def _swap(points: Points, codes: Codes, i: int, j: int) -> None:
    """Swap two rows."""
    for d in range(DIMENSIONS):
        points[i, d], points[j, d] = points[j, d], points[i, d]
    codes[i], codes[j] = codes[j], codes[i]


@njit(cache=True, error_model="numpy")
def _select(points: Points, codes: Codes, lo: int, hi: int, middle: int, d: int) -> None:
    """Order rows lo to hi: in dimension d, none before `middle` is above it and none after it is below."""
    hi -= 1
    while hi > lo:
        # The median of three as pivot: rows in order would otherwise cost the square of their number.
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
def _order(points: Points, codes: Codes, weights: FloatArray, levels: int) -> tuple[Dims, Points]:
    """Order points and codes into a tree, in place; return each inner node's dimension and value."""
    dims = np.zeros(1 << levels, dtype=np.uint8)
    splits = np.zeros(1 << levels, dtype=np.uint16)
    n = points.shape[0]
    for level in range(levels):
        first = 1 << level
        for node in range(first, 2 * first):
            # The bits of a node's number tell which halves lead to it.
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
                for i in range(lo, hi, 1 + (hi - lo) // _SPREAD_SAMPLE):
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
    tree: Tree, query: FloatArray, weights: FloatArray, reach2: float, found_d2: FloatArray, found: Codes
) -> int:
    """Find the nearest points; write their codes and squared distances, in no order.

    Parameters
    ----------
    tree : Tree
    query : ndarray, shape (5,)
        In the points' units.
    weights : ndarray, shape (5,)
        Factors on the differences in each dimension.
    reach2 : float
        Points at this squared distance or farther are ignored.
    found_d2 : ndarray, shape (m,)
        Written: squared weighted distances.
    found : ndarray of uint32, shape (m,)
        Written: codes.

    Returns
    -------
    int
        Number of points found, at most m.
    """
    room = found.shape[0]
    count = 0
    nodes = np.empty(_MAX_DEPTH, dtype=np.int64)
    bounds = np.empty((_MAX_DEPTH, 2), dtype=np.int64)
    sides = np.empty((_MAX_DEPTH, DIMENSIONS))
    away = np.empty(_MAX_DEPTH)
    nodes[0], bounds[0, 0], bounds[0, 1], away[0] = 1, 0, tree.points.shape[0], 0.0
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
        while node < 1 << tree.levels:
            d = tree.dims[node]
            middle = (lo + hi) // 2
            delta = weights[d] * (query[d] - float(tree.splits[node]))
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
                e = weights[d] * (query[d] - float(tree.points[i, d]))
                d2 += e * e
            if d2 >= reach2:
                continue
            if count < room:
                # Sift up.
                k = count
                found_d2[k], found[k] = d2, tree.codes[i]
                while k and found_d2[(k - 1) // 2] < found_d2[k]:
                    parent = (k - 1) // 2
                    found_d2[k], found_d2[parent] = found_d2[parent], found_d2[k]
                    found[k], found[parent] = found[parent], found[k]
                    k = parent
                count += 1
            else:
                found_d2[0], found[0] = d2, tree.codes[i]
                _sink(found_d2, found, count)
            if count == room:
                reach2 = min(reach2, found_d2[0])
    return count
