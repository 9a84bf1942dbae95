"""Index of a catalogue: triples of craters, described by five numbers that scale and rotation do not change.

A triple is a crater and two of its nearest neighbours of at least `SMALLEST` its size, counter-clockwise as
seen from above. The numbers are two side lengths over the perimeter, and the logarithms of the three sizes
over the perimeter. Sides are chords; a size is the geometric mean of the semi-axes.
"""

import hashlib
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from io import BufferedReader
from pathlib import Path

import numpy as np
import numpy.typing as npt
import platformdirs

from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, open_input, replacing
from craternav_fg.matching.identify import kd_tree
from craternav_fg.matching.identify.craters import Craters, craters_of, log_sizes
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Int32Array = npt.NDArray[np.int32]

# Version of the file's format: to be raised when the triples or the tree change.
VERSION = 1
# Least size of a neighbour over the crater's: measured sizes of equal craters may differ by as much.
SMALLEST = 0.9
# What numpy and zipfile raise for a file of another kind, or with a corrupted byte.
_UNREADABLE = (
    OSError, EOFError, ValueError, KeyError, TypeError, RuntimeError, MemoryError, zipfile.BadZipFile,
    zlib.error, tokenize.TokenError,
)  # fmt: skip
# Units of the 16-bit numbers: sides over the perimeter are 0 to 1/2; logarithms of sizes over the perimeter
# are `MIN_LOG_SIZE` to `MIN_LOG_SIZE` + 9, and beyond that stored as the nearer end.
SIDE_UNIT = 0.5 / 65535
SIZE_UNIT = 9.0 / 65535
MIN_LOG_SIZE = -8.0
# Weights by which the tree is split: queries tolerate about four times as much in sizes as in sides.
_SPLIT_WEIGHTS = np.array([4.0 * SIDE_UNIT, 4.0 * SIDE_UNIT, SIZE_UNIT, SIZE_UNIT, SIZE_UNIT])
# Neighbours per crater, for catalogues of up to so many craters: many allow for missing and false rims, few
# limit the memory of a large catalogue.
_NEIGHBOURS = ((100_000, 9), (400_000, 7), (np.inf, 6))
# Ratio of the sizes of craters whose neighbours are sought in one tree of the larger craters.
_SIZE_STEP = 1.15


