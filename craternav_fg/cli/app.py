"""The application that all commands join.

A command's module is imported when the command is called: the help of all of them costs no import of GTSAM.
"""

import functools
import gc
import importlib
import inspect
import warnings
from typing import Annotated, Any, get_args

import typer
from typer.core import TyperGroup
from typer.models import ParameterInfo

import craternav_fg
from craternav_fg.cli.commands import COMMANDS
from craternav_fg.cli.terminal import err, note, out, say, set_verbosity
from craternav_fg.errors import CraternavError
from factors import numba_cache


class _Lazy(TyperGroup):
    """A group that knows its commands by name and help, and imports the one that is called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find the command that the arguments name, and import it."""
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None:
            command = _loaded([name]).commands[name]
            _search_for_garbage()
        return name, command, rest


def _search_for_garbage() -> None:
    """Search for garbage again, see `cli.main`, though never among what was imported."""
    _leave_out_present()
    gc.enable()


# Once: in one process, such as a test, many commands are called, and garbage of one would stay.
@functools.cache
def _leave_out_present() -> None:
    gc.freeze()


app = typer.Typer(
    cls=_Lazy,
    help="Reconstruct a planetary landing from crater rims and an IMU.",
    epilog="Results go below ./runs unless -o names another place; import and export require -o. Existing "
    "results are replaced only with --force.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
catalog_commands = typer.Typer(help=COMMANDS["catalog"].help, no_args_is_help=True)
app.add_typer(catalog_commands, name="catalog")
evaluate_commands = typer.Typer(help=COMMANDS["evaluate"].help, no_args_is_help=True)
app.add_typer(evaluate_commands, name="evaluate")
import_commands = typer.Typer(help=COMMANDS["import"].help, no_args_is_help=True)
app.add_typer(import_commands, name="import")
export_commands = typer.Typer(help=COMMANDS["export"].help, no_args_is_help=True)
app.add_typer(export_commands, name="export")


def _not_imported() -> None:
    """Stand for a command until its module is imported."""


# In the order of the help; a module's own command takes the place of its name.
for _name, _command in COMMANDS.items():
    app.command(_name, help=_command.help)(_not_imported)


def _loaded(names: Any) -> TyperGroup:
    """Return the group of all commands, with those of the names imported."""
    for name in names:
        for module in COMMANDS[name].modules:
            importlib.import_module(f"craternav_fg.cli.{module}")
    return _group(_registered(app))


def _registered(group: typer.Typer) -> int:
    """Count the commands of a group and below it: each module that is imported adds its own."""
    below = (one.typer_instance for one in group.registered_groups)
    return len(group.registered_commands) + sum(_registered(one) for one in below if one is not None)


# Made anew when commands have come: in one process, such as a test, many are called.
@functools.lru_cache(maxsize=1)
def _group(_count: int) -> TyperGroup:
    """Return the group of all commands, of which so many are registered."""
    _leave_files_unchecked(app)
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    return group


def _leave_files_unchecked(group: typer.Typer) -> None:
    """Leave it to those who read a file to say, in one line, that it may not be read."""
    for command in group.registered_commands:
        assert command.callback is not None
        for parameter in inspect.signature(command.callback).parameters.values():
            for about in get_args(parameter.annotation)[1:]:
                if isinstance(about, ParameterInfo):
                    about.readable = False
    for one in group.registered_groups:
        assert one.typer_instance is not None
        _leave_files_unchecked(one.typer_instance)


def every_command() -> TyperGroup:
    """Import all commands, for documentation and tests.

    Returns
    -------
    TyperGroup
    """
    return _loaded(COMMANDS)


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
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print each step, and the traceback of a known error.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print warnings, errors and JSON, and nothing else.")
    ] = False,
) -> None:
    """Reconstruct a planetary landing from crater rims and an IMU."""
    del version
    set_verbosity(verbose=verbose, quiet=quiet)


def _one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """Format what users must know (`FutureWarning`) as one line, other warnings as Python does."""
    if issubclass(category, FutureWarning):
        return f"craternav: warning: {message}\n"
    return f"{filename}:{lineno}: {category.__name__}: {message}\n"


def run() -> None:
    """Run the command line."""
    warnings.formatwarning = _one_line
    if numba_cache.FOLDER is not None:
        note(f"no folder for compiled code can be written: {numba_cache.FOLDER} is used")
    try:
        _loaded([])()
    except CraternavError:
        if out.verbose:
            err.print_exception()
        raise
