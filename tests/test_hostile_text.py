"""Settings that are small on disk and large in memory, or odd in other ways, are refused at once."""

import time
from itertools import pairwise
from pathlib import Path

import pytest

from craternav_fg.config import ResultSection, Section, parse_toml, read_json, validate
from craternav_fg.errors import InputError
from craternav_fg.sensors.yaml_files import parse_yaml

HERE = Path("in")
LETTERS = "abcdefghijklm"
LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{after}: &{after} [{', '.join([f'*{before}'] * 9)}]\n" for before, after in pairwise(LETTERS)
)
MERGES = "a: &a {k: 1}\n" + "".join(
    f"{after}: &{after} {{<<: [{', '.join([f'*{before}'] * 9)}]}}\n" for before, after in pairwise(LETTERS)
)
YAML = {
    "billion laughs": (LAUGHS, "with aliases written out"),
    "merged keys": (MERGES, "with aliases written out"),
    "a list in itself": ("a: &a [*a]", "with aliases written out"),
    "brackets": ("a: " + "[" * 2000, "nested too deeply"),
    "indents": ("- " * 40_000, "nested too deeply"),
    "length": ("a: 1\n" * 50_000, "expected at most 100000 characters, found 250000"),
    "many values": ("".join(f"k{i}: 1\n" for i in range(9000)), "expected at most 10000 values"),
    "no boolean": ("a: !!bool maybe", "a value that is none of its type"),
    "no date": ("comment: 2024-13-45", "a value that is none of its type: month must be in 1..12"),
    "no time": ("a: !!timestamp x", "a value that is none of its type"),
    "no integer": ("a: !!int ''", "a value that is none of its type"),
    "digits": ("a: " + "9" * 5000, "a value that is none of its type"),
    "a key that is a list": ("? [a]\n: 1", "found unhashable key"),
    "code": ("a: !!python/object/apply:os.system [x]", "could not determine a constructor"),
    "nothing": ("", "expected keys and values, found nothing"),
}
TOML = {
    "brackets": ("a = " + "[" * 2000, "nested too deeply"),
    "tables": ("a = " + "{a = " * 2000, "nested too deeply"),
    "digits": ("a = " + "9" * 5000, "Exceeds the limit"),
    "a long key": ("a." * 100_000 + "a = 1", "keys of a few parts"),
    "no date": ("a = 2024-02-31", "Invalid date or datetime"),
}


def refused_at_once(text: str, problem: str, parse: object) -> None:
    began = time.process_time()
    with pytest.raises(InputError) as raised:
        parse(HERE, text)  # type: ignore[operator]
    assert time.process_time() - began < 3.0
    assert problem in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("case", YAML)
def test_yaml(case: str) -> None:
    refused_at_once(*YAML[case], parse_yaml)


@pytest.mark.parametrize("case", TOML)
def test_toml(case: str) -> None:
    refused_at_once(*TOML[case], parse_toml)


def test_a_few_aliases_are_read() -> None:
    assert parse_yaml(HERE, "a: &a [1, 2]\nb: *a\nc: *a") == {name: [1, 2] for name in "abc"}


class Numbers(ResultSection):
    a: int


def test_a_hexadecimal_integer_of_thousands_of_digits_is_refused() -> None:
    with pytest.raises(InputError, match="expected numbers of usual size"):
        validate(HERE, {"a": 16**5000}, Numbers, text="")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[" * 100_000, "nested too deeply"),
        ('{"a": ' + "9" * 5000 + "}", "Exceeds the limit"),
        ("[1]", "expected a JSON object, found a list"),
        ("5", "expected a JSON object, found a int"),
        ("{}", "a: key is missing"),
        ('{"a": 1.5}', "a: expected a valid integer"),
        ("\udcff", "'utf-8' codec can't decode"),
    ],
)
def test_json(text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "in.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError) as raised:
        read_json(path, Numbers)
    assert problem in str(raised.value)


class Settings(Section):
    a: dict[str, float]


@pytest.mark.parametrize("number", ["1e308", "-1e308", "1e-320", "1e61"])
def test_numbers_beyond_reason_are_refused_by_name(number: str) -> None:
    text = f"[a]\nb = 1.0\nc = {number}\n"
    with pytest.raises(InputError, match=r"in:3: a\.c: expected 0, or 1e-60 to 1e\+60 in size"):
        validate(HERE, parse_toml(HERE, text), Settings, text=text)


def test_usual_numbers_and_infinity_are_for_the_model_to_judge() -> None:
    text = "[a]\nb = 0.0\nc = -1e-20\nd = 1.3e20\n"
    assert validate(HERE, parse_toml(HERE, text), Settings, text=text).a["d"] == 1.3e20
    with pytest.raises(InputError, match=r"a\.b: expected a finite number"):
        validate(HERE, parse_toml(HERE, "[a]\nb = inf\n"), Settings, text="")
