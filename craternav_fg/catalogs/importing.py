"""Import of catalogues of any origin: rows that are no rims are skipped and reported, wrong files refused."""

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs import bodies, checks, columns
from craternav_fg.catalogs.columns import (
    COMMON_COLUMNS,
    COMMON_SOURCE,
    ERROR_COLUMNS,
    FORMER,
    HEIGHT,
    Columns,
    ImportOptions,
)
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.foreign_table import (
    ForeignTable,
    Header,
    read_columns,
    read_headers,
    read_parquet_table,
    refuse_doubled,
)
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from factors.arrays import BoolArray, FloatArray

PARQUET = ".parquet"
# In tables of at least this many rows, a fault that half of them have is one of the file, not of its rows.
_COMMON_FAULT_MIN_ROWS, _COMMON_FAULT_SHARE = 20, 0.5
# Largest number of a source: whole numbers up to it are exact as floating-point ones.
_MAX_SOURCE = 2.0**53
# What descriptions of tables and labels of PDS say of longitudes that count to the west.
_POSITIVE_WEST = re.compile(r"positive[\s_-]*west|west[\s_-]*positive|\+\s*west", re.IGNORECASE)


@dataclass(frozen=True)
class SkippedRow:
    """A row that was not imported.

    Attributes
    ----------
    line : int
        1-based line of the file.
    identifier : str
        As in the file; empty when it has none.
    reason : str
        Column and problem.
    """

    line: int
    identifier: str
    reason: str


@dataclass(frozen=True)
class ImportReport:
    """What an import made of a catalogue.

    Attributes
    ----------
    rows : int
        Rows of the file.
    circles : int
        Craters without an ellipse in a catalogue of ellipses; they were imported as circles.
    numbered : bool
        Whether the file has no identifiers; craters are then named by the line of the file.
    skipped : tuple of SkippedRow
        Rows that were not imported.
    columns : str
        Which columns were recognised as what, as words for messages; empty for our own store.
    body_by : str
        What states the body: "given", words for messages, or empty when the Moon was assumed.
    """

    rows: int
    circles: int
    numbered: bool
    skipped: tuple[SkippedRow, ...]
    columns: str
    body_by: str


def import_table(path: Path, body: Body | None, options: ImportOptions) -> tuple[Catalog, ImportReport]:
    """Read a table of craters: ellipses in the columns of Robbins (2018), or circles in any columns.

    Parameters
    ----------
    path : Path
    body : Body or None
        Which the catalogue must be of; None for the one that the file states.
    options : ImportOptions

    Returns
    -------
    catalog : Catalog
    report : ImportReport

    Raises
    ------
    InputError
        When the file is not such a table or of another body, when latitude and longitude are swapped or, by
        its own words, counted in another way, when
        the sizes make no sense for the body, or when no row is left.
    """
    if path.suffix == PARQUET:
        table, found = read_parquet_table(path, lambda p, names: columns.recognise(p, names, options))
    else:
        header, found = _header(path, options)
        table = read_columns(path, header, found.numbers, found.texts)
    identifiers = table.columns[found.identifier] if found.identifier else []
    body, body_by = bodies.resolve_body(path, body, bodies.stated_body(path, table.columns, identifiers))
    _check_system(table, found, body)
    shown = found.shown
    if found.angular:
        found = replace(found, size_m=found.size_m * body.radius_m)
    values, is_circle = _values(table, found)
    used = found.ellipse or found.circle
    problem = checks.swapped(values[0], values[1], used[1])
    if problem is not None:
        table.fail(problem[0], used[0], problem[1])
    faults = checks.row_faults(values, used, body.radius_m, found.height or HEIGHT)
    if found.identifier is None:
        identifiers = [str(line) for line in table.lines(range(len(table)))]
    else:
        faults = {**checks.identifier_faults(identifiers, found.identifier), **faults}
    _refuse_common_fault(table, faults, used[2:4], body.radius_m)
    keep = np.ones(len(table), dtype=np.bool_)
    keep[list(faults)] = False
    if not keep.any():
        raise InputError(path, _none_left(table, faults, used[2:4], body.radius_m))
    latitude, longitude, major, minor, angle, height = (column[keep] for column in values)
    if found.west:
        longitude = np.mod(-longitude, 360.0)
    longitude = checks.wrapped_deg(longitude)
    odd = checks.implausible_sizes(latitude, longitude, major, body.radius_m)
    if odd is not None:
        raise InputError(path, odd, column=used[2])
    odd = checks.distances_for_heights(height, body.radius_m)
    if odd is not None:
        raise InputError(path, odd, column=found.height)
    errors, shift = _sigmas(table, found, ERROR_COLUMNS, keep), _common_shift(table, found, keep)
    stated = errors is not None or shift is not None
    catalog = Catalog(
        plane_tilt_rad=_tilts(table, found, keep),
        identifiers=tuple(np.array(identifiers, dtype=object)[keep]),
        errors=None if errors is None else MapErrors(**errors),
        common_shift=shift,
        latitude_rad=np.radians(latitude),
        longitude_rad=np.radians(longitude),
        semi_major_m=0.5 * major,
        semi_minor_m=0.5 * minor,
        angle_rad=np.radians(angle),
        height_m=height,
        body=body,
        has_heights=_heights(table, found) is not None
        and checks.heights_are_stated(height, with_errors=stated),
    )
    report = ImportReport(
        rows=len(table) + len(table.broken),
        circles=int(np.count_nonzero(is_circle & keep)) if found.ellipse else 0,
        numbered=found.identifier is None,
        skipped=_skipped(table, faults, identifiers),
        columns=shown,
        body_by=body_by,
    )
    return catalog, report


