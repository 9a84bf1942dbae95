"""Command that writes the report of a run or a campaign."""

import json
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import ForceOption, JsonOption, require_free, require_suffix
from craternav_fg.cli.terminal import out, say
from craternav_fg.errors import InputError
from craternav_fg.reports.foxglove_recording import write_mcap
from craternav_fg.reports.recording import write_recording
from craternav_fg.reports.write import REPORT, is_campaign
from craternav_fg.reports.write import report as write_report
from craternav_fg.runs.read import read_run

_MCAP = ".mcap"


@app.command(epilog=example("report runs/demo --recording runs/demo.rrd"))
def report(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...|CAMPAIGN", help="Folder of a run or a campaign, or of several runs."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="HTML file.", show_default=f"{REPORT} in the folder; several runs need it"
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(help="Also write trajectories and rims in 3-D: .rrd for rerun, .mcap for Foxglove."),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a report: one interactive HTML page that works offline."""
    _check(folders, output, recording)
    for asked in (output, recording):
        if asked is not None:
            require_free(asked, force=force)
    written = {"report": str(write_report(folders, output))}
    if recording is not None:
        write = write_mcap if recording.suffix == _MCAP else write_recording
        write(read_run(folders[0]), recording)
        written["recording"] = str(recording)
    if as_json:
        out.print_json(json.dumps(written))
    else:
        say("\n".join(written.values()))


def _check(folders: list[Path], output: Path | None, recording: Path | None) -> None:
    if len(folders) > 1 and output is None:
        raise InputError("--output", "expected the file to write for several runs, found none")
    campaigns = [folder for folder in folders if is_campaign(folder)]
    if campaigns and len(folders) > 1:
        raise InputError(campaigns[0], "is a campaign: expected several runs, or a single campaign")
    if recording is not None:
        require_suffix(recording, (".rrd", _MCAP))
    if recording is not None and (campaigns or len(folders) > 1):
        raise InputError(folders[0], "expected one run for --recording, found a campaign or several runs")
