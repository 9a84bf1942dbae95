"""CSV tables: a file that is not what it must be is refused with file, line and column."""

import csv
import io
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn, TextIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pa_compute
import pyarrow.csv as pa_csv

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, check_input, open_input
from craternav_fg.tables.arrow import numbers
from craternav_fg.tables.sizes import LARGEST
from factors.arrays import FloatArray

Kind = Literal["integer", "number", "text"]
# Characters of a line that are read at once: longer cells are refused by the csv module.
_MAX_LINE = 1 << 20
_ARROW = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string()}


@dataclass(frozen=True)
class Column:
    """A column that a table may have.

    Attributes
    ----------
    name : str
        As in the header, without '#' and unit.
    kind : {"integer", "number", "text"}
        Numbers are finite, integers are written without a decimal point, texts are not empty.
    unit : str or None
        Unit that may stand in brackets after the name in the header.
    optional : bool
        Whether the column may be missing.
    may_be_empty : bool
        Whether cells may be empty, which stand for NaN (numbers only).
    former : str or None
        Name that an earlier version wrote, which is read, too.
    """

    name: str
    kind: Kind = "number"
    unit: str | None = None
    optional: bool = False
    may_be_empty: bool = False
    former: str | None = None

    @property
    def heading(self) -> str:
        """Name and unit as they stand in a header."""
        if self.unit is None or self.name.endswith(f"_{self.unit}"):
            return self.name
        return f"{self.name} [{self.unit}]"


@dataclass(frozen=True)
class Table:
    """A table that was read, with the file it came from.

    Attributes
    ----------
    path : Path
    columns : dict of str to ndarray or list of str
        Float64 for numbers, int64 for integers; optional columns only when they are there.
    headed : bool
        Whether the file begins with a header.
    """

    path: Path
    columns: Mapping[str, Any]
    headed: bool = True

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def numbers(self, *names: str) -> FloatArray:
        """Put numeric columns side by side.

        Parameters
        ----------
        *names : str

        Returns
        -------
        ndarray, shape (n, k)
            One column for each name, in its unit.
        """
        return np.stack([self.columns[name] for name in names], axis=-1)

    def line(self, row: int) -> int:
        """Find the line of the file in which a row stands.

        Parameters
        ----------
        row : int
            Counted from 0, without the header and blank lines.

        Returns
        -------
        int
            1-based.
        """
        with _csv_reader(self.path) as reader:
            if self.headed:
                _first_cells(reader)
            count = -1
            for cells in reader:
                count += not _is_blank(cells)
                if count == row:
                    return reader.line_num
        return row + 2

    def fail(self, row: int, column: str, problem: str) -> NoReturn:
        """Refuse a cell.

        Parameters
        ----------
        row : int
            Counted from 0, without the header and blank lines.
        column : str
        problem : str
            What was expected and what was found.

        Raises
        ------
        InputError
            Always: names the file, the line and the column.
        """
        raise InputError(self.path, problem, line=self.line(row), column=column)

    def require_increasing(self, column: str) -> None:
        """Refuse a column that does not increase strictly.

        Parameters
        ----------
        column : str
            Column of integers.

        Raises
        ------
        InputError
            At the first row that is not larger than the one before it.
        """
        stamps = self.columns[column]
        bad = np.flatnonzero(np.diff(stamps) <= 0)
        if len(bad):
            row = int(bad[0]) + 1
            self.fail(
                row,
                column,
                f"expected a stamp after the previous row's {stamps[row - 1]}, found {stamps[row]}",
            )


