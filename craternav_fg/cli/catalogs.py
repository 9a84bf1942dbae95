"""Commands on crater catalogues: summarise, list, draw."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

import typer

from craternav_fg.catalogs.checks import overlaps, write_pairs
from craternav_fg.catalogs.merge import MergeOptions
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli.app import catalog_commands, example
from craternav_fg.cli.catalog_merge import against, show_against
from craternav_fg.cli.catalog_reading import read_any_catalog
from craternav_fg.cli.catalog_summary import show, summarise
from craternav_fg.cli.options import (
    FIGURE_SUFFIXES,
    CatalogBodyOption,
    ForceOption,
    JsonOption,
    require_free,
    require_suffix,
)
from craternav_fg.cli.terminal import out, say, table_of_numbers
from craternav_fg.errors import InputError
from craternav_fg.files import replacing

CatalogArgument = Annotated[
    Path, typer.Argument(help="Crater catalogue (.parquet), or a table that `catalog import` reads.")
]

_FIGURE_DPI = 130


@catalog_commands.command(epilog=example("catalog info craters.parquet --pairs pairs.csv"))
def info(
    catalog: CatalogArgument,
    pairs: Annotated[
        Path | None,
        typer.Option(help="CSV to write: pairs of crossing rims and of probable duplicates."),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option("--against", help="Catalogue to compare with: shift and scale of the shared craters."),
    ] = None,
    body_radius_m: CatalogBodyOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Summarise a catalogue: body, sizes, region, crossing rims, probable duplicates."""
    _check_pairs(pairs, catalog, force)
    craters, report = read_any_catalog(catalog, body_radius_m)
    found = overlaps(craters)
    values = {"catalog": str(catalog), **summarise(craters, found, report.body_by)}
    if pairs is not None:
        with replacing(pairs) as temporary:
            write_pairs(temporary, craters, found)
    if reference is not None:
        values["against"] = against(read_any_catalog(reference, body_radius_m)[0], craters, MergeOptions())
    if as_json:
        out.print_json(json.dumps(values))
        return
    show(values)
    if reference is not None:
        show_against(values["against"], str(reference))


# A negative latitude is no option.
@catalog_commands.command(
    context_settings={"ignore_unknown_options": True},
    epilog=example("catalog near craters.parquet -30.5 170 --distance-km 20"),
)
def near(
    catalog: CatalogArgument,
    latitude_deg: Annotated[float, typer.Argument(min=-90.0, max=90.0, help="Latitude, positive north.")],
    longitude_deg: Annotated[float, typer.Argument(min=-180.0, max=360.0, help="Longitude, positive east.")],
    distance_km: Annotated[
        float, typer.Option(min=0.0, help="Largest distance of a crater's centre.")
    ] = 50.0,
    min_diameter_km: Annotated[float, typer.Option(min=0.0, help="Smallest diameter.")] = 0.0,
    count: Annotated[int, typer.Option(min=1, help="Largest number of craters.")] = 30,
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
    headings = ("dist. km", "lat deg", "lon deg", "2a km", "2b km", "angle deg", "height m")
    table = table_of_numbers("crater", headings)
    for crater in found:
        table.add_row(
            crater["identifier"], f"{crater['distance_km']:.2f}", f"{crater['latitude_deg']:.4f}",
            f"{crater['longitude_deg']:.4f}", f"{crater['major_km']:.3f}", f"{crater['minor_km']:.3f}",
            f"{crater['angle_deg']:.0f}", f"{crater['height_m']:.0f}",
        )  # fmt: skip
    out.print(table)
    say(f"{len(rows)} craters within {distance_km:g} km" + (f", {count} shown" if len(rows) > count else ""))


@catalog_commands.command(
    epilog=example("catalog plot craters.parquet --latitude-deg -30 --longitude-deg 170 -o region.png")
)
def plot(
    catalog: CatalogArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Figure: .png, .pdf or .svg.")] = Path(
        "runs/catalog.png"
    ),
    latitude_deg: Annotated[
        float | None, typer.Option(min=-90.0, max=90.0, help="Latitude of the centre of a region.")
    ] = None,
    longitude_deg: Annotated[
        float | None, typer.Option(min=-180.0, max=360.0, help="Longitude of that centre.")
    ] = None,
    distance_km: Annotated[
        float, typer.Option(min=0.001, help="Distance from that centre to the border of the region.")
    ] = 200.0,
    body_radius_m: CatalogBodyOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draw a catalogue: the whole body, or the rims of a region."""
    require_suffix(output, FIGURE_SUFFIXES)
    require_free(output, force=force)
    place = _place(latitude_deg, longitude_deg)
    craters, _ = read_any_catalog(catalog, body_radius_m)

    # matplotlib takes half a second to import: what draws nothing does not wait for it.
    from craternav_fg.plots.catalogs import draw_globe, draw_region

    figure = draw_globe(craters) if place is None else draw_region(craters, *place, 1e3 * distance_km)
    with replacing(output) as temporary:
        figure.savefig(temporary, dpi=_FIGURE_DPI)
    if as_json:
        out.print_json(json.dumps({"figure": str(output)}))
    else:
        say(f"{output}")


def _check_pairs(pairs: Path | None, catalog: Path, force: bool) -> None:
    if pairs is None:
        return
    if pairs.suffix != ".csv" or pairs.resolve() == catalog.resolve():
        raise InputError(pairs, "expected another name that ends in .csv")
    require_free(pairs, force=force)


def _place(latitude_deg: float | None, longitude_deg: float | None) -> tuple[float, float] | None:
    """Latitude and longitude in rad, None without them."""
    if latitude_deg is None and longitude_deg is None:
        return None
    if latitude_deg is None or longitude_deg is None:
        raise InputError("--latitude-deg, --longitude-deg", "expected both, found one")
    return math.radians(latitude_deg), math.radians(longitude_deg)


def _crater(catalog: Catalog, row: int, distance_m: float) -> dict[str, Any]:
    """Return a crater as JSON can carry it."""
    east, north = (0.0, 0.0) if catalog.plane_tilt_rad is None else catalog.plane_tilt_rad[row]
    return {
        "identifier": catalog.identifiers[row],
        "distance_km": 1e-3 * float(distance_m),
        "latitude_deg": math.degrees(catalog.latitude_rad[row]),
        "longitude_deg": math.degrees(catalog.longitude_rad[row]),
        "major_km": 2e-3 * float(catalog.semi_major_m[row]),
        "minor_km": 2e-3 * float(catalog.semi_minor_m[row]),
        "angle_deg": math.degrees(catalog.angle_rad[row]),
        "height_m": float(catalog.height_m[row]),
        "plane_tilt_east_deg": math.degrees(east),
        "plane_tilt_north_deg": math.degrees(north),
    }
