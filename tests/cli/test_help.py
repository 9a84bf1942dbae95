"""Help texts: every command says what its options mean, and shows an example that parses."""

import re
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


# Numbers without a unit: shares, factors, qualities, multiples of an elevation model's resolution.
PLAIN = {
    "--arc-share", "--place-share", "--size-factor", "--min-quality", "--min-diameter-steps",
    "--resolution-steps",
}  # fmt: skip
UNIT = re.compile(r"-(px|m|km|deg|percent|m3-s2|rad-s|(m|rad)-s2-sqrt-hz)$")


def test_an_option_is_of_one_kind_in_all_commands() -> None:
    kinds: dict[str, set[str]] = {}
    defaults = set()
    for command in COMMANDS.values():
        for parameter in command.params:
            kind = re.sub(r"typing|class|list|None|[^A-Za-z]", "", str(parameter.type_descriptor.annotation))
            kinds.setdefault(max(parameter.opts, key=len), set()).add(kind)
            if parameter.name == "workers":
                defaults.add((parameter.default, parameter.show_default))
    assert kinds["--workers"] == {"int"}
    assert defaults == {(None, "one per core")}
    assert {name: found for name, found in kinds.items() if name.startswith("--") and len(found) > 1} == {}


def test_every_number_carries_its_unit_in_its_name() -> None:
    found = set()
    for command in COMMANDS.values():
        for parameter in command.params:
            if "float" in str(parameter.type_descriptor.annotation):
                found.add(max(parameter.opts, key=len))
    assert {"--noise-px", "--dem-unit-m", "--mu-m3-s2"} < found
    assert {name for name in found if name.startswith("--") and not UNIT.search(name)} <= PLAIN
