"""Columns of Arrow tables: arrays as fixed-size lists, and names of estimators."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import FORMER_NAMES
from factors.arrays import FloatArray

# Length of an estimator's name in a file.
_MAX_NAME = 100


def list_column(rows: FloatArray) -> pa.Array:
    """Make a column of fixed-size lists.

    Parameters
    ----------
    rows : ndarray, shape (n, d)

    Returns
    -------
    pyarrow.FixedSizeListArray, shape (n,)
        Column of lists of d numbers.
    """
    flat = pa.array(np.ascontiguousarray(rows).ravel(), pa.float64())
    return pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])


def list_values(column: pa.ChunkedArray) -> FloatArray | None:
    """Read a column of fixed-size lists.

    Parameters
    ----------
    column : pyarrow.ChunkedArray, shape (n,)
        Column of fixed-size lists of d numbers.

    Returns
    -------
    ndarray, shape (n, d), or None
        None when a row is null.
    """
    array = column.combine_chunks()
    if array.null_count:
        return None
    flat = array.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat, dtype=np.float64).reshape(len(array), array.type.list_size)


def with_present_names(table: pa.Table) -> pa.Table:
    """Replace former names of estimators in a table that an earlier version wrote.

    Parameters
    ----------
    table : pyarrow.Table
        With or without a column `estimator`.

    Returns
    -------
    pyarrow.Table
    """
    column = table.schema.get_field_index("estimator")
    if column < 0:
        return table
    names = table.column(column)
    for former, present in FORMER_NAMES.items():
        names = pc.if_else(pc.equal(names, former), present, names)
    return table.set_column(column, table.schema.field(column), names)


def check_names(path: Path, names: Iterable[str]) -> None:
    """Refuse names of estimators that cannot be shown in one line.

    Parameters
    ----------
    path : Path
        For messages.
    names : iterable of str

    Raises
    ------
    InputError
        For a name that is empty, too long, or has characters that cannot be printed.
    """
    for name in names:
        if not name.isprintable() or not 0 < len(name) <= _MAX_NAME:
            problem = f"expected an estimator's name of 1 to {_MAX_NAME} printable characters"
            raise InputError(path, f"{problem}, found {name[:_MAX_NAME]!a}", column="estimator")
