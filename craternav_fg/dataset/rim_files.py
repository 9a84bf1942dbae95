"""Measured rims on disk: `rims.parquet`, ellipse charts, and `arcs.parquet`, edge points of partly seen rims.

`layout` describes the columns. Rows of a frame are read in the order of the catalogue.
"""

from collections.abc import Sequence, Sized
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pyarrow as pa

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import layout
from craternav_fg.ellipse import half_sides
from craternav_fg.errors import InputError
from craternav_fg.measurements import (
    CORRELATED_SIZE,
    MAP_SIZE,
    SHARED_SIZE,
    TILT_SIZE,
    ArcSet,
    FrameMeasurement,
    RimQuality,
    RimSet,
)
from craternav_fg.tables.parquet import filled, read_parquet, write_parquet
from craternav_fg.tables.sizes import LARGEST
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels import admission

_POINTS, _SIGMAS, _SHARED_SIGMA = "points_normalised", "sigmas_normalised", "correlated_sigma_normalised"
_KEYS = [filled("timestamp", pa.int64()), filled("crater_id", pa.string())]
_RIMS = pa.schema(
    [*_KEYS, filled("chart", pa.list_(pa.float64(), 5)), filled("covariance", pa.list_(pa.float64(), 25))]
)
# Roots of the correlated parts of the covariance, with their columns.
_ROOTS = {
    "correlated": CORRELATED_SIZE, "map_errors": MAP_SIZE, "map_tilt": TILT_SIZE, "shared": SHARED_SIZE,
}  # fmt: skip
# Columns that make `RimSet.of_map`.
_OF_MAP = ("map_errors", "map_tilt")
_FUSED = "fused_white"
_QUALITY = tuple(field.name for field in fields(RimQuality))
_PART_SHAPES: dict[str, tuple[int, ...]] = {
    **{name: (5, width) for name, width in _ROOTS.items()},
    _FUSED: (5, 5),
    **dict.fromkeys(_QUALITY, ()),
}
# The height's part of `map_errors`, which earlier files have instead.
_FORMER_HEIGHT, _HEIGHT = "correlated_height", 2
_READ_SHAPES = {**_PART_SHAPES, _FORMER_HEIGHT: (5, 1)}
_RIM_PARTS = pa.schema(
    [
        (name, pa.list_(pa.float64(), int(np.prod(shape))) if shape else pa.float64())
        for name, shape in _READ_SHAPES.items()
    ]
)
# Present names of columns by the former ones.
_FORMER_COLUMNS = {
    "persistent": "correlated",
    "correlated_tilt": "map_tilt",
    "gain": "slope_contrast",
    "points": "points_normalised",
    "sigmas": "sigmas_normalised",
    "correlated_sigma": "correlated_sigma_normalised",
}
_ARCS = pa.schema(
    [
        *_KEYS,
        filled(_POINTS, pa.list_(pa.list_(pa.float64(), 2))),
        filled(_SIGMAS, pa.list_(pa.float64())),
    ]
)
_ARC_PARTS = pa.schema([(_SHARED_SIGMA, pa.float64()), ("shared", pa.list_(pa.float64(), 5 * SHARED_SIZE))])
# Largest asymmetry of a covariance, in products of standard deviations: components that are nearly
# independent have cross terms of rounding errors.
_MAX_ASYMMETRY = 1e-9
# Points along each side of the image, by which its undistorted bounds are found.
_BORDER_POINTS = 9
# Hardly any camera sees so far from its axis, 79 deg: larger coordinates are not normalised.
_LARGEST_TANGENT = 5.0
# Smallest eigenvalue of a correlation matrix: a smaller one is rounding of a singular matrix.
_MIN_EIGENVALUE = 1e-12


