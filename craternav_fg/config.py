"""Configuration files (TOML, YAML) checked against models: an error names file, line and key."""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import (
    AfterValidator,
    AliasChoices,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from craternav_fg.body import Body
from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, read_bytes


def _not_zero(values: tuple[float, ...]) -> tuple[float, ...]:
    if not any(values):
        raise ValueError("expected numbers of which one is not zero")
    return values


Vector = tuple[float, float, float]
# Of any length but zero.
Direction = Annotated[Vector, AfterValidator(_not_zero)]
Quaternion = Annotated[tuple[float, float, float, float], AfterValidator(_not_zero)]
Positive = Annotated[float, Field(gt=0.0)]
M = TypeVar("M", bound="Section")

# Newton's constant (CODATA 2018), and mean densities of bodies: a porous comet has 500 kg/m^3, iron has 8000.
# Room for a sphere of reference that is not the mean one.
_NEWTON_M3_KG_S2 = 6.6743e-11
_DENSITIES_KG_M3 = (100.0, 30_000.0)
# Minimum and maximum size of a number in settings.
_SIZES = (1e-60, 1e60)
# Characters of a wrong value that an error shows.
_MAX_SHOWN = 60
# A dotted key of fifty parts: tomllib needs memory by the square of their number.
_LONG_KEY = re.compile(r"(?:\.[ \t]*[^\s.=,\[\]{}][^.\n=,\[\]{}]*){50}")


class Section(BaseModel):
    """A table of a configuration file: no unknown keys, no conversion of types, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class ResultSection(Section):
    """A part of a results file: further keys are passed over, and numbers may be NaN or infinite."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=True)


def or_former(present: str, former: str) -> Any:
    """Describe a field whose key may stand under the name that an earlier version gave it.

    Parameters
    ----------
    present, former : str

    Returns
    -------
    pydantic.fields.FieldInfo
        For the annotation of the field `present`.
    """
    return Field(validation_alias=AliasChoices(present, former))


class BodySection(Section):
    """Target body: a sphere with central gravity."""

    name: Annotated[str, Field(min_length=1)]
    radius_m: Positive
    mu_m3_s2: Positive
    spin_rad_s: Vector
    """Angular velocity in inertial space, components in g."""

    @field_validator("mu_m3_s2")
    @classmethod
    def _of_matter(cls, mu_m3_s2: float, others: ValidationInfo) -> float:
        """Refuse a gravitational parameter in another unit, or of another body than the radius."""
        radius_m = others.data.get("radius_m")
        if radius_m is None:
            return mu_m3_s2
        low, high = _DENSITIES_KG_M3
        # No power: that of an integer of hundreds of digits is an OverflowError.
        density = mu_m3_s2 / _NEWTON_M3_KG_S2 / (4.0 / 3.0 * math.pi * radius_m * radius_m * radius_m)
        if not low <= density <= high:
            raise ValueError(
                f"expected a mean density of {low:g} to {high:g} kg/m^3, found {density:.3g} with a radius "
                f"of {radius_m:g} m: is it in km^3/s^2, or of another body?"
            )
        return mu_m3_s2

    def body(self) -> Body:
        """Make the body that the table describes."""
        return Body(self.name, self.radius_m, self.mu_m3_s2, self.spin_rad_s)


def load_toml(path: Path, model: type[M]) -> M:
    """Read a TOML file into a model.

    Parameters
    ----------
    path : Path
    model : type
        Subclass of `Section`.

    Returns
    -------
    model

    Raises
    ------
    InputError
        When the file is missing or not TOML, or a key is unknown, missing, of the wrong type or out of range.
        Names the file, the key and, where it can be found, the line.
    """
    text, data = read_toml(path)
    return validate(path, data, model, text=text)


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Read and parse a TOML file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    text : str
        Its text.
    data : dict
        Its tables.

    Raises
    ------
    InputError
        When the file is missing, not UTF-8 or not TOML.
    """
    text = read_text(path)
    return text, parse_toml(path, text)


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Parse the text of a TOML file.

    Parameters
    ----------
    path : Path
        For messages.
    text : str

    Returns
    -------
    dict

    Raises
    ------
    InputError
        When it is not TOML, or has a value beyond what can be read.
    """
    if _LONG_KEY.search(text):
        raise InputError(path, "expected TOML with keys of a few parts, found one of more than 50")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(path, "expected TOML, found brackets nested too deeply") from None
    except ValueError as error:
        # Besides syntax: dates that do not exist, and integers of thousands of digits.
        raise InputError(path, f"expected TOML: {error}") from None


def read_json(path: Path, model: type[M]) -> dict[str, Any]:
    """Read a JSON file and check it against a model.

    Parameters
    ----------
    path : Path
    model : type
        Subclass of `Section`.

    Returns
    -------
    dict
        As the file has it, with keys that the model does not name.

    Raises
    ------
    InputError
        When the file cannot be opened, see `craternav_fg.files.open_input`, is not JSON, or does not match
        the model.
    """
    try:
        text = read_bytes(path, SizeLimit.JSON).decode("utf-8")
        data = json.loads(text)
    except RecursionError:
        raise InputError(path, "expected JSON, found brackets nested too deeply") from None
    except ValueError as error:
        raise InputError(path, f"expected JSON: {error}") from None
    if not isinstance(data, dict):
        raise InputError(path, f"expected a JSON object, found a {type(data).__name__}")
    validate(path, data, model, text="")
    return data


def read_text(path: Path) -> str:
    """Read a text file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str

    Raises
    ------
    InputError
        When it cannot be opened, see `craternav_fg.files.open_input`, or is not UTF-8.
    """
    try:
        # Windows' editors put a byte order mark before the text.
        return read_bytes(path, SizeLimit.SETTINGS).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"expected a text file in UTF-8: {error.reason}") from None


