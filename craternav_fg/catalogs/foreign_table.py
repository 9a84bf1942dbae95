"""Third-party tables: any separator, a preamble, broken lines that are skipped and counted."""

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, NoReturn, Protocol, TypeVar

import pyarrow as pa
import pyarrow.csv as pa_csv

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, open_input
from craternav_fg.tables import arrow
from craternav_fg.tables.parquet import parquet_names, read_parquet_columns
from factors.arrays import IntArray

# Cells that stand for no value.
_NULL_CELLS = ["", "NA", "N/A", "NaN", "nan", "null", "NULL", "-", "--"]
# Lines that may stand above the column names.
_MAX_PREAMBLE = 60
# Length of a line in bytes, with its end.
_MAX_LINE = 1 << 20
# First bytes of files that are often taken for tables.
_OTHER_FORMATS = {
    b"PK\x03\x04": "a zip archive or a spreadsheet: unpack it, or save it as CSV",
    b"\x1f\x8b": "a compressed file: unpack it",
    b"\xff\xfe": "one in UTF-16: save it in UTF-8",
    b"\xfe\xff": "one in UTF-16: save it in UTF-8",
    b"{": "JSON (GeoJSON?): save it as CSV with columns of latitude, longitude and diameter",
    b"SQLite format 3": "a database (GeoPackage?): save it as CSV",
    b"PAR1": "a Parquet file: its name must end in .parquet",
}
# Bytes that no text has.
_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x1f]")
# How pyarrow words an error of conversion.
_CONVERSION = re.compile(r"In CSV column #(\d+): (?:Row #(\d+): )?.*invalid value '(.*)'")


class _Needed(Protocol):
    """Columns that are to be read."""

    @property
    def numbers(self) -> list[str]:
        """Those of numbers."""
        ...

    @property
    def texts(self) -> list[str]:
        """Those of texts."""
        ...


C = TypeVar("C", bound=_Needed)


@dataclass(frozen=True)
class ForeignTable:
    """Some columns of a table.

    Attributes
    ----------
    path : Path
    columns : dict of str to ndarray or list of str
        Numbers as float64 with NaN for empty cells; texts with None for empty cells.
    broken : tuple of (int, int)
        Line and number of cells of each line with more or fewer cells than the header.
    width : int
        Number of cells of the header.
    header_line : int
        1-based; 0 in a Parquet file, whose rows count from 1.
    """

    path: Path
    columns: Mapping[str, Any]
    broken: tuple[tuple[int, int], ...]
    width: int
    header_line: int

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def lines(self, rows: Sequence[int] | IntArray) -> list[int]:
        """Find the lines of the file in which rows stand.

        Parameters
        ----------
        rows : sequence of int, or ndarray of int, shape (k,)

        Returns
        -------
        list of int
            1-based.
        """
        if self.header_line == 0:
            return [int(row) + 1 for row in rows]
        broken = {line for line, _ in self.broken}
        kept = [line for line in _filled_lines(self.path, self.header_line)[1:] if line not in broken]
        return [kept[row] for row in rows]

    def fail(self, row: int, column: str, problem: str) -> NoReturn:
        """Refuse a cell.

        Parameters
        ----------
        row : int
        column : str
        problem : str
            What was expected and what was found.

        Raises
        ------
        InputError
            Always: names the file, the line and the column.
        """
        raise InputError(self.path, problem, line=self.lines([row])[0], column=column)


@dataclass(frozen=True)
class Header:
    """A line that may hold the column names.

    Attributes
    ----------
    names : list of str
        As they are written.
    separator : str
    line : int
        1-based, of the file.
    """

    names: list[str]
    separator: str
    line: int


def read_headers(path: Path) -> list[Header]:
    """Read the lines of a table that may hold its column names.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of Header
        The first line that is not blank, then those below it, which count if there is a preamble.

    Raises
    ------
    InputError
        When the file is missing, empty, or not text with line feeds.
    """
    first: list[tuple[int, bytes]] = []
    with open_input(path, SizeLimit.TABLE) as raw:
        for number, line in enumerate(_lines(raw), 1):
            if len(line) >= _MAX_LINE:
                problem = f"expected lines of at most {_MAX_LINE} bytes, found a longer one"
                raise InputError(path, problem, line=number)
            if line.strip():
                first.append((number, line))
            if len(first) > _MAX_PREAMBLE:
                break
    for sign, what in _OTHER_FORMATS.items():
        if first and first[0][1].startswith(sign):
            raise InputError(path, f"expected a table as text, found {what}")
    if not first:
        raise InputError(path, "expected a table with column names in its first line, found nothing", line=1)
    for number, line in first:
        if _CONTROLS.search(line):
            raise InputError(path, "expected a table as text, found binary data", line=number)
        if b"\r" in line.rstrip(b"\r\n"):
            problem = "expected lines that end in a line feed, found a carriage return alone"
            raise InputError(path, problem, line=number)
    headers = []
    for number, line in first:
        text = _decoded(line).strip("\r\n")
        separator = max(",;\t", key=text.count)
        cells = _cells(path, number, text, separator)
        headers.append(Header([cell.strip().removeprefix("#").strip() for cell in cells], separator, number))
    return headers