def write_rims(path: Path, frames: Sequence[FrameMeasurement], catalog: Catalog) -> None:
    """Write the rims of all frames; numbers read back exactly.

    Parameters
    ----------
    path : Path
    frames : sequence of FrameMeasurement
    catalog : Catalog
        Catalogue of their craters.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    sets = [frame.rims for frame in frames]
    columns = {
        **_key_columns(frames, [rims.craters for rims in sets], catalog),
        "chart": _vectors(np.concatenate([rims.chart for rims in sets]), 5),
        "covariance": _vectors(np.concatenate([rims.covariance for rims in sets]), 25),
    }
    for name, width in _ROOTS.items():
        roots = [_root(rims, name) for rims in sets]
        if any(A is not None for A in roots):
            full = [
                np.zeros((len(rims), 5, width)) if A is None else A
                for rims, A in zip(sets, roots, strict=True)
            ]
            columns[name] = _vectors(np.concatenate(full), 5 * width, _unknown(sets, roots))
    fused = [rims.fused_white for rims in sets]
    if any(S is not None for S in fused):
        full = [np.zeros((len(rims), 5, 5)) if S is None else S for rims, S in zip(sets, fused, strict=True)]
        columns[_FUSED] = _vectors(np.concatenate(full), 25, _unknown(sets, fused))
    qualities = [rims.quality for rims in sets]
    if any(quality is not None for quality in qualities):
        for name in _QUALITY:
            values = [
                np.zeros(len(rims)) if quality is None else getattr(quality, name)
                for rims, quality in zip(sets, qualities, strict=True)
            ]
            columns[name] = pa.array(np.concatenate(values), pa.float64(), mask=_unknown(sets, qualities))
    write_parquet(path, pa.table(columns))


def read_rims(path: Path, stamps_ns: IntArray, catalog: Catalog, camera: Camera) -> list[RimSet]:
    """Read the rims of all frames.

    Parameters
    ----------
    path : Path
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames, increasing.
    catalog : Catalog
    camera : Camera

    Returns
    -------
    list of RimSet, length k
        Empty for frames without a row.

    Raises
    ------
    InputError
        Naming the column: for a file of another form, unknown frames or craters, a crater twice in a frame,
        values that are not finite, a rim outside the image, matrices that are no covariances, a part of the
        covariance or a quality that is given for some rims of a frame only.
    """
    table = read_parquet(path, _RIMS, optional=_RIM_PARTS, renamed=_FORMER_COLUMNS)
    rows, craters = _frame_rows(path, table, stamps_ns), _craters(path, table, catalog)
    charts, covariances = _numbers(path, table, "chart", (5,)), _numbers(path, table, "covariance", (5, 5))
    parts = {
        name: _part(path, table, name, shape, rows)
        for name, shape in _READ_SHAPES.items()
        if name in table.column_names
    }
    if _FORMER_HEIGHT in parts:
        former = parts.pop(_FORMER_HEIGHT)
        whole = np.zeros((len(table), 5, MAP_SIZE))
        whole[:, :, [_HEIGHT]] = former.values
        parts.setdefault("map_errors", _Part(whole, former.known))
    _check_charts(path, charts)
    half = half_sides(charts)
    _check_inside(path, "chart", charts[:, :2] - half, charts[:, :2] + half, camera)
    _check_covariances(path, "covariance", covariances)
    roots = {name: parts[name].values for name in _ROOTS if name in parts}
    _check_roots(path, covariances, roots)
    if _FUSED in parts:
        _check_covariances(path, _FUSED, parts[_FUSED].values, parts[_FUSED].known)
        _check_fused(path, parts[_FUSED], _white(covariances, roots))
    _check_quality(path, {name: parts[name] for name in _QUALITY if name in parts})
    out = []
    for own in _rows_of_frames(path, rows, craters, len(stamps_ns)):
        seen = {name: part.values[own] for name, part in parts.items() if part.known[own].any()}
        here = {name: seen.pop(name) for name in _ROOTS if name in seen}
        stated = [here.pop(name, None) is not None for name in _OF_MAP]
        if any(stated):
            # In all frames as wide: zeros are no error.
            widest = [parts[name].values[own] for name in _OF_MAP if name in parts]
            here["of_map"] = np.concatenate(widest, axis=2)
        fused = seen.pop(_FUSED, None)
        quality = RimQuality(**seen) if seen else None
        out.append(RimSet(craters[own], charts[own], covariances[own], quality, fused_white=fused, **here))
    return out


def write_arcs(path: Path, frames: Sequence[FrameMeasurement], catalog: Catalog) -> None:
    """Write the arcs of all frames; numbers read back exactly.

    Parameters
    ----------
    path : Path
    frames : sequence of FrameMeasurement
    catalog : Catalog
        Catalogue of their craters.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    sets = [frame.arcs for frame in frames]
    points = [points.tolist() for arcs in sets for points in arcs.points]
    sigmas = [sigmas.tolist() for arcs in sets for sigmas in arcs.sigmas]
    columns = {
        **_key_columns(frames, [arcs.craters for arcs in sets], catalog),
        _POINTS: pa.array(points, _ARCS.field(_POINTS).type),
        _SIGMAS: pa.array(sigmas, _ARCS.field(_SIGMAS).type),
    }
    shared = [arcs.correlated_sigmas for arcs in sets]
    if any(sigmas is not None for sigmas in shared):
        values = [
            np.zeros(len(arcs)) if sigmas is None else sigmas
            for arcs, sigmas in zip(sets, shared, strict=True)
        ]
        mask = _unknown(sets, shared)
        columns[_SHARED_SIGMA] = pa.array(np.concatenate(values), pa.float64(), mask=mask)
    roots = [arcs.shared for arcs in sets]
    if any(A is not None for A in roots):
        full = [
            np.zeros((len(arcs), 5, SHARED_SIZE)) if A is None else A
            for arcs, A in zip(sets, roots, strict=True)
        ]
        columns["shared"] = _vectors(np.concatenate(full), 5 * SHARED_SIZE, _unknown(sets, roots))
    write_parquet(path, pa.table(columns))


