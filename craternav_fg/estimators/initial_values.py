"""Initial values of all states of a graph, from the states of a filter at the frames."""

from collections.abc import Sequence
from dataclasses import replace

import gtsam

from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem, Start
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import insert_state, state_stamps


def initial_values(
    problem: Problem, start: Start, states: Sequence[FilterState], longest_s: float
) -> tuple[gtsam.Values, list[int]]:
    """Initialise all states of a graph with the states of a filter.

    Parameters
    ----------
    problem : Problem
    start : Start
        Where the filter began.
    states : sequence of FilterState
        At the start's frame and those after it.
    longest_s : float
        Longest interval between two states.

    Returns
    -------
    values : gtsam.Values
    state_indices : list of int
        Indices of the frames' states.
    """
    before = filter_state.states_through_start(replace(problem, start=start))[: start.frame]
    at_frames = [*before, *states]
    values = gtsam.Values()
    state_indices = []
    last = 0
    for k, (frame, state) in enumerate(zip(problem.frames, at_frames, strict=True)):
        _insert(values, last, state)
        state_indices.append(last)
        if k + 1 < len(problem.frames):
            begin_ns = frame.stamp_ns
            stamps = state_stamps(begin_ns, problem.frames[k + 1].stamp_ns, longest_s)
            for end_ns in stamps[:-1]:
                state = filter_state.propagate(state, problem, begin_ns, int(end_ns))
                last, begin_ns = last + 1, int(end_ns)
                _insert(values, last, state)
            last += 1
    return values, state_indices


def _insert(values: gtsam.Values, index: int, state: FilterState) -> None:
    insert_state(values, index, gtsam.NavState(gtsam.Pose3(state.gTb), state.gV), state.bias)
