"""What moved between two benchmarks."""

import json
from pathlib import Path

import pytest

from craternav_fg.bench.compare import changes, read_benchmark
from craternav_fg.errors import InputError


def test_what_lies_outside_the_noise_has_moved() -> None:
    before = {
        "a": 1.0,
        "a_spread": [0.9, 1.1],
        "b": 1.0,
        "b_spread": [0.9, 1.1],
        "ms": 10.0,
        "s": 10.0,
        "gone": 1.0,
    }
    now = {
        "a": 1.05,
        "a_spread": [0.8, 1.2],
        "b": 1.5,
        "b_spread": [1.4, 1.6],
        "ms": 12.0,
        "s": 13.0,
        "new": 1.0,
    }
    found = {one.name: one.moved for one in changes(before, now)}
    assert found == {"a": False, "b": True, "ms": False, "s": True}


def test_a_wide_spread_of_either_is_noise() -> None:
    before = {"a": 1.0, "a_spread": [0.9, 1.1]}
    now = {"a": 1.3, "a_spread": [0.95, 1.6]}
    assert [one.moved for one in changes(before, now)] == [False]


def test_what_a_comparison_printed_can_be_compared_again(tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    path.write_text(json.dumps({"a": 1.0, "a_spread": [0.9, 1.1], "moved": [{"name": "a"}]}))
    assert set(read_benchmark(path)) == {"a", "a_spread"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nonsense", "expected the JSON of craternav bench"),
        ("[1.0]", "found something else"),
        (json.dumps({"a": "fast", "a_spread": [1.0, 2.0]}), "a: expected a number"),
        (json.dumps({"a": 1.0, "a_spread": 2.0}), "a_spread: expected a number, or two"),
        (json.dumps({"a": [1.0], "a_spread": [1.0, 2.0]}), r"a: expected a number, .* found \[1.0\]"),
        (json.dumps({"a": 1.0, "a_spread": [2.0]}), "a_spread: expected a number, or two"),
    ],
)
def test_another_file_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "old.json"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_benchmark(path)
