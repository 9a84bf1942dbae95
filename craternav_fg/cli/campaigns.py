"""Command that runs many trials of one scenario."""

import json
import os
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table

from craternav_fg.campaign.read import read_campaign
from craternav_fg.campaign.run import CampaignOptions
from craternav_fg.campaign.run import montecarlo as run_campaign
from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.descents import EstimatorOption
from craternav_fg.cli.terminal import bar, err, number, out, say
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.registry import DEFAULT
from craternav_fg.simulation.scenario_file import load_scenario

COLUMNS = {
    "converged": "conv.",
    "position_final_mean_m": "end m",
    "position_final_rms_m": "end RMS",
    "attitude_final_mean_deg": "end deg",
    "rms_over_pcrb": "/PCRB",
    "anees": "ANEES",
    "time_per_trial_s": "time s",
}
# What a shell expects of a command that was ended by Ctrl-C.
INTERRUPTED = 130


@app.command()
def montecarlo(
    scenario: Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")],
    trials: Annotated[int, typer.Option("-n", help="Number of trials.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the campaign.")],
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine.", show_default="one for each core")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler, whose workers run the trials instead.")
    ] = None,
    images: Annotated[
        bool, typer.Option("--images", help="Render images and measure them, in place of analytic rims.")
    ] = False,
    estimators: EstimatorOption = None,
    retry: Annotated[bool, typer.Option("--retry", help="Do trials again that failed.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run trials of a scenario with every estimator; in a folder of before, those that are missing."""
    if workers is not None and scheduler is not None:
        raise CraternavError("expected --workers or --scheduler, found both")
    options = CampaignOptions(
        trials=trials,
        estimators=tuple(dict.fromkeys(estimators or DEFAULT)),
        images=images,
        workers=os.cpu_count() or 1 if workers is None else workers,
        scheduler=scheduler,
        retry=retry,
    )
    case = load_scenario(scenario)
    try:
        with bar() as report:
            summary = run_campaign(case, output, options, report)
    except KeyboardInterrupt:
        err.print("craternav: interrupted: finished trials stay, the same command goes on", style="red")
        raise typer.Exit(INTERRUPTED) from None
    _show(output, summary, as_json)


def _show(folder: Path, summary: dict[str, Any], as_json: bool) -> None:
    failed = read_campaign(folder).failed
    if failed:
        first = min(failed)
        line = (
            f"{len(failed)} of {summary['trials']} trials failed, the first: trial {first}: {failed[first]}"
        )
        if len(failed) == summary["trials"]:
            raise CraternavError(line)
        err.print(
            f"craternav: warning: {line}", style="yellow", highlight=False, markup=False, soft_wrap=True
        )
    if as_json:
        out.print_json(json.dumps(summary))
        return
    # With padding that neighbours share, the longest name and every column fit into 80 characters.
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False, collapse_padding=True)
    table.add_column("estimator", no_wrap=True)
    for heading in COLUMNS.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for name, values in summary["estimators"].items():
        table.add_row(name, *(number(values[column]) for column in COLUMNS))
    out.print(table)
    trials = summary["trials"]
    for name, values in summary["estimators"].items():
        given = values["trajectories"]
        if given != trials:
            say(f"{name}: a trajectory in {given} of {trials} trials, its figures are of these")
    say(
        "conv.: trials whose last error is below 2 % of the altitude and 1 deg; end: mean and RMS of the\n"
        "last errors; /PCRB: RMS of the position over its bound, all frames; ANEES of the pose, honest: 6"
    )
    say(f"{summary['trials']} trials, {summary['wall_s']:.0f} s: {folder}")
