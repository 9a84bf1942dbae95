"""Crater catalogues in CSV files with the column names of Robbins (2018)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg.body import Body
from craternav_fg.catalog import Catalog
from craternav_fg.errors import InputError
from craternav_fg.tables import Column, Table, read_table, write_table

FloatArray = npt.NDArray[np.float64]

ID = "CRATER_ID"
LATITUDE = "LAT_ELLI_IMG"
LONGITUDE = "LON_ELLI_IMG"
MAJOR = "DIAM_ELLI_MAJOR_IMG"
MINOR = "DIAM_ELLI_MINOR_IMG"
ANGLE = "DIAM_ELLI_ANGLE_IMG"
HEIGHT = "RIM_HEIGHT_M"
_ELLIPSE = (LATITUDE, LONGITUDE, MAJOR, MINOR, ANGLE)

# The other columns of the published file: allowed, not used.
_PUBLISHED = (
    "LAT_CIRC_IMG",
    "LON_CIRC_IMG",
    "DIAM_CIRC_IMG",
    "DIAM_CIRC_SD_IMG",
    "DIAM_ELLI_ECCEN_IMG",
    "DIAM_ELLI_ELLIP_IMG",
    "LAT_ELLI_SD_IMG",
    "LON_ELLI_SD_IMG",
    "DIAM_ELLI_MAJOR_SD_IMG",
    "DIAM_ELLI_MINOR_SD_IMG",
    "DIAM_ELLI_ANGLE_SD_IMG",
    "DIAM_ELLI_ECCEN_SD_IMG",
    "DIAM_ELLI_ELLIP_SD_IMG",
    "ARC_IMG",
    "PTS_RIM_IMG",
)


@dataclass(frozen=True)
class SkippedRow:
    """A row of a published catalogue that was not imported.

    Attributes
    ----------
    line : int
        1-based line of the file.
    identifier : str
        As in the file.
    reason : str
        What is wrong with it.
    """

    line: int
    identifier: str
    reason: str


def read_catalog(path: Path, body: Body) -> Catalog:
    """Read a catalogue in which every row must be right.

    Columns: CRATER_ID, LAT_ELLI_IMG and LON_ELLI_IMG (deg, east positive), DIAM_ELLI_MAJOR_IMG and
    DIAM_ELLI_MINOR_IMG (km), DIAM_ELLI_ANGLE_IMG (deg from local east towards north), and optionally
    RIM_HEIGHT_M (above the reference sphere, 0 without it). Other published columns are not read.

    Raises
    ------
    InputError
        For the first row at fault, and for a catalogue without rows.
    """
    table = _read(path, may_be_empty=False)
    if not len(table):
        raise InputError(path, "expected at least one crater, found none")
    faults = _faults(table, body)
    if faults:
        row = min(faults)
        column, problem = faults[row]
        table.fail(row, column, problem)
    return _catalog(table, body, np.arange(len(table)))


def import_catalog(path: Path, body: Body) -> tuple[Catalog, tuple[SkippedRow, ...]]:
    """Read a published catalogue and leave out the rows that are no rim.

    Parameters
    ----------
    path : Path
        Robbins' 21 columns or the six of `read_catalog`.
    body : Body

    Returns
    -------
    catalog : Catalog
    skipped : tuple of SkippedRow
        Rows without an ellipse, with values out of range, or with an identifier seen before.

    Raises
    ------
    InputError
        When the file is no such table, or no row is left.
    """
    table = _read(path, may_be_empty=True)
    faults = _faults(table, body)
    keep = np.array([row for row in range(len(table)) if row not in faults], dtype=np.int64)
    if not len(keep):
        raise InputError(
            path, f"expected at least one crater with an ellipse, found none in {len(table)} rows"
        )
    skipped = tuple(
        SkippedRow(table.line(row), table.columns[ID][row], f"{faults[row][0]}: {faults[row][1]}")
        for row in sorted(faults)
    )
    return _catalog(table, body, keep), skipped


def write_catalog(path: Path, catalog: Catalog) -> None:
    """Write a catalogue with the columns that `read_catalog` reads."""
    write_table(
        path,
        _columns(may_be_empty=False),
        [
            catalog.identifiers,
            np.degrees(catalog.latitude_rad),
            np.degrees(catalog.longitude_rad),
            catalog.semi_major_m * 2e-3,
            catalog.semi_minor_m * 2e-3,
            np.degrees(catalog.angle_rad),
            catalog.height_m,
        ],
    )


def _columns(*, may_be_empty: bool) -> Sequence[Column]:
    return (
        Column(ID, "text"),
        *(Column(name, may_be_empty=may_be_empty) for name in _ELLIPSE),
        Column(HEIGHT, optional=True),
    )


def _read(path: Path, *, may_be_empty: bool) -> Table:
    return read_table(path, _columns(may_be_empty=may_be_empty), ignored=_PUBLISHED)


def _faults(table: Table, body: Body) -> dict[int, tuple[str, str]]:
    """Rows that are no rim: column and what is wrong with it."""
    latitude, longitude, major, minor, angle = (table.columns[name] for name in _ELLIPSE)
    largest_km = 2e-3 * body.radius_m
    tests = [
        (LATITUDE, ~(np.abs(latitude) <= 90.0), "expected -90 to 90 deg", latitude),
        (LONGITUDE, ~((longitude >= -180.0) & (longitude <= 360.0)), "expected -180 to 360 deg", longitude),
        (ANGLE, ~(np.abs(angle) <= 360.0), "expected -360 to 360 deg", angle),
        (MAJOR, ~((major > 0.0) & (major < largest_km)), f"expected 0 to {largest_km:g} km", major),
        (MINOR, ~(minor > 0.0), "expected a positive diameter", minor),
        (MINOR, minor > major, "expected at most the major diameter", minor),
    ]
    faults: dict[int, tuple[str, str]] = {}
    for column, bad, expected, values in tests:
        for row in np.flatnonzero(bad).tolist():
            found = "none" if np.isnan(values[row]) else f"{values[row]:g}"
            faults.setdefault(row, (column, f"{expected}, found {found}"))
    if HEIGHT in table.columns:
        for row in np.flatnonzero(table.columns[HEIGHT] <= -body.radius_m).tolist():
            faults.setdefault(row, (HEIGHT, "expected a rim above the body's centre"))
    seen: set[str] = set()
    for row, identifier in enumerate(table.columns[ID]):
        if identifier in seen:
            faults.setdefault(row, (ID, f"expected each identifier once, found {identifier!r} again"))
        seen.add(identifier)
    return faults


def _catalog(table: Table, body: Body, rows: npt.NDArray[np.int64]) -> Catalog:
    latitude, longitude, major, minor, angle = (table.columns[name][rows] for name in _ELLIPSE)
    height = table.columns[HEIGHT][rows] if HEIGHT in table.columns else np.zeros(len(rows))
    return Catalog(
        identifiers=tuple(table.columns[ID][row] for row in rows),
        latitude_rad=np.radians(latitude),
        longitude_rad=np.radians(longitude),
        semi_major_m=major * 500.0,
        semi_minor_m=minor * 500.0,
        angle_rad=np.radians(angle),
        height_m=height,
        body=body,
    )
