"""Options that say which case is simulated."""

from typing import Annotated

import typer

from craternav_fg.cli.options import completing
from craternav_fg.simulation.scenario_file import Scenario, built_in_scenarios

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
    typer.Option("--trial", min=0, help="Trial of a campaign: use its random numbers."),
]


def seeded(scenario: Scenario, seed: int | None) -> Scenario:
    """Give a scenario with another seed, or as it is without one.

    Parameters
    ----------
    scenario : Scenario
    seed : int or None

    Returns
    -------
    Scenario
    """
    return scenario if seed is None else scenario.model_copy(update={"seed": seed})
