"""Help texts: every command says what its options mean, and shows an example that parses."""

import shlex
from collections.abc import Iterator
from typing import Any

import pytest

from craternav_fg.cli import commands as table
from craternav_fg.cli.app import every_command
from tests.cli.calls import call


def commands(group: Any, names: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*names, name))
        else:
            yield (*names, name), command


GROUP = every_command()
COMMANDS = dict(commands(GROUP))


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_the_example_of_a_command_parses(names: tuple[str, ...]) -> None:
    command = COMMANDS[names]
    start = f"Example: craternav {' '.join(names)} "
    assert command.epilog.startswith(start)
    command.make_context(names[-1], shlex.split(command.epilog.removeprefix(start)))


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_help_is_one_paragraph_and_says_what_every_option_means(names: tuple[str, ...]) -> None:
    command = COMMANDS[names]
    assert "\n" not in command.help.strip()
    assert all(parameter.help for parameter in command.params)
    shown = call(*names, "--help")
    assert shown.code == 0
    assert "Example: craternav" in shown.out


def test_the_table_of_commands_tells_what_their_help_tells() -> None:
    assert list(GROUP.commands) == list(table.COMMANDS)
    assert {name: command.help for name, command in GROUP.commands.items()} == {
        name: command.help for name, command in table.COMMANDS.items()
    }


def test_results_go_below_runs_and_imports_and_exports_need_a_place() -> None:
    for names, command in COMMANDS.items():
        for output in (one for one in command.params if one.name == "output"):
            assert output.required == (names[0] in ("import", "export")), names
            # Without a default nothing is written, or beside what is shown.
            assert output.required or output.default is None or output.default.parts[0] == "runs", names
    assert "below ./runs" in " ".join(call("--help").out.split())
