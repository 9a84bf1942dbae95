"""Command that compares runs."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import FIGURE_SUFFIXES, ForceOption, JsonOption, require_free, require_suffix
from craternav_fg.cli.run_summary import comparison, show_comparison
from craternav_fg.cli.terminal import out, say, warn
from craternav_fg.errors import InputError
from craternav_fg.runs.read import Run, read_run


@app.command(epilog=example("compare runs/first runs/second -o errors.png"))
def compare(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Figure of the position errors to write: .png, .pdf or .svg."),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare the estimators of one or more runs."""
    if output is not None:
        require_suffix(output, FIGURE_SUFFIXES)
        require_free(output, force=force)
    read = [read_run(path) for path in runs]
    other = next((run for run in read[1:] if run.dataset.resolve() != read[0].dataset.resolve()), None)
    if other is not None:
        warn(f"different data sets: {read[0].dataset} of {read[0].path}, {other.dataset} of {other.path}")
    if output is not None:
        _draw(read, output)
    compared = [(str(run.path), comparison(run)) for run in read]
    if as_json:
        out.print_json(json.dumps(dict(compared)))
        return
    show_comparison(compared)
    if output is not None:
        say(f"{output}")


def _draw(runs: Sequence[Run], output: Path) -> None:
    truths = {str(run.path): run.truth for run in runs if run.truth is not None}
    known = all(run.truth is not None for run in runs)
    if not known:
        _require_same_descent(runs)

    # matplotlib takes half a second to import: what draws nothing does not wait for it.
    from craternav_fg.plots.comparison import draw_comparison
    from craternav_fg.plots.style import save

    save(
        draw_comparison({str(run.path): run.trajectories for run in runs}, truths if known else None), output
    )


def _require_same_descent(runs: Sequence[Run]) -> None:
    """Refuse distances between trajectories of different descents."""
    stamps_ns = [next(iter(run.trajectories.values())).stamps_ns for run in runs]
    for run, stamps in zip(runs, stamps_ns, strict=True):
        for same, what in (
            (run.dataset.resolve() == runs[0].dataset.resolve(), "data set"),
            (np.array_equal(stamps, stamps_ns[0]), "frames"),
        ):
            if not same:
                problem = f"expected the {what} of {runs[0].path} for --output without ground truth"
                raise InputError(run.path, f"{problem}, found others")
