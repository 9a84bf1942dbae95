"""Slow tests by the clock: where a run begins, where it ends, and that all have their turn."""

import itertools
from datetime import datetime, timedelta

import pytest

from tests import slow_budget

FILE = """
    import pytest

    def test_quick():
        pass

    @pytest.mark.slow
    @pytest.mark.parametrize("k", range(10))
    def test_slow(k):
        pass
"""


@pytest.mark.parametrize("every", [timedelta(hours=1), timedelta(hours=3), timedelta(days=1)])
def test_all_have_their_turn_within_a_few_runs(every: timedelta) -> None:
    count = 60
    for month in range(1, 13):
        begun: set[int] = set()
        for run in range(7):
            when = datetime(2026, month, 1, 10) + run * every
            start = slow_budget.first(f"{when:%Y-%m-%dT%H}", count)
            # Each run has time for a quarter of them.
            begun |= {k % count for k in range(start, start + count // 4)}
        assert begun == set(range(count))


def run(pytester: pytest.Pytester, *arguments: str) -> pytest.RunResult:
    pytester.makepyfile(FILE)
    pytester.makeini("[pytest]\nmarkers = slow")
    return pytester.runpytest_inprocess("-v", "-p", "tests.slow_budget", *arguments)


def slow_lines(result: pytest.RunResult, outcome: str) -> list[int]:
    """Parameters of the slow tests in the order in which they were reported."""
    return [
        int(line.split("[")[1].split("]")[0])
        for line in result.outlines
        if "::test_slow[" in line and outcome in line
    ]


def test_none_is_begun_after_the_budget(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    # The clock is read once at the start and once before each slow test: a minute passes each time.
    minutes = itertools.count()
    monkeypatch.setattr(slow_budget, "monotonic", lambda: 60.0 * next(minutes))
    options = ("--slow-budget-min", "5", "--slow-rotation", "2026-11-22T14")
    result = run(pytester, *options)
    result.assert_outcomes(passed=1 + 4, skipped=6)
    assert result.ret == 0
    start = slow_budget.first(options[-1], 10)
    order = [k % 10 for k in range(start, start + 10)]
    assert slow_lines(result, "PASSED") == order[:4]
    assert slow_lines(result, "SKIPPED") == order[4:]
    result.stdout.fnmatch_lines(
        ["*slow tests begun, rotation 2026-11-22T14*", "*4 of  10, * s  *::test_slow"]
    )


def test_the_order_is_that_of_collection_without_a_budget(pytester: pytest.Pytester) -> None:
    result = run(pytester)
    result.assert_outcomes(passed=11)
    assert slow_lines(result, "PASSED") == list(range(10))


@pytest.mark.parametrize("arguments", [("-m", "slow"), ("-m", "not slow", "-k", "slow")])
def test_a_run_that_begins_none_succeeds(pytester: pytest.Pytester, arguments: tuple[str, ...]) -> None:
    assert run(pytester, "--slow-budget-min", "0", *arguments).ret == 0


def test_a_failure_is_one(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_bad="import pytest\n@pytest.mark.slow\ndef test_bad():\n    assert False")
    assert run(pytester, "--slow-budget-min", "25").ret == 1


def test_a_rotation_that_is_no_date(pytester: pytest.Pytester) -> None:
    result = run(pytester, "--slow-rotation", "today")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--slow-rotation: Invalid isoformat string: 'today'"])