def _header(path: Path, options: ImportOptions) -> tuple[Header, Columns]:
    """Find the line with the column names: the first one, or one below a preamble."""
    first, *others = read_headers(path)
    try:
        found = columns.recognise(path, first.names, options, first.line)
    except InputError:
        for header in others:
            with contextlib.suppress(InputError):
                found = columns.recognise(path, header.names, options, header.line)
                break
        else:
            raise
        _check_preamble(path, [first, *others[: others.index(header)]], found)
        return header, found
    refuse_doubled(path, first)
    return first, found


def _check_preamble(path: Path, lines: Sequence[Header], found: Columns) -> None:
    """Refuse longitudes that the text above the table says to be positive west."""
    for line in lines:
        said = _POSITIVE_WEST.search(" ".join(line.names))
        if said is not None and not found.west:
            problem = f"expected longitudes positive east, found {said[0]!r}: --west-longitudes?"
            raise InputError(path, problem, line=line.line)


def _check_system(table: ForeignTable, found: Columns, body: Body) -> None:
    """Refuse what the table itself says to be counted the other way, or from an ellipsoid."""
    if found.system is None:
        return
    for row, text in enumerate(table.columns[found.system]):
        said = (text or "").lower()
        ways = set(re.findall(r"\b(?:west|east)", said))
        if ways == {"east" if found.west else "west"}:
            expected = "positive west, as --west-longitudes says" if found.west else "positive east"
            hint = "" if found.west else ": --west-longitudes?"
            table.fail(row, found.system, f"expected longitudes {expected}, found {text!r}{hint}")
        if "planetographic" in said and body.name in bodies.FLATTENED:
            problem = f"expected planetocentric latitudes, found {text!r}: convert them"
            table.fail(row, found.system, problem)


def _heights(table: ForeignTable, found: Columns) -> FloatArray | None:
    """Heights (n,) of the rims, NaN where one is missing; None without any."""
    heights: FloatArray | None = table.columns[found.height] if found.height else None
    return None if heights is None or np.isnan(heights).all() else found.height_m * heights


def _tilts(table: ForeignTable, found: Columns, keep: BoolArray) -> FloatArray | None:
    """Slopes (k, 2) of the planes of the rims that are kept, rad; None where the table has none."""
    if not found.tilts:
        return None
    for name in found.tilts:
        problem = checks.tilt_fault(np.where(keep, table.columns[name], 0.0))
        if problem is not None:
            table.fail(problem[0], name, problem[1])
    return np.radians(np.stack([table.columns[name][keep] for name in found.tilts], axis=-1))


