"""Options that several commands get in the same way.

A parameter that is a dataclass stands for the options of its fields; a result is replaced by --force alone.
"""

import functools
import inspect
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from craternav_fg.cli.options import ForceOption, require_free

Command = TypeVar("Command", bound=Callable[..., None])


def with_option_groups(command: Command) -> Command:
    """Let a command take groups of options.

    Parameters
    ----------
    command : callable
        A parameter whose type is a dataclass stands for its fields: each is an option, annotated and with a
        default as a parameter would be.

    Returns
    -------
    callable
        With the options one by one, as typer expects them.
    """
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, tuple[type[Any], list[str]]] = {}
    parameters = []
    for one in signature.parameters.values():
        if not is_dataclass(one.annotation):
            parameters.append(one.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        group: Any = one.annotation
        hints = get_type_hints(group, include_extras=True)
        groups[one.name] = group, [field.name for field in fields(group)]
        for field in fields(group):
            default = inspect.Parameter.empty if field.default is MISSING else field.default
            parameters.append(
                inspect.Parameter(
                    field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[field.name]
                )
            )

    @functools.wraps(command)
    def call(**values: Any) -> None:
        made = {
            name: group(**{field: values.pop(field) for field in names})
            for name, (group, names) in groups.items()
        }
        command(**values, **made)

    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]


def never_replacing(command: Command) -> Command:
    """Add the option --force to a command, which otherwise does not replace its `output`.

    Parameters
    ----------
    command : callable
        With a parameter `output`, a path.

    Returns
    -------
    callable
    """
    return never_replacing_any(lambda values: [values["output"]])(command)


def never_replacing_any(
    outputs: Callable[[dict[str, Any]], Iterable[Path]],
) -> Callable[[Command], Command]:
    """Add the option --force to a command of several outputs, which otherwise replaces none of them.

    Parameters
    ----------
    outputs : callable
        Paths that the command will write, by the values of its parameters.

    Returns
    -------
    callable
        Decorator of the command.
    """

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        force = inspect.Parameter(
            "force", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=ForceOption
        )
        given = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in signature.parameters.values()]

        @functools.wraps(command)
        def call(*, force: bool, **values: Any) -> None:
            for path in outputs(values):
                require_free(path, force=force)
            command(**values)

        call.__signature__ = signature.replace(parameters=[*given, force])  # type: ignore[attr-defined]
        return call  # type: ignore[return-value]

    return decorate
