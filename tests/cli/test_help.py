"""Help texts: every command says what its options mean, and shows an example that parses."""

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from craternav_fg.cli.app import app
from tests.cli.calls import call


def commands(group: Any, names: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*names, name))
        else:
            yield (*names, name), command


COMMANDS = dict(commands(typer.main.get_command(app)))


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