@dataclass(frozen=True)
class TripleIndex:
    """A catalogue with its triples, ready for identification.

    Attributes
    ----------
    catalog : Catalog
    neighbours : ndarray of int32, shape (n, k)
        Rows of each crater's neighbours, nearest first; -1 where there are fewer.
    tree : Tree
        The triples' five numbers; the code of a triple of crater c and its neighbours i and j is
        c k^2 + i k + j.
    """

    catalog: Catalog
    neighbours: Int32Array
    tree: kd_tree.Tree

    @classmethod
    def build(cls, catalog: Catalog) -> "TripleIndex":
        """Index a catalogue.

        Parameters
        ----------
        catalog : Catalog
            At least one crater.

        Returns
        -------
        TripleIndex
        """
        centres, sizes = np.ascontiguousarray(catalog.centres), log_sizes(catalog)
        count = next(k for most, k in _NEIGHBOURS if len(catalog) <= most)
        neighbours = _neighbours(centres, sizes, count)
        found = np.sum(neighbours >= 0, axis=1)
        total = int(np.sum(found * (found - 1) // 2))
        points = np.empty((total, kd_tree.DIMENSIONS), dtype=np.uint16)
        codes = np.empty(total, dtype=np.uint32)
        _describe_all(centres, sizes, neighbours, points, codes)
        return cls(catalog, neighbours, kd_tree.build(points, codes, _SPLIT_WEIGHTS))

    @cached_property
    def craters(self) -> Craters:
        """The catalogue's craters as compiled code takes them."""
        return craters_of(self.catalog)

    @property
    def nbytes(self) -> int:
        """Size of the triples in memory and, but for headers, on disk."""
        t = self.tree
        return sum(a.nbytes for a in (self.neighbours, t.points, t.codes, t.dims, t.splits))

    def save(self, path: Path) -> None:
        """Write the index; the file is complete or absent.

        Parameters
        ----------
        path : Path
            A .npz file.

        Raises
        ------
        InputError
            When it cannot be written.
        """
        t = self.tree
        with replacing(path) as temporary, temporary.open("wb") as stream:
            np.savez(
                stream, version=VERSION, fingerprint=fingerprint(self.catalog), neighbours=self.neighbours,
                points=t.points, codes=t.codes, dims=t.dims, splits=t.splits, levels=t.levels,
            )  # fmt: skip

    @classmethod
    def load(cls, path: Path, catalog: Catalog) -> "TripleIndex":
        """Read the index of a catalogue.

        Parameters
        ----------
        path : Path
        catalog : Catalog
            The catalogue that was indexed.

        Returns
        -------
        TripleIndex

        Raises
        ------
        InputError
            When the file is missing, of another kind or version, or the index of another catalogue.
        """
        with open_input(path, SizeLimit.ARCHIVE) as stream:
            return cls._load(path, stream, catalog)

    @classmethod
    def _load(cls, path: Path, stream: BufferedReader, catalog: Catalog) -> "TripleIndex":
        try:
            with zipfile.ZipFile(stream) as archive:
                # `save` stores the arrays as they are; a few compressed bytes could fill the memory.
                if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
                    raise InputError(path, "expected arrays that are not compressed")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as data:
                found = int(data["version"])
                if found != VERSION:
                    raise InputError(path, f"expected an index of version {VERSION}, found {found}")
                if str(data["fingerprint"]) != fingerprint(catalog):
                    raise InputError(path, "is the index of another catalogue")
                tree = kd_tree.Tree(
                    data["points"], data["codes"], data["dims"], data["splits"], int(data["levels"])
                )
                index = cls(catalog, data["neighbours"], tree)
        except _UNREADABLE:
            raise InputError(path, "expected an index written by craternav, found something else") from None
        problem = index.fault()
        if problem is not None:
            raise InputError(path, f"is damaged: {problem}")
        return index

    def fault(self) -> str | None:
        """Say what makes the arrays unfit for compiled code, which checks no bounds.

        Returns
        -------
        str or None
            None when nothing does.
        """
        t, n = self.tree, len(self.catalog)
        count = self.neighbours.shape[1] if self.neighbours.ndim == 2 else 0
        nodes = 1 << t.levels if 0 <= t.levels <= kd_tree.MAX_LEVELS else 0
        expected = (
            ("neighbours", self.neighbours, (n, count), np.int32),
            ("points", t.points, (t.codes.size, kd_tree.DIMENSIONS), np.uint16),
            ("codes", t.codes, (t.codes.size,), np.uint32),
            ("dims", t.dims, (nodes,), np.uint8),
            ("splits", t.splits, (nodes,), np.uint16),
        )
        for name, array, shape, dtype in expected:
            if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
                return f"expected {name} of {np.dtype(dtype)} {shape}, found {array.dtype} {array.shape}"
        if not 2 <= count <= _NEIGHBOURS[0][1]:
            return f"expected 2 to {_NEIGHBOURS[0][1]} neighbours, found {count}"
        if n and not -1 <= self.neighbours.min() <= self.neighbours.max() < n:
            return "a neighbour is no crater of the catalogue"
        if t.codes.size and t.codes.max() >= n * count * count:
            return "a triple is of no crater of the catalogue"
        if t.dims.max() >= kd_tree.DIMENSIONS:
            return "a node is split in no dimension"
        return None


def index_path(catalog: Path) -> Path:
    """Return the default path of a catalogue's index for identification: in the user's cache.

    Parameters
    ----------
    catalog : Path

    Returns
    -------
    Path
        Another one for each path of a catalogue.
    """
    place = hashlib.sha256(str(catalog.resolve()).encode()).hexdigest()[:12]
    return platformdirs.user_cache_path("craternav_fg") / f"{catalog.stem}-{place}.index.npz"


def load_or_build(path: Path, catalog: Catalog) -> tuple[TripleIndex, str]:
    """Load the index of a catalogue or, when there is none at a path, build and store it.

    Parameters
    ----------
    path : Path
        Where the index is stored.
    catalog : Catalog

    Returns
    -------
    index : TripleIndex
    message : str
        Why it was built, and whether it could be stored; empty when it was loaded.
    """
    message = f"{path} is built, once for this catalogue"
    if path.exists():
        try:
            return TripleIndex.load(path, catalog), ""
        except InputError as error:
            message = f"{error}; built anew"
    index = TripleIndex.build(catalog)
    try:
        index.save(path)
    except InputError as error:
        message += f", not stored ({error})"
    return index, message


def fingerprint(catalog: Catalog) -> str:
    """Hash all that an index depends on: the craters, their order, and the body's radius.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    str
        Hexadecimal digits.
    """
    digest = hashlib.blake2b(digest_size=16)
    for values in (
        catalog.latitude_rad, catalog.longitude_rad, catalog.semi_major_m, catalog.semi_minor_m,
        catalog.angle_rad, catalog.height_m, np.array([catalog.body.radius_m]),
        np.empty(0) if catalog.plane_tilt_rad is None else catalog.plane_tilt_rad,
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return digest.hexdigest()


def _neighbours(centres: FloatArray, sizes: FloatArray, count: int) -> Int32Array:
    """Nearest neighbours (n, count) of at least `SMALLEST` each one's size, -1 where there are fewer."""
    # Imported here: an index that is read from a file needs none.
    from scipy.spatial import cKDTree

    n = len(centres)
    out = np.full((n, count), -1, dtype=np.int32)
    order = np.argsort(sizes)
    ordered = sizes[order]
    slack = np.log(SMALLEST)
    first = 0
    while first < n:
        last = int(np.searchsorted(ordered, ordered[first] + np.log(_SIZE_STEP), side="right"))
        large = order[np.searchsorted(ordered, ordered[first] + slack) :]
        # The tree also holds craters too small for the larger ones of this step.
        wanted = min(2 * count + 2, len(large))
        tree_of_step = cKDTree(centres[large], compact_nodes=False, balanced_tree=False)
        _, found = tree_of_step.query(centres[order[first:last]], k=wanted)
        rows = large[found.reshape(last - first, wanted)]
        _keep_large(order[first:last], rows, sizes, slack, out)
        first = last
    return out


@njit(cache=True, error_model="numpy")
def _keep_large(craters: IntArray, rows: IntArray, sizes: FloatArray, slack: float, out: Int32Array) -> None:
    """Write the first of the neighbours `rows` (n, m) that are large enough."""
    for i in range(craters.shape[0]):
        crater = craters[i]
        k = 0
        for row in rows[i]:
            if row != crater and sizes[row] >= sizes[crater] + slack and k < out.shape[1]:
                out[crater, k] = row
                k += 1


@njit(cache=True, error_model="numpy")
def describe(
    X: FloatArray, log_sizes: FloatArray, i: int, j: int, k: int, out: FloatArray
) -> tuple[bool, float]:
    """Describe three craters by the five numbers of their triple.

    Parameters
    ----------
    X : ndarray, shape (n, 3)
        Positions of the rims' centres relative to the sphere's, in any unit and frame.
    log_sizes : ndarray, shape (n,)
        Natural logarithms of the sizes in the same unit.
    i, j, k : int
        Rows of the three.
    out : ndarray, shape (5,)
        Written: the numbers in the tree's units.

    Returns
    -------
    swapped : bool
        Whether the numbers are those of i, k, j, because that is counter-clockwise seen from above.
    perimeter : float
        In the unit of X.
    """
    ax, ay, az = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
    bx, by, bz = X[k, 0] - X[i, 0], X[k, 1] - X[i, 1], X[k, 2] - X[i, 2]
    turn = X[i, 0] * (ay * bz - az * by) + X[i, 1] * (az * bx - ax * bz) + X[i, 2] * (ax * by - ay * bx)
    a = np.sqrt(ax * ax + ay * ay + az * az)
    b = np.sqrt(bx * bx + by * by + bz * bz)
    c = np.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2)
    perimeter = a + b + c
    log = np.log(perimeter) + MIN_LOG_SIZE
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
    centres: FloatArray, log_sizes: FloatArray, neighbours: Int32Array, points: kd_tree.Points,
    codes: kd_tree.Codes,
) -> None:  # fmt: skip
    """Write the numbers (m, 5) and codes (m,) of all triples."""
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
