"""Durations of calls, and the memory of this process."""

import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

# Repetitions of a call that is timed by its shortest duration.
_REPETITIONS = 3
_PROC_STATUS = Path("/proc/self/status")


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


def cpu_and_wall_s(function: Callable[[], object]) -> tuple[float, float]:
    """Time one call by both clocks.

    Parameters
    ----------
    function : callable

    Returns
    -------
    cpu_s, wall_s : float
        Processor time of all threads, and time on the wall.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    function()
    return time.process_time() - cpu, time.perf_counter() - wall


def peak_mb() -> float:
    """Peak memory of this process since its program began, MB."""
    # On Linux getrusage passes a parent's peak on to the child, even to one that runs another program.
    if _PROC_STATUS.exists():
        (line,) = (line for line in _PROC_STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1.024e-3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Bytes on macOS, KiB elsewhere.
    return peak / 1e6 if sys.platform == "darwin" else peak * 1.024e-3
