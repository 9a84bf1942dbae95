"""The application that all commands join."""

import sys
import warnings
from typing import Annotated

import typer
from typer.core import TyperGroup

import craternav_fg
from craternav_fg.cli.terminal import err, say
from craternav_fg.errors import CraternavError

# Order of the commands in the help: that of a user's first steps. Others follow.
_ORDER = (
    "demo",
    "simulate",
    "reconstruct",
    "compare",
    "report",
    "montecarlo",
    "catalog",
    "detect",
    "identify",
    "pose",
)


class _InOrder(TyperGroup):
    """A group whose help lists the commands of `_ORDER` first."""

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """Give the names of the commands."""
        names = list(self.commands)
        return sorted(names, key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER))


app = typer.Typer(
    cls=_InOrder,
    help="Reconstruct a planetary landing from crater rims and an IMU.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

catalog_commands = typer.Typer(help="Crater catalogues: import, summarise, list, draw.", no_args_is_help=True)
app.add_typer(catalog_commands, name="catalog")


def example(arguments: str) -> str:
    """Last line of a command's help: how it may be called."""
    return f"Example: craternav {arguments}"


def _version(show: bool) -> None:
    if show:
        say(craternav_fg.__version__)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Reconstruct a planetary landing from crater rims and an IMU."""
    del version


def _one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """Format what users must know (`FutureWarning`) as one line, other warnings as Python does."""
    if issubclass(category, FutureWarning):
        return f"craternav: warning: {message}\n"
    return f"{filename}:{lineno}: {category.__name__}: {message}\n"


def main() -> None:
    """Run the command line: a known error is one line on stderr and exit code 2."""
    warnings.formatwarning = _one_line
    try:
        app()
    except CraternavError as error:
        err.print(f"craternav: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