def read_arcs(path: Path, stamps_ns: IntArray, catalog: Catalog, camera: Camera) -> list[ArcSet]:
    """Read the arcs of all frames.

    Parameters
    ----------
    path : Path
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames, increasing.
    catalog : Catalog
    camera : Camera

    Returns
    -------
    list of ArcSet, length k
        Empty for frames without a row.

    Raises
    ------
    InputError
        Naming the column: as `read_rims`; also for an arc without points, or with another number of standard
        deviations than points.
    """
    table = read_parquet(path, _ARCS, optional=_ARC_PARTS, renamed=_FORMER_COLUMNS)
    rows, craters = _frame_rows(path, table, stamps_ns), _craters(path, table, catalog)
    points = _lists(path, table, _POINTS, 2)
    sigmas = _lists(path, table, _SIGMAS, 1)
    for row, (places, deviations) in enumerate(zip(points, sigmas, strict=True)):
        if not len(places) or len(places) != len(deviations):
            found = f"{len(deviations)} for {len(places)} points"
            raise InputError(path, f"row {row + 1}: expected one per point, found {found}", column=_SIGMAS)
        if deviations.min() <= 0.0:
            problem = f"row {row + 1}: expected more than 0, found {deviations.min():g}"
            raise InputError(path, problem, column=_SIGMAS)
    if points:
        low, high = (np.array([end(one, axis=0) for one in points]) for end in (np.min, np.max))
        _check_inside(path, _POINTS, low, high, camera)
    shapes: dict[str, tuple[int, ...]] = {_SHARED_SIGMA: (), "shared": (5, SHARED_SIZE)}
    parts = {
        name: _part(path, table, name, shape, rows)
        for name, shape in shapes.items()
        if name in table.column_names
    }
    if _SHARED_SIGMA in parts:
        values = parts[_SHARED_SIGMA].values
        _require(path, _SHARED_SIGMA, values >= 0.0, values, "at least 0")
    out = []
    for own in _rows_of_frames(path, rows, craters, len(stamps_ns)):
        seen = {name: part.values[own] for name, part in parts.items() if part.known[own].any()}
        out.append(
            ArcSet(
                craters[own],
                tuple(points[i] for i in own),
                tuple(sigmas[i].ravel() for i in own),
                seen.get(_SHARED_SIGMA),
                seen.get("shared"),
            )
        )
    return out


@dataclass(frozen=True)
class _Part:
    """An optional column: values (n, ...), and whether each row has one."""

    values: FloatArray
    known: BoolArray


def _root(rims: RimSet, name: str) -> FloatArray | None:
    """Root (n, 5, m) of a part of the covariance as the file has it: errors of the map and tilts apart."""
    if name not in _OF_MAP:
        return rims.shared if name == "shared" else rims.correlated
    if rims.of_map is None:
        return None
    begin = 0 if rims.of_map.shape[2] == TILT_SIZE else MAP_SIZE
    part = rims.of_map[:, :, :begin] if name == "map_errors" else rims.of_map[:, :, begin:]
    return part if part.shape[2] else None


def _key_columns(
    frames: Sequence[FrameMeasurement], craters: Sequence[IntArray], catalog: Catalog
) -> dict[str, pa.Array]:
    """Stamps and identifiers of the rows of all frames."""
    stamps = [frame.stamp_ns for frame, rows in zip(frames, craters, strict=True) for _ in rows]
    identifiers = [catalog.identifiers[row] for rows in craters for row in rows]
    return {"timestamp": pa.array(stamps, pa.int64()), "crater_id": pa.array(identifiers, pa.string())}


