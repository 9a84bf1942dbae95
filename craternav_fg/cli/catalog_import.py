"""Command that imports tables of craters into one catalogue."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from craternav_fg.body import Body
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.checks import overlaps
from craternav_fg.catalogs.columns import ImportOptions
from craternav_fg.catalogs.files import import_catalog, write_catalog
from craternav_fg.catalogs.importing import ImportReport
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import SUFFIX
from craternav_fg.cli.app import catalog_commands, example
from craternav_fg.cli.catalog_reading import (
    assumed_body,
    body_of_radius,
    skipped_lines,
    warn_of_exact_rims,
    warn_of_lost_heights,
    with_model_heights,
)
from craternav_fg.cli.catalog_summary import MAX_LISTED, show, summarise
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import (
    DemUnitOption,
    ForceOption,
    JsonOption,
    require_free,
    require_kept,
    require_suffix,
)
from craternav_fg.cli.terminal import out, say, warn
from craternav_fg.errors import InputError
from craternav_fg.pipeline.catalog_warnings import angles_in_radians, heights_in_km

# Radii of one body that agree to so much: those of two tables may be rounded differently.
_RADIUS_TOLERANCE = 1e-6


class Unit(StrEnum):
    """Units of diameters."""

    KM = "km"
    M = "m"


@dataclass(frozen=True)
class _Table:
    """A table that was read: its craters, and what was skipped or assumed."""

    path: Path
    craters: Catalog
    report: ImportReport


@dataclass(frozen=True)
class Columns:
    """Columns of the tables, where their names do not tell them."""

    latitude: Annotated[
        str | None, typer.Option(help="Column of the latitude, deg.", show_default="found by its name")
    ] = None
    longitude: Annotated[
        str | None,
        typer.Option(help="Column of the longitude, deg, positive east.", show_default="found by its name"),
    ] = None
    west_longitudes: Annotated[
        bool, typer.Option("--west-longitudes", help="Longitudes are positive west.")
    ] = False
    diameter: Annotated[
        str | None, typer.Option(help="Column of the diameter.", show_default="found by its name")
    ] = None
    identifier: Annotated[
        str | None, typer.Option(help="Column of unique identifiers.", show_default="found by its name")
    ] = None
    height: Annotated[
        str | None,
        typer.Option(
            help="Column of the rims' heights above the body's sphere, in km if its name says so, else m.",
            show_default="RIM_HEIGHT_M, if there is one",
        ),
    ] = None
    unit: Annotated[
        Unit | None,
        typer.Option(help="Unit of the diameters.", show_default="that of the column's name, else km"),
    ] = None

    def options(self) -> ImportOptions:
        """As the reader expects them."""
        unit = self.unit and self.unit.value
        return ImportOptions(
            self.latitude, self.longitude, self.diameter, self.identifier, unit, self.west_longitudes,
            self.height,
        )  # fmt: skip


@dataclass(frozen=True)
class GivenBody:
    """Body of the craters."""

    body: Annotated[
        str | None,
        typer.Option(help="Name of the body.", show_default="that of the tables, else the Moon"),
    ] = None
    body_radius_m: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            help="Radius of the catalogue's sphere.",
            show_default="the IAU's, for bodies known by name",
        ),
    ] = None


@catalog_commands.command(
    "import", epilog=example("catalog import robbins.csv -o craters.parquet --dem gld100.tif --dem-unit-m 1")
)
@with_option_groups
def import_(
    tables: Annotated[list[Path], typer.Argument(help="Tables of craters, joined into one catalogue.")],
    columns: Columns,
    given: GivenBody,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Catalogue to write: .parquet, or .csv with Robbins' columns."),
    ] = Path("runs/catalog.parquet"),
    dem: Annotated[
        Path | None,
        typer.Option(help="Elevation model (GeoTIFF) for the heights of the rims."),
    ] = None,
    dem_unit_m: DemUnitOption = 1.0,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Import tables of craters: Robbins' columns, or circles with latitude, longitude and diameter."""
    require_suffix(output, (SUFFIX, ".csv"))
    require_kept(tables, [output])
    require_free(output, force=force)
    radius_m = given.body_radius_m
    body = body_of_radius(radius_m) if given.body is None else named_body(given.body, radius_m)
    parts = [_read(path, body, columns.options(), alone=len(tables) == 1) for path in tables]
    catalog = _joined(parts)
    if dem is not None:
        catalog = with_model_heights(catalog, dem, dem_unit_m)
    warn_of_lost_heights(tables, [part.craters for part in parts], catalog)
    warn_of_exact_rims(tables, [part.craters for part in parts])
    write_catalog(output, catalog)
    values = {
        "catalog": str(output),
        "files": [_file(part) for part in parts],
        **summarise(catalog, overlaps(catalog), parts[0].report.body_by),
    }
    for part in parts:
        if not part.report.body_by:
            warn(assumed_body(part.path, "--body"))
        for text in (*angles_in_radians(part.craters), *heights_in_km(part.craters)):
            warn(f"{part.path}: {text}")
    if as_json:
        out.print_json(json.dumps(values))
        return
    for part in parts:
        _show_part(part)
    show(values)
    say(f"{output}")


def _read(path: Path, body: Body | None, names: ImportOptions, *, alone: bool) -> _Table:
    """Read a table; craters without identifiers are numbered, in several tables with the file's name."""
    craters, report = import_catalog(path, body, names)
    if report.numbered and not alone:
        craters = replace(craters, identifiers=tuple(f"{path.stem}-{name}" for name in craters.identifiers))
    return _Table(path, craters, report)


def _joined(parts: Sequence[_Table]) -> Catalog:
    """Join the craters of all tables.

    Raises
    ------
    InputError
        When the tables are of different bodies, or an identifier stands in two of them.
    """
    known: set[str] = set()
    first = parts[0].craters.body
    for part in parts:
        body = part.craters.body
        if abs(body.radius_m - first.radius_m) > _RADIUS_TOLERANCE * first.radius_m:
            expected = f"{first.name or 'a body'} of {first.radius_m:.9g} m, as in {parts[0].path}"
            found = f"{body.name or 'a body'} of {body.radius_m:.9g} m"
            raise InputError(part.path, f"expected {expected}, found {found}")
        again = known.intersection(part.craters.identifiers)
        if again:
            raise InputError(
                part.path, f"expected each identifier once, found {min(again)!r} in another table as well"
            )
        known.update(part.craters.identifiers)
    return Catalog.joined([part.craters for part in parts])


def _file(part: _Table) -> dict[str, Any]:
    """Describe what was read of a table, as JSON can carry it."""
    report = part.report
    return {
        "path": str(part.path),
        "rows": report.rows,
        "imported": len(part.craters),
        "read": report.columns,
        "circles": report.circles,
        "numbered": report.numbered,
        "skipped": len(report.skipped),
        "first_skipped": [
            {"line": row.line, "identifier": row.identifier, "reason": row.reason}
            for row in report.skipped[:MAX_LISTED]
        ],
    }


def _show_part(part: _Table) -> None:
    report = part.report
    say(f"{part.path}: {len(part.craters):,} of {report.rows:,} rows")
    if report.columns:
        say(f"  read: {report.columns}")
    if report.circles:
        say(f"  {report.circles:,} without an ellipse, kept as circles")
    if report.numbered:
        say("  no identifiers: craters are named by their line numbers")
    for line in skipped_lines(report):
        say(f"  {line}")
