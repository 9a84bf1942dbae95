"""Durations of calls."""

import time
from collections.abc import Callable

# Repetitions of a call that is timed by its shortest duration.
_REPETITIONS = 3


def seconds_of(function: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Time one call.

    Parameters
    ----------
    function : callable
    clock : callable
        Processor time by default: other programs do not count.

    Returns
    -------
    float
        Seconds.
    """
    began = clock()
    function()
    return clock() - began


def shortest_ms(function: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Shortest duration of a few calls, ms: other programs disturb the rest."""
    return 1e3 * min(seconds_of(function, clock) for _ in range(_REPETITIONS))