def _unknown(sets: Sequence[Sized], parts: Sequence[object]) -> BoolArray:
    """Mask of the rows of all frames whose frame lacks a part."""
    return np.concatenate(
        [np.full(len(rows), part is None) for rows, part in zip(sets, parts, strict=True)]
    ).astype(np.bool_)


def _vectors(values: FloatArray, size: int, mask: BoolArray | None = None) -> pa.Array:
    flat = pa.array(values.ravel(), pa.float64())
    return pa.FixedSizeListArray.from_arrays(flat, size, mask=None if mask is None else pa.array(mask))


def _numbers(path: Path, table: pa.Table, name: str, shape: tuple[int, ...]) -> FloatArray:
    """Finite numbers (n, *shape) of a column, zeros where it is empty."""
    column = table[name].combine_chunks()
    values = column.drop_null()
    numbers = values.flatten() if shape else values
    out = np.zeros((len(table), *shape))
    filled = column.is_valid().to_numpy(zero_copy_only=False)
    out[filled] = np.asarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64).reshape(-1, *shape)
    bad = np.flatnonzero(~(np.abs(out) <= LARGEST).all(axis=tuple(range(1, out.ndim))))
    if len(bad):
        raise InputError(path, f"expected finite numbers, row {bad[0] + 1} has others", column=name)
    return out


def _lists(path: Path, table: pa.Table, name: str, width: int) -> list[FloatArray]:
    """Finite numbers of a column of lists, each (m, width)."""
    out = []
    for row, values in enumerate(table[name]):
        flat = values.values.flatten() if width > 1 else values.values
        numbers = np.asarray(flat.to_numpy(zero_copy_only=False), dtype=np.float64)
        if not (np.abs(numbers) <= LARGEST).all() or len(numbers) != width * len(values):
            raise InputError(path, f"expected finite numbers, row {row + 1} has others", column=name)
        out.append(numbers.reshape(-1, width).copy())
    return out


def _part(path: Path, table: pa.Table, name: str, shape: tuple[int, ...], frame_rows: IntArray) -> _Part:
    """Read an optional column, of which the rows of one frame have all a value, or none."""
    known = table[name].is_valid().to_numpy().astype(np.bool_)
    mixed = np.isin(frame_rows, frame_rows[known]) & ~known
    if mixed.any():
        row = int(np.flatnonzero(mixed)[0]) + 1
        problem = f"expected a value for all rows of a frame or for none, row {row} has none"
        raise InputError(path, problem, column=name)
    return _Part(_numbers(path, table, name, shape), known)


def _require(path: Path, name: str, good: BoolArray, values: FloatArray, expected: str) -> None:
    bad = np.flatnonzero(~good)
    if len(bad):
        row = int(bad[0])
        raise InputError(path, f"row {row + 1}: expected {expected}, found {values[row]:g}", column=name)


def _check_charts(path: Path, charts: FloatArray) -> None:
    """Refuse charts (n, 5) whose conics leave double precision."""
    row = admission.first_bad_chart(charts)
    if row >= 0:
        problem = f"row {row + 1}: expected the chart of an ellipse in normalised coordinates"
        raise InputError(path, problem, column="chart")


def _check_inside(path: Path, name: str, low: FloatArray, high: FloatArray, camera: Camera) -> None:
    """Refuse upright boxes (n, 2) to (n, 2) that do not reach into the image."""
    border = camera.normalised(camera.border_px(_BORDER_POINTS, -0.5))
    left, top = border.min(axis=0)
    right, bottom = border.max(axis=0)
    outside = ((high < [left, top]) | (low > [right, bottom])).any(axis=1)
    if outside.any():
        row = int(np.argmax(outside))
        x, y = 0.5 * (low[row] + high[row])
        pixels = ", in pixels?" if max(abs(x), abs(y)) > _LARGEST_TANGENT else ""
        raise InputError(
            path,
            f"row {row + 1}: expected normalised coordinates in the image, {left:.3g} to {right:.3g} by "
            f"{top:.3g} to {bottom:.3g}, found a rim at {x:.6g}, {y:.6g}{pixels}",
            column=name,
        )


