"""Commands on crater catalogues."""

import json
import math
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table

from craternav_fg.body import Body
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.checks import overlaps, write_pairs
from craternav_fg.catalogs.columns import ImportOptions
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog, write_catalog
from craternav_fg.catalogs.heights import implausible_heights, with_rim_heights
from craternav_fg.catalogs.importing import ImportReport
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import SUFFIX
from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.catalog_about import LISTED, about, show
from craternav_fg.cli.catalog_reading import (
    CatalogBodyOption,
    assumed_body,
    read_any_catalog,
    skipped_lines,
    warn,
)
from craternav_fg.cli.terminal import out, say
from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.plots.catalogs import draw_globe, draw_region

commands = typer.Typer(help="Crater catalogues: import, look into, draw.", no_args_is_help=True)
app.add_typer(commands, name="catalog")

CatalogArgument = Annotated[
    Path, typer.Argument(help="Catalogue: one that was imported (.parquet), or any table that can be.")
]


class Unit(StrEnum):
    """Units of diameters."""

    KM = "km"
    M = "m"


@commands.command("import")
def import_(
    tables: Annotated[
        list[Path], typer.Argument(help="Tables of craters, one after the other in one catalogue.")
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Catalogue to write: .parquet, or .csv with Robbins' columns."),
    ],
    latitude: Annotated[
        str | None, typer.Option(help="Column of the latitude, deg.", show_default="seen")
    ] = None,
    longitude: Annotated[
        str | None, typer.Option(help="Column of the longitude, deg, to the east.", show_default="seen")
    ] = None,
    diameter: Annotated[str | None, typer.Option(help="Column of the diameter.", show_default="seen")] = None,
    identifier: Annotated[
        str | None, typer.Option(help="Column of unique names.", show_default="seen")
    ] = None,
    unit: Annotated[
        Unit | None, typer.Option(help="Of the diameters.", show_default="as the column's name says, else km")
    ] = None,
    body: Annotated[
        str | None,
        typer.Option(help="The body's name.", show_default="as the tables tell, else the Moon"),
    ] = None,
    body_radius_m: Annotated[
        float | None,
        typer.Option(
            min=1.0, help="Of the catalogue's sphere.", show_default="the IAU's, for bodies known by name"
        ),
    ] = None,
    dem: Annotated[
        Path | None, typer.Option(help="Elevation model (GeoTIFF, lon/lat): gives the rims' heights.")
    ] = None,
    dem_unit_m: Annotated[float, typer.Option(help="Metres that a unit of its values means.")] = 1.0,
    as_json: JsonOption = False,
) -> None:
    """Import tables of craters: Robbins' columns, or circles with latitude, longitude and diameter."""
    if output.suffix not in (SUFFIX, ".csv"):
        raise InputError(output, "expected a name that ends in .parquet or .csv")
    for path in tables:
        if path.resolve() == output.resolve():
            raise InputError(path, "would be overwritten by the result: choose another --output")
    if not (math.isfinite(dem_unit_m) and dem_unit_m > 0.0):
        raise InputError("--dem-unit-m", f"expected metres, more than 0, found {dem_unit_m}")
    given = None
    if body is not None:
        given = named_body(body, body_radius_m)
    elif body_radius_m is not None:
        given = Body("", body_radius_m, 1.0, (0.0, 0.0, 0.0))
    names = ImportOptions(latitude, longitude, diameter, identifier, unit and unit.value)
    parts: list[Catalog] = []
    reports: list[ImportReport] = []
    for path in tables:
        part, report = import_catalog(path, given, names)
        if len(tables) > 1 and report.numbered:
            part = replace(part, identifiers=tuple(f"{path.stem}-{name}" for name in part.identifiers))
        parts.append(part)
        reports.append(report)
    catalog = _joined(parts, tables)
    if dem is not None:
        catalog = with_rim_heights(catalog, read_dem(dem, dem_unit_m, catalog.body.radius_m))
        problem = implausible_heights(catalog)
        if problem is not None:
            raise InputError(dem, problem)
    write_catalog(output, catalog)
    values = {
        "catalog": str(output),
        "files": [_file(*one) for one in zip(tables, parts, reports, strict=True)],
        **about(catalog, overlaps(catalog), reports[0].body_by),
    }
    for path, report in zip(tables, reports, strict=True):
        if not report.body_by:
            warn(assumed_body(path, "--body"))
    if as_json:
        out.print_json(json.dumps(values))
        return
    for path, part, report in zip(tables, parts, reports, strict=True):
        say(f"{path}: {len(part):,} of {report.rows:,} rows")
        if report.columns:
            say(f"  read: {report.columns}")
        if report.circles:
            say(f"  {report.circles:,} without an ellipse, kept as circles")
        if report.numbered:
            say("  no identifiers: craters are called by their line's number")
        for line in skipped_lines(report):
            say(f"  {line}")
    show(values)
    say(f"{output}")