def read_table(
    path: Path,
    columns: Sequence[Column],
    *,
    ignored: Sequence[str] = (),
    others: bool = False,
    headed: bool = True,
) -> Table:
    """Read a CSV file. Blank lines and spaces around cells are ignored.

    Parameters
    ----------
    path : Path
    columns : sequence of Column
        Columns to read, in any order.
    ignored : sequence of str
        Names of further columns that may be there and are not read.
    others : bool
        Accept columns of any other name as well, unless they begin like an optional one: `sigma` is more
        likely a misspelt `sigma_px` than a column that need not be read.
    headed : bool
        Whether the file begins with a header; without one, it has all columns, in their order.

    Returns
    -------
    Table
        Possibly without rows.

    Raises
    ------
    InputError
        When the file cannot be opened, see `craternav_fg.files.open_input`; when a column is missing or
        unknown, or a cell is not of its kind.
    """
    if headed:
        names, found, header_line = _read_header(path, columns, ignored, others)
    else:
        check_input(path, SizeLimit.TABLE)
        names, found, header_line = [column.name for column in columns], list(columns), 0
    by_name = {column.name: column for column in found}
    try:
        table = pa_csv.read_csv(
            path,
            read_options=pa_csv.ReadOptions(column_names=names, skip_rows=header_line),
            convert_options=pa_csv.ConvertOptions(
                column_types={column.name: _ARROW[column.kind] for column in found},
                include_columns=[column.name for column in found],
                null_values=[""],
                strings_can_be_null=True,
                quoted_strings_can_be_null=True,
            ),
        )
        data = {name: _from_arrow(table[name], column) for name, column in by_name.items()}
    except (pa.ArrowInvalid, _EmptyCellError):
        # Read again cell by cell, which is slow, to find the one at fault.
        data = _read_slowly(path, names, by_name, headed)
    result = Table(path, data, headed)
    for column in found:
        if column.kind == "number":
            cells = data[column.name]
            good = np.abs(cells) <= LARGEST
            bad = np.flatnonzero(~(good | np.isnan(cells) if column.may_be_empty else good))
            if len(bad):
                row = int(bad[0])
                expected = f"expected a finite number, at most {LARGEST:g} in size"
                result.fail(row, column.name, f"{expected}, found {cells[row]}")
    return result


def write_table(path: Path, columns: Sequence[Column], data: Sequence[Any], *, comment: bool = False) -> None:
    """Write a CSV file; numbers read back exactly.

    Parameters
    ----------
    path : Path
    columns : sequence of Column
    data : sequence of array_like
        One per column, of equal lengths.
    comment : bool
        Begin the header with '#', as EuRoC does.
    """
    texts = []
    for column, values in zip(columns, data, strict=True):
        if column.kind == "number":
            numbers = np.asarray(values, dtype=np.float64).tolist()
            texts.append(["" if column.may_be_empty and x != x else repr(x) for x in numbers])
        elif column.kind == "integer":
            texts.append([str(int(v)) for v in values])
        else:
            texts.append([str(v) for v in values])
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(("#" if comment else "") + ",".join(column.heading for column in columns) + "\n")
        csv.writer(stream, lineterminator="\n").writerows(zip(*texts, strict=True))


class _EmptyCellError(Exception):
    """A cell is empty that must not be."""


def _from_arrow(values: pa.ChunkedArray, column: Column) -> Any:
    if values.null_count and not column.may_be_empty:
        raise _EmptyCellError
    if column.kind == "text":
        texts = pa_compute.utf8_trim_whitespace(values).to_pylist()
        if "" in texts:
            raise _EmptyCellError
        return texts
    if column.kind == "number":
        return numbers(values)
    return np.array(np.from_dlpack(values.combine_chunks()))


