"""Commands on descents: simulate, reconstruct, compare."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import EstimatorOption, JsonOption, ScenarioArgument
from craternav_fg.cli.run_summary import comparison, show_comparison, show_run
from craternav_fg.cli.terminal import out, progress_bars, say
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.estimators.registry import DEFAULT, estimator
from craternav_fg.files import replacing_folder
from craternav_fg.pipeline.reconstruct import Progress
from craternav_fg.runs.execute import execute_run
from craternav_fg.runs.read import read_run
from craternav_fg.runs.store import CONTENTS, DATASET, MARKER
from craternav_fg.simulation.scenario import simulate as simulate_scenario
from craternav_fg.simulation.scenario_file import load_scenario


@app.command(epilog=example("demo -o runs/demo"))
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
    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, progress_bars() as report:
        simulate_scenario(case, folder / DATASET, progress=_simulated(report))
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


@app.command(epilog=example("simulate lunar_descent -o runs/data --lost"))
def simulate(
    scenario: ScenarioArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set.")],
    lost: Annotated[
        bool,
        typer.Option(
            "--lost", help="Leave out the initial state: a reconstruction must identify the craters."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a scenario and write its data set (EuRoC/ASL layout)."""
    case = load_scenario(scenario)
    with progress_bars() as report:
        simulate_scenario(case, output, with_initial=not lost, progress=_simulated(report))
    if as_json:
        out.print_json(json.dumps({"dataset": str(output)}))
    else:
        say(f"{output}\nnext: craternav reconstruct {output} -o RUN")


@app.command(epilog=example("reconstruct runs/data -o runs/first -e smoother -e ekf --overlay-every 10"))
def reconstruct(
    data: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")],
    estimators: EstimatorOption = None,
    overlays: Annotated[
        bool, typer.Option("--overlays", help="Draw the rims on every frame, into RUN/overlays.")
    ] = False,
    overlay_every: Annotated[
        int | None, typer.Option(min=1, help="Draw them on every Nth frame only.", metavar="N")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct the trajectory of a data set."""
    began_s = time.perf_counter()
    names = tuple(dict.fromkeys(estimator(name).name for name in estimators or DEFAULT))
    _check_folders(data, output)
    dataset = Dataset.open(data)
    every = overlay_every or int(overlays)
    _check_overlays(data, dataset, every)
    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, progress_bars() as report:
        summary = execute_run(
            dataset, folder, names, label=str(data.resolve()), began_s=began_s, progress=report,
            overlay_every=every,
        )  # fmt: skip
    show_run(output, summary, as_json)


@app.command(epilog=example("compare runs/first runs/second"))
def compare(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs.")],
    as_json: JsonOption = False,
) -> None:
    """Compare the estimators of one or more runs."""
    compared = [(str(run.path), comparison(run)) for run in (read_run(path) for path in runs)]
    if as_json:
        out.print_json(json.dumps(dict(compared)))
    else:
        show_comparison(compared)


def _simulated(report: Progress) -> Callable[[int, int], None]:
    """Report the progress of a simulation."""
    return lambda done, total: report("simulated frames", done, total)


def _check_folders(data: Path, output: Path) -> None:
    """Refuse a run that would replace its data set, and a run in place of a data set."""
    if data.resolve().is_relative_to(output.resolve()):
        raise InputError(output, f"holds the data set {data}, which would be lost when the run replaces it")
    if (data / MARKER).is_file() and (data / DATASET).is_dir():
        raise InputError(data, f"expected a data set, found a run: its data set is {data / DATASET}")


def _check_overlays(data: Path, dataset: Dataset, every: int) -> None:
    if every and dataset.measurements is not None:
        raise InputError(data, "has measured rims: expected images for --overlays")
