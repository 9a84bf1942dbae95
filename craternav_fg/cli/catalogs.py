"""Commands on crater catalogues."""

import json
import math
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich import box
from rich.table import Table

from craternav_fg.body import Body
from craternav_fg.catalog import Catalog
from craternav_fg.catalog_files import import_catalog, write_catalog
from craternav_fg.catalogs.checks import overlaps
from craternav_fg.catalogs.columns import ImportOptions
from craternav_fg.catalogs.heights import with_rim_heights
from craternav_fg.catalogs.store import SUFFIX, read_body
from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.terminal import err, number, out, say
from craternav_fg.dem import read_dem
from craternav_fg.errors import InputError
from craternav_fg.evaluation.catalog_figures import draw_globe, draw_region
from craternav_fg.files import replacing

MOON_RADIUS_M = 1737400.0
# Of what is left out or doubled, so many are listed.
_LISTED = 20
_SHARES = (0.0, 0.05, 0.5, 0.95, 1.0)

commands = typer.Typer(help="Crater catalogues: import, look into, draw.", no_args_is_help=True)
app.add_typer(commands, name="catalog")

CatalogArgument = Annotated[
    Path, typer.Argument(help="Catalogue: one that was imported (.parquet), or any table that can be.")
]
RadiusOption = Annotated[
    float | None,
    typer.Option(
        "--body-radius-m", min=1.0, help="Of the catalogue's sphere.  [default: the file's, else the Moon's]"
    ),
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
        str | None, typer.Option(help="Column of the latitude, deg.  [default: seen]")
    ] = None,
    longitude: Annotated[
        str | None, typer.Option(help="Column of the longitude, deg, to the east.  [default: seen]")
    ] = None,
    diameter: Annotated[str | None, typer.Option(help="Column of the diameter.  [default: seen]")] = None,
    identifier: Annotated[str | None, typer.Option(help="Column of unique names.  [default: seen]")] = None,
    unit: Annotated[
        Unit | None, typer.Option(help="Of the diameters.  [default: as the column's name says, else km]")
    ] = None,
    body_name: Annotated[str, typer.Option(help="Of the body, as it is shown.")] = "Moon",
    body_radius_m: RadiusOption = None,
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
    body = Body(body_name, body_radius_m or MOON_RADIUS_M, 1.0, (0.0, 0.0, 0.0))
    names = ImportOptions(latitude, longitude, diameter, identifier, unit and unit.value)
    parts: list[Catalog] = []
    files: list[dict[str, Any]] = []
    for path in tables:
        part, report = import_catalog(path, body, names)
        if len(tables) > 1 and report.numbered:
            part = replace(part, identifiers=tuple(f"{path.stem}-{name}" for name in part.identifiers))
        parts.append(part)
        files.append(
            {
                "path": str(path),
                "rows": report.rows,
                "imported": len(part),
                "circles": report.circles,
                "numbered": report.numbered,
                "skipped": len(report.skipped),
                "first_skipped": [
                    {"line": row.line, "identifier": row.identifier, "reason": row.reason}
                    for row in report.skipped[:_LISTED]
                ],
            }
        )
    catalog = _joined(parts, tables)
    if dem is not None:
        catalog = with_rim_heights(catalog, read_dem(dem, dem_unit_m))
    with replacing(output) as temporary:
        write_catalog(temporary, catalog)
    values = {"catalog": str(output), "files": files, **_about(catalog)}
    if as_json:
        out.print_json(json.dumps(values))
        return
    for file in files:
        say(f"{file['path']}: {file['imported']} of {file['rows']} rows")
        if file["circles"]:
            say(f"  {file['circles']} without an ellipse, kept as circles")
        if file["numbered"]:
            say("  no identifiers: craters are called by their line's number")
        for row in file["first_skipped"]:
            say(f"  left out: line {row['line']}: {row['reason']}")
        if file["skipped"] > _LISTED:
            say(f"  and {file['skipped'] - _LISTED} more")
    _show(values)
    say(f"{output}")


@commands.command()
def info(catalog: CatalogArgument, body_radius_m: RadiusOption = None, as_json: JsonOption = False) -> None:
    """Show what a catalogue holds: where, how large, what meets what."""
    values = {"catalog": str(catalog), **_about(_read(catalog, body_radius_m))}
    if as_json:
        out.print_json(json.dumps(values))
    else:
        _show(values)


