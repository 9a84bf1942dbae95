"""Options that several commands share, and checks of their values."""

import os
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from craternav_fg.errors import CraternavError, InputError
from factors.arrays import FloatArray

# Kinds of figures that commands write.
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")]
CameraOption = Annotated[Path, typer.Option(help="sensor.yaml of the camera.")]
CatalogOption = Annotated[
    Path, typer.Option(help="Crater catalogue (.parquet), or a table that `catalog import` reads.")
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


def _metres(value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise InputError("--dem-unit-m", f"expected metres, more than 0, found {value}")
    return value


DemUnitOption = Annotated[
    float,
    typer.Option(
        "--dem-unit-m",
        callback=_metres,
        help="Length in metres of one unit of the elevation model's heights.",
    ),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an existing result.")]

WorkersOption = Annotated[
    int | None, typer.Option(help="Number of processes on this machine.", show_default="one per core")
]


@dataclass(frozen=True)
class WorkerOptions:
    """Who does the work."""

    workers: WorkersOption = None
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler whose workers do the work instead.")
    ] = None

    def checked(self, cores: int) -> tuple[int, str | None]:
        """Return the number of processes, by default one per core, and the scheduler.

        Parameters
        ----------
        cores : int

        Returns
        -------
        tuple of (int, str or None)

        Raises
        ------
        CraternavError
            When both are given, or there is no process.
        """
        if self.workers is not None and self.scheduler is not None:
            raise CraternavError("expected --workers or --scheduler, found both")
        if self.workers is not None and self.workers < 1:
            raise CraternavError(f"workers: expected 1 or more, found {self.workers}")
        return (cores if self.workers is None else self.workers), self.scheduler


@dataclass(frozen=True)
class AttitudeOptions:
    """Attitude that another sensor gives."""

    attitude: Annotated[
        str | None, typer.Option(help="Attitude gRb from another sensor, as a quaternion w,x,y,z.")
    ] = None
    attitude_sigma_deg: Annotated[
        float | None,
        typer.Option(min=0.0, help="Standard deviation of --attitude per axis, needed with it; 0 if exact."),
    ] = None

    def values(self) -> tuple[list[float], float] | None:
        """Quaternion w, x, y, z and sigma, deg; None without an attitude.

        Returns
        -------
        tuple of (list of float, float) or None

        Raises
        ------
        InputError
            When one is given without the other, or the quaternion is wrong.
        """
        q = numbers_of("--attitude", self.attitude, 4)
        if (q is None) != (self.attitude_sigma_deg is None):
            raise InputError("--attitude, --attitude-sigma-deg", "expected both, found one")
        if q is None or self.attitude_sigma_deg is None:
            return None
        if not any(q):
            raise InputError("--attitude", "expected a quaternion, found zero")
        return q, self.attitude_sigma_deg


def completing(known: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Make a completion of the last of names that are separated by commas.

    Parameters
    ----------
    known : callable
        Gives the names.

    Returns
    -------
    callable
        From what is typed to what may be meant.
    """

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [before + comma + name for name in known() if name.startswith(last)]

    return complete


def names_of(given: Iterable[str] | None, default: Sequence[str]) -> tuple[str, ...]:
    """Split names that are separated by commas; each once.

    Parameters
    ----------
    given : iterable of str or None
        Values of an option that may be repeated.
    default : sequence of str
        Without any.

    Returns
    -------
    tuple of str
    """
    names = [name.strip() for text in given or () for name in text.split(",") if name.strip()]
    return tuple(dict.fromkeys(names or default))


def require_free(path: Path, *, force: bool) -> None:
    """Refuse to replace a result without being asked, and to make a folder at the root of a file system.

    Parameters
    ----------
    path : Path
        Path of the result.
    force : bool
        Whether it may be replaced.

    Raises
    ------
    InputError
    """
    if not force and (path.is_file() or (path.is_dir() and any(path.iterdir()))):
        raise InputError(path, "already exists: choose another name, or replace it with --force")
    parts = path.absolute().parts
    if len(parts) > 2 and not Path(*parts[:2]).exists():
        top = Path(*parts[:2])
        raise InputError(path, f"would make the folder {top} at the root of the file system: create it first")


def require_unused(context: typer.Context, names: Collection[str], why: str) -> None:
    """Refuse options that were given although they do nothing as the command was called.

    Parameters
    ----------
    context : typer.Context
        Of the command.
    names : collection of str
        Names of the options' parameters.
    why : str
        What they would do nothing for.

    Raises
    ------
    InputError
        Names the first of them.
    """
    for one in context.command.params:
        source = context.get_parameter_source(one.name or "")
        if one.name in names and source is not None and source.name == "COMMANDLINE":
            raise InputError(one.opts[0], f"does nothing {why}: leave it out")


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
    written = {os.path.realpath(path) for path in outputs}
    for path in sources:
        if os.path.realpath(path) in written:
            raise InputError(path, "would be overwritten by the result: choose another --output")


def sun_direction(text: str | None) -> FloatArray | None:
    """Read the direction of --sun.

    Parameters
    ----------
    text : str or None
        Its value: x,y,z of any length.

    Returns
    -------
    ndarray, shape (3,), or None
        As given; None without a value.

    Raises
    ------
    InputError
        When the text is not three numbers, or all are zero.
    """
    values = numbers_of("--sun", text, 3)
    if values is None:
        return None
    if not any(values):
        raise InputError("--sun", "expected a direction, found zeros")
    return np.array(values)
