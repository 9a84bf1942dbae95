"""Options of a reconstruction in a TOML file: every field of the options' dataclasses can be given.

A table `[front_end]` for the front end, a table `[estimators.NAME]` for an estimator; dataclasses inside are
tables inside. What a file does not say keeps its default.
"""

import difflib
import inspect
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from textwrap import wrap
from types import NoneType, UnionType
from typing import Any, get_args, get_type_hints

import tomli_w
from pydantic import TypeAdapter, ValidationError

from craternav_fg.config import line_of, read_toml
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.estimators.base import Estimator
from craternav_fg.estimators.calibration import Calibration
from craternav_fg.estimators.correlated_errors import RimErrorOptions
from craternav_fg.estimators.gnc import GncOptions
from craternav_fg.estimators.registry import estimator, estimators
from craternav_fg.vision.arcs import ArcOptions
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.point_tracks import PointTrackOptions
from craternav_fg.vision.sun import SunOptions
from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels import robust

FRONT_END, ESTIMATORS = "front_end", "estimators"
# TOML has no null: this stands for a limit that is not set.
NONE = "none"
# Of a comment.
WIDTH = 100
# Fields that a file gives by name.
_LOSSES = ("NONE", "HUBER", "CAUCHY", "GEMAN_MCCLURE", "TRUNCATED")
_NAMED = {(Loss, "kind"): {name.lower(): getattr(robust, name) for name in _LOSSES}}

# Present names of keys by the former ones, of which one may have become several: files with them are read.
FORMER: Mapping[type, Mapping[str, tuple[str, ...]]] = {
    GuidedOptions: {
        "brightness_sigma": ("brightness_sigma_share",),
        "first_reach": ("first_reach_px", "first_reach_share"),
        "second_reach": ("second_reach_px", "second_reach_share"),
    },
    EdgeOptions: {"min_step": ("min_step_share",)},
    ArcOptions: {"gate": ("gate_sigmas",)},
    SunOptions: {"min_emission": ("min_emission_cosine",), "min_contrast": ("min_contrast_per_px",)},
    PointTrackOptions: {"quality": ("quality_share",)},
    Loss: {"scale": ("scale_sigmas",)},
    RimErrorOptions: {"decay": ("decay_shape_change",), "step": ("step_shape_change",)},
    GncOptions: {"growth": ("growth_factor",)},
    Calibration: {
        "map_place_sigma": ("map_place_sigma_share",),
        "map_height_sigma": ("map_height_sigma_share",),
        "map_size_sigma": ("map_size_sigma_share",),
        "focal_sigma": ("focal_sigma_share",),
        "radial_sigma": ("k1_sigma",),
    },
}


@dataclass(frozen=True)
class _NoOptions:
    """Of an estimator that has settings of its own only."""


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
        if not isinstance(self._tables, dict):
            self._fail([ESTIMATORS], f"expected a table, found {self._tables!r}")
        known = estimators()
        for name, table in self._tables.items():
            if name not in known:
                self._fail([ESTIMATORS, name], f"unknown estimator{_meant(name, known)}")
            if not isinstance(table, dict):
                self._fail([ESTIMATORS, name], f"expected a table, found {table!r}")
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
                setattr(one, key, self._value(float, None, table[key], [*where, key]))
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
        """Return options with the values of a table; `default` is a dataclass."""
        if not isinstance(table, dict):
            self._fail(where, f"expected a table, found {table!r}")
        hints = _hints(type(default))
        new, written = {}, {}
        for key, value, name in self._entries(type(default), table, where):
            if key not in hints:
                self._fail([*where, key], f"unknown key{_meant(key, hints)}")
            named = _NAMED.get((type(default), key))
            if named is not None:
                if value not in named:
                    self._fail([*where, key], f"expected one of {', '.join(named)}, found {value!r}")
                new[key] = named[value]
            else:
                new[key] = self._value(hints[key], getattr(default, key), value, [*where, name])
            written[key] = name
        try:
            return replace(default, **new)
        except (ValueError, CraternavError, FactorError) as error:
            key = str(error).split(":")[0].split(".")[-1]
            self._fail([*where, written[key]] if key in new else where, str(error).split(": ", 1)[-1])

    def _entries(
        self, kind: type, table: Mapping[str, Any], where: list[str]
    ) -> Iterator[tuple[str, Any, str]]:
        """Present key, value and key as written of the entries of a table, which may have former names."""
        for name, value in table.items():
            keys = FORMER.get(kind, {}).get(name, (name,))
            twice = [key for key in keys if key in table and key != name]
            if twice:
                problem = f"is the former name of {' and '.join(keys)}, and {twice[0]} is given, too"
                self._fail([*where, name], problem)
            if len(keys) == 1:
                yield keys[0], value, name
            elif isinstance(value, list) and len(value) == len(keys):
                yield from ((key, one, name) for key, one in zip(keys, value, strict=True))
            else:
                self._fail([*where, name], f"expected a list of {len(keys)} numbers, found {value!r}")

    def _value(self, hint: Any, default: Any, value: Any, where: list[str]) -> Any:
        """Check a value against the type of its field; what is a dataclass there is a table here."""
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        if value == NONE and NoneType in kinds:
            return None
        table: Any = next((kind for kind in kinds if is_dataclass(kind)), None)
        if table is not None:
            return self._changed(table() if default is None else default, value, where)
        try:
            # By way of JSON: strict validation of Python objects refuses lists where a field has a tuple.
            checked = TypeAdapter(hint).validate_json(json.dumps(value, default=str), strict=True)
        except ValidationError as error:
            message = (
                error.errors()[0]["msg"].replace("Input should be", "expected").replace("Tuple", "a list")
            )
            self._fail(where, f"{message[:1].lower()}{message[1:]}, found {value!r}")
        numbers = checked if isinstance(checked, tuple) else (checked,)
        if any(isinstance(one, int | float) and not 0.0 <= one < math.inf for one in numbers):
            self._fail(where, f"expected a number of 0 or more, found {value!r}")
        return checked

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


