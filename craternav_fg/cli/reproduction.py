"""Command that regenerates the paper's figures and tables."""

import json
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.terminal import bar, out, say
from craternav_fg.files import replacing_folder
from craternav_fg.reproduce import run as reproduction
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.terminal import tables


@app.command()
def reproduce(
    figures: Annotated[
        list[str], typer.Argument(help=f"{', '.join((*reproduction.FIGURES, *reproduction.OTHERS))}, or all.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the figures.")] = Path(
        "runs/reproduction"
    ),
    craters: Annotated[int, typer.Option(help="Craters of figs. 11 and 12, 3 or more.")] = 3,
    altitudes: Annotated[
        tuple[float, float], typer.Option(help="Lowest and highest altitude of figs. 11 to 14, km.")
    ] = (10.0, 100.0),
    semi_axes: Annotated[
        tuple[float, float], typer.Option(help="Least and largest semi-axis of rims, figs. 11 to 14, m.")
    ] = ReproduceOptions.semi_axes_m,
    noise: Annotated[float, typer.Option(help="Noise of each coordinate of an edge point, px.")] = 1.0,
    arc: Annotated[float, typer.Option(help="Part of each rim that shows, of 1.")] = 1.0,
    trials: Annotated[int, typer.Option(help="Trials at each altitude and point.")] = 100,
    images: Annotated[
        int, typer.Option(help="Images from each altitude of table 2; other sets by this, too.")
    ] = 128,
    descents: Annotated[int, typer.Option(help="Trials of figs. 15 to 18 and of the lag.")] = 30,
    seed: Annotated[int, typer.Option(help="The same seed gives the same result.")] = 1,
    workers: Annotated[int, typer.Option(help="Processes.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Reproduce the paper's figures and tables, each number with a verdict; and what the front end holds."""
    names = reproduction.chosen(figures)
    options = ReproduceOptions(
        craters=craters, altitudes_km=altitudes, semi_axes_m=semi_axes, noise_px=noise, arc=arc,
        trials=trials, images=images, descents=descents, seed=seed, workers=workers,
    )  # fmt: skip
    contents = reproduction.CONTENTS
    with replacing_folder(output, marker=reproduction.MARKER, ours=contents) as folder, bar() as report:
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
    say(f"all numbers: {output / reproduction.MARKER}, drawings and tables: {output / 'reproduction.md'}")