def _read_header(
    path: Path, columns: Sequence[Column], ignored: Sequence[str], others: bool
) -> tuple[list[str], list[Column], int]:
    """Read the header: names of all columns, columns to read, and the header's line."""
    with _csv_reader(path) as reader:
        cells, line = _first_cells(reader), max(reader.line_num, 1)
    by_name = {column.name: column for column in columns}
    expected = ", ".join(column.name for column in columns if not column.optional)
    if len(cells) == 1:
        for sign, found in ((";", "semicolons"), ("\t", "tabs")):
            if sign in cells[0]:
                raise InputError(path, f"expected columns separated by commas, found {found}", line=line)
    present = {column.former: column.name for column in columns if column.former is not None}
    optional = [column.name for column in columns if column.optional]
    names: list[str] = []
    for cell in cells:
        name, bracket, unit = cell.strip().removeprefix("#").strip().partition(" [")
        name = present.get(name, name)
        passed = others and not any(name.lower().startswith(right[:5].lower()) for right in optional)
        if name not in by_name and name not in ignored and not passed:
            raise InputError(
                path, f"expected only the columns {expected}, found another one", line=line, column=name
            )
        if name in names:
            raise InputError(path, "expected each column once, found this one twice", line=line, column=name)
        wanted = by_name[name].unit if name in by_name else None
        if bracket and wanted is not None and unit.rstrip("]") != wanted:
            raise InputError(
                path, f"expected the unit [{wanted}], found [{unit.rstrip(']')}]", line=line, column=name
            )
        names.append(name)
    for column in columns:
        if not column.optional and column.name not in names:
            raise InputError(
                path, f"expected the columns {expected}, this one is missing", line=line, column=column.name
            )
    return names, [by_name[name] for name in names if name in by_name], line


def _is_blank(cells: list[str]) -> bool:
    """Whether a line that the csv module read is blank."""
    return not cells or (len(cells) == 1 and not cells[0].strip())


def _first_cells(reader: Iterable[list[str]]) -> list[str]:
    """Cells of the first line that is not blank."""
    return next((cells for cells in reader if not _is_blank(cells)), [])


def _read_slowly(path: Path, names: list[str], by_name: Mapping[str, Column], headed: bool) -> dict[str, Any]:
    data: dict[str, Any] = {
        name: [] if column.kind == "text" else array("q" if column.kind == "integer" else "d")
        for name, column in by_name.items()
    }
    with _csv_reader(path) as reader:
        if headed:
            _first_cells(reader)
        for cells in reader:
            if _is_blank(cells):
                continue
            if len(cells) != len(names):
                raise InputError(
                    path, f"expected {len(names)} columns, found {len(cells)}", line=reader.line_num
                )
            for name, cell in zip(names, cells, strict=True):
                if name in by_name:
                    data[name].append(_cell(path, reader.line_num, by_name[name], cell.strip()))
    return {
        name: values if by_name[name].kind == "text" else np.array(values) for name, values in data.items()
    }


class _CsvReader:
    """Cells of a CSV file line by line, with the number of lines that were read."""

    def __init__(self, path: Path, stream: TextIO) -> None:
        self._path = path
        self._stream = stream
        self._cells = csv.reader(iter(lambda: self._stream.readline(_MAX_LINE), ""))

    @property
    def line_num(self) -> int:
        """1-based line of the cells read last; 0 before any."""
        return self._cells.line_num

    def __iter__(self) -> Iterator[list[str]]:
        return self

    def __next__(self) -> list[str]:
        line = self.line_num + 1
        try:
            return next(self._cells)
        except (UnicodeDecodeError, csv.Error) as error:
            problem = f"expected text in UTF-8, separated by commas: {error}"
            raise InputError(self._path, problem, line=line) from None


@contextmanager
def _csv_reader(path: Path) -> Iterator[_CsvReader]:
    with (
        open_input(path, SizeLimit.TABLE) as raw,
        io.TextIOWrapper(raw, encoding="utf-8-sig", newline="") as stream,
    ):
        yield _CsvReader(path, stream)


def _cell(path: Path, line: int, column: Column, cell: str) -> Any:
    if not cell and column.may_be_empty:
        return np.nan
    if column.kind == "text" and cell:
        return cell
    try:
        # Python also reads 1_000 and digits of other scripts as numbers.
        if "_" in cell or not cell.isascii():
            pass
        elif column.kind == "integer":
            value = int(cell)
            if -(2**63) <= value < 2**63:
                return value
        elif column.kind == "number":
            return float(cell)
    except ValueError:
        pass
    article = "an integer" if column.kind == "integer" else f"a {column.kind}"
    raise InputError(path, f"expected {article}, found {cell!r}", line=line, column=column.name)
