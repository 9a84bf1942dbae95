"""Memory that a process keeps, measured in one of its own.

A worker of the test run holds over a gigabyte by the time it gets here, in a heap that other tests left in
pieces: what it takes from the system then says little about the code under test.
"""

import gc
import multiprocessing
import resource
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest

STATM = Path("/proc/self/statm")

needs_statm = pytest.mark.skipif(not STATM.exists(), reason=f"needs {STATM}")


def resident_kb() -> int:
    """Memory in use now: what the process once used says nothing of what it keeps."""
    gc.collect()
    return int(STATM.read_text().split()[1]) * resource.getpagesize() // 1024


def in_fresh_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function of a module returns in a process that has imported that module and nothing else."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=spawn) as pool:
        return pool.submit(function, *arguments).result()
