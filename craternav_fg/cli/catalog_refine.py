"""Command that improves a catalogue's rims by an elevation model or by images."""

import json
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.store import SUFFIX, write_parquet
from craternav_fg.cli.app import catalog_commands, example
from craternav_fg.cli.catalog_reading import read_any_catalog
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import (
    CatalogBodyOption,
    DemUnitOption,
    ForceOption,
    JsonOption,
    require_free,
    require_kept,
    require_suffix,
    require_unused,
)
from craternav_fg.cli.terminal import out, progress_bars, say
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, check_input
from craternav_fg.mapping.apply_errors import CorrectedRims, RunOutcome, apply_errors
from craternav_fg.mapping.measured_rim import Outcome, disagrees
from craternav_fg.mapping.posed_images import rims_in_posed_images
from craternav_fg.mapping.refine import RefinedRims, RefineOptions
from craternav_fg.mapping.refine_chunks import DemFile, KeptChunks, refine_in_chunks
from craternav_fg.runs.read import read_map_errors, read_run
from craternav_fg.workers import cluster

# Rounding of a catalogue in a file.
_SAME_PLACE_M = 1.0


@dataclass(frozen=True)
class MeasureOptions:
    """What the elevation model shows."""

    dem_unit_m: DemUnitOption = 1.0
    min_diameter_steps: Annotated[
        float, typer.Option(min=4.0, help="Smallest diameter to measure, in grid steps of the model.")
    ] = RefineOptions.min_diameter_steps
    resolution_steps: Annotated[
        float, typer.Option(min=0.1, help="Shortest length that the model resolves, in grid steps.")
    ] = RefineOptions.resolution_steps
    tilts: Annotated[
        bool, typer.Option("--tilts", help="Tilt the rims' planes as measured, in place of level ones.")
    ] = False


@catalog_commands.command(
    epilog=example("catalog refine craters.parquet --dem gld100.tif -o refined.parquet")
)
@with_option_groups
def refine(
    context: typer.Context,
    catalog: Annotated[
        Path, typer.Argument(help="Crater catalogue (.parquet), or a table that `catalog import` reads.")
    ],
    measured: MeasureOptions,
    dem: Annotated[
        Path | None,
        typer.Option(help="Elevation model (GeoTIFF); it may have gaps.", show_default=False),
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option(help="Run of map_refining_smoother, in place of --dem.", show_default=False),
    ] = None,
    posed_images: Annotated[
        list[Path] | None,
        typer.Option(
            help="Data set whose ground truth gives the poses of its images, in place of --dem; repeatable.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Catalogue to write (.parquet).")] = Path(
        "runs/refined.parquet"
    ),
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers do the work instead.")
    ] = None,
    body_radius_m: CatalogBodyOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Improve rims by an elevation model, a reconstructed descent, or images whose poses are known."""
    posed = posed_images or []
    _require_one(dem, run, posed)
    if dem is None:
        require_unused(
            context, {*(field.name for field in fields(MeasureOptions)), "scheduler"}, "without --dem"
        )
    require_suffix(output, (SUFFIX,))
    require_kept([catalog, *filter(None, [dem, run]), *posed], [output])
    require_free(output, force=force)
    craters, _ = read_any_catalog(catalog, body_radius_m)
    if run is not None:
        _by_run(catalog, craters, run, output, as_json)
        return
    if posed:
        with progress_bars() as shown:
            found = rims_in_posed_images(
                craters, [Dataset.open(one) for one in posed], progress=partial(shown, "measured images")
            )
        _write_corrected(catalog, posed[0], found, output, as_json)
        return
    assert dem is not None
    options = RefineOptions(
        min_diameter_steps=measured.min_diameter_steps, resolution_steps=measured.resolution_steps
    )
    check_input(dem, SizeLimit.RASTER)
    model = DemFile(str(dem.resolve()), measured.dem_unit_m, craters.body.radius_m)
    kept = KeptChunks.beside(output, craters, model, options)
    with ExitStack() as stack:
        report = stack.enter_context(progress_bars())
        workers = None if scheduler is None else stack.enter_context(cluster(scheduler))
        rims = refine_in_chunks(
            craters, model, options, kept, lambda done, total: report("refined craters", done, total), workers
        )
    _require_refined(rims, catalog, dem)
    write_parquet(output, rims.tilted() if measured.tilts else rims.catalog, rims.columns())
    kept.remove()
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


def _require_one(dem: Path | None, run: Path | None, posed: list[Path]) -> None:
    if (dem is not None) + (run is not None) + bool(posed) != 1:
        raise InputError("catalog refine", "expected one of --dem, --run and --posed-images")


def _by_run(path: Path, craters: Catalog, folder: Path, output: Path, as_json: bool) -> None:
    """Correct rims by the errors that a run's smoother has estimated."""
    run = read_run(folder)
    errors = read_map_errors(run)
    used = Dataset.open(run.dataset).catalog
    rows = {name: row for row, name in enumerate(craters.identifiers)}
    there = {name: row for row, name in enumerate(used.identifiers)}
    for name in errors:
        if name not in rows or name not in there:
            raise InputError(path, f"has no crater {name}, which the run {folder} has seen")
        off_m = float(np.linalg.norm(craters.centres[rows[name]] - used.centres[there[name]]))
        if off_m > _SAME_PLACE_M:
            problem = (
                f"crater {name} is {off_m:.0f} m from its place in the run's catalogue, expected the same"
            )
            raise InputError(path, problem)
    found = apply_errors(craters, {rows[name]: one for name, one in errors.items()})
    _write_corrected(path, folder, found, output, as_json)


def _write_corrected(path: Path, images: Path, found: CorrectedRims, output: Path, as_json: bool) -> None:
    """Write a catalogue corrected by images, and tell by how much."""
    counts = found.counts()
    told = ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    if not counts.get(RunOutcome.REFINED.value):
        raise InputError(images, f"corrects no rim of {path}: {told}")
    write_parquet(output, found.catalog, found.columns())
    shift_m = float(np.nanmedian(np.linalg.norm(found.shift_m, axis=1)))
    sigma_m = float(np.nanmedian(np.linalg.norm(found.sigma_m, axis=1)))
    if as_json:
        values = {"median_shift_m": shift_m, "median_center_sigma_m": sigma_m}
        out.print_json(
            json.dumps({"catalog": str(output), "craters": len(found.outcomes), "outcomes": counts, **values})
        )
        return
    say(f"{len(found.outcomes)} craters: {told}")
    say(f"refined rims: centres moved by {shift_m:.0f} m in the median, {sigma_m:.0f} m left (one sigma)")
    say(f"{output}")


def _require_refined(rims: RefinedRims, catalog: Path, dem: Path) -> None:
    if not rims.refined.any():
        raise InputError(dem, f"shows no rim of {catalog}: {_told(_counts(rims))}")
    if disagrees(rims.outcomes):
        problem = (
            "the catalogue disagrees with the model by a kilometre or more, or is of another place or size"
        )
        raise InputError(catalog, f"{problem} ({dem}: {_told(_counts(rims))})")


def _counts(rims: RefinedRims) -> dict[str, int]:
    counts = Counter(rims.outcomes)
    return {outcome.value: counts[outcome] for outcome in Outcome if counts[outcome]}


def _told(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {outcome}" for outcome, count in counts.items())


def _figures(rims: RefinedRims) -> dict[str, Any]:
    """Return the refined rims' medians."""
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
