"""Command that writes the report of a run or a campaign."""

import json
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.campaign import store as campaign_store
from craternav_fg.campaign.read import read_campaign
from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import JsonOption
from craternav_fg.cli.terminal import out, say
from craternav_fg.errors import InputError
from craternav_fg.reports.campaign_page import campaign_page
from craternav_fg.reports.page import write_page
from craternav_fg.reports.recording import write_recording
from craternav_fg.reports.run_page import run_page
from craternav_fg.runs.read import read_run

_PAGE = "report.html"


@app.command(epilog=example("report runs/demo --recording runs/demo.rrd"))
def report(
    folder: Annotated[Path, typer.Argument(metavar="RUN|CAMPAIGN", help="Folder of a run or a campaign.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="HTML file.", show_default=f"{_PAGE} in the folder")
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(help="Also write a .rrd file for the rerun viewer: trajectories and rims in 3-D."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a report: one HTML page that needs no network."""
    path = output or folder / _PAGE
    written = {"report": str(path)}
    if (folder / campaign_store.MARKER).is_file():
        _check_no_recording(folder, recording)
        write_page(campaign_page(read_campaign(folder)), path)
    else:
        run = read_run(folder)
        write_page(run_page(run), path)
        if recording is not None:
            write_recording(run, recording)
            written["recording"] = str(recording)
    if as_json:
        out.print_json(json.dumps(written))
    else:
        say("\n".join(written.values()))


def _check_no_recording(folder: Path, recording: Path | None) -> None:
    if recording is not None:
        raise InputError(folder, "is a campaign: expected a run for --recording")
