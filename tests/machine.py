"""How slowly this machine computes at the moment, so that limits on time hold on slower machines too.

The limits in the tests are CPU seconds on one machine. A test divides what it measured by `slowness`, which
it takes in the same process and about the same time.
"""

import time

import numpy as np

from factors.kernels.compiled import njit

# CPU seconds of `_work` on the machine on which the limits were set: 32 ms, the median of 24 on another one,
# by 2.2, the ratio of their times for the whole quick suite (30.5 and 13.9 CPU minutes).
REFERENCE_S = 0.0145

_TABLE = np.random.default_rng(0).permutation(1 << 20)
_VALUES = np.random.default_rng(1).random((400, 3))


@njit(cache=True)
def _walk(table, steps):
    """Arithmetic at random places of a table of 8 MB, with branches that cannot be foreseen."""
    at, total = 0, 0.0
    for k in range(steps):
        at = table[at ^ (k & 1023)]
        total += np.sqrt(float(at)) if at & 1 else np.cos(float(at))
    return total


def _work() -> None:
    _walk(_TABLE, 150_000)
    for row in _VALUES:
        np.dot(row, row)
        np.cross(row, _VALUES[0])


def slowness() -> float:
    """CPU time of a fixed piece of work, compiled and not, over that of the reference machine; at least 1."""
    times_s = []
    for _ in range(3):
        began = time.process_time()
        _work()
        times_s.append(time.process_time() - began)
    return max(1.0, min(times_s) / REFERENCE_S)
