"""Recursive estimators need no more memory, and no more time, the longer they run."""

import time

import numpy as np
import pytest

from craternav_fg.bench.problems import make
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.incremental import FixedLagIsam
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.state_log import StateLog
from factors.kernels.strapdown import SIZE
from tests.resident_memory import in_fresh_process, needs_statm, resident_kb

FRAMES = 12_000


def sizes_and_times(lag_s: float | None) -> tuple[list[int], list[float], int]:
    """Resident memory (kB) after each half of the frames, CPU seconds of each half, and states estimated."""
    problem = make(FRAMES, 5).problem
    session = OnlineSession(problem, solver=None if lag_s is None else FixedLagIsam(lag_s))
    session.begin(problem.frames[0], problem.start)
    half = FRAMES // 2
    sizes_kb, times_s = [], []
    for part in (problem.frames[1:half], problem.frames[half:]):
        began = time.process_time()
        for frame in part:
            session.update(frame)
        times_s.append(time.process_time() - began)
        sizes_kb.append(resident_kb())
    return sizes_kb, times_s, len(session.filtered().stamps_ns)


@needs_statm
@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [None, 30.0], ids=["online", "fixed lag"])
def test_memory_and_time_are_flat(lag_s: float | None) -> None:
    """Memory of the second half: 20 MiB over 50,000 frames, that is 0.4 kB a frame."""
    sizes_kb, times_s, estimated = in_fresh_process(sizes_and_times, lag_s)
    assert sizes_kb[1] - sizes_kb[0] < 0.42 * (FRAMES // 2)
    assert times_s[1] < 1.3 * times_s[0]
    assert estimated == FRAMES


def some_state(rng: np.random.Generator, biases: int) -> FilterState:
    size = SIZE + biases
    return FilterState(
        rng.normal(size=(4, 4)), rng.normal(size=3), rng.normal(size=3), rng.normal(size=6),
        rng.normal(size=(size, size)), rng.normal(size=biases),
    )  # fmt: skip


def test_states_come_back_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("craternav_fg.estimators.state_log._BLOCK", 4)
    rng = np.random.default_rng(1)
    states = [some_state(rng, 2) for _ in range(11)]
    log = StateLog(2)
    for number, state in enumerate(states):
        log.append(10 * number, state)
        # Reading in between moves nothing.
        assert len(log.states()) == len(log) == number + 1
    for state, found in zip(states, log.states(), strict=True):
        for name, value in vars(state).items():
            np.testing.assert_array_equal(getattr(found, name), value)
    trajectory = log.trajectory()
    assert trajectory.velocity_covariance is not None
    np.testing.assert_array_equal(trajectory.stamps_ns, 10 * np.arange(11))
    np.testing.assert_array_equal(trajectory.gTb, [state.gTb for state in states])
    np.testing.assert_array_equal(
        trajectory.velocity_covariance, [state.covariance[6:9, 6:9] for state in states]
    )
