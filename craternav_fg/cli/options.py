"""Options that several commands share, and checks of their values."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from craternav_fg.errors import InputError

# Kinds of figures that commands write.
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")]
CameraOption = Annotated[Path, typer.Option(help="sensor.yaml of the camera.")]
CatalogOption = Annotated[
    Path, typer.Option(help="Crater catalogue: imported (.parquet), or any table that can be imported.")
]
CatalogBodyOption = Annotated[
    float | None,
    typer.Option(
        "--body-radius-m",
        min=1.0,
        help="Radius of the catalogue's sphere.",
        show_default="that of the file, else the Moon's",
    ),
]
ScenarioArgument = Annotated[str, typer.Argument(help="Name of a built-in scenario, or a TOML file.")]


def numbers_of(option: str, text: str | None, count: int) -> list[float] | None:
    """Read the numbers of an option, separated by commas.

    Parameters
    ----------
    option : str
        Its name.
    text : str or None
        Its value.
    count : int
        How many numbers are expected.

    Returns
    -------
    list of float or None
        None without a value.

    Raises
    ------
    InputError
        When the text is anything else.
    """
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(option, f"expected {count} numbers, separated by commas, found {text!r}")
    return values


def require_suffix(path: Path, suffixes: Iterable[str]) -> None:
    """Refuse the name of an output whose suffix names no known format.

    Raises
    ------
    InputError
    """
    if path.suffix not in suffixes:
        raise InputError(path, f"expected a name that ends in {' or '.join(suffixes)}")


def require_kept(sources: Iterable[Path], outputs: Iterable[Path]) -> None:
    """Refuse outputs that would overwrite what they are made from.

    Raises
    ------
    InputError
        Naming the source.
    """
    written = {path.resolve() for path in outputs}
    for path in sources:
        if path.resolve() in written:
            raise InputError(path, "would be overwritten by the result: choose another --output")