@commands.command()
def near(
    catalog: CatalogArgument,
    latitude_deg: Annotated[float, typer.Argument(min=-90.0, max=90.0, help="Put -- before a negative one.")],
    longitude_deg: Annotated[float, typer.Argument(min=-180.0, max=360.0, help="To the east.")],
    distance_km: Annotated[
        float, typer.Option(min=0.0, help="Largest distance of a crater's centre.")
    ] = 50.0,
    min_diameter_km: Annotated[float, typer.Option(min=0.0, help="Smallest diameter.")] = 0.0,
    count: Annotated[int, typer.Option(min=1, help="So many at most, the nearest.")] = 30,
    body_radius_m: RadiusOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the craters around a place, the nearest first."""
    craters = _read(catalog, body_radius_m)
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
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False)
    table.add_column("crater", no_wrap=True)
    for heading in ("away km", "lat deg", "lon deg", "2a km", "2b km", "turn deg"):
        table.add_column(heading, justify="right", no_wrap=True)
    for crater in found:
        table.add_row(
            crater["identifier"], f"{crater['distance_km']:.2f}", f"{crater['latitude_deg']:.4f}",
            f"{crater['longitude_deg']:.4f}", f"{crater['major_km']:.3f}", f"{crater['minor_km']:.3f}",
            f"{crater['angle_deg']:.0f}",
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
    body_radius_m: RadiusOption = None,
    as_json: JsonOption = False,
) -> None:
    """Draw a catalogue: the whole body, or the rims around a place."""
    if output.suffix not in (".png", ".pdf", ".svg"):
        raise InputError(output, "expected a name that ends in .png or .pdf or .svg")
    if (latitude_deg is None) != (longitude_deg is None):
        raise InputError("--latitude-deg, --longitude-deg", "expected both, found one")
    craters = _read(catalog, body_radius_m)
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


def _read(path: Path, radius_m: float | None) -> Catalog:
    if path.suffix == SUFFIX:
        body = read_body(path)
        return import_catalog(path, body if radius_m is None else Body("", radius_m, 1.0, (0.0, 0.0, 0.0)))[0]
    catalog, report = import_catalog(path, Body("", radius_m or MOON_RADIUS_M, 1.0, (0.0, 0.0, 0.0)))
    if report.skipped:
        first = report.skipped[0]
        err.print(
            f"craternav: warning: {len(report.skipped)} rows left out, the first: line {first.line}: "
            f"{first.reason}",
            style="yellow", highlight=False, markup=False, soft_wrap=True,
        )  # fmt: skip
    return catalog


def _joined(parts: list[Catalog], paths: list[Path]) -> Catalog:
    known: set[str] = set()
    for part, path in zip(parts, paths, strict=True):
        again = known.intersection(part.identifiers)
        if again:
            raise InputError(
                path, f"expected each identifier once, found {min(again)!r} in another table, too"
            )
        known.update(part.identifiers)
    return Catalog.joined(parts)


def _about(catalog: Catalog) -> dict[str, Any]:
    meets = overlaps(catalog)
    diameter_km = 2e-3 * catalog.semi_major_m
    return {
        "craters": len(catalog),
        "body": catalog.body.name,
        "body_radius_m": catalog.body.radius_m,
        "diameter_km_quantiles": dict(
            zip((str(share) for share in _SHARES), np.quantile(diameter_km, _SHARES).tolist(), strict=True)
        ),
        "latitude_deg": np.degrees([catalog.latitude_rad.min(), catalog.latitude_rad.max()]).tolist(),
        "circles": int(np.count_nonzero(catalog.semi_major_m == catalog.semi_minor_m)),
        "height_m": [float(catalog.height_m.min()), float(catalog.height_m.max())],
        "crossed_rims": int(np.count_nonzero(meets.crossed)),
        "twins": len(meets.twins),
        "first_twins": [
            [catalog.identifiers[row] for row in pair] for pair in meets.twins[:_LISTED].tolist()
        ],
    }


def _show(values: dict[str, Any]) -> None:
    quantiles = ", ".join(f"{number(value)}" for value in values["diameter_km_quantiles"].values())
    body = values["body"] or "a body"
    say(f"{values['craters']} craters on {body} of {values['body_radius_m']:.1f} m radius")
    say(f"  diameters (least, 5 %, median, 95 %, largest): {quantiles} km; {values['circles']} circles")
    (south, north), (low, high) = values["latitude_deg"], values["height_m"]
    say(f"  latitudes {south:.2f} to {north:.2f} deg; rims {low:.0f} to {high:.0f} m high")
    say(f"  {values['crossed_rims']} whose rim crosses another's")
    if values["twins"]:
        pairs = "; ".join(f"{one} and {other}" for one, other in values["first_twins"])
        more = f" and {values['twins'] - _LISTED} more" if values["twins"] > _LISTED else ""
        say(f"  {values['twins']} pairs that are probably one crater: {pairs}{more}")


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
