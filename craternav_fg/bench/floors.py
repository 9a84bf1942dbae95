"""Costs that no factor written in Python can undercut, and the cost of one step of the batch optimiser."""

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import X

from craternav_fg.bench.problems import Bench
from craternav_fg.bench.ratios import RELATIVE_TOLERANCE, Ratio, batch_graphs, interleaved, projection_factors
from craternav_fg.estimators.graph import FactorGraph
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from factors.conic_shape import REDUCED_ROWS
from factors.custom import PackedKernel, packed_pose_factor

FloatArray = npt.NDArray[np.float64]


def factor_floor(bench: Bench, repetitions: int = 31) -> Ratio:
    """Compare factors whose callback computes nothing with GTSAM's `GenericProjectionFactor`.

    Parameters
    ----------
    bench : Bench
    repetitions : int

    Returns
    -------
    Ratio
        Of the time to linearise all frames, with one factor of as many rows as ours for each frame; they have
        several rims.
    """
    values = bench.values(np.random.default_rng(1), scale=0.1)
    reference = projection_factors(bench, values)
    empty = FactorGraph()
    for i in range(len(bench.problem.frames)):
        empty.push_back(packed_pose_factor(X(i), REDUCED_ROWS, lambda *_: 0.0, np.zeros(1)))
    return interleaved(lambda: empty.linearize(values), lambda: reference.linearize(values), repetitions)


def batch_steps(bench: Bench, repetitions: int = 15) -> tuple[dict[str, Ratio], dict[str, float]]:
    """Compare single steps of the batch optimiser: linearise, solve by QR, move, evaluate the error.

    Parameters
    ----------
    bench : Bench
    repetitions : int

    Returns
    -------
    ratios : dict of str to Ratio
        `batch_step_ratio`: with our factors over GTSAM's own; `batch_step_floor`: with callbacks that compute
        nothing.
    counts : dict of str to float
        `batch_iterations` and `batch_reference_iterations`: steps until the decrease is below the tolerance.
    """
    ours, reference, values = batch_graphs(bench)
    frozen = _frozen(ours, ours.linearize(values))
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(ours)

    def step(graph: gtsam.NonlinearFactorGraph) -> float:
        moved = values.retract(graph.linearize(values).optimize(ordering, gtsam.EliminateQR))
        return float(graph.error(moved))

    ratios = {
        "batch_step_ratio": interleaved(lambda: step(ours), lambda: step(reference), repetitions),
        "batch_step_floor": interleaved(lambda: step(frozen), lambda: step(reference), repetitions),
    }
    options = LmOptions(relative_tolerance=RELATIVE_TOLERANCE)
    counts = {
        "batch_iterations": float(levenberg_marquardt(ours, values, options).iterations),
        "batch_reference_iterations": float(levenberg_marquardt(reference, values, options).iterations),
    }
    return ratios, counts


def _frozen(graph: gtsam.NonlinearFactorGraph, linear: gtsam.GaussianFactorGraph) -> FactorGraph:
    """Replace our factors by ones that always return what they return at one point."""
    out = FactorGraph()
    for number in range(graph.size()):
        factor = graph.at(number)
        if not isinstance(factor, gtsam.CustomFactor):
            out.push_back(factor)
            continue
        A, b = linear.at(number).jacobian()
        out.push_back(packed_pose_factor(factor.keys()[0], len(b), _constant(A, b), np.zeros(1)))
    return out


def _constant(A: FloatArray, b: FloatArray) -> PackedKernel:
    """Kernel that writes a Jacobian and a residual when it is first called, and nothing later."""

    def kernel(gTb: FloatArray, data: FloatArray, linearise: bool, out: FloatArray) -> float:
        if data[0] == 0.0:
            out[:6], out[6], data[0] = A.T, -b, 1.0
        return 0.0

    return kernel
