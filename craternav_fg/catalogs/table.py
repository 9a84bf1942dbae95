"""Reading tables as others write them: any separator, broken lines left out and counted."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv as pa_csv

from craternav_fg.errors import InputError

IntArray = npt.NDArray[np.int64]

_NONE = ["", "NA", "N/A", "NaN", "nan", "null", "NULL", "-", "--"]
_CONVERSION = re.compile(r"In CSV column #(\d+): (?:Row #(\d+): )?.*invalid value '(.*)'")


@dataclass(frozen=True)
class ForeignTable:
    """Some columns of a table.

    Attributes
    ----------
    path : Path
    columns : dict of str to ndarray or list of str
        Float64 with NaN for empty cells; texts, None for empty ones.
    broken : tuple of (int, int)
        Lines with another number of cells than the header, each with that number.
    width : int
        Cells of the header.
    """

    path: Path
    columns: Mapping[str, Any]
    broken: tuple[tuple[int, int], ...]
    width: int

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def lines(self, rows: Sequence[int] | IntArray) -> list[int]:
        """1-based lines of the file in which rows stand."""
        broken = {line for line, _ in self.broken}
        kept = [line for line in _filled_lines(self.path)[1:] if line not in broken]
        return [kept[row] for row in rows]

    def fail(self, row: int, column: str, problem: str) -> NoReturn:
        """Raise the `InputError` of one cell."""
        raise InputError(self.path, problem, line=self.lines([row])[0], column=column)


def read_header(path: Path) -> tuple[list[str], str]:
    """Give a table's column names, as they are written, and the sign that separates them.

    Raises
    ------
    InputError
        When the file is missing, empty, or has a column twice.
    """
    if not path.is_file():
        raise InputError(path, "file is missing")
    raw = path.open("rb")
    with raw:
        first = next((line for line in raw if line.strip()), b"")
    text = _decoded(first).strip("\r\n")
    if not text.strip() or "\0" in text:
        raise InputError(path, "expected a table with column names in its first line", line=1)
    separator = max(",;\t", key=text.count)
    names = [cell.strip().removeprefix("#").strip() for cell in next(csv.reader([text], delimiter=separator))]
    for name in names:
        if name and names.count(name) > 1:
            raise InputError(path, "expected each column once, found this one twice", line=1, column=name)
    return names, separator


def read_columns(path: Path, numbers: Sequence[str], texts: Sequence[str]) -> ForeignTable:
    """Read some columns, which must be there.

    Parameters
    ----------
    path : Path
    numbers, texts : sequence of str
        Their names in the header.

    Raises
    ------
    InputError
        When a cell of a column of numbers is none.
    """
    names, separator = read_header(path)
    # A name of one's own for nameless ones: pyarrow wants them to differ.
    unique = [name or f"#{k}" for k, name in enumerate(names)]
    broken: list[tuple[int, int]] = []

    def skip(row: Any) -> str:
        broken.append((row.number, row.actual_columns))
        return "skip"

    encoding = "utf8" if _is_utf8(path) else "latin1"
    try:
        table = pa_csv.read_csv(
            path,
            # One thread: only then pyarrow tells in which row something is wrong.
            read_options=pa_csv.ReadOptions(
                column_names=unique, skip_rows=_filled_lines(path)[0], use_threads=False, encoding=encoding
            ),
            parse_options=pa_csv.ParseOptions(delimiter=separator, invalid_row_handler=skip),
            convert_options=pa_csv.ConvertOptions(
                column_types={**dict.fromkeys(numbers, pa.float64()), **dict.fromkeys(texts, pa.string())},
                include_columns=[*numbers, *texts],
                null_values=_NONE,
                strings_can_be_null=True,
                quoted_strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid as error:
        raise _cell_error(path, unique, str(error)) from None
    data: dict[str, Any] = {}
    for name in numbers:
        data[name] = table[name].to_numpy().astype(np.float64)
    for name in texts:
        data[name] = [text and text.strip() for text in table[name].to_pylist()]
    if broken:
        filled = _filled_lines(path)
        # pyarrow counts the header's line and what it skips, but no blank lines below it.
        skipped = filled[0] - 1
        broken = [(filled[number - 1 - skipped], cells) for number, cells in broken]
    return ForeignTable(path, data, tuple(broken), len(names))


def _cell_error(path: Path, names: Sequence[str], message: str) -> InputError:
    match = _CONVERSION.search(message)
    if match is None:
        return InputError(path, f"expected a table: {message}")
    column, row, found = match.groups()
    filled = _filled_lines(path)
    line = None if row is None else filled[min(int(row) - filled[0], len(filled) - 1)]
    return InputError(path, f"expected a number, found {found!r}", line=line, column=names[int(column)])


def _filled_lines(path: Path) -> list[int]:
    """1-based numbers of the lines that are not blank."""
    with path.open("rb") as stream:
        return [number for number, line in enumerate(stream, 1) if line.strip()]


def _decoded(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _is_utf8(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8") as stream:
            for _ in iter(lambda: stream.read(1 << 20), ""):
                pass
    except UnicodeDecodeError:
        return False
    return True
