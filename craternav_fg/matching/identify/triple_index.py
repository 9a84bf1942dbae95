"""The index of a catalogue: triples of craters by five numbers that neither scale nor turning changes.

A triple is a crater and two of its nearest neighbours of at least `SMALLEST` its size, counter-clockwise as
seen from above. Its numbers are two sides and the three sizes, over the perimeter; sides are chords.
"""

import hashlib
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.spatial import cKDTree

from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.matching.identify import tree
from craternav_fg.matching.identify.craters import Craters, craters_of, log_sizes

FloatArray = npt.NDArray[np.float64]

VERSION = 1
SMALLEST = 0.9
# What numpy and zipfile raise for a file that is none of ours, or has a byte that is wrong.
_NO_INDEX = (
    OSError, EOFError, ValueError, KeyError, TypeError, RuntimeError, MemoryError, zipfile.BadZipFile,
    zlib.error, tokenize.TokenError,
)  # fmt: skip
# Of the sides over the perimeter, 0 to 1/2, and of the logarithms of sizes over the perimeter.
SIDE_UNIT = 0.5 / 65535
SIZE_UNIT = 9.0 / 65535
LEAST_LOG = -8.0
# A tree that is asked with small tolerances on sides and large ones on sizes is halved likewise.
_SPREAD = np.array([4.0 * SIDE_UNIT, 4.0 * SIDE_UNIT, SIZE_UNIT, SIZE_UNIT, SIZE_UNIT])
# Neighbours of a crater: missing and false rims need many, the room that a large catalogue takes needs few.
_NEIGHBOURS = ((100_000, 9), (400_000, 7), (np.inf, 6))
# Ratio of the sizes of craters whose neighbours are sought in one tree.
_LEVEL = 1.15


@dataclass(frozen=True)
class Triples:
    """The part of an index that is stored.

    Attributes
    ----------
    neighbours : ndarray of int32, shape (n, k)
        Of each crater, nearest first; -1 where there is none.
    points : ndarray of uint16, shape (m, 5)
        The five numbers of each triple, ordered as a tree.
    codes : ndarray of uint32, shape (m,)
        crater k^2 + i k + j: its neighbours i and j.
    dims : ndarray of uint8
    splits : ndarray of uint16
        Of the tree's nodes.
    levels : int
    """

    neighbours: npt.NDArray[np.int32]
    points: tree.Points
    codes: tree.Codes
    dims: npt.NDArray[np.uint8]
    splits: tree.Points
    levels: int

    @property
    def nbytes(self) -> int:
        """Size in memory and, but for headers, on disk."""
        return sum(a.nbytes for a in (self.neighbours, self.points, self.codes, self.dims, self.splits))


@dataclass(frozen=True)
class TripleIndex:
    """A catalogue, ready for identification.

    Attributes
    ----------
    catalog : Catalog
    triples : Triples
    """

    catalog: Catalog
    triples: Triples

    @classmethod
    def build(cls, catalog: Catalog) -> "TripleIndex":
        """Index a catalogue of at least one crater."""
        return cls(catalog, _triples(catalog))

    @cached_property
    def craters(self) -> Craters:
        """The catalogue's craters."""
        return craters_of(self.catalog)

    def save(self, path: Path) -> None:
        """Write the index; the file appears whole or not at all.

        Raises
        ------
        InputError
            When it cannot be written.
        """
        t = self.triples
        with replacing(path) as temporary, temporary.open("wb") as stream:
            np.savez(
                stream, version=VERSION, fingerprint=fingerprint(self.catalog), neighbours=t.neighbours,
                points=t.points, codes=t.codes, dims=t.dims, splits=t.splits, levels=t.levels,
            )  # fmt: skip

    @classmethod
    def load(cls, path: Path, catalog: Catalog) -> "TripleIndex":
        """Read the index of a catalogue.

        Raises
        ------
        InputError
            When the file is missing, none of ours, of another version or of another catalogue.
        """
        if not path.is_file():
            raise InputError(path, "none yet")
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
                found = int(data["version"])
                if found != VERSION:
                    raise InputError(path, f"expected an index of version {VERSION}, found {found}")
                if str(data["fingerprint"]) != fingerprint(catalog):
                    raise InputError(path, "is the index of another catalogue")
                triples = Triples(
                    data["neighbours"], data["points"], data["codes"], data["dims"], data["splits"],
                    int(data["levels"]),
                )  # fmt: skip
        except _NO_INDEX:
            raise InputError(path, "expected an index written by craternav, found something else") from None
        return cls(catalog, triples)


def load_or_build(path: Path, catalog: Catalog) -> tuple[TripleIndex, str]:
    """Give a catalogue's index: the stored one or, when that is not of this catalogue, a new one.

    Parameters
    ----------
    path : Path
        Where it is stored.
    catalog : Catalog

    Returns
    -------
    index : TripleIndex
    said : str
        Why it was built, and what became of it; empty when it was loaded.
    """
    try:
        return TripleIndex.load(path, catalog), ""
    except InputError as error:
        said = f"{error}: built"
    index = TripleIndex.build(catalog)
    try:
        index.save(path)
    except InputError as error:
        said += f", not stored ({error})"
    return index, said