def _check_covariances(
    path: Path, name: str, covariances: FloatArray, known: BoolArray | None = None
) -> None:
    """Refuse matrices (n, 5, 5) that are no covariances; those that a mask names, if it is given."""
    if not len(covariances):
        return
    sigmas = np.sqrt(np.abs(np.diagonal(covariances, axis1=1, axis2=2)))
    skew = np.abs(covariances - np.swapaxes(covariances, 1, 2))
    scale = sigmas[:, :, None] * sigmas[:, None, :]
    sound = np.all(skew <= _MAX_ASYMMETRY * scale, axis=(1, 2)) & (sigmas.min(axis=1) > 0.0)
    # A chart's components differ by orders of magnitude: the correlation tells what rounding has left.
    correlations = covariances[sound] / scale[sound]
    sound[sound] = np.linalg.eigvalsh(correlations)[:, 0] > _MIN_EIGENVALUE
    if known is not None:
        sound |= ~known
    if not sound.all():
        problem = f"row {int(np.argmin(sound)) + 1}: expected a symmetric positive definite matrix"
        raise InputError(path, problem, column=name)


def _white(covariances: FloatArray, roots: dict[str, FloatArray]) -> FloatArray:
    """Compute what covariances (n, 5, 5) have beside the parts of which roots are given."""
    return covariances - sum((A @ np.swapaxes(A, 1, 2) for A in roots.values()), np.zeros((5, 5)))


def _check_fused(path: Path, fused: _Part, white: FloatArray) -> None:
    """Refuse white parts for estimators that are less than those that are stated: they would be too sure."""
    scale = np.sqrt(np.abs(np.diagonal(fused.values, axis1=1, axis2=2)))
    scale = np.where(fused.known[:, None], scale, 1.0)
    added = (fused.values - white) / (scale[:, :, None] * scale[:, None, :])
    enough = (
        np.linalg.eigvalsh(0.5 * (added + np.swapaxes(added, 1, 2)))[:, 0] > -_MAX_ASYMMETRY
    ) | ~fused.known
    if not enough.all():
        problem = f"row {int(np.argmin(enough)) + 1}: expected at least the white part of the covariance"
        raise InputError(path, problem, column=_FUSED)


def _check_roots(path: Path, covariances: FloatArray, roots: dict[str, FloatArray]) -> None:
    """Refuse parts that are not less than the whole covariances (n, 5, 5)."""
    if not roots or not len(covariances):
        return
    less = np.linalg.eigvalsh(_white(covariances, roots))[:, 0] > 0.0
    if not less.all():
        problem = f"row {int(np.argmin(less)) + 1}: expected parts that are less than the whole covariance"
        raise InputError(path, problem, column=next(iter(roots)))


def _check_quality(path: Path, parts: dict[str, _Part]) -> None:
    """Refuse measures of quality below 0, and some without the others."""
    if not parts:
        return
    first = next(iter(parts))
    for name in _QUALITY:
        if name not in parts:
            raise InputError(path, f"column is missing beside {first}", column=name)
        values, known = parts[name].values, parts[name].known
        _require(path, name, values >= 0.0, values, "at least 0")
        if not np.array_equal(known, parts[first].known):
            raise InputError(path, f"expected values in the same rows as in {first}", column=name)


def _craters(path: Path, table: pa.Table, catalog: Catalog) -> IntArray:
    """Rows of the catalogue."""
    known = {identifier: row for row, identifier in enumerate(catalog.identifiers)}
    craters = np.empty(len(table), dtype=np.int64)
    for i, identifier in enumerate(table["crater_id"].to_pylist()):
        if identifier not in known:
            raise InputError(path, f"row {i + 1}: {identifier!r} is not in the catalogue", column="crater_id")
        craters[i] = known[identifier]
    return craters


def _frame_rows(path: Path, table: pa.Table, frames_ns: IntArray) -> IntArray:
    """Index of each row's frame."""
    stamps = table["timestamp"].to_numpy()
    rows = np.minimum(np.searchsorted(frames_ns, stamps), len(frames_ns) - 1)
    unknown = np.flatnonzero(frames_ns[rows] != stamps)
    if len(unknown):
        raise InputError(
            path, f"{stamps[unknown[0]]} is no stamp of {layout.CAMERA_DATA}", column="timestamp"
        )
    return rows


def _rows_of_frames(path: Path, frame_rows: IntArray, craters: IntArray, count: int) -> list[IntArray]:
    """Rows of each frame, in the order of the catalogue; no crater may be there twice."""
    order = np.lexsort((craters, frame_rows))
    frame, crater = frame_rows[order], craters[order]
    again = np.flatnonzero((np.diff(frame) == 0) & (np.diff(crater) == 0))
    if len(again):
        rows = sorted((order[again[0] : again[0] + 2] + 1).tolist())
        problem = f"row {rows[1]}: expected each crater once in a frame, found that of row {rows[0]} again"
        raise InputError(path, problem, column="crater_id")
    return np.split(order, np.searchsorted(frame, np.arange(1, count)))
