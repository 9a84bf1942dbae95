"""Commands on descents: simulate, reconstruct.

What simulates, reconstructs and draws is imported after the arguments are checked: it takes a second.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from craternav_fg.cli.app import app, example
from craternav_fg.cli.estimator_option import EstimatorOption
from craternav_fg.cli.option_groups import with_option_groups
from craternav_fg.cli.options import ForceOption, JsonOption, names_of, require_free, require_unused
from craternav_fg.cli.run_summary import show_run
from craternav_fg.cli.scenario_options import DataOption, ScenarioArgument, SeedOption, TrialOption, chosen
from craternav_fg.cli.terminal import out, progress_bars, say
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.estimators.base import Estimator
from craternav_fg.estimators.registry import DEFAULT, estimator
from craternav_fg.files import replacing_folder
from craternav_fg.pipeline.options_file import OptionsFile, default_options
from craternav_fg.runs.store import CONTENTS, DATASET, MARKER

if TYPE_CHECKING:
    from craternav_fg.pipeline.measuring import Progress


@app.command(epilog=example("demo -o runs/demo --seed 7"))
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")] = Path("runs/demo"),
    scenario: Annotated[
        str, typer.Option(help="Name of a built-in scenario, or a TOML file.")
    ] = "lunar_descent",
    seed: SeedOption = None,
    trial: TrialOption = None,
    data: DataOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a descent, reconstruct it with the default estimators, and compare them."""
    began_s = time.perf_counter()
    require_free(output, force=force)
    case = chosen(scenario, seed, data)

    from craternav_fg.runs.warm_up import warming_up
    from craternav_fg.simulation.scenario import simulate as simulate_scenario

    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, progress_bars() as report:
        with warming_up():
            simulate_scenario(case, folder / DATASET, trial=trial, progress=_simulated(report))
        simulated_s = time.perf_counter() - began_s

        from craternav_fg.runs.execute import execute_run

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


@app.command(epilog=example("simulate paper_case3 --trial 17 -o runs/data"))
def simulate(
    scenario: ScenarioArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set.")] = Path(
        "runs/simulate"
    ),
    seed: SeedOption = None,
    trial: TrialOption = None,
    data: DataOption = None,
    measured: Annotated[
        bool,
        typer.Option("--measured", help="Simulate measured rims in place of images, as montecarlo does."),
    ] = False,
    lost: Annotated[
        bool,
        typer.Option(
            "--lost", help="Leave out the initial state: `reconstruct` must then identify the craters."
        ),
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a scenario and write its data set (EuRoC/ASL layout)."""
    require_free(output, force=force)
    case = chosen(scenario, seed, data)

    from craternav_fg.campaign.run import as_measured
    from craternav_fg.simulation.scenario import simulate as simulate_scenario

    if measured:
        case = as_measured(case, images=False)
    with progress_bars() as report:
        simulate_scenario(case, output, trial=trial, with_initial=not lost, progress=_simulated(report))
    if as_json:
        out.print_json(json.dumps({"dataset": str(output)}))
    else:
        say(f"{output}\nnext: craternav reconstruct {output} -o RUN")


# Options of `reconstruct` that --print-config has no use for.
_OF_RUNS = ("data", "output", "without", "config", "overlays", "overlay_every", "force", "as_json")


@dataclass(frozen=True)
class Choice:
    """What takes part in a reconstruction, and how."""

    estimators: EstimatorOption = None
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SENSOR",
            help="Sensors to exclude (also rims, sun, features), separated by commas or as repeated options.",
        ),
    ] = None
    config: Annotated[Path | None, typer.Option(help="Options of front end and estimators (TOML).")] = None


@app.command(epilog=example("reconstruct runs/data -o runs/first -e smoother,ekf --overlay-every 10"))
@with_option_groups
def reconstruct(
    context: typer.Context,
    choice: Choice,
    data: Annotated[Path | None, typer.Argument(help="Folder of the data set.")] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")] = Path(
        "runs/reconstruct"
    ),
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print all options with their defaults, for --config.")
    ] = False,
    overlays: Annotated[
        bool, typer.Option("--overlays", help="Draw the rims on every frame, into RUN/overlays.")
    ] = False,
    overlay_every: Annotated[
        int | None, typer.Option(min=1, help="Draw the rims on every Nth frame only.", metavar="N")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct the trajectory of a data set."""
    began_s = time.perf_counter()
    if print_config:
        require_unused(context, _OF_RUNS, "with --print-config, which prints the defaults")
        typer.echo(default_options(names_of(choice.estimators, ())), nl=False)
        return
    folder_of_data = _given(data)
    file = None if choice.config is None else OptionsFile(choice.config)
    chosen = _estimators(names_of(choice.estimators, DEFAULT), file)
    _check_folders(folder_of_data, output)
    require_free(output, force=force)
    dataset = Dataset.open(folder_of_data)
    every = overlay_every or int(overlays)
    _check_overlays(folder_of_data, dataset, every)

    from craternav_fg.runs.execute import execute_run

    with replacing_folder(output, marker=MARKER, ours=CONTENTS) as folder, progress_bars() as report:
        summary = execute_run(
            dataset, folder, chosen, label=str(folder_of_data.resolve()), began_s=began_s, progress=report,
            overlay_every=every, front_end=None if file is None else file.front_end,
            without=names_of(choice.without, ()),
        )  # fmt: skip
    show_run(output, summary, as_json)


def _simulated(report: "Progress") -> Callable[[int, int], None]:
    """Report the progress of a simulation."""
    return lambda done, total: report("simulated frames", done, total)


def _given(data: Path | None) -> Path:
    """Refuse a call without the data set, which only --print-config does not need."""
    if data is None:
        raise InputError("reconstruct", "expected the folder of a data set")
    return data


def _estimators(names: Sequence[str], file: OptionsFile | None) -> list[Estimator]:
    """Make the named estimators, each once, with the options of a file."""
    made = {name: estimator(name) if file is None else file.estimator(name) for name in names}
    return list({one.name: one for one in made.values()}.values())


def _check_folders(data: Path, output: Path) -> None:
    """Refuse a run that would replace its data set, and a run in place of a data set."""
    if data.resolve().is_relative_to(output.resolve()):
        raise InputError(output, f"holds the data set {data}, which would be lost when the run replaces it")
    if (data / MARKER).is_file() and (data / DATASET).is_dir():
        raise InputError(data, f"expected a data set, found a run: its data set is {data / DATASET}")


def _check_overlays(data: Path, dataset: Dataset, every: int) -> None:
    if every and dataset.measurements is not None:
        raise InputError(data, "has measured rims: expected images for --overlays")
