"""Command that runs many trials of one scenario."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from craternav_fg.campaign.read import failed_trials
from craternav_fg.campaign.run import CampaignOptions
from craternav_fg.campaign.run import montecarlo as run_campaign
from craternav_fg.cli.app import app, example
from craternav_fg.cli.estimator_option import EstimatorOption
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import JsonOption, WorkerOptions, names_of, require_free
from craternav_fg.cli.scenario_options import DataOption, ScenarioArgument, SeedOption, chosen
from craternav_fg.cli.terminal import out, progress_bars, say, table_of_numbers, tell, three_digits, warn
from craternav_fg.errors import CraternavError
from craternav_fg.estimators.registry import DEFAULT
from craternav_fg.simulation.scenario_file import Scenario

# Figures of an estimator in summary.json and their headings.
_COLUMNS = {
    "converged": "conv.",
    "position_final_mean_m": "pos.\nmean\nm",
    "position_final_rms_m": "pos.\nRMS\nm",
    "attitude_final_mean_deg": "att.\nmean\ndeg",
    "rms_over_pcrb": "RMS\n/PCRB",
    "anees": "ANEES",
    "time_per_trial_s": "time\ns",
}
_LEGEND = (
    "conv.: trials with final errors below 2 % of the altitude (of 1 % of the largest altitude at least)\n"
    "and 1 deg; pos., att.: mean and RMS of the final errors of position and attitude; RMS/PCRB: RMS\n"
    "position error over its posterior Cramér-Rao bound, averaged over the altitude (over the frames\n"
    "where that falls and rises); ANEES of the pose: 6 expected; time: per trial"
)


@dataclass(frozen=True)
class Where(WorkerOptions):
    """Who runs the trials, and where the scenario's data are."""

    data: DataOption = None


@app.command(epilog=example("montecarlo paper_case3 -n 30 -o runs/campaign -e smoother,ekf"))
@with_option_groups
def montecarlo(
    scenario: ScenarioArgument,
    trials: Annotated[int, typer.Option("-n", help="Number of trials.")],
    where: Where,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the campaign.")] = Path(
        "runs/montecarlo"
    ),
    seed: SeedOption = None,
    trial: Annotated[int, typer.Option("--trial", min=0, help="Number of the first trial.")] = 0,
    images: Annotated[
        bool, typer.Option("--images", help="Render images and measure them, instead of simulated rims.")
    ] = False,
    estimators: EstimatorOption = None,
    retry: Annotated[bool, typer.Option("--retry", help="Repeat the trials that failed.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a campaign: many trials of a scenario with the default estimators. Continue it if it exists."""
    workers, scheduler = where.checked(os.cpu_count() or 1)
    # A campaign that is there is completed: nothing is replaced.
    require_free(output, force=True)
    options = CampaignOptions(
        trials=trials,
        first=trial,
        estimators=names_of(estimators, DEFAULT),
        images=images,
        workers=workers,
        scheduler=scheduler,
        retry=retry,
    )
    summary = _run(chosen(scenario, seed, where.data), output, options)
    if summary["failed"]:
        _report_failures(failed_trials(output), summary["trials"])
    if as_json:
        out.print_json(json.dumps(summary))
    else:
        _show(output, summary)


def _run(scenario: Scenario, folder: Path, options: CampaignOptions) -> dict[str, Any]:
    """Run the campaign; Ctrl-C ends the command in one line."""
    try:
        with progress_bars() as report:
            return run_campaign(scenario, folder, options, report)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("finished trials are kept; the same command resumes") from None


def _report_failures(failed: dict[int, str], trials: int) -> None:
    """Warn of trials that failed; it is an error when all have."""
    first = min(failed)
    message = f"{len(failed)} of {trials} trials failed, the first: trial {first}: {failed[first]}"
    if len(failed) == trials:
        raise CraternavError(message)
    warn(message)


def _show(folder: Path, summary: dict[str, Any]) -> None:
    table = table_of_numbers("estimator", _COLUMNS.values())
    for name, values in summary["estimators"].items():
        table.add_row(name, *(three_digits(values[column]) for column in _COLUMNS))
    out.print(table)
    trials = summary["trials"]
    for name, values in summary["estimators"].items():
        count = values["trajectories"]
        if count != trials:
            tell(f"{name}: statistics of the {count} of {trials} trials that produced a trajectory")
        if 0 < values["anees_trials"] < count:
            tell(f"{name}: ANEES of the {values['anees_trials']} trials without a singular covariance")
    tell(_LEGEND)
    say(f"{trials} trials, {summary['wall_s']:.0f} s: {folder}\nnext: craternav report {folder}")
