"""Catalogue files: tables with the columns of Robbins (2018), third-party tables, and our own store."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs import checks
from craternav_fg.catalogs.bodies import BODY, BODY_RADIUS, resolve_body, stated_body
from craternav_fg.catalogs.columns import (
    ANGLE,
    COMMON_COLUMNS,
    COMMON_SOURCE,
    ELLIPSE,
    ERROR_COLUMNS,
    FORMER,
    HEIGHT,
    ID,
    LATITUDE,
    LONGITUDE,
    MAJOR,
    MINOR,
    TILTS,
    ImportOptions,
    all_or_none,
)
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.importing import ImportReport, import_table
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import SUFFIX, is_store, read_parquet, write_parquet
from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.tables import Column, Table, read_table, write_table
from factors.arrays import FloatArray

# Further columns of the published file, which may be there and are not read.
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
    *(Column(name, optional=True) for name in TILTS),
    Column(BODY, "text", optional=True),
    Column(BODY_RADIUS, optional=True),
    *(Column(name, optional=True, former=FORMER.get(name)) for name in ERROR_COLUMNS),
    *(Column(name, optional=True, may_be_empty=True) for name in COMMON_COLUMNS),
    Column(COMMON_SOURCE, "integer", optional=True),
)


def read_catalog(path: Path, body: Body) -> Catalog:
    """Read a catalogue without a fault: our own store (`.parquet`), or a table.

    Parameters
    ----------
    path : Path
        Store, or table with the columns CRATER_ID, LAT_ELLI_IMG and LON_ELLI_IMG (deg, east positive),
        DIAM_ELLI_MAJOR_IMG and DIAM_ELLI_MINOR_IMG (km), DIAM_ELLI_ANGLE_IMG (deg from local east towards
        north), and optionally RIM_HEIGHT_M (above the sphere; unknown without it), PLANE_TILT_EAST_DEG and
        PLANE_TILT_NORTH_DEG (both or none, see `Catalog.plane_tilt_rad`), BODY and BODY_RADIUS_M (the same in
        all rows), and the standard deviations PLACE_SIGMA_M, SIZE_SIGMA_SHARE (a share) and
        RIM_HEIGHT_SIGMA_M (all or none, see `MapErrors`), COMMON_PLACE_SIGMA_M and COMMON_HEIGHT_SIGMA_M
        (both or none, empty where unknown, see `CommonShift`), and COMMON_SOURCE beside them (without it, all
        craters are of one source). Other published columns are not read.
    body : Body
        Which the catalogue must be of.

    Returns
    -------
    Catalog

    Raises
    ------
    InputError
        For the first row at fault, a catalogue without rows, and one of another body.
    """
    if path.suffix == SUFFIX:
        return read_parquet(path, body)
    table = read_table(path, _COLUMNS, ignored=_PUBLISHED)
    if not len(table):
        raise InputError(path, "expected at least one crater, found none")
    resolve_body(path, body, stated_body(path, table.columns, table.columns[ID]))
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
    problem_of_heights = checks.distances_for_heights(height, body.radius_m)
    if problem_of_heights is not None:
        raise InputError(path, problem_of_heights, column=HEIGHT)
    errors, shift = _sigmas(table, ERROR_COLUMNS), _common_shift(table)
    stated = errors is not None or shift is not None
    return Catalog(
        errors=None if errors is None else MapErrors(**errors),
        common_shift=shift,
        identifiers=tuple(table.columns[ID]),
        latitude_rad=np.radians(latitude),
        longitude_rad=np.radians(checks.wrapped_deg(longitude)),
        semi_major_m=major_km * 500.0,
        semi_minor_m=minor_km * 500.0,
        angle_rad=np.radians(angle),
        height_m=height,
        body=body,
        has_heights=HEIGHT in table.columns and checks.heights_are_stated(height, with_errors=stated),
        plane_tilt_rad=_tilts(table),
        sphere_stated=BODY_RADIUS in table.columns,
    )


def import_catalog(
    path: Path | str, body: Body | None = None, options: ImportOptions | None = None
) -> tuple[Catalog, ImportReport]:
    """Read a catalogue of any origin, and skip the rows that are no rims.

    Parameters
    ----------
    path : Path or str
        Our own store (`.parquet`), a table with the columns of Robbins (2018), or a table of circles; tables
        as text or as Parquet.
    body : Body, optional
        Which the catalogue must be of. Without it the body that the file states by metadata, a column,
        identifiers of Robbins (2018) or its name, else the Moon; such a body has neither gravity nor spin.
    options : ImportOptions, optional
        Names of columns that are not recognised.

    Returns
    -------
    catalog : Catalog
    report : ImportReport
        With the rows that were skipped: without a size, with values out of range, or with the identifier of
        an earlier row.

    Raises
    ------
    InputError
        When the file is not such a table, is of another body, its sizes make no sense for the body, or no row
        is left.
    """
    path = Path(path)
    if path.suffix == SUFFIX and is_store(path):
        catalog = read_parquet(path, body)
        return catalog, ImportReport(len(catalog), 0, False, (), "", "its metadata say")
    return import_table(path, body, options or ImportOptions())


def write_catalog(path: Path, catalog: Catalog) -> None:
    """Write a catalogue that `read_catalog` reads.

    Parameters
    ----------
    path : Path
        A name in `.parquet` for our own store, any other for a table.
    catalog : Catalog

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
    left_out = set() if catalog.body.name.strip() else {BODY}
    if not catalog.has_heights:
        left_out |= {HEIGHT}
    if catalog.plane_tilt_rad is None:
        left_out |= set(TILTS)
    else:
        data |= dict(zip(TILTS, np.degrees(catalog.plane_tilt_rad).T, strict=True))
    if catalog.errors is None:
        left_out |= set(ERROR_COLUMNS)
    else:
        data |= {name: getattr(catalog.errors, key) for name, key in ERROR_COLUMNS.items()}
    if catalog.common_shift is None:
        left_out |= {*COMMON_COLUMNS, COMMON_SOURCE}
    else:
        data |= {name: getattr(catalog.common_shift, key) for name, key in COMMON_COLUMNS.items()}
        data[COMMON_SOURCE] = catalog.common_shift.source
    written = [column for column in _COLUMNS if column.name not in left_out]
    with replacing(path) as temporary:
        write_table(temporary, written, [data[column.name] for column in written])


def _tilts(table: Table) -> FloatArray | None:
    """Slopes (n, 2) of the rims' planes, rad; None where the table has none."""
    there = all_or_none(table.path, list(table.columns), TILTS)
    for name in there:
        problem = checks.tilt_fault(table.columns[name])
        if problem is not None:
            table.fail(problem[0], name, problem[1])
    return np.radians(np.stack([table.columns[name] for name in there], axis=-1)) if there else None


def _common_shift(table: Table) -> CommonShift | None:
    sigmas = _sigmas(table, COMMON_COLUMNS)
    if sigmas is None:
        return None
    return CommonShift(
        **sigmas, source=table.columns.get(COMMON_SOURCE, np.zeros(len(table), dtype=np.int64))
    )


def _sigmas(table: Table, names: Mapping[str, str]) -> dict[str, FloatArray] | None:
    """Read columns of standard deviations, by the name of each, None when the table has none of them."""
    if not all_or_none(table.path, list(table.columns), names):
        return None
    for name in names:
        # Empty cells are NaN, where the column may have any.
        wrong = np.flatnonzero(table.columns[name] < 0.0)
        if len(wrong):
            table.fail(int(wrong[0]), name, f"expected 0 or more, found {table.columns[name][wrong[0]]:g}")
    return {key: table.columns[name] for name, key in names.items()}
