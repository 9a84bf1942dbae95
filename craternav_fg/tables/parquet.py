"""Parquet tables with a schema: a file that is not what it must be is refused with file and column."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pa_compute
import pyarrow.parquet as pq

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, check_input, replacing
from craternav_fg.tables.sizes import LARGEST
from factors.arrays import FloatArray

_NOTHING = pa.schema([])
_TEXTS = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
# Most memory of a table: a few bytes on disk may stand for billions of equal values.
_MAX_BYTES = 1 << 31
# Memory that an entry of a column takes when its length is not fixed.
_TEXT_BYTES = 24


def filled(name: str, kind: pa.DataType) -> pa.Field:
    """Describe a column without empty cells.

    Parameters
    ----------
    name : str
    kind : pyarrow.DataType

    Returns
    -------
    pyarrow.Field
    """
    return pa.field(name, kind, nullable=False)


def read_parquet(
    path: Path,
    schema: pa.Schema,
    *,
    optional: pa.Schema = _NOTHING,
    renamed: Mapping[str, str] | None = None,
    other_columns: bool = False,
) -> pa.Table:
    """Read a Parquet file, whole or not at all.

    Parameters
    ----------
    path : Path
    schema : pyarrow.Schema
        Columns that must be there. Those that are not nullable may have no empty cells. Other forms of the
        same type are converted, as pandas and polars write them: texts of any kind, and lists of free length.
    optional : pyarrow.Schema, optional
        Columns that may be there.
    renamed : mapping of str to str, optional
        Present names of columns by those that an earlier version wrote.
    other_columns : bool
        Accept columns of other names, which are not read.

    Returns
    -------
    pyarrow.Table
        The columns of `schema` and those of `optional` that are there, in the order of the file.

    Raises
    ------
    InputError
        When the file cannot be opened, see `craternav_fg.files.open_input`, is of another kind, is damaged
        (its checksums are verified), or has other columns or types.
    """
    with _opened(path) as file:
        try:
            names = [(renamed or {}).get(name, name) for name in file.schema_arrow.names]
            fields = _wanted(path, file.schema_arrow, names, schema, optional, other_columns)
            # Names in the metadata need not be text, either.
            _check_size(path, file.metadata, fields.values())
            table = file.read(
                columns=[file.schema_arrow.names[k] for k, name in enumerate(names) if name in fields]
            )
            table = table.rename_columns([name for name in names if name in fields])
            table.validate(full=True)
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise _damaged(path, error) from None
    table = _converted(path, table, fields)
    for name, field in fields.items():
        if not field.nullable and table[name].null_count:
            row = int(np.flatnonzero(table[name].is_null().to_numpy())[0])
            raise InputError(path, f"expected a value, found none in row {row + 1}", column=name)
    return table


def read_parquet_metadata(path: Path, key: bytes) -> bytes | None:
    """Read a text that a Parquet file holds beside its columns.

    Parameters
    ----------
    path : Path
    key : bytes

    Returns
    -------
    bytes or None
        None when the file has no text of this key.

    Raises
    ------
    InputError
        When the file cannot be opened or is of another kind.
    """
    with _opened(path) as file:
        return (file.schema_arrow.metadata or {}).get(key)


def parquet_names(path: Path) -> list[str]:
    """Read the names of a Parquet file's columns.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        When the file cannot be opened or is of another kind.
    """
    with _opened(path) as file:
        return list(file.schema_arrow.names)


def read_parquet_columns(path: Path, names: Sequence[str]) -> pa.Table:
    """Read some columns of a Parquet file of others, of whatever types.

    Parameters
    ----------
    path : Path
    names : sequence of str

    Returns
    -------
    pyarrow.Table

    Raises
    ------
    InputError
        When the file cannot be opened, is of another kind, or is damaged.
    """
    with _opened(path) as file:
        _check_size(path, file.metadata, [field for field in file.schema_arrow if field.name in names])
        try:
            table = file.read(columns=list(names))
            table.validate(full=True)
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise _damaged(path, error) from None
    return table


def require_finite(path: Path, table: pa.Table, *names: str) -> None:
    """Refuse numbers that are not finite, or larger than any quantity; empty cells are passed over.

    Parameters
    ----------
    path : Path
        For messages.
    table : pyarrow.Table
    *names : str
        Columns of numbers, or of lists of numbers.

    Raises
    ------
    InputError
        Naming the column.
    """
    for name in names:
        column = table[name].combine_chunks()
        flat = column.flatten() if pa.types.is_nested(column.type) else column
        sound = (np.abs(_floats(flat.drop_null())) <= LARGEST).all()
        if (flat.null_count and flat is not column) or not sound:
            expected = f"expected finite numbers, at most {LARGEST:g} in size"
            raise InputError(path, f"{expected}, found others", column=name)


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a Parquet file with checksums, whole or not at all; numbers read back exactly.

    Parameters
    ----------
    path : Path
    table : pyarrow.Table

    Raises
    ------
    InputError
        When it cannot be written; a file of that name stays what it was.
    """
    with replacing(path) as temporary:
        pq.write_table(table, temporary, use_dictionary=False, write_page_checksum=True)


