"""Cost of the estimators over frames and craters, beside what a first script would do.

`naive` is one `CustomFactor` per crater in numpy, with numerical derivatives, and GTSAM's own
Levenberg-Marquardt. `scipy` takes Gauss-Newton steps with our factors and scipy's sparse solver.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import X
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from craternav_fg.bench.problems import Bench, make
from craternav_fg.bench.ratios import RELATIVE_TOLERANCE, batch_graphs
from craternav_fg.bench.timing import seconds_of
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.incremental import FixedLagIsam, Isam
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from craternav_fg.files import replacing
from craternav_fg.linalg import whitening
from factors.arrays import FloatArray
from factors.custom import pose_factor

Report = Callable[[str, int, int], None]

FRAMES, CRATERS = (30, 100, 300, 1000), (3, 10, 30)
METHODS = ("ekf", "online", "fixed_lag", "batch", "scipy", "naive")
LAG_S = 30.0
REPETITIONS = 3
# Rims above which the naive graph, which takes minutes, is left out; it is timed once.
NAIVE_RIMS = 1000
# Of the naive derivatives, rad and as a share of a metre.
_STEPS = np.repeat([1e-6, 1e-2], 3)
_MAX_STEPS = 20


def scaling(
    report: Report, frames: tuple[int, ...] = FRAMES, craters: tuple[int, ...] = CRATERS
) -> list[dict[str, Any]]:
    """Time all methods on problems of all sizes.

    Parameters
    ----------
    report : callable
        Called with a description, the number of finished problems and of all.
    frames, craters : tuple of int
        Numbers of frames, and of craters in each.

    Returns
    -------
    list of dict
        For each problem `frames`, `craters`, and by the names of `METHODS` the processor time per frame in
        ms: the median of `REPETITIONS`, all methods in turn; None where a method is left out.
    """
    rows: list[dict[str, Any]] = []
    sizes = [(n, m) for n in frames for m in craters]
    for n, m in sizes:
        calls = methods(make(n, m))
        seconds: dict[str, list[float]] = {name: [] for name in calls}
        for turn in range(REPETITIONS + 1):
            for name, call in calls.items():
                # The first turn fills caches.
                if (turn == 1) if name == "naive" else turn > 0 or not rows:
                    seconds[name].append(seconds_of(call))
        per_frame = {name: 1e3 * float(np.median(s[-REPETITIONS:])) / n for name, s in seconds.items()}
        rows.append({"frames": n, "craters": m, **{name: per_frame.get(name) for name in METHODS}})
        report("problems", len(rows), len(sizes))
    return rows


def methods(bench: Bench) -> dict[str, Callable[[], object]]:
    """Return the methods as functions without parameters, by name, for one problem.

    Parameters
    ----------
    bench : Bench

    Returns
    -------
    dict of str to callable
    """
    ours, _, values = batch_graphs(bench)
    options = LmOptions(relative_tolerance=RELATIVE_TOLERANCE)
    found: dict[str, Callable[[], object]] = {
        "ekf": lambda: ekf().states(bench.problem),
        "online": lambda: _session(bench, Isam()),
        "fixed_lag": lambda: _session(bench, FixedLagIsam(LAG_S)),
        "batch": lambda: levenberg_marquardt(ours, values, options),
        "scipy": lambda: sparse_gauss_newton(ours, values),
    }
    if bench.points.shape[0] * bench.points.shape[1] <= NAIVE_RIMS:
        graph = naive_graph(bench, ours)
        params = gtsam.LevenbergMarquardtParams()
        params.setLinearSolverType("MULTIFRONTAL_QR")
        found["naive"] = lambda: gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    return found


def _session(bench: Bench, solver: Isam) -> None:
    session = OnlineSession(bench.problem, solver=solver)
    session.begin(bench.problem.frames[0], bench.problem.start)
    for frame in bench.problem.frames[1:]:
        session.update(frame)


def sparse_gauss_newton(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Minimise the error of a graph by the sparse normal equations, their columns scaled.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Initial values; not changed.

    Returns
    -------
    gtsam.Values
    """
    keys = sorted(values.keys())
    zero = values.zeroVectors()
    ends = np.cumsum([0, *(len(zero.at(key)) for key in keys)])
    places = {key: np.arange(begin, end) for key, begin, end in zip(keys, ends[:-1], ends[1:], strict=True)}
    error = graph.error(values)
    for _ in range(_MAX_STEPS):
        J, r = _system(graph.linearize(values), places)
        scale = 1.0 / np.sqrt((J * J).sum(axis=0))
        A = J * scale
        step = scale * splu((A.T @ A).tocsc()).solve(A.T @ r)
        delta = gtsam.VectorValues()
        for key, place in places.items():
            delta.insert(key, step[place])
        values = values.retract(delta)
        last, error = error, graph.error(values)
        if abs(last - error) <= RELATIVE_TOLERANCE * error:
            break
    return values


