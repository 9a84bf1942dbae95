"""Command that reproduces the figures and tables of the paper."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.app import app, example
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import ForceOption, JsonOption, WorkersOption, require_free
from craternav_fg.cli.terminal import out, progress_bars, say
from craternav_fg.files import replacing_folder
from craternav_fg.reproduce import run as reproduction
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.terminal import tables


@dataclass(frozen=True)
class Images:
    """Set-up of figs. 11 to 14, single images."""

    craters: Annotated[int, typer.Option(help="Number of craters in figs. 11 and 12, 3 or more.")] = (
        ReproduceOptions.craters
    )
    altitudes_km: Annotated[
        tuple[float, float], typer.Option(help="Lowest and highest altitude in figs. 11 to 14.")
    ] = ReproduceOptions.altitudes_km
    semi_axes_m: Annotated[
        tuple[float, float], typer.Option(help="Smallest and largest semi-axis of rims in figs. 11 to 14.")
    ] = ReproduceOptions.semi_axes_m
    noise_px: Annotated[
        float, typer.Option(help="Standard deviation of each coordinate of an edge point.")
    ] = ReproduceOptions.noise_px
    arc: Annotated[float, typer.Option("--arc-share", help="Visible share of each rim, 1 for all of it.")] = (
        ReproduceOptions.arc
    )


@dataclass(frozen=True)
class Amount:
    """How much is run, and where."""

    trials: Annotated[int, typer.Option(help="Trials per altitude in figs. 11 to 14.")] = (
        ReproduceOptions.trials
    )
    images: Annotated[
        int,
        typer.Option(
            "--images-per-altitude", help="Images per altitude in table 2; other image sets scale with it."
        ),
    ] = ReproduceOptions.images
    descents: Annotated[
        int, typer.Option(help="Trials of figs. 15 to 18, of lag and of ablation (10 at the most).")
    ] = ReproduceOptions.descents
    seed: Annotated[int, typer.Option(help="Seed; the same seed gives the same result.")] = (
        ReproduceOptions.seed
    )
    workers: WorkersOption = None


@app.command(epilog=example("reproduce fig02 fig11 --trials 100 -o runs/reproduce"))
@with_option_groups
def reproduce(
    figures: Annotated[
        list[str],
        typer.Argument(help=f"{', '.join((*reproduction.FIGURES, *reproduction.OTHERS))}, or all."),
    ],
    setup: Images,
    amount: Amount,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the figures.")] = Path(
        "runs/reproduce"
    ),
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Reproduce figures and tables of Tian et al. (2019), with a verdict on each number."""
    names = reproduction.chosen(figures)
    workers = (os.cpu_count() or 1) if amount.workers is None else amount.workers
    options = ReproduceOptions(**{**vars(setup), **vars(amount), "workers": workers})
    require_free(output, force=force)
    contents = reproduction.CONTENTS
    with (
        replacing_folder(output, marker=reproduction.MARKER, ours=contents) as folder,
        progress_bars() as report,
    ):
        results = reproduction.reproduce(names, options, report)
        reproduction.write(folder, results, options)
    if as_json:
        out.print_json(json.dumps([row.as_dict() for result in results for row in result.rows]))
        return
    for result in results:
        say(f"{result.name}: {result.title}\n")
        for heading, table in tables(result):
            say(heading)
            out.print(table)
        out.print(f"{result.note}\n", highlight=False, markup=False)
    say(f"all numbers: {output / reproduction.MARKER}, figures and tables: {output / 'reproduction.md'}")