def _opened(path: Path) -> pq.ParquetFile:
    check_input(path, SizeLimit.TABLE)
    try:
        return pq.ParquetFile(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"expected a Parquet file: {' '.join(str(error).split())}") from None


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(path, f"is damaged: {' '.join(str(error).split())}")


def _wanted(
    path: Path, found: pa.Schema, names: list[str], schema: pa.Schema, optional: pa.Schema, others: bool
) -> dict[str, pa.Field]:
    """Fields to read, by the present names of columns; refuses those that are missing or of another type."""
    for name in schema.names:
        if name not in names:
            raise InputError(path, f"column is missing, found {', '.join(names) or 'none'}", column=name)
    fields: dict[str, pa.Field] = {}
    for field in (*schema, *optional):
        if names.count(field.name) > 1:
            raise InputError(path, "expected each column once, found this one twice", column=field.name)
        if field.name in names:
            fields[field.name] = field
    for k, name in enumerate(names):
        if name not in fields:
            if not others:
                raise InputError(path, "unknown column", column=name)
            continue
        kind, expected = found.field(k).type, fields[name].type
        if not _alike(kind, expected):
            raise InputError(path, f"expected the type {expected}, found {kind}", column=name)
    return fields


def _alike(kind: pa.DataType, expected: pa.DataType) -> bool:
    """Whether values of a type can be converted to another one as they are."""
    if pa.types.is_string(expected):
        text = kind.value_type if pa.types.is_dictionary(kind) else kind
        return any(is_text(text) for is_text in _TEXTS)
    free = pa.types.is_list(kind) or pa.types.is_large_list(kind)
    if free and (pa.types.is_list(expected) or pa.types.is_fixed_size_list(expected)):
        return _alike(kind.value_type, expected.value_type)
    return bool(kind == expected)


def _converted(path: Path, table: pa.Table, fields: Mapping[str, pa.Field]) -> pa.Table:
    """Convert the columns to the types of their fields."""
    for k, name in enumerate(table.column_names):
        kind = fields[name].type
        if table[name].type == kind:
            continue
        try:
            table = table.set_column(k, name, table[name].cast(kind))
        except pa.ArrowInvalid:
            raise InputError(path, _other_length(table[name], kind), column=name) from None
    return table


def _other_length(column: pa.ChunkedArray, kind: pa.DataType) -> str:
    """Say which list cannot be converted to one of a fixed length."""
    if not pa.types.is_fixed_size_list(kind):
        return f"expected the type {kind}, found lists of other lengths"
    lengths = pa_compute.list_value_length(column).combine_chunks()
    row = int(np.flatnonzero(pa_compute.not_equal(lengths, kind.list_size).to_numpy(False) == 1)[0])
    return f"row {row + 1}: expected {kind.list_size} values, found {lengths[row].as_py()}"


def _check_size(path: Path, about: pq.FileMetaData, fields: Iterable[pa.Field]) -> None:
    """Refuse a table that is too large, and one whose parts have other numbers of rows than it says."""
    groups = [about.row_group(k) for k in range(about.num_row_groups)]
    needed = max(
        about.num_rows * sum(_width(field.type) for field in fields),
        sum(max(group.total_byte_size, 0) for group in groups),
    )
    if needed > _MAX_BYTES:
        raise InputError(path, f"expected a table of at most {_MAX_BYTES >> 20} MiB, found {needed >> 20}")
    # Pages have checksums, the numbers of their values have none.
    whole = sum(group.num_rows for group in groups) == about.num_rows and all(
        group.column(k).num_values == group.num_rows
        for group in groups
        for k in range(group.num_columns)
        # A list has as many values as it likes.
        if "." not in group.column(k).path_in_schema
    )
    if not whole:
        raise InputError(path, "is damaged: expected a value per row in each column, found another number")


def _width(kind: pa.DataType) -> int:
    """Bytes of an entry."""
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size) * _width(kind.value_type)
    try:
        return int(kind.bit_width) // 8
    except ValueError:
        return _TEXT_BYTES


def _floats(values: Any) -> FloatArray:
    return np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64)