@commands.command()
def info(
    catalog: CatalogArgument,
    pairs: Annotated[
        Path | None, typer.Option(help="CSV to write: the pairs of craters that cross, or are probably one.")
    ] = None,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what a catalogue holds: where, how large, what meets what."""
    if pairs is not None and (pairs.suffix != ".csv" or pairs.resolve() == catalog.resolve()):
        raise InputError(pairs, "expected another name that ends in .csv")
    craters, report = read_any_catalog(catalog, body_radius_m)
    meets = overlaps(craters)
    values = {"catalog": str(catalog), **about(craters, meets, report.body_by)}
    if pairs is not None:
        with replacing(pairs) as temporary:
            write_pairs(temporary, craters, meets)
    if as_json:
        out.print_json(json.dumps(values))
    else:
        show(values)


# A negative latitude must not pass for an option.
@commands.command(context_settings={"ignore_unknown_options": True})
def near(
    catalog: CatalogArgument,
    latitude_deg: Annotated[float, typer.Argument(min=-90.0, max=90.0, help="To the north.")],
    longitude_deg: Annotated[float, typer.Argument(min=-180.0, max=360.0, help="To the east.")],
    distance_km: Annotated[
        float, typer.Option(min=0.0, help="Largest distance of a crater's centre.")
    ] = 50.0,
    min_diameter_km: Annotated[float, typer.Option(min=0.0, help="Smallest diameter.")] = 0.0,
    count: Annotated[int, typer.Option(min=1, help="So many at most, the nearest.")] = 30,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the craters around a place, the nearest first."""
    craters, _ = read_any_catalog(catalog, body_radius_m)
    rows, distances_m = craters.near(
        math.radians(latitude_deg),
        math.radians(longitude_deg),
        1e3 * distance_km,
        min_diameter_m=1e3 * min_diameter_km,
    )
    found = [
        _crater(craters, row, distance) for row, distance in zip(rows[:count], distances_m, strict=False)
    ]
    if as_json:
        out.print_json(json.dumps({"catalog": str(catalog), "found": len(rows), "craters": found}))
        return
    if not found:
        say(f"no crater within {distance_km:g} km")
        return
    # An identifier is to be copied whole: where the line is too short for one, it goes on in the next.
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, collapse_padding=True)
    table.add_column("crater", overflow="fold")
    for heading in ("away km", "lat deg", "lon deg", "2a km", "2b km", "turn deg", "height m"):
        table.add_column(heading, justify="right", no_wrap=True)
    for crater in found:
        table.add_row(
            crater["identifier"], f"{crater['distance_km']:.2f}", f"{crater['latitude_deg']:.4f}",
            f"{crater['longitude_deg']:.4f}", f"{crater['major_km']:.3f}", f"{crater['minor_km']:.3f}",
            f"{crater['angle_deg']:.0f}", f"{crater['height_m']:.0f}",
        )  # fmt: skip
    out.print(table)
    say(f"{len(rows)} craters within {distance_km:g} km" + (f", {count} shown" if len(rows) > count else ""))


@commands.command()
def plot(
    catalog: CatalogArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Figure: .png, .pdf or .svg.")] = Path(
        "runs/catalog.png"
    ),
    latitude_deg: Annotated[
        float | None, typer.Option(min=-90.0, max=90.0, help="Of a place to draw the surroundings of.")
    ] = None,
    longitude_deg: Annotated[float | None, typer.Option(min=-180.0, max=360.0, help="Of that place.")] = None,
    distance_km: Annotated[float, typer.Option(min=0.001, help="From the place to the border.")] = 200.0,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Draw a catalogue: the whole body, or the rims around a place."""
    if output.suffix not in (".png", ".pdf", ".svg"):
        raise InputError(output, "expected a name that ends in .png or .pdf or .svg")
    if (latitude_deg is None) != (longitude_deg is None):
        raise InputError("--latitude-deg, --longitude-deg", "expected both, found one")
    craters, _ = read_any_catalog(catalog, body_radius_m)
    if latitude_deg is None or longitude_deg is None:
        figure = draw_globe(craters)
    else:
        place = math.radians(latitude_deg), math.radians(longitude_deg)
        figure = draw_region(craters, *place, 1e3 * distance_km)
    with replacing(output) as temporary:
        figure.savefig(temporary, dpi=130)
    if as_json:
        out.print_json(json.dumps({"figure": str(output)}))
    else:
        say(f"{output}")


def _file(path: Path, part: Catalog, report: ImportReport) -> dict[str, Any]:
    return {
        "path": str(path),
        "rows": report.rows,
        "imported": len(part),
        "read": report.columns,
        "circles": report.circles,
        "numbered": report.numbered,
        "skipped": len(report.skipped),
        "first_skipped": [
            {"line": row.line, "identifier": row.identifier, "reason": row.reason}
            for row in report.skipped[:LISTED]
        ],
    }


def _joined(parts: list[Catalog], paths: list[Path]) -> Catalog:
    known: set[str] = set()
    first = parts[0].body
    for part, path in zip(parts, paths, strict=True):
        if abs(part.body.radius_m - first.radius_m) > 1e-6 * first.radius_m:
            found = f"found {part.body.name or 'a body'} of {part.body.radius_m:.9g} m"
            raise InputError(
                path,
                f"expected {first.name or 'a body'} of {first.radius_m:.9g} m, as in {paths[0]}, {found}",
            )
        again = known.intersection(part.identifiers)
        if again:
            raise InputError(
                path, f"expected each identifier once, found {min(again)!r} in another table, too"
            )
        known.update(part.identifiers)
    return Catalog.joined(parts)


def _crater(catalog: Catalog, row: int, distance_m: float) -> dict[str, Any]:
    return {
        "identifier": catalog.identifiers[row],
        "distance_km": 1e-3 * float(distance_m),
        "latitude_deg": math.degrees(catalog.latitude_rad[row]),
        "longitude_deg": math.degrees(catalog.longitude_rad[row]),
        "major_km": 2e-3 * float(catalog.semi_major_m[row]),
        "minor_km": 2e-3 * float(catalog.semi_minor_m[row]),
        "angle_deg": math.degrees(catalog.angle_rad[row]),
        "height_m": float(catalog.height_m[row]),
    }
