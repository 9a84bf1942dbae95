"""Options of a reconstruction in a TOML file: every field of the options' dataclasses can be given.

A table `[front_end]` for the front end, a table `[estimators.NAME]` for an estimator; dataclasses inside are
tables inside. What a file does not say keeps its default.
"""

import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from textwrap import wrap
from typing import Any

import tomli_w

from craternav_fg.config import line_of, read_toml
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.estimators.base import Estimator
from craternav_fg.estimators.registry import estimator, estimators
from craternav_fg.vision.guided_options import GuidedOptions

FRONT_END, ESTIMATORS = "front_end", "estimators"
# TOML has no null: this stands for a limit that is not set.
NONE = "none"
# Of a comment.
WIDTH = 100
_KINDS = {float: "a number", int: "a whole number", list: "a list", bool: "true or false", str: "a text"}


class OptionsFile:
    """What a file says, checked when it is read.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        When it is missing or no TOML, or a table, key, type or value is wrong: names file, line and key.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text, data = read_toml(path)
        for key in data:
            if key not in (FRONT_END, ESTIMATORS):
                self._fail([key], f"unknown table, expected {FRONT_END} or {ESTIMATORS}")
        self.front_end: GuidedOptions = self._changed(GuidedOptions(), data.get(FRONT_END, {}), [FRONT_END])
        self._tables: Mapping[str, Any] = data.get(ESTIMATORS, {})
        known = estimators()
        for name in self._tables:
            if name not in known:
                self._fail([ESTIMATORS, name], f"expected one of {', '.join(known)}")
            self.estimator(name)

    def estimator(self, name: str) -> Estimator:
        """Make an estimator with the file's options.

        Parameters
        ----------
        name : str

        Returns
        -------
        Estimator

        Raises
        ------
        InputError
            When the file is wrong about it.
        """
        one = estimator(name)
        table = self._tables.get(name)
        if table is None:
            return one
        where = [ESTIMATORS, name]
        for key in own_settings(one):
            if key in table:
                setattr(one, key, self._value(getattr(one, key), table[key], [*where, key]))
        rest = {key: value for key, value in table.items() if key not in own_settings(one)}
        if not hasattr(one, "options"):
            if rest:
                self._fail([*where, next(iter(rest))], f"unknown key: {name} has no options")
            return one
        changed = self._changed(one.options, rest, where)
        if is_dataclass(one) and not isinstance(one, type):
            return replace(one, options=changed)
        one.options = changed
        return one

    def _changed(self, default: Any, table: Any, where: list[str]) -> Any:
        """Give options with what a table says; `default` is a dataclass."""
        if not isinstance(table, dict):
            self._fail(where, f"expected a table, found {table!r}")
        known = {field.name for field in fields(default)}
        new = {}
        for key, value in table.items():
            if key not in known:
                self._fail([*where, key], f"unknown key, expected one of {', '.join(sorted(known))}")
            new[key] = self._value(getattr(default, key), value, [*where, key])
        try:
            return replace(default, **new)
        except (ValueError, CraternavError) as error:
            key = str(error).split(":")[0]
            self._fail([*where, key] if key in new else where, str(error).removeprefix(f"{key}: "))

    def _value(self, default: Any, value: Any, where: list[str]) -> Any:
        if is_dataclass(default):
            return self._changed(default, value, where)
        if value == NONE and not isinstance(default, str):
            return None
        if isinstance(default, bool) or default is None:
            kinds: tuple[type, ...] = (bool,) if isinstance(default, bool) else (int, float, str)
        elif isinstance(default, float):
            kinds = (int, float)
        elif isinstance(default, tuple):
            kinds = (list,)
        else:
            kinds = (type(default),)
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            names = {
                float: "a number",
                int: "a whole number",
                list: "a list",
                bool: "true or false",
                str: "a text",
            }
            self._fail(where, f"expected {names[kinds[-1]]}, found {value!r}")
        if isinstance(default, tuple):
            if len(value) != len(default):
                self._fail(where, f"expected {len(default)} values, found {len(value)}")
            return tuple(self._value(d, v, where) for d, v in zip(default, value, strict=True))
        return float(value) if isinstance(default, float) else value

    def _fail(self, where: list[str], problem: str) -> Any:
        raise InputError(self._path, problem, line=line_of(self._text, where), column=".".join(where))


def own_settings(one: Estimator) -> list[str]:
    """Names of an estimator's settings beside its options: numbers that its constructor takes.

    Parameters
    ----------
    one : Estimator

    Returns
    -------
    list of str
    """
    taken = inspect.signature(type(one)).parameters
    return [
        key for key in taken if key not in ("options", "name") and isinstance(getattr(one, key, None), float)
    ]


def default_options() -> str:
    """Text of a file with every option at its default, each with a comment that says what it does.

    Returns
    -------
    str
        TOML.
    """
    lines = [
        "# Options of `craternav reconstruct --config FILE`. What is left out keeps its default.",
        f'# "{NONE}" stands for a limit that is not set.',
        "",
        *_table([FRONT_END], GuidedOptions()),
    ]
    for name in estimators():
        one = estimator(name)
        extra = {key: getattr(one, key) for key in own_settings(one)}
        if hasattr(one, "options") or extra:
            lines += ["", *_table([ESTIMATORS, name], getattr(one, "options", None), extra)]
    return "\n".join(lines) + "\n"


def _table(where: list[str], options: Any, extra: Mapping[str, Any] | None = None) -> Iterator[str]:
    """Lines of a table and of those inside it."""
    yield f"[{'.'.join(where)}]"
    for key, value in (extra or {}).items():
        yield f"{key} = {_written(value)}"
    inner = []
    said = {} if options is None else _descriptions(type(options))
    for field in fields(options) if options is not None else ():
        value = getattr(options, field.name)
        if is_dataclass(value):
            inner.append((field.name, value))
            continue
        if field.name in said:
            yield from wrap(said[field.name], WIDTH, initial_indent="# ", subsequent_indent="# ")
        yield f"{field.name} = {_written(value)}"
    for name, value in inner:
        yield ""
        yield from _table([*where, name], value)


def _written(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_written, value))}]"
    return tomli_w.dumps({"x": NONE if value is None else value}).split("=", 1)[1].strip()


def _descriptions(cls: type) -> dict[str, str]:
    """First sentences about a dataclass's fields, from the section Attributes of its docstring."""
    text = inspect.getdoc(cls) or ""
    section = text.split("Attributes\n----------\n", 1)[-1] if "Attributes\n----------\n" in text else ""
    out = {}
    for match in re.finditer(r"^(\w[\w, ]*) : .*\n((?:[ ]{4}.*\n?)+)", section, re.MULTILINE):
        sentence = " ".join(match.group(2).split()).split(". ")[0].removesuffix(".")
        for name in match.group(1).split(", "):
            out[name] = f"{sentence}."
    return out
