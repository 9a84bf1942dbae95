"""Configuration files: what is wrong is named by file, line and key."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from craternav_fg.config import Section, line_of, load_toml
from craternav_fg.errors import InputError


class Box(Section):
    shape: Literal["box"]
    width_m: Annotated[float, Field(gt=0.0)]


class Ball(Section):
    shape: Literal["ball"]
    least_m: float
    most_m: float

    @model_validator(mode="after")
    def ordered(self) -> "Ball":
        if self.least_m > self.most_m:
            raise ValueError("expected least_m of at most most_m")
        return self


class Pile(Section):
    kind: Literal["pile"]
    stone: tuple[Annotated[Box | Ball, Field(discriminator="shape")], ...]


class Field_(Section):  # noqa: N801 (pydantic has the other name)
    kind: Literal["field"]
    bodies: Annotated[Box | Ball, Field(discriminator="shape")]


class Ground(Section):
    what: Annotated[Pile | Field_, Field(discriminator="kind")]


class Plan(Section):
    name: str
    ground: Ground


PILE = """\
name = "a"

[ground.what]
kind = "pile"

[[ground.what.stone]]
shape = "box"
width_m = 1.0

[[ground.what.stone]]
shape = "ball"
least_m = 1.0
most_m = 2.0
"""


def problem(tmp_path: Path, text: str) -> str:
    path = tmp_path / "plan.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_toml(path, Plan)
    return str(caught.value).removeprefix(str(path))


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PILE, encoding="utf-8-sig")
    assert load_toml(path, Plan).name == "a"


def test_nested_unions_are_read(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PILE, encoding="utf-8")
    what = load_toml(path, Plan).ground.what
    assert isinstance(what, Pile)
    assert [stone.shape for stone in what.stone] == ["box", "ball"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        # The location of each has the tags of two unions, one inside the other.
        ("width_m = 1.0", "width_m = -1.0", ":8: ground.what.stone.0.width_m: expected greater than 0"),
        ("most_m = 2.0", 'most_m = "2"', ":13: ground.what.stone.1.most_m: expected a valid number"),
        ("most_m = 2.0", "", ":10: ground.what.stone.1.most_m: key is missing"),
        ("most_m = 2.0", "most_m = 2.0\ncolour = 3", ":14: ground.what.stone.1.colour: unknown key"),
        # An error of a whole table ends with the tag.
        ("most_m = 2.0", "most_m = 0.5", ":10: ground.what.stone.1: expected least_m of at most most_m"),
        ('shape = "ball"\n', "", ":10: ground.what.stone.1.shape: key is missing"),
        (
            'kind = "pile"',
            'kind = "heap"',
            ":4: ground.what.kind: expected one of 'pile', 'field', found 'heap'",
        ),
        ('name = "a"', "name = 3", ":1: name: expected a valid string, found 3"),
        ('name = "a"', "", ": name: key is missing"),
    ],
)
def test_errors_name_line_and_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in PILE
    found = problem(tmp_path, PILE.replace(old, new, 1))
    assert found.startswith(expected)
    assert "\n" not in found


def test_long_values_are_cut(tmp_path: Path) -> None:
    found = problem(tmp_path, PILE.replace("width_m = 1.0", f"width_m = {list(range(100))}"))
    assert found.endswith("...")
    assert len(found) < 150


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"name = \xff", "expected a text file in UTF-8"), (b"name = ", "expected TOML: ")],
)
def test_what_is_no_toml(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=expected):
        load_toml(path, Plan)
    for missing, problem_ in ((tmp_path / "none.toml", "file is missing"), (tmp_path, "found a folder")):
        with pytest.raises(InputError, match=problem_):
            load_toml(missing, Plan)


def test_lines_of_yaml_keys() -> None:
    text = "sensor_type: camera\n# fx: 1\nT_BS:\n  cols: 4\nintrinsics: [1, 2]\n"
    assert line_of(text, ["intrinsics"]) == 5
    assert line_of(text, ["nowhere"]) is None