def read_parquet_table(path: Path, recognise: Callable[[Path, Sequence[str]], C]) -> tuple[ForeignTable, C]:
    """Read some columns of a Parquet file of others.

    Parameters
    ----------
    path : Path
    recognise : callable
        recognise(path, names of all columns) says which are needed: its `numbers` and `texts`.

    Returns
    -------
    table : ForeignTable
    columns
        What was recognised.

    Raises
    ------
    InputError
        When the file cannot be read, or a column is of another kind.
    """
    found = recognise(path, parquet_names(path))
    table = read_parquet_columns(path, [*found.numbers, *found.texts])
    try:
        data: dict[str, Any] = {
            name: table[name].cast(pa.float64()).to_numpy(zero_copy_only=False) for name in found.numbers
        }
        data.update({name: table[name].cast(pa.string()).to_pylist() for name in found.texts})
    except pa.ArrowException as error:
        raise InputError(path, f"expected numbers and texts: {' '.join(str(error).split())}") from None
    return ForeignTable(path, data, (), len(table.column_names), 0), found


def _cells(path: Path, number: int, text: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator))
    except csv.Error as error:
        raise InputError(path, f"expected cells of a table: {error}", line=number) from None


def refuse_doubled(path: Path, header: Header) -> None:
    """Refuse a header that has a column twice.

    Parameters
    ----------
    path : Path
    header : Header

    Raises
    ------
    InputError
        Naming the column.
    """
    for name in header.names:
        if name and header.names.count(name) > 1:
            problem = "expected each column once, found this one twice"
            raise InputError(path, problem, line=header.line, column=name)


def read_columns(path: Path, header: Header, numbers: Sequence[str], texts: Sequence[str]) -> ForeignTable:
    """Read some columns of a table.

    Parameters
    ----------
    path : Path
    header : Header
        Which must have the columns.
    numbers, texts : sequence of str
        Names of the columns to read as numbers and as texts.

    Returns
    -------
    ForeignTable

    Raises
    ------
    InputError
        When a cell of a column of numbers is not a number.
    """
    # Nameless columns get names, because pyarrow wants them to differ.
    unique = [name or f"#{k}" for k, name in enumerate(header.names)]
    broken: list[tuple[int, int]] = []

    def skip(row: Any) -> str:
        broken.append((row.number, row.actual_columns))
        return "skip"

    encoding = "utf8" if _is_utf8(path) else "latin1"
    try:
        table = pa_csv.read_csv(
            path,
            # With one thread pyarrow names the row of an error.
            read_options=pa_csv.ReadOptions(
                column_names=unique, skip_rows=header.line, use_threads=False, encoding=encoding
            ),
            parse_options=pa_csv.ParseOptions(delimiter=header.separator, invalid_row_handler=skip),
            convert_options=pa_csv.ConvertOptions(
                column_types={**dict.fromkeys(numbers, pa.float64()), **dict.fromkeys(texts, pa.string())},
                include_columns=[*numbers, *texts],
                null_values=_NULL_CELLS,
                strings_can_be_null=True,
                quoted_strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid as error:
        raise _cell_error(path, header, unique, str(error)) from None
    data: dict[str, Any] = {}
    for name in numbers:
        data[name] = arrow.numbers(table[name])
    for name in texts:
        data[name] = [text and text.strip() for text in table[name].to_pylist()]
    if broken:
        filled = _filled_lines(path, header.line)
        # pyarrow counts the header and the lines above it, but not the empty lines below.
        broken = [(filled[number - header.line], cells) for number, cells in broken]
    return ForeignTable(path, data, tuple(broken), len(header.names), header.line)


def _cell_error(path: Path, header: Header, names: Sequence[str], message: str) -> InputError:
    match = _CONVERSION.search(message)
    if match is None:
        return InputError(path, f"expected a table: {message}")
    column, row, found = match.groups()
    filled = _filled_lines(path, header.line)
    line = None if row is None else filled[min(int(row) - header.line, len(filled) - 1)]
    return InputError(path, f"expected a number, found {found!r}", line=line, column=names[int(column)])


def _filled_lines(path: Path, first: int) -> list[int]:
    """1-based lines that are not empty, from some line on: once for each row that pyarrow counts.

    pyarrow counts a line of spaces, and ends a row at a carriage return in a line.
    """
    with open_input(path, SizeLimit.TABLE) as stream:
        return [
            number
            for number, line in enumerate(_lines(stream), 1)
            for row in line.splitlines()
            if number >= first and row
        ]


def _lines(stream: BufferedReader) -> Iterator[bytes]:
    """Read lines; one that is too long comes in parts."""
    return iter(lambda: stream.readline(_MAX_LINE), b"")


def _decoded(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _is_utf8(path: Path) -> bool:
    try:
        with (
            open_input(path, SizeLimit.TABLE) as raw,
            io.TextIOWrapper(raw, encoding="utf-8") as stream,
        ):
            for _ in iter(lambda: stream.read(1 << 20), ""):
                pass
    except UnicodeDecodeError:
        return False
    return True