def _system(
    linear: gtsam.GaussianFactorGraph, places: dict[int, npt.NDArray[np.int64]]
) -> tuple[Any, FloatArray]:
    """Sparse Jacobian, with the columns of a key at its places, and right-hand side of a linear graph."""
    data, rows, columns, right = [], [], [], []
    row = 0
    for number in range(linear.size()):
        factor = linear.at(number)
        A, b = factor.jacobian()
        own = np.concatenate([places[key] for key in factor.keys()])  # noqa: SIM118 (KeyVector is no mapping)
        data.append(A.ravel())
        rows.append(np.repeat(row + np.arange(len(b)), len(own)))
        columns.append(np.tile(own, len(b)))
        right.append(b)
        row += len(b)
    indices = (np.concatenate(rows), np.concatenate(columns))
    return coo_array((np.concatenate(data), indices)).tocsc(), np.concatenate(right)


def naive_graph(bench: Bench, ours: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """Make the graph of a descent with one factor per crater, in numpy.

    Parameters
    ----------
    bench : Bench
    ours : gtsam.NonlinearFactorGraph
        Its prior and its IMU factors are taken.

    Returns
    -------
    gtsam.NonlinearFactorGraph
    """
    graph = gtsam.NonlinearFactorGraph()
    for number in range(ours.size()):
        if not isinstance(ours.at(number), gtsam.CustomFactor):
            graph.push_back(ours.at(number))
    problem = bench.problem
    for i, frame in enumerate(problem.frames):
        W = whitening(frame.rims.covariance)
        for k, row in enumerate(frame.rims.craters.tolist()):
            residual = _residual(
                problem.catalog.centres[row], problem.catalog.axes[row], frame.rims.chart[k], W[k]
            )
            graph.push_back(pose_factor(X(i), 5, _differenced(residual), problem.camera.bTc))
    return graph


def _residual(
    centre: FloatArray, axes: FloatArray, chart: FloatArray, W: FloatArray
) -> Callable[[FloatArray], FloatArray]:
    """Whitened difference of predicted and measured chart of one rim, by the camera's pose (4, 4) in g."""

    def residual(gTc: FloatArray) -> FloatArray:
        cRg, P = gTc[:3, :3].T, gTc[:3, 3]
        p, (a, b) = cRg @ (centre - P), axes @ cRg.T
        C = np.outer(p, p) - np.outer(a, a) - np.outer(b, b)
        m = C[:2, 2] / C[2, 2]
        S = np.outer(m, m) - C[:2, :2] / C[2, 2]
        y = [*m, 0.5 * np.log(S[0, 0]), S[0, 1] / S[0, 0], 0.5 * np.log(S[1, 1] - S[0, 1] ** 2 / S[0, 0])]
        return np.asarray(W @ (np.array(y) - chart))

    return residual


def _differenced(
    residual: Callable[[FloatArray], FloatArray],
) -> Callable[[FloatArray, FloatArray, bool, FloatArray, FloatArray], None]:
    """Kernel of `pose_factor` with central differences."""

    def kernel(gTb: FloatArray, bTc: FloatArray, linearise: bool, e: FloatArray, J: FloatArray) -> None:
        e[:] = residual(gTb @ bTc)
        if not linearise:
            return
        pose = gtsam.Pose3(gTb)
        for k, step in enumerate(_STEPS):
            twist = np.zeros(6)
            twist[k] = step
            up, down = (residual(pose.retract(sign * twist).matrix() @ bTc) for sign in (1.0, -1.0))
            J[:, k] = (up - down) / (2.0 * step)

    return kernel


def write_figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw time per frame over the number of frames, a panel for each number of craters."""
    craters = sorted({row["craters"] for row in rows})
    figure = Figure(figsize=(4.0 * len(craters), 3.8), layout="constrained")
    for axes, m in zip(np.atleast_1d(figure.subplots(1, len(craters), sharey=True)), craters, strict=True):
        for name in METHODS:
            found = [
                (row["frames"], row[name]) for row in rows if row["craters"] == m and row[name] is not None
            ]
            if found:
                axes.loglog(*zip(*found, strict=True), "o-", label=name)
        axes.set(xlabel="frames", title=f"{m} craters in a frame")
        axes.grid(alpha=0.3, which="both")
    figure.axes[0].set(ylabel="processor time, ms a frame")
    figure.axes[0].legend(frameon=False)
    with replacing(path) as temporary:
        FigureCanvasAgg(figure).print_figure(temporary, dpi=150, format=path.suffix.lstrip(".") or "png")