def default_options(names: Sequence[str] = ()) -> str:
    """Text of a file with every option at its default, each with a comment that says what it does.

    Parameters
    ----------
    names : sequence of str
        Estimators whose options are written, all by default.

    Returns
    -------
    str
        TOML.

    Raises
    ------
    EstimationError
        When there is no estimator of a name.
    """
    lines = [
        "# Options of `craternav reconstruct --config FILE`. Missing keys keep their defaults.",
        f'# "{NONE}" means that a limit is not set, or that a table is omitted.',
        "",
        *_table([FRONT_END], GuidedOptions()),
    ]
    for name in names or estimators():
        one = estimator(name)
        own = own_settings(one)
        if not hasattr(one, "options") and not own:
            continue
        said = _descriptions(type(one))
        head, *rest = _table([ESTIMATORS, name], one.options if hasattr(one, "options") else _NoOptions())
        lines += ["", head]
        for key in own:
            lines += [*_comment(said.get(key)), f"{key} = {_written(getattr(one, key))}"]
        lines += rest
    return "\n".join(lines) + "\n"


def _table(where: list[str], options: Any) -> Iterator[str]:
    """Lines of a table and of those inside it."""
    yield f"[{'.'.join(where)}]"
    yield from _values(options)
    for field in fields(options):
        value = getattr(options, field.name)
        if is_dataclass(value):
            yield ""
            yield from _table([*where, field.name], value)


def _values(options: Any) -> Iterator[str]:
    """Lines of a dataclass's fields that are no tables, each below its comment."""
    said, hints = _descriptions(type(options)), _hints(type(options))
    for field in fields(options):
        value = getattr(options, field.name)
        if is_dataclass(value):
            continue
        named = _NAMED.get((type(options), field.name), {})
        choices = tuple(named) or (get_args(hints[field.name]) if isinstance(value, str) else ())
        if not named:
            yield from _comment(said.get(field.name))
        if choices:
            yield f"# One of {', '.join(choices)}."
        shown = next((name for name, number in named.items() if number == value), value)
        yield f"{field.name} = {_written(shown)}"


def _comment(sentence: str | None) -> list[str]:
    """Write a sentence of a docstring in the words of a file."""
    said = re.sub(r"\bNone\b", f'"{NONE}"', sentence or "")
    return wrap(said, WIDTH, initial_indent="# ", subsequent_indent="# ")


def _hints(cls: type) -> dict[str, Any]:
    """Types of a dataclass's fields."""
    known = get_type_hints(cls)
    return {field.name: known[field.name] for field in fields(cls)}


def _meant(key: str, known: Iterable[str]) -> str:
    """Suggest the key that was probably meant, or list the known keys."""
    near = difflib.get_close_matches(key, known, 1)
    return f" (did you mean {near[0]}?)" if near else f", expected one of {', '.join(sorted(known))}"


def _written(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_written, value))}]"
    return tomli_w.dumps({"x": NONE if value is None else value}).split("=", 1)[1].strip()


def _descriptions(cls: type) -> dict[str, str]:
    """First sentences about a class's fields or parameters, from its docstring."""
    out = {}
    # A class describes only the fields that it adds to those of its base.
    texts = "\n\n".join(inspect.cleandoc(one.__doc__ or "") for one in cls.__mro__[:-1])
    for match in re.finditer(r"^(\w[\w, ]*) : .*\n((?:[ ]{4}.*\n?)+)", texts, re.MULTILINE):
        # A sentence ends before a capital letter or a mark, an abbreviation before anything else.
        text = " ".join(match.group(2).split())
        sentence = re.split(r"(?<!et al)\. (?=[A-Z\"`])", text)[0].removesuffix(".")
        for name in match.group(1).split(", "):
            out[name] = f"{sentence}."
    return out
