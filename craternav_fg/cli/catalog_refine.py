"""Command that measures a catalogue's rims on an elevation model."""

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.store import SUFFIX, write_parquet
from craternav_fg.cli.app import catalog_commands, example
from craternav_fg.cli.catalog_reading import read_any_catalog
from craternav_fg.cli.options import (
    CatalogBodyOption,
    DemUnitOption,
    ForceOption,
    JsonOption,
    require_free,
    require_kept,
    require_suffix,
)
from craternav_fg.cli.terminal import out, progress_bars, say
from craternav_fg.errors import InputError
from craternav_fg.mapping.refine import Outcome, RefinedRims, RefineOptions, refine_on_dem


@catalog_commands.command(
    epilog=example("catalog refine craters.parquet --dem gld100.tif -o refined.parquet")
)
def refine(
    catalog: Annotated[
        Path, typer.Argument(help="Crater catalogue (.parquet), or a table that `catalog import` reads.")
    ],
    dem: Annotated[Path, typer.Option(help="Elevation model (GeoTIFF, longitude and latitude).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Catalogue to write (.parquet).")] = Path(
        "runs/refined.parquet"
    ),
    dem_unit_m: DemUnitOption = 1.0,
    min_diameter_steps: Annotated[
        float, typer.Option(min=4.0, help="Smallest diameter to measure, in grid steps of the model.")
    ] = RefineOptions.min_diameter_steps,
    resolution_steps: Annotated[
        float, typer.Option(min=0.1, help="Shortest length that the model resolves, in grid steps.")
    ] = RefineOptions.resolution_steps,
    body_radius_m: CatalogBodyOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure rims on an elevation model: ellipses, heights and covariances in place of circles."""
    require_suffix(output, (SUFFIX,))
    require_kept([catalog, dem], [output])
    require_free(output, force=force)
    craters, _ = read_any_catalog(catalog, body_radius_m)
    model = read_dem(dem, dem_unit_m, craters.body.radius_m)
    options = RefineOptions(min_diameter_steps=min_diameter_steps, resolution_steps=resolution_steps)
    with progress_bars() as report:
        rims = refine_on_dem(
            craters, model, options, progress=lambda done, total: report("refined craters", done, total)
        )
    _require_refined(rims, catalog, dem)
    write_parquet(output, rims.catalog, rims.columns())
    values = {"catalog": str(output), "craters": len(craters), "outcomes": _counts(rims), **_figures(rims)}
    if as_json:
        out.print_json(json.dumps(values))
        return
    say(f"{len(craters)} craters: {_told(_counts(rims))}")
    say(
        f"refined rims: centres moved by {values['median_shift_m']:.0f} m in the median "
        f"({values['median_shift_east_m']:+.0f} m east, {values['median_shift_north_m']:+.0f} m north in "
        f"common), radii by a factor of {values['median_size_ratio']:.3f}"
    )
    say(f"{output}")


def _require_refined(rims: RefinedRims, catalog: Path, dem: Path) -> None:
    if not rims.refined.any():
        raise InputError(dem, f"shows no rim of {catalog}: {_told(_counts(rims))}")


def _counts(rims: RefinedRims) -> dict[str, int]:
    counts = Counter(rims.outcomes)
    return {outcome.value: counts[outcome] for outcome in Outcome if counts[outcome]}


def _told(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {outcome}" for outcome, count in counts.items())


def _figures(rims: RefinedRims) -> dict[str, Any]:
    """Give the refined rims' medians."""
    shift = rims.shift_m[rims.refined]
    east, north = np.median(shift, axis=0)
    spread = 1.4826 * np.median(np.abs(shift - (east, north)), axis=0)
    return {
        "median_shift_m": float(np.median(np.hypot(*shift.T))),
        "median_shift_east_m": float(east),
        "median_shift_north_m": float(north),
        "spread_east_m": float(spread[0]),
        "spread_north_m": float(spread[1]),
        "median_size_ratio": float(np.exp(np.median(rims.log_size[rims.refined]))),
        "median_center_sigma_m": float(np.median(np.sqrt(rims.covariance[rims.refined, 0, 0]))),
        "median_height_sigma_m": float(np.median(rims.height_sigma_m[rims.refined])),
    }
