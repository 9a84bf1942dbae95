"""Commands on descents: simulate, reconstruct, compare."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.app import JsonOption, app
from craternav_fg.cli.terminal import (
    LEGEND,
    bar,
    from_smoother,
    number,
    out,
    row_of_estimator,
    say,
    show_run,
    table_of_estimators,
)
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import DEFAULT, ESTIMATORS, ON_REQUEST, estimator
from craternav_fg.files import replacing_folder
from craternav_fg.runs.execute import execute_run
from craternav_fg.runs.read import read_run
from craternav_fg.runs.store import CONTENTS, DATASET, MARKER
from craternav_fg.simulation.scenario import simulate as simulate_scenario
from craternav_fg.simulation.scenario_file import load_scenario

EstimatorOption = Annotated[
    list[str] | None,
    typer.Option(
        "--estimator",
        "-e",
        help=f"One of {', '.join(ESTIMATORS)}; may be repeated.",
        show_default=f"all but {', '.join(ON_REQUEST)}",
    ),
]


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")] = Path("runs/demo"),
    scenario: Annotated[
        str, typer.Option(help="Name of a built-in scenario, or a TOML file.")
    ] = "lunar_descent",
    as_json: JsonOption = False,
) -> None:
    """Simulate a descent, reconstruct it with every estimator, and compare them."""
    began_s = time.perf_counter()
    case = load_scenario(scenario)
    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, bar() as report:
        simulate_scenario(
            case, folder / DATASET, progress=lambda done, total: report("simulated frames", done, total)
        )
        simulated_s = time.perf_counter() - began_s
        summary = execute_run(
            Dataset.open(folder / DATASET),
            folder,
            DEFAULT,
            label=DATASET,
            began_s=began_s,
            earlier_s={"simulation": simulated_s},
            progress=report,
        )
    show_run(output, summary, as_json)


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set.")],
    lost: Annotated[
        bool, typer.Option("--lost", help="Leave out the initial state: the craters must be identified.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a scenario and write its data set (EuRoC/ASL layout)."""
    case = load_scenario(scenario)
    with bar() as report:
        simulate_scenario(
            case,
            output,
            with_initial=not lost,
            progress=lambda done, total: report("simulated frames", done, total),
        )
    if as_json:
        out.print_json(json.dumps({"dataset": str(output)}))
    else:
        say(f"{output}\nnext: craternav reconstruct {output} -o RUN")


@app.command()
def reconstruct(
    data: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")],
    estimators: EstimatorOption = None,
    overlays: Annotated[
        bool, typer.Option("--overlays", help="Draw the rims on every frame, into RUN/overlays.")
    ] = False,
    overlay_every: Annotated[
        int | None, typer.Option(min=1, help="Draw them on each Nth frame only.", metavar="N")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct the trajectory of a data set."""
    began_s = time.perf_counter()
    names = tuple(dict.fromkeys(estimator(name).name for name in estimators or DEFAULT))
    if data.resolve().is_relative_to(output.resolve()):
        raise InputError(output, f"holds the data set {data}, which would be lost when the run replaces it")
    if (data / MARKER).is_file() and (data / DATASET).is_dir():
        raise InputError(data, f"expected a data set, found a run: its data set is {data / DATASET}")
    dataset = Dataset.open(data)
    every = overlay_every or int(overlays)
    if every and dataset.measurements is not None:
        raise InputError(data, "has measured rims: expected images for --overlays")
    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, bar() as report:
        summary = execute_run(
            dataset, folder, names, label=str(data.resolve()), began_s=began_s, progress=report,
            overlay_every=every,
        )  # fmt: skip
    show_run(output, summary, as_json)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs.")],
    as_json: JsonOption = False,
) -> None:
    """Compare the estimators of one or more runs."""
    loaded = [read_run(path) for path in runs]
    if as_json:
        result = {
            str(run.path): {
                name: {**run.metrics["estimators"][name], "from_smoother_rms_m": from_smoother(run, name)}
                for name in run.trajectories
            }
            for run in loaded
        }
        out.print_json(json.dumps(result))
        return
    for run in loaded:
        table = table_of_estimators()
        table.add_column("off m", justify="right", no_wrap=True)
        for name in run.trajectories:
            cells = row_of_estimator(name, run.metrics["estimators"][name])
            off_m = from_smoother(run, name)
            table.add_row(*cells, number(None if off_m is None else round(off_m, 3)))
        say(f"{run.path}")
        out.print(table)
    say(f"{LEGEND}\noff: RMS distance from the smoother")
