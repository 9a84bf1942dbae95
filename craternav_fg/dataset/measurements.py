"""Measured rims and sun tilts on disk, in place of images."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.errors import InputError
from craternav_fg.measurements import SHARED_SIZE, FrameMeasurement, RimSet, SunTilt
from craternav_fg.tables import read_table, write_table

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_SCHEMA = pa.schema(
    [
        ("timestamp", pa.int64()),
        ("crater_id", pa.string()),
        ("chart", pa.list_(pa.float64(), 5)),
        ("covariance", pa.list_(pa.float64(), 25)),
    ]
)
# Roots of the parts of the covariance that outlast a frame; a table may lack either.
_CORRELATED = {"correlated": 5, "shared": SHARED_SIZE}
# What a column was called in files of version 0.1.
_FORMER = {"persistent": "correlated"}


def ground_sun_direction(
    sun: FloatArray, catalog: Catalog, craters: IntArray, prior_gP: FloatArray
) -> FloatArray:
    """Direction (3,) in g whose image a measured sun tilt is: the sun's, along the level ground.

    Parameters
    ----------
    sun : ndarray, shape (3,)
        Unit vector towards the sun in g.
    catalog : Catalog
    craters : ndarray of int, shape (n,)
        Rows of the craters that the frame shows: the ground's normal is that at their mean.
    prior_gP : ndarray, shape (3,)
        Position of the initial state, m: without craters the ground's normal is that below it.

    Returns
    -------
    ndarray, shape (3,)
        s - (s.n) n; what a lander can know, whatever its true position.
    """
    normal = catalog.centres[craters].mean(axis=0) if len(craters) else prior_gP
    normal = normal / np.linalg.norm(normal)
    return np.asarray(sun - (sun @ normal) * normal)


def write_measurements(folder: Path, frames: Sequence[FrameMeasurement], catalog: Catalog) -> None:
    """Write `rims.parquet` and `sun_tilts.csv`."""
    stamps = np.repeat([f.stamp_ns for f in frames], [len(f.rims) for f in frames])
    charts = np.concatenate([f.rims.chart for f in frames])
    covariances = np.concatenate([f.rims.covariance for f in frames])
    identifiers = [catalog.identifiers[row] for f in frames for row in f.rims.craters]
    columns = [
        pa.array(stamps, pa.int64()),
        pa.array(identifiers, pa.string()),
        pa.FixedSizeListArray.from_arrays(pa.array(charts.ravel(), pa.float64()), 5),
        pa.FixedSizeListArray.from_arrays(pa.array(covariances.ravel(), pa.float64()), 25),
    ]
    schema = _SCHEMA
    for name, width in _CORRELATED.items():
        roots = [getattr(f.rims, name) for f in frames]
        if all(A is None for A in roots):
            continue
        full = [
            np.zeros((len(f.rims), 5, width)) if A is None else A for f, A in zip(frames, roots, strict=True)
        ]
        flat = pa.array(np.concatenate(full).ravel(), pa.float64())
        columns.append(pa.FixedSizeListArray.from_arrays(flat, 5 * width))
        schema = schema.append(pa.field(name, pa.list_(pa.float64(), 5 * width)))
    pq.write_table(pa.Table.from_arrays(columns, schema=schema), folder / layout.RIMS)
    tilts = [(f.stamp_ns, f.sun) for f in frames if f.sun is not None]
    write_table(
        folder / layout.TILTS,
        layout.TILT_COLUMNS,
        [
            [stamp for stamp, _ in tilts],
            [sun.tilt_rad for _, sun in tilts],
            [sun.sigma_rad for _, sun in tilts],
            [sun.point[0] for _, sun in tilts],
            [sun.point[1] for _, sun in tilts],
        ],
        comment=True,
    )


def read_measurements(
    folder: Path, stamps_ns: IntArray, catalog: Catalog, sun: SunVectors, prior_gP: FloatArray | None
) -> tuple[FrameMeasurement, ...]:
    """Read `rims.parquet` and, when it is there, `sun_tilts.csv`; one measurement per frame.

    Parameters
    ----------
    folder : Path
        Of the data set.
    stamps_ns : ndarray of int, shape (k,)
        Of the frames.
    catalog : Catalog
    sun : SunVectors
    prior_gP : ndarray, shape (3,), or None
        Position of the initial state, m (see `ground_sun_direction`); without it the tilts of frames
        without rims are left out, as nothing tells the ground's normal there.

    Raises
    ------
    InputError
        For a table of another form, unknown stamps or craters, repeated rims, values that are not
        finite, and covariances that are none.
    """
    stamps, rims = _read_rims(folder / layout.RIMS, catalog)
    frame = _frame_rows(folder / layout.RIMS, stamps, stamps_ns)
    if len(set(zip(frame.tolist(), rims.craters.tolist(), strict=True))) != len(rims):
        raise InputError(folder / layout.RIMS, "expected each crater once in a frame, found one twice")
    tilts = _read_tilts(folder / layout.TILTS, stamps_ns)
    out = []
    for k, stamp in enumerate(stamps_ns):
        rows = np.flatnonzero(frame == k)
        seen = rims.take(rows[np.argsort(rims.craters[rows])])
        tilt = None
        if k in tilts:
            if prior_gP is None and not len(seen):
                out.append(FrameMeasurement(int(stamp), seen, None))
                continue
            prior = np.zeros(3) if prior_gP is None else prior_gP
            direction = ground_sun_direction(sun.at(int(stamp)), catalog, seen.craters, prior)
            angle, sigma, u, v = tilts[k].tolist()
            tilt = SunTilt(angle, sigma, np.array([u, v]), direction)
        out.append(FrameMeasurement(int(stamp), seen, tilt))
    return tuple(out)


def _read_rims(path: Path, catalog: Catalog) -> tuple[IntArray, RimSet]:
    try:
        table = pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(path, f"expected a Parquet file: {error}") from None
    table = table.rename_columns([_FORMER.get(name, name) for name in table.column_names])
    parts = [name for name in _CORRELATED if name in table.column_names]
    extra = [pa.field(name, pa.list_(pa.float64(), 5 * _CORRELATED[name])) for name in parts]
    for field in [*_SCHEMA, *extra]:
        if field.name not in table.column_names:
            raise InputError(path, "column is missing", column=field.name)
        if table.schema.field(field.name).type != field.type:
            found = table.schema.field(field.name).type
            raise InputError(path, f"expected the type {field.type}, found {found}", column=field.name)
        if table[field.name].null_count:
            raise InputError(path, "expected no empty cells", column=field.name)
    for name in table.column_names:
        if name not in _SCHEMA.names and name not in _CORRELATED:
            raise InputError(path, "unknown column", column=name)
    n = len(table)
    charts = _flat(table["chart"]).reshape(n, 5)
    covariances = _flat(table["covariance"]).reshape(n, 5, 5)
    roots = {name: _flat(table[name]).reshape(n, 5, _CORRELATED[name]) for name in parts}
    for name, values in (("chart", charts), ("covariance", covariances), *roots.items()):
        bad = np.flatnonzero(~np.isfinite(values).reshape(n, -1).all(axis=1))
        if len(bad):
            raise InputError(path, f"expected finite numbers, row {bad[0] + 1} has others", column=name)
    # By the standard deviations: components that are nearly independent have cross terms of rounding errors.
    sigmas = np.sqrt(np.abs(np.diagonal(covariances, axis1=1, axis2=2)))
    skew = np.abs(covariances - np.swapaxes(covariances, 1, 2))
    symmetric = np.all(skew <= 1e-9 * sigmas[:, :, None] * sigmas[:, None, :])
    if n and (not symmetric or np.linalg.eigvalsh(covariances)[:, 0].min() <= 0.0):
        raise InputError(path, "expected symmetric positive definite matrices", column="covariance")
    white = covariances - sum((A @ np.swapaxes(A, 1, 2) for A in roots.values()), np.zeros((n, 5, 5)))
    if n and parts and np.linalg.eigvalsh(white)[:, 0].min() <= 0.0:
        raise InputError(path, "expected parts that are less than the whole covariance", column=parts[0])
    known = {identifier: row for row, identifier in enumerate(catalog.identifiers)}
    craters = np.empty(n, dtype=np.int64)
    for i, identifier in enumerate(table["crater_id"].to_pylist()):
        if identifier not in known:
            raise InputError(path, f"row {i + 1}: {identifier!r} is not in the catalogue", column="crater_id")
        craters[i] = known[identifier]
    return table["timestamp"].to_numpy(), RimSet(
        craters, charts, covariances, correlated=roots.get("correlated"), shared=roots.get("shared")
    )


def _flat(column: pa.ChunkedArray) -> FloatArray:
    values = column.combine_chunks().flatten()
    return np.array(values.to_numpy(zero_copy_only=False), dtype=np.float64)


def _frame_rows(path: Path, stamps: IntArray, frames_ns: IntArray) -> IntArray:
    rows = np.minimum(np.searchsorted(frames_ns, stamps), len(frames_ns) - 1)
    unknown = np.flatnonzero(frames_ns[rows] != stamps)
    if len(unknown):
        raise InputError(
            path, f"{stamps[unknown[0]]} is no stamp of {layout.CAMERA_DATA}", column="timestamp"
        )
    return rows


def _read_tilts(path: Path, frames_ns: IntArray) -> dict[int, FloatArray]:
    """Tilt, sigma, u and v of the frames that have them."""
    if not path.exists():
        return {}
    table = read_table(path, layout.TILT_COLUMNS)
    table.require_increasing(layout.STAMP)
    bad = np.flatnonzero(table.columns["sigma"] <= 0.0)
    if len(bad):
        table.fail(int(bad[0]), "sigma", f"expected more than 0, found {table.columns['sigma'][bad[0]]}")
    rows = _frame_rows(path, table.columns[layout.STAMP], frames_ns)
    return dict(zip(rows.tolist(), table.numbers("tilt", "sigma", "u", "v"), strict=True))
