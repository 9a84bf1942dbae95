"""Run the slow tests for a given time: `pytest -m slow --slow-budget-min 25`.

The slow tests form a circle in the order of collection. A run begins at a point that depends on the date and
hour (`--slow-rotation`, the present one unless given), so that successive runs begin at points spread over
the circle. When the budget is used up no further test is begun: the remaining ones are skipped, and the end
of the output says what ran. The exit code is that of the tests that ran, also when there were none.
"""

from collections import Counter
from datetime import UTC, datetime
from time import monotonic

import pytest

# Turns of the circle an hour. A day is 14.618 turns: the golden section spreads daily runs most evenly, and
# with 14 whole turns hourly runs spread as well.
TURNS_PER_HOUR = (14.0 + (5.0**0.5 - 1.0) / 2.0) / 24.0
NOT_BEGUN = "not begun: the budget for slow tests is used up"

DEADLINE_S = pytest.StashKey[float]()


def first(rotation: str, count: int) -> int:
    """Index of the test that a run begins with, of `count` tests, at an ISO date or date and hour in UTC."""
    hours = datetime.fromisoformat(rotation).replace(tzinfo=UTC).timestamp() // 3600
    return int(hours * TURNS_PER_HOUR % 1.0 * count)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("slow tests")
    group.addoption(
        "--slow-budget-min", type=float, metavar="MINUTES",
        help="begin no slow test later than this after the start, and rotate their order",
    )  # fmt: skip
    group.addoption(
        "--slow-rotation", metavar="YYYY-MM-DD[THH]", default=f"{datetime.now(UTC):%Y-%m-%dT%H}",
        help="date, or date and hour, that determines the first slow test (default: now, UTC)",
    )  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    try:
        first(config.option.slow_rotation, 1)
    except ValueError as e:
        raise pytest.UsageError(f"--slow-rotation: {e}") from None
    if config.option.slow_budget_min is not None:
        config.stash[DEADLINE_S] = monotonic() + 60.0 * config.option.slow_budget_min


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if DEADLINE_S in config.stash:
        slow = [item for item in items if item.get_closest_marker("slow")]
        start = first(config.option.slow_rotation, len(slow))
        quick = [item for item in items if not item.get_closest_marker("slow")]
        items[:] = [*quick, *slow[start:], *slow[:start]]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    deadline_s = item.config.stash.get(DEADLINE_S, None)
    if deadline_s is not None and item.get_closest_marker("slow") and monotonic() >= deadline_s:
        pytest.skip(NOT_BEGUN)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    if DEADLINE_S in session.config.stash and exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.OK


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if DEADLINE_S not in config.stash:
        return
    begun, all_of, seconds = Counter[str](), Counter[str](), Counter[str]()
    for category, reports in terminalreporter.stats.items():
        for report in reports:
            # Of no category: setup and teardown that passed.
            if not isinstance(report, pytest.TestReport) or "slow" not in report.keywords:
                continue
            name = report.nodeid.split("[")[0]
            seconds[name] += report.duration
            if category:
                all_of[name] += 1
                begun[name] += NOT_BEGUN not in str(report.longrepr)
    terminalreporter.section(f"slow tests begun, rotation {config.option.slow_rotation}")
    for name in sorted(all_of):
        terminalreporter.line(f"{begun[name]:3} of {all_of[name]:3}, {seconds[name]:5.0f} s  {name}")
