"""Options that say which case is simulated."""

from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.cli.options import completing
from craternav_fg.simulation.scenario_file import Scenario, built_in_scenarios, load_scenario

ScenarioArgument = Annotated[
    str,
    typer.Argument(
        help="Name of a built-in scenario, or a TOML file.", autocompletion=completing(built_in_scenarios)
    ),
]
SeedOption = Annotated[
    int | None,
    typer.Option("--seed", min=0, help="Seed of the random numbers.", show_default="the scenario's"),
]
TrialOption = Annotated[
    int | None,
    typer.Option("--trial", min=0, help="Use the random numbers of this trial of a campaign."),
]
DataOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the public files that a scenario needs.", show_default="that of CRATERNAV_DATA"
    ),
]


def chosen(name: str, seed: int | None, data: Path | None) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    name : str
        Of a built-in scenario, or the path of a TOML file.
    seed : int or None
        In place of the scenario's.
    data : Path or None
        Folder of public files.

    Returns
    -------
    Scenario

    Raises
    ------
    InputError
        When there is no such scenario, it is wrong, or a public file that it needs is missing.
    """
    scenario = load_scenario(name).with_data(data)
    return scenario if seed is None else scenario.model_copy(update={"seed": seed})
