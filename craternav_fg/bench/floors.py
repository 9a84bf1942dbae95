"""Costs that no factor written in Python can undercut, and the cost of one step of the batch optimiser."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.bench.problems import Bench
from craternav_fg.bench.ratios import (
    KNOWING,
    RELATIVE_TOLERANCE,
    RUN_REPETITIONS,
    UNKNOWING,
    Ratio,
    batch_graphs,
    interleaved,
    projection_factors,
    summary,
)
from craternav_fg.bench.timing import cpu_and_wall_s
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import BatchSmoother, build_graph
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.elimination import CholeskyOrder
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, add_frame
from craternav_fg.estimators.incremental import Isam
from craternav_fg.estimators.initial_values import initial_values
from craternav_fg.estimators.motion import longest_interval_s
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt

# Of the batch smoother without errors of rims: steps, and one for covariances.
BATCH_ELIMINATIONS = 5
# Of each of two alternatives, whose medians are compared.
FACTOR_REPETITIONS, STEP_REPETITIONS = 31, 15


def factor_floor(bench: Bench) -> Ratio:
    """Compare factors whose callback computes nothing with GTSAM's `GenericProjectionFactor`.

    Parameters
    ----------
    bench : Bench

    Returns
    -------
    Ratio
        Of the time to linearise all frames, of several rims each, with our factors evaluated before.
    """
    values = bench.values(np.random.default_rng(1), scale=0.1)
    problem = bench.problem
    ours = FactorGraph()
    for i, frame in enumerate(problem.frames):
        add_frame(ours, problem, GraphOptions(), X(i), frame)
    poses = gtsam.Values(values)
    reference = projection_factors(bench, values)
    with ours.ahead.at(poses, linearise=True):
        return interleaved(
            lambda: gtsam.NonlinearFactorGraph.linearize(ours, poses),
            lambda: reference.linearize(values),
            FACTOR_REPETITIONS,
        )


def batch_steps(bench: Bench) -> tuple[dict[str, Ratio], dict[str, float]]:
    """Compare single steps of the batch optimiser: linearise, solve by QR, move, evaluate the error.

    Parameters
    ----------
    bench : Bench

    Returns
    -------
    ratios : dict of str to Ratio
        `batch_step_ratio`: with our factors over GTSAM's own; `batch_step_floor`: with callbacks that compute
        nothing.
    counts : dict of str to float
        `batch_iterations` and `batch_reference_iterations`: steps until the decrease is below the tolerance.
    """
    ours, reference, values = batch_graphs(bench)
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(ours)
    plain = gtsam.NonlinearFactorGraph

    def step(graph: gtsam.NonlinearFactorGraph, kind: type[gtsam.NonlinearFactorGraph] = plain) -> float:
        moved = values.retract(kind.linearize(graph, values).optimize(ordering, gtsam.EliminateQR))
        return float(kind.error(graph, moved))

    ratios = {
        "batch_step_ratio": interleaved(
            lambda: step(ours, FactorGraph), lambda: step(reference), STEP_REPETITIONS
        )
    }
    with ours.ahead.at(values, linearise=True):
        ratios["batch_step_floor"] = interleaved(
            lambda: step(ours), lambda: step(reference), STEP_REPETITIONS
        )
    options = LmOptions(relative_tolerance=RELATIVE_TOLERANCE)
    counts = {
        "batch_iterations": float(levenberg_marquardt(ours, values, options).iterations),
        "batch_reference_iterations": float(levenberg_marquardt(reference, values, options).iterations),
    }
    return ratios, counts


def batch_errors_floor(problem: Problem) -> Ratio:
    """Cost of the batch smoother if its variables for errors of rims cost nothing but eliminations.

    Parameters
    ----------
    problem : Problem
        With time-correlated errors of rims.

    Returns
    -------
    Ratio
        The run without such variables, and as many times as it eliminates its graph the difference that they
        make to one elimination, over that run: by Cholesky factorisation with them, by QR without.
    """
    reference = BatchSmoother(UNKNOWING)
    values, _ = initial_values(
        problem, problem.start, ekf().states(problem), longest_interval_s(problem, UNKNOWING)
    )
    eliminations = []
    for options in (KNOWING, UNKNOWING):
        at = gtsam.Values(values)
        linear = build_graph(problem, options, at).linearize(at)
        how: list[Any] = [gtsam.Ordering.ColamdGaussianFactorGraph(linear), gtsam.EliminateQR]
        if options is KNOWING:
            order = CholeskyOrder(linear)
            linear, how = order.apart(linear), [order.ordering]
        eliminations.append(partial(linear.optimize, *how))
    knowing, unknowing = eliminations
    return _beside(lambda: reference.estimate(problem), knowing, unknowing, BATCH_ELIMINATIONS)


def _beside(
    reference: Callable[[], object],
    more: Callable[[], object],
    less: Callable[[], object],
    times: int,
) -> Ratio:
    """Cost of a reference, and some times the difference of two calls, over the reference."""
    pairs = []
    for _ in range(RUN_REPETITIONS + 1):
        run, more_s, less_s = (np.array(cpu_and_wall_s(call)) for call in (reference, more, less))
        pairs.append((run + times * (more_s - less_s), run))
    # The first calls compile.
    ours_s, reference_s = np.array(pairs[1:]).transpose(1, 0, 2)
    return summary(ours_s, reference_s)


def online_errors_floor(problem: Problem) -> Ratio:
    """Cost of the online smoother if its variables for errors of rims cost nothing outside GTSAM.

    Parameters
    ----------
    problem : Problem
        With time-correlated errors of rims.

    Returns
    -------
    Ratio
        The run without such variables, and the difference of what iSAM2 takes for the graphs with and without
        them, over that run. The graphs have constant linear factors in place of ours, evaluated in C++.
    """
    reference = OnlineSmoother(UNKNOWING)
    of_errors, without = (_Recorded(problem, options) for options in (KNOWING, UNKNOWING))
    return _beside(lambda: reference.estimate(problem), of_errors.replay, without.replay, 1)


class _Recorded:
    """Updates of a session's solver, with constant linear factors in place of ours."""

    def __init__(self, problem: Problem, options: GraphOptions) -> None:
        self._updates: list[tuple[gtsam.NonlinearFactorGraph, gtsam.Values]] = []
        session = OnlineSession(problem, options)
        solver = session._solver
        self._relinearise_m = solver.relinearise_m
        update = solver.update

        def recording(
            graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int] = ()
        ) -> list[int]:
            if values.size():
                point = gtsam.Values(solver.tree.getLinearizationPoint())
                point.insert(values)
                self._updates.append((_linear(graph, point), values))
            return update(graph, values, time_s, drop)

        solver.update = recording  # type: ignore[method-assign]
        session.begin(problem.frames[0], problem.start)
        for frame in problem.frames[1:]:
            session.update(frame)

    def replay(self) -> Isam:
        """Update a new solver, and take the newest state and its covariance each time."""
        solver = Isam(self._relinearise_m)
        for graph, values in self._updates:
            solver.update(graph, values, 0.0)
            last = max(key for key in values.keys() if chr(gtsam.Symbol(key).chr()) == "x")  # noqa: SIM118
            n = gtsam.Symbol(last).index()
            solver.tree.calculateEstimatePose3(last)
            solver.tree.jointMarginalCovariance([last, V(n), B(n)]).fullMatrix()
        return solver


def _linear(graph: gtsam.NonlinearFactorGraph, point: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """Replace our factors by their linear ones at a point."""
    out = gtsam.NonlinearFactorGraph()
    for number in range(graph.size()):
        factor = graph.at(number)
        if isinstance(factor, gtsam.CustomFactor):
            factor = gtsam.LinearContainerFactor(factor.linearize(point), point)
        out.push_back(factor)
    return out
