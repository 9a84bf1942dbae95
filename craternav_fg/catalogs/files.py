"""Crater catalogues in files: the columns of Robbins (2018), those of others, and our own store."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs import checks
from craternav_fg.catalogs.bodies import BODY, BODY_RADIUS, settled, stated_body
from craternav_fg.catalogs.columns import (
    ANGLE,
    ELLIPSE,
    HEIGHT,
    ID,
    LATITUDE,
    LONGITUDE,
    MAJOR,
    MINOR,
    ImportOptions,
)
from craternav_fg.catalogs.importing import ImportReport, import_table
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import SUFFIX, read_parquet, write_parquet
from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.tables import Column, read_table, write_table

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
_COLUMNS: Sequence[Column] = (
    Column(ID, "text"),
    *(Column(name) for name in ELLIPSE),
    Column(HEIGHT, optional=True),
    Column(BODY, "text", optional=True),
    Column(BODY_RADIUS, optional=True),
)


def read_catalog(path: Path, body: Body) -> Catalog:
    """Read a catalogue in which every row must be right: our own store (`.parquet`), or a table.

    Columns of the table: CRATER_ID, LAT_ELLI_IMG and LON_ELLI_IMG (deg, east positive),
    DIAM_ELLI_MAJOR_IMG and DIAM_ELLI_MINOR_IMG (km), DIAM_ELLI_ANGLE_IMG (deg from local east towards
    north), and optionally RIM_HEIGHT_M (above the reference sphere, 0 without it), BODY and BODY_RADIUS_M
    (the same in all rows). Other published columns are not read.

    Raises
    ------
    InputError
        For the first row at fault, for a catalogue without rows, and for one of another body.
    """
    if path.suffix == SUFFIX:
        return read_parquet(path, body)
    table = read_table(path, _COLUMNS, ignored=_PUBLISHED)
    if not len(table):
        raise InputError(path, "expected at least one crater, found none")
    settled(path, body, stated_body(path, table.columns, table.columns[ID]))
    latitude, longitude, major_km, minor_km, angle = (table.columns[name] for name in ELLIPSE)
    height = table.columns[HEIGHT] if HEIGHT in table.columns else np.zeros(len(table))
    values = (latitude, longitude, 1e3 * major_km, 1e3 * minor_km, angle, height)
    problem = checks.swapped(latitude, longitude, ELLIPSE[1])
    if problem is not None:
        table.fail(problem[0], ELLIPSE[0], problem[1])
    faults = checks.row_faults(values, ELLIPSE, body.radius_m)
    faults = {**checks.identifier_faults(table.columns[ID], ID), **faults}
    if faults:
        row = min(faults)
        table.fail(row, *faults[row])
    return Catalog(
        identifiers=tuple(table.columns[ID]),
        latitude_rad=np.radians(latitude),
        longitude_rad=np.radians(longitude),
        semi_major_m=major_km * 500.0,
        semi_minor_m=minor_km * 500.0,
        angle_rad=np.radians(angle),
        height_m=height,
        body=body,
    )


def import_catalog(
    path: Path, body: Body | None = None, options: ImportOptions | None = None
) -> tuple[Catalog, ImportReport]:
    """Read a catalogue of any origin, and leave out the rows that are no rim.

    Parameters
    ----------
    path : Path
        Our own store (`.parquet`), or a table with Robbins' columns, or one of circles.
    body : Body, optional
        Which the catalogue must be of. Without it, that which the file tells by metadata, column, identifiers
        of Robbins (2018) or its name, else the Moon; it has neither gravity nor spin then.
    options : ImportOptions, optional
        Names of columns that are not recognised.

    Returns
    -------
    catalog : Catalog
    report : ImportReport
        With the rows that were left out: without a size, with values out of range, or with an identifier
        seen before.

    Raises
    ------
    InputError
        When the file is no such table, is of another body, its sizes make no sense for the body, or no row is
        left.
    """
    if path.suffix == SUFFIX:
        catalog = read_parquet(path, body)
        return catalog, ImportReport(len(catalog), 0, False, (), "", "its metadata say")
    return import_table(path, body, options or ImportOptions())


def write_catalog(path: Path, catalog: Catalog) -> None:
    """Write a catalogue that `read_catalog` reads: a table, or under a name in `.parquet` our own store.

    Raises
    ------
    InputError
        When it cannot be written; a file of that name stays what it was.
    """
    if path.suffix == SUFFIX:
        write_parquet(path, catalog)
        return
    n = len(catalog)
    data = {
        ID: catalog.identifiers,
        LATITUDE: np.degrees(catalog.latitude_rad),
        LONGITUDE: np.degrees(catalog.longitude_rad),
        MAJOR: catalog.semi_major_m * 2e-3,
        MINOR: catalog.semi_minor_m * 2e-3,
        ANGLE: np.degrees(catalog.angle_rad),
        HEIGHT: catalog.height_m,
        BODY: [catalog.body.name] * n,
        BODY_RADIUS: np.full(n, catalog.body.radius_m),
    }
    written = [column for column in _COLUMNS if column.name != BODY or catalog.body.name.strip()]
    with replacing(path) as temporary:
        write_table(temporary, written, [data[column.name] for column in written])
