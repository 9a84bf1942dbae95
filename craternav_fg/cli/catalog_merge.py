"""Command that merges catalogues into one, with each crater once."""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from craternav_fg.catalogs.files import write_catalog
from craternav_fg.catalogs.merge import MergeOptions, difference, merge, write_sources
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import SUFFIX
from craternav_fg.cli.app import catalog_commands, example
from craternav_fg.cli.catalog_reading import read_any_catalog, warn_of_lost_heights, with_model_heights
from craternav_fg.cli.option_groups import never_replacing_any
from craternav_fg.cli.options import (
    CatalogBodyOption,
    DemUnitOption,
    JsonOption,
    require_kept,
    require_suffix,
)
from craternav_fg.cli.terminal import out, say
from craternav_fg.files import replacing


@catalog_commands.command(
    "merge", epilog=example("catalog merge robbins.csv head.csv -o craters.parquet --dem gld100.tif")
)
@never_replacing_any(lambda values: filter(None, [values["output"], values["sources"]]))
def merge_(
    catalogs: Annotated[list[Path], typer.Argument(help="Catalogues of one body, the preferred one first.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Catalogue to write: .parquet or .csv.")
    ] = Path("runs/merged.parquet"),
    place_share: Annotated[
        float,
        typer.Option(min=0.01, max=1.0, help="Largest distance between centres of duplicates, in radii."),
    ] = 0.5,
    size_factor: Annotated[
        float, typer.Option(min=1.01, max=3.0, help="Largest ratio between sizes of duplicates.")
    ] = 1.4,
    dem: Annotated[
        Path | None, typer.Option(help="Elevation model (GeoTIFF) for the heights of the rims.")
    ] = None,
    dem_unit_m: DemUnitOption = 1.0,
    sources: Annotated[
        Path | None,
        typer.Option(help="CSV to write: source of each crater, and other catalogues that list it."),
    ] = None,
    body_radius_m: CatalogBodyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Merge catalogues, keeping the best shape of each duplicate."""
    require_suffix(output, (SUFFIX, ".csv"))
    outputs = [output] if sources is None else [output, sources]
    require_kept(catalogs, outputs)
    parts = [read_any_catalog(path, body_radius_m)[0] for path in catalogs]
    names = [path.stem for path in catalogs]
    options = MergeOptions(place_share, size_factor)
    merged = merge(parts, names, options)
    craters = merged.catalog if dem is None else with_model_heights(merged.catalog, dem, dem_unit_m)
    warn_of_lost_heights(catalogs, parts, craters)
    write_catalog(output, craters)
    if sources is not None:
        with replacing(sources) as temporary:
            write_sources(temporary, merged, names)
    listed: list[dict[str, Any]] = [
        {
            "catalog": str(path),
            "read": len(part),
            "kept": int(np.count_nonzero(merged.source == k)),
            "also_in": sum(k in others for others in merged.also_in),
            "against_first": None if k == 0 else against(parts[0], part, options),
        }
        for k, (path, part) in enumerate(zip(catalogs, parts, strict=True))
    ]
    if as_json:
        out.print_json(json.dumps({"catalog": str(output), "craters": len(craters), "sources": listed}))
        return
    for one in listed:
        say(f"{one['catalog']}: {one['read']:,} craters, {one['kept']:,} kept")
        show_against(one["against_first"], str(catalogs[0]))
    say(f"{output}: {len(craters):,} craters")


def against(one: Catalog, other: Catalog, options: MergeOptions) -> dict[str, Any] | None:
    """Describe how a catalogue differs from another by numbers that JSON can carry; None without pairs.

    Parameters
    ----------
    one, other : Catalog
    options : MergeOptions

    Returns
    -------
    dict or None
    """
    found = difference(one, other, options)
    if found is None:
        return None
    return {
        "shared_craters": len(found.pairs),
        "east_north_m": found.shift_m.tolist(),
        "east_north_sigma_m": found.shift_sigma_m.tolist(),
        "east_north_sigma_radii": found.shift_share.tolist(),
        "scale": found.scale,
        "log_scale_sigma": found.scale_sigma,
    }


def show_against(values: dict[str, Any] | None, name: str) -> None:
    """Print what `against` gives.

    Parameters
    ----------
    values : dict or None
    name : str
        Name of the catalogue that is the reference.
    """
    if values is None:
        return
    (east, north), (e, n) = values["east_north_m"], values["east_north_sigma_m"]
    share = max(values["east_north_sigma_radii"])
    say(
        f"  against {name}: {values['shared_craters']:,} shared craters; shift {east:.0f} m east, "
        f"{north:.0f} m north (single ones {e:.0f}, {n:.0f} m; {100.0 * share:.1f} % of the radius); "
        f"sizes x {values['scale']:.3f} (single ones {100.0 * values['log_scale_sigma']:.1f} %)"
    )
