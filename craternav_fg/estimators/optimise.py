"""Levenberg-Marquardt driven from Python, with QR, and covariances.

GTSAM's own optimisers hand every custom factor a deep copy of all values, and their Cholesky refuses
realistic IMU information; `graph.linearize` and `EliminateQR` have neither fault.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from craternav_fg.errors import EstimationError

FloatArray = npt.NDArray[np.float64]

# Steps that the damping takes as large, by the letter of the key: pose (rad, m), velocity (m/s),
# bias (accelerometer m/s^2, gyro rad/s).
STEP_SCALES: dict[str, FloatArray] = {
    "x": np.array([0.1, 0.1, 0.1, 1e3, 1e3, 1e3]),
    "v": np.full(3, 5.0),
    "b": np.array([3e-3, 3e-3, 3e-3, 5e-6, 5e-6, 5e-6]),
}


@dataclass(frozen=True)
class LmOptions:
    """Levenberg-Marquardt.

    Attributes
    ----------
    max_iterations : int
        Linearisations at most.
    relative_tolerance : float
        Stop when the error falls by less than this share.
    first_damping : float
        Damping of the first step, in units of the step scales; it is divided by 10 after each success.
    """

    max_iterations: int = 50
    relative_tolerance: float = 1e-9
    first_damping: float = 1e-6


@dataclass(frozen=True)
class LmResult:
    """What the optimiser reached.

    Attributes
    ----------
    values : gtsam.Values
    error : float
        Half the sum of squares.
    iterations : int
    converged : bool
        False when the iterations ran out.
    """

    values: gtsam.Values
    error: float
    iterations: int
    converged: bool


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: LmOptions = LmOptions()
) -> LmResult:
    """Minimise the error of a graph.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Start; not changed.
    options : LmOptions

    Returns
    -------
    LmResult

    Raises
    ------
    EstimationError
        When the error at the start is not finite.
    """
    error = graph.error(values)
    if not np.isfinite(error):
        raise EstimationError(f"the error at the start is {error}")
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
    damping = options.first_damping
    keys = list(values.keys())
    for iteration in range(1, options.max_iterations + 1):
        linear = graph.linearize(values)
        while True:
            step = _damped(linear, keys, damping).optimize(ordering, gtsam.EliminateQR)
            candidate = values.retract(step)
            new_error = graph.error(candidate)
            if new_error <= error:
                break
            damping *= 10.0
            if damping > 1e12:
                # At the optimum to the last digit: rounding decides whether a step goes down.
                return LmResult(values, error, iteration, True)
        gain = error - new_error
        values, error = candidate, new_error
        damping *= 0.1
        if gain <= options.relative_tolerance * error + 1e-12:
            return LmResult(values, error, iteration, True)
    return LmResult(values, error, options.max_iterations, False)


def _damped(linear: gtsam.GaussianFactorGraph, keys: list[int], damping: float) -> gtsam.GaussianFactorGraph:
    """Add to a linear graph the damping of every variable."""
    damped = gtsam.GaussianFactorGraph()
    damped.push_back(linear)
    models = {}
    for letter, scales in STEP_SCALES.items():
        A = np.diag(np.sqrt(damping) / scales)
        models[letter] = (A, np.zeros(len(scales)), gtsam.noiseModel.Unit.Create(len(scales)))
    for key in keys:
        damped.push_back(gtsam.JacobianFactor(key, *models[chr(gtsam.Symbol(key).chr())]))
    return damped


def bayes_tree(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.ISAM2:
    """Linearise and eliminate by QR once; its `marginalCovariance` gives covariances.

    `gtsam.Marginals` knows Cholesky only.
    """
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.enableRelinearization = False
    isam = gtsam.ISAM2(params)
    isam.update(graph, values)
    return isam