def _values(table: ForeignTable, found: Columns) -> tuple[tuple[FloatArray, ...], BoolArray]:
    """Latitude, longitude (deg), diameters (m), angle (deg), height (m); and which rows are circles."""
    zero = np.zeros(len(table))
    heights = _heights(table, found)
    height = zero if heights is None else heights
    circle: tuple[FloatArray, ...] | None = None
    if found.circle:
        latitude, longitude, diameter = (table.columns[name] for name in found.circle)
        diameter = found.size_m * diameter
        circle = (latitude, longitude, diameter, diameter, zero)
    if not found.ellipse:
        assert circle is not None
        return (*circle, height), np.ones(len(table), dtype=np.bool_)
    ellipse = [table.columns[name] for name in found.ellipse]
    ellipse[2], ellipse[3] = found.size_m * ellipse[2], found.size_m * ellipse[3]
    is_circle = np.zeros(len(table), dtype=np.bool_)
    if circle is not None:
        is_circle = np.any(np.isnan(ellipse), axis=0) & ~np.any(np.isnan(circle), axis=0)
        ellipse = [np.where(is_circle, c, e) for c, e in zip(circle, ellipse, strict=True)]
    return (*ellipse, height), is_circle


def _common_shift(table: ForeignTable, found: Columns, keep: BoolArray) -> CommonShift | None:
    sigmas = _sigmas(table, found, COMMON_COLUMNS, keep, may_be_empty=True)
    if sigmas is None:
        return None
    source = table.columns[COMMON_SOURCE] if COMMON_SOURCE in found.sigmas else np.zeros(len(table))
    wrong = np.flatnonzero(keep & ~((np.abs(source) <= _MAX_SOURCE) & (source == np.round(source))))
    if len(wrong):
        table.fail(int(wrong[0]), COMMON_SOURCE, f"expected a whole number, found {source[wrong[0]]:g}")
    return CommonShift(**sigmas, source=source[keep].astype(np.int64))


def _sigmas(
    table: ForeignTable,
    found: Columns,
    ours: Mapping[str, str],
    keep: BoolArray,
    *,
    may_be_empty: bool = False,
) -> dict[str, FloatArray] | None:
    """Take the standard deviations of the rows that are kept; None when the table has none."""
    out = {}
    for present, key in ours.items():
        name = next((one for one in (present, FORMER.get(present)) if one in found.sigmas), None)
        if name is None:
            return None
        values = table.columns[name]
        good = (values >= 0.0) & (values < np.inf)
        wrong = np.flatnonzero(keep & ~(good | np.isnan(values) if may_be_empty else good))
        if len(wrong):
            table.fail(int(wrong[0]), name, f"expected 0 or more, found {values[wrong[0]]:g}")
        out[key] = values[keep]
    return out


def _skipped(
    table: ForeignTable, faults: checks.Faults, identifiers: Sequence[str | None]
) -> tuple[SkippedRow, ...]:
    """Rows at fault and lines with another number of cells, in the order of the file."""
    rows = sorted(faults)
    skipped = [
        SkippedRow(line, identifiers[row] or "", f"{faults[row][0]}: {faults[row][1]}")
        for row, line in zip(rows, table.lines(rows) if rows else [], strict=True)
    ]
    skipped += [
        SkippedRow(line, "", f"expected {table.width} columns, found {cells}") for line, cells in table.broken
    ]
    return tuple(sorted(skipped, key=lambda row: row.line))


def _none_left(table: ForeignTable, faults: checks.Faults, diameters: Sequence[str], radius_m: float) -> str:
    """Explain why no row of a table was imported."""
    problem = f"expected at least one crater, found none in {len(table) + len(table.broken)} rows"
    if not faults:
        if not table.broken:
            return problem
        line, cells = table.broken[0]
        found = f"expected {table.width} columns, found {cells}: is a text with a separator not in quotes?"
        return f"{problem}, the first left out is line {line}: {found}"
    row = min(faults)
    column, fault = faults[row]
    hint = f": {checks.wrong_unit(radius_m)}" if column in diameters else ""
    return f"{problem}, the first left out is line {table.lines([row])[0]}: {column}: {fault}{hint}"


def _refuse_common_fault(
    table: ForeignTable, faults: checks.Faults, diameters: Sequence[str], radius_m: float
) -> None:
    """Refuse a table of which many rows have the same fault."""
    if len(table) < _COMMON_FAULT_MIN_ROWS:
        return
    by_column: dict[str, list[int]] = {}
    for row, (column, _) in faults.items():
        by_column.setdefault(column, []).append(row)
    for column, rows in by_column.items():
        if len(rows) > _COMMON_FAULT_SHARE * len(table):
            row = min(rows)
            problem = f"{faults[row][1]}; so in {len(rows)} of {len(table)} rows"
            if "at most the major" in problem:
                problem += ": major and minor diameters are swapped"
            elif column in diameters:
                problem += f": {checks.wrong_unit(radius_m)}"
            table.fail(row, column, problem)