def validate(path: Path, data: dict[str, Any], model: type[M], *, text: str) -> M:
    """Check parsed data against a model.

    Parameters
    ----------
    path : Path
        The file, named in errors.
    data : dict
        What the file says.
    model : type
        Subclass of `Section`.
    text : str
        The file's text, in which lines are looked up.

    Returns
    -------
    model

    Raises
    ------
    InputError
        When a key is unknown, missing, of the wrong type or out of range.
    """
    if not issubclass(model, ResultSection):
        _check_sizes(path, data, (), text)
    try:
        # By way of JSON: strict validation of Python objects refuses lists where a model has tuples.
        plain = json.dumps(data, default=str)
    except ValueError as error:
        # An integer of thousands of digits, written as a hexadecimal one.
        raise InputError(path, f"expected numbers of usual size: {error}") from None
    try:
        return model.model_validate_json(plain)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        # A misspelt key is both unknown and missing; only the former error tells where it is.
        first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    keys = _keys_in(data, first["loc"], missing=first["type"] == "missing")
    problem = _problem(first)
    present = _former_names(model).get(keys[-1]) if first["type"] == "extra_forbidden" else None
    if present is not None and _keys_in(data, (*keys[:-1], present), missing=False) == [*keys[:-1], present]:
        problem = f"is the former name of {present}, which is given, too"
    if first["type"].startswith("union_tag"):
        keys.append(first["ctx"]["discriminator"].strip("'"))
    raise InputError(path, problem, line=line_of(text, keys), column=".".join(keys) or None) from None


def _check_sizes(path: Path, data: Any, keys: tuple[str, ...], text: str) -> None:
    """Refuse numbers whose squares are infinite or vanish: no quantity has such a size in SI units."""
    if isinstance(data, dict | list):
        items = data.items() if isinstance(data, dict) else enumerate(data)
        for key, value in items:
            _check_sizes(path, value, (*keys, str(key)), text)
    elif isinstance(data, float) and not (
        data == 0.0 or not math.isfinite(data) or _SIZES[0] <= abs(data) <= _SIZES[1]
    ):
        problem = f"expected 0, or {_SIZES[0]:g} to {_SIZES[1]:g} in size, found {data:g}"
        raise InputError(path, problem, line=line_of(text, list(keys)), column=".".join(keys))


def _former_names(kind: Any) -> dict[str, str]:
    """Present names of a model's keys by their former ones, with those of the tables in it."""
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        return {old: new for part in get_args(kind) for old, new in _former_names(part).items()}
    names: dict[str, str] = {}
    for key, field in kind.model_fields.items():
        if isinstance(field.validation_alias, AliasChoices):
            names |= {str(name): key for name in field.validation_alias.choices if name != key}
        names |= _former_names(field.annotation)
    return names


def _keys_in(data: Any, location: tuple[str | int, ...], *, missing: bool) -> list[str]:
    """Select the keys of an error's location that the file holds, and the one that it lacks, if `missing`.

    pydantic puts the tag of the chosen alternative of a union into the location as well.
    """
    keys: list[str] = []
    for depth, key in enumerate(location, start=1):
        here = isinstance(data, dict) and key in data
        listed = isinstance(data, list) and isinstance(key, int) and key < len(data)
        if here or listed:
            data = data[key]
        elif not (missing and depth == len(location)):
            continue
        keys.append(str(key))
    return keys


def line_of(text: str, keys: list[str]) -> int | None:
    """Find the line of a key in TOML or flat YAML text.

    Parameters
    ----------
    text : str
    keys : list of str
        From the outermost table to the key; elements of arrays of tables by their index.

    Returns
    -------
    int or None
        1-based line of the key, or of the innermost table around it when the key is not there.
    """
    table: list[str] = []
    counts: dict[str, int] = {}
    best: tuple[int, int] | None = None
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if line.startswith("["):
            name = line.strip("[]").split("]")[0].strip()
            table = [part.strip() for part in name.split(".")]
            if line.startswith("[["):
                counts[name] = counts.get(name, -1) + 1
                table.append(str(counts[name]))
            found = table
        else:
            for separator in "=:":
                key, mark, _ = line.partition(separator)
                if mark and key.strip().replace("_", "").isalnum():
                    break
            else:
                continue
            found = [*table, key.strip()]
        depth = len(found)
        if keys[:depth] == found and (best is None or depth > best[0]):
            best = (depth, number)
    return None if best is None else best[1]


def _problem(error: Any) -> str:
    found = error["input"]
    match error["type"]:
        case "extra_forbidden":
            return "unknown key"
        case "missing" | "union_tag_not_found":
            return "key is missing"
        case "value_error":
            return str(error["ctx"]["error"])
        case "union_tag_invalid":
            return f"expected one of {error['ctx']['expected_tags']}, found {error['ctx']['tag']!r}"
        case _:
            message = str(error["msg"]).replace("Input should be", "expected")
            what = "a table" if isinstance(found, dict) else json.dumps(found, default=str)
            what = what if len(what) <= _MAX_SHOWN else f"{what[: _MAX_SHOWN - 3]}..."
            return f"{message[:1].lower()}{message[1:]}, found {what}"
