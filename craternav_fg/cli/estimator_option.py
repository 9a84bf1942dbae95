"""The option that names estimators. It imports them all, so commands without them do not read it."""

from typing import Annotated

import typer

from craternav_fg.cli.options import completing
from craternav_fg.estimators.registry import ESTIMATORS, ON_REQUEST, estimators

EstimatorOption = Annotated[
    list[str] | None,
    typer.Option(
        "--estimator",
        "-e",
        metavar="NAME[,NAME...]",
        help=f"Estimators to run, separated by commas or as repeated options: {', '.join(ESTIMATORS)}.",
        show_default=f"all but {', '.join(ON_REQUEST)}",
        autocompletion=completing(estimators),
    ),
]
