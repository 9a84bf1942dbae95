"""What moved between two benchmarks, beyond noise."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, read_bytes

# Ending of the name under which a ratio's 10 % and 90 % points stand.
SPREAD = "_spread"
# Name under which a comparison stands in the JSON.
MOVED = "moved"
# A number without a spread was measured once: it moved when it changed by more than this factor.
SINGLE_FACTOR = 1.25


@dataclass(frozen=True)
class Change:
    """A number in two benchmarks.

    Attributes
    ----------
    name : str
    before, now : float
    moved : bool
        Whether they differ by more than noise.
    """

    name: str
    before: float
    now: float
    moved: bool


def read_benchmark(path: Path) -> dict[str, Any]:
    """Read what `craternav bench --json` printed.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict
        Numbers, and lists of two numbers, by name.

    Raises
    ------
    InputError
        When the file is missing or holds something else.
    """
    try:
        values = json.loads(read_bytes(path, SizeLimit.JSON))
    except ValueError as error:
        raise InputError(path, f"expected the JSON of craternav bench: {error}") from None
    if not isinstance(values, dict) or not any(str(name).endswith(SPREAD) for name in values):
        raise InputError(path, "expected the JSON of craternav bench, found something else")
    values.pop(MOVED, None)
    for name, value in values.items():
        numbers = value if isinstance(value, list) else [value]
        spread = str(name).endswith(SPREAD)
        fits = isinstance(value, list) == spread and len(numbers) == 1 + spread
        if not fits or not all(_is_number(one) for one in numbers):
            raise InputError(path, f"{name}: expected a number, or two of a spread, found {value!r}")
    return values


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Change]:
    """Compare two benchmarks.

    Parameters
    ----------
    before, now : mapping
        As `Result.json` gives them.

    Returns
    -------
    list of Change
        One for each number that both have. A number with spreads moved when each median lies outside the
        other's spread.
    """
    out = []
    for name, value in now.items():
        if name.endswith(SPREAD) or name not in before:
            continue
        spread = name + SPREAD
        if spread in before and spread in now:
            moved = _outside(value, before[spread]) and _outside(before[name], now[spread])
        else:
            low, high = sorted((abs(before[name]), abs(value)))
            moved = high > SINGLE_FACTOR * low
        out.append(Change(name, before[name], value, moved))
    return out


def _outside(value: float, spread: list[float]) -> bool:
    return not spread[0] <= value <= spread[1]