def fingerprint(catalog: Catalog) -> str:
    """Hash of all that an index depends on: craters, their order, the body's radius."""
    digest = hashlib.blake2b(digest_size=16)
    for values in (
        catalog.latitude_rad, catalog.longitude_rad, catalog.semi_major_m, catalog.semi_minor_m,
        catalog.angle_rad, catalog.height_m, np.array([catalog.body.radius_m]),
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return digest.hexdigest()


def _triples(catalog: Catalog) -> Triples:
    centres = np.ascontiguousarray(catalog.centres)
    sizes = log_sizes(catalog)
    count = next(k for most, k in _NEIGHBOURS if len(catalog) <= most)
    neighbours = _neighbours(centres, sizes, count)
    total = _number(neighbours)
    points = np.empty((total, tree.DIMENSIONS), dtype=np.uint16)
    codes = np.empty(total, dtype=np.uint32)
    _describe_all(centres, sizes, neighbours, points, codes)
    levels = tree.levels_of(total)
    dims, splits = tree.build(points, codes, _SPREAD, levels)
    return Triples(neighbours, points, codes, dims, splits, levels)


def _neighbours(centres: FloatArray, log_sizes: FloatArray, count: int) -> npt.NDArray[np.int32]:
    """Nearest neighbours (n, count) of at least `SMALLEST` each one's size, -1 where there are fewer."""
    n = len(centres)
    out = np.full((n, count), -1, dtype=np.int32)
    order = np.argsort(log_sizes)
    ordered = log_sizes[order]
    slack = np.log(SMALLEST)
    first = 0
    while first < n:
        last = int(np.searchsorted(ordered, ordered[first] + np.log(_LEVEL), side="right"))
        large = order[np.searchsorted(ordered, ordered[first] + slack) :]
        wanted = min(2 * count + 2, len(large))
        tree_of_level = cKDTree(centres[large], compact_nodes=False, balanced_tree=False)
        _, found = tree_of_level.query(centres[order[first:last]], k=wanted)
        rows = large[found.reshape(last - first, wanted)]
        _keep_large(order[first:last], rows, log_sizes, slack, out)
        first = last
    return out


@njit(cache=True, error_model="numpy")
def _keep_large(
    craters: npt.NDArray[np.int64], rows: npt.NDArray[np.int64], log_sizes: FloatArray, slack: float,
    out: npt.NDArray[np.int32],
) -> None:  # fmt: skip
    for i in range(craters.shape[0]):
        crater = craters[i]
        k = 0
        for row in rows[i]:
            if row != crater and log_sizes[row] >= log_sizes[crater] + slack and k < out.shape[1]:
                out[crater, k] = row
                k += 1


@njit(cache=True, error_model="numpy")
def _number(neighbours: npt.NDArray[np.int32]) -> int:
    total = 0
    for i in range(neighbours.shape[0]):
        k = 0
        while k < neighbours.shape[1] and neighbours[i, k] >= 0:
            k += 1
        total += k * (k - 1) // 2
    return total


@njit(cache=True, error_model="numpy")
def describe(
    X: FloatArray, log_sizes: FloatArray, i: int, j: int, k: int, out: FloatArray
) -> tuple[bool, float]:
    """Write the five numbers (5,) of three craters, in the tree's units.

    Parameters
    ----------
    X : ndarray, shape (n, 3)
        Centres, from that of a sphere.
    log_sizes : ndarray, shape (n,)
        In the same units.
    i, j, k : int
        Rows of the three.
    out : ndarray, shape (5,)
        Written.

    Returns
    -------
    swapped : bool
        Whether j and k changed places: the numbers are of i, k, j, which is counter-clockwise from above.
    perimeter : float
    """
    ax, ay, az = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
    bx, by, bz = X[k, 0] - X[i, 0], X[k, 1] - X[i, 1], X[k, 2] - X[i, 2]
    turn = X[i, 0] * (ay * bz - az * by) + X[i, 1] * (az * bx - ax * bz) + X[i, 2] * (ax * by - ay * bx)
    a = np.sqrt(ax * ax + ay * ay + az * az)
    b = np.sqrt(bx * bx + by * by + bz * bz)
    c = np.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2)
    perimeter = a + b + c
    log = np.log(perimeter) + LEAST_LOG
    swapped = turn < 0.0
    if swapped:
        a, b = b, a
        j, k = k, j
    out[0] = a / perimeter / SIDE_UNIT
    out[1] = b / perimeter / SIDE_UNIT
    out[2] = (log_sizes[i] - log) / SIZE_UNIT
    out[3] = (log_sizes[j] - log) / SIZE_UNIT
    out[4] = (log_sizes[k] - log) / SIZE_UNIT
    return swapped, perimeter


@njit(cache=True, error_model="numpy")
def _describe_all(
    centres: FloatArray, log_sizes: FloatArray, neighbours: npt.NDArray[np.int32], points: tree.Points,
    codes: tree.Codes,
) -> None:  # fmt: skip
    count = neighbours.shape[1]
    numbers = np.empty(5)
    row = 0
    for i in range(neighbours.shape[0]):
        for p in range(count):
            for q in range(p + 1, count):
                if neighbours[i, q] < 0:
                    break
                swapped, _ = describe(centres, log_sizes, i, neighbours[i, p], neighbours[i, q], numbers)
                first, second = (q, p) if swapped else (p, q)
                codes[row] = (i * count + first) * count + second
                for d in range(5):
                    points[row, d] = int(min(max(numbers[d] + 0.5, 0.0), 65535.0))
                row += 1
