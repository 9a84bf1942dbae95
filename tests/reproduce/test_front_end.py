"""Acceptance limits of the front end in rendered images, and what its rows hold."""

import json

import pytest

from craternav_fg.reproduce import table1
from craternav_fg.reproduce.front_end import front_end
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import FIELDS, NO_NUMBER, Reproduction, Row
from craternav_fg.reproduce.table1_trials import Sets, simulate

FEW = ReproduceOptions(images=2, workers=1)
CREST = "rim crest against projected rim, 4x zoom"
# Lowest and highest allowed value by quantity and condition.
LIMITS: dict[tuple[str, str], tuple[float, float]] = {
    (CREST, "absolute mean"): (0.0, 0.03),
    (CREST, "mean absolute"): (0.0, 0.03),
    ("guided, fine rims", "centre, mean absolute"): (0.0, 0.20),
    ("guided, fine rims", "semi-major, mean absolute"): (0.0, 0.18),
    ("guided, fine rims", "semi-minor, mean absolute"): (0.0, 0.18),
    ("guided, fine rims", "semi-major, absolute mean, below 60 px"): (0.0, 0.10),
    ("guided, fine rims", "semi-minor, absolute mean, below 60 px"): (0.0, 0.10),
    ("guided, fine rims", "measured"): (0.99, 1.0),
    ("guided, fine rims", "chi-square / 5"): (0.7, 1.3),
    ("guided, irregular rims", "centre, mean absolute"): (0.0, 0.65),
    ("guided, irregular rims", "semi-major, mean absolute"): (0.0, 0.45),
    ("guided, irregular rims", "semi-minor, mean absolute"): (0.0, 0.40),
    ("guided, irregular rims", "chi-square / 5"): (0.7, 1.3),
    ("prediction wrong by 30 px and 3 %", "recovered"): (0.98, 1.0),
    ("blind, plain terrain", "recall"): (0.97, 1.0),
    ("blind, plain terrain", "precision"): (0.97, 1.0),
    ("blind, plain terrain", "centre, mean absolute"): (0.0, 0.40),
    ("blind, plain terrain", "semi-major, mean absolute"): (0.0, 0.25),
    ("blind, plain terrain", "semi-minor, mean absolute"): (0.0, 0.25),
    ("blind, hard terrain", "recall"): (0.85, 1.0),
    ("blind, hard terrain", "precision"): (0.92, 1.0),
    ("sun tilt", "reversed"): (0.0, 0.0),
    ("sun tilt", "RMS error, at nadir"): (0.0, 2.0),
    ("sun tilt", "share of frames with a tilt, at nadir"): (0.9, 1.0),
    ("sun tilt", "RMS error, 30 deg off nadir"): (0.0, 6.0),
    ("sun tilt", "share of frames with a tilt, 30 deg off nadir"): (0.9, 1.0),
    ("images without craters", "rims in 20 noise images"): (0.0, 0.0),
    ("images without craters", "rims in 20 gradient images"): (0.0, 0.0),
}


def limit_of(row: Row) -> tuple[float, float]:
    # The condition of the reversed tilts ends with their number.
    condition, _, _ = row.condition.partition(", of ")
    return LIMITS[row.quantity, condition]


def ours(row: Row) -> float | None:
    return row.corrected if row.quantity.startswith(("blind", "images")) else row.efficient


@pytest.fixture(scope="module")
def measured() -> Sets:
    return simulate(FEW)


@pytest.fixture(scope="module")
def few(measured: Sets) -> Reproduction:
    return front_end(measured, FEW)


def test_every_row_has_a_number_and_a_limit(few: Reproduction) -> None:
    assert len(few.rows) == len(LIMITS)
    for row in few.rows:
        low, high = limit_of(row)
        assert low <= high
        assert ours(row) is not None, row


def test_figures_that_few_images_tell_are_within_their_limits(few: Reproduction) -> None:
    """Two images of a set give errors of a few dozen rims; shares and chi-square take more."""
    for row in few.rows:
        low, high = limit_of(row)
        value = ours(row)
        if row.unit == "px" or row.quantity == "images without craters":
            assert value is not None
            assert low <= value <= high, row


def test_the_product_judges_by_the_papers_numbers_alone(few: Reproduction) -> None:
    for row in few.rows:
        assert (row.verdict == NO_NUMBER) == (row.paper is None)
    text = " ".join([few.note, few.title, *(row.verdict for row in few.rows)])
    for word in ("holds", "missed", "at most", "limit"):
        assert word not in text


def test_table1_and_the_front_end_agree_on_the_same_rims(few: Reproduction, measured: Sets) -> None:
    table = table1.table1(measured)
    by_name = {(row.quantity, row.condition): row for row in few.rows}
    fine = next(row for row in table.rows if row.quantity == "centre, average error")
    assert "fine" in fine.condition
    assert by_name["guided, fine rims", "centre, mean absolute"].efficient == fine.efficient
    assert by_name["blind, plain terrain", "centre, mean absolute"].corrected == fine.corrected
    assert by_name["blind, plain terrain", "recall"].paper == 0.92
    assert fine.efficient is not None
    assert fine.as_printed is not None
    assert fine.as_printed > 1.5 * fine.efficient
    for row in (*table.rows, *few.rows):
        assert set(row.as_dict()) == set(FIELDS)
        assert row.verdict
    assert json.dumps([row.as_dict() for row in (*table.rows, *few.rows)], allow_nan=False)


@pytest.mark.slow
def test_every_figure_is_within_its_limit() -> None:
    options = ReproduceOptions()
    rows = front_end(simulate(options), options).rows
    missed = []
    for row in rows:
        low, high = limit_of(row)
        value = ours(row)
        if value is None or not low <= value <= high:
            missed.append((row.quantity, row.condition, value, low, high))
    assert not missed
