"""Levenberg-Marquardt and Gauss-Newton driven from Python, with QR or Cholesky factorisation.

GTSAM's own optimisers hand every custom factor a deep copy of all values, and their Cholesky factorisation
refuses much realistic IMU information. `graph.linearize` does not have the first problem, `EliminateQR` and
the order of `elimination` not the second.
"""

from contextlib import suppress
from dataclasses import dataclass

import gtsam
import numpy as np

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.correlated_errors import MAP_LETTERS, STATE_SIZE
from craternav_fg.estimators.graph import cholesky_order
from craternav_fg.measurements import SHARED_SIZE
from factors.arrays import FloatArray

# Steps that the damping treats as of size 1, by the letter of the key: pose (rad, m), velocity (m/s),
# bias (accelerometer m/s^2, gyro rad/s), mounting of the camera (rad, m).
STEP_SCALES: dict[str, FloatArray] = {
    "x": np.array([0.1, 0.1, 0.1, 1e3, 1e3, 1e3]),
    "y": np.array([0.1, 0.1, 0.1, 1e3, 1e3, 1e3]),
    "d": np.full(1, 0.1),
    "m": np.full(6, 1.0),
    "v": np.full(3, 5.0),
    "c": np.array([0.01, 0.01, 0.01, 0.1, 0.1, 0.1]),
    "r": np.full(STATE_SIZE, 1.0),
    **{letter: np.full(size, 1.0) for size, letter in MAP_LETTERS.items()},
    "s": np.full(SHARED_SIZE, 1.0),
    "l": np.full(3, 1e3),
    "k": np.full(4, 1.0),
    **{str(size): np.full(size, 1.0) for size in range(1, 10)},
    "b": np.array([3e-3, 3e-3, 3e-3, 5e-6, 5e-6, 5e-6]),
}
# Largest decrease of the error that a full step predicts at an optimum: a tenth of a standard deviation.
MAX_PREDICTED_DECREASE = 5e-3
# Share of the error by which a step may lower it and yet be the last one, if it does as predicted.
MAX_LAST_SHARE = 0.01


@dataclass(frozen=True)
class LmOptions:
    """Levenberg-Marquardt.

    Attributes
    ----------
    max_iterations : int
        Largest number of linearisations.
    relative_tolerance : float
        Stop when the error falls by less than this share, or when a full step by QR lowers it by what the
        linear graph predicts, to within this share. The point reached is then the minimum of both: where
        steps shrink by a factor r each, less than r/(1 - r) of the share is left.
    first_damping : float
        Damping after the first step that fails, in units of the step scales. It grows by 10 with each failure
        and falls by 10 with each success. Below it steps are not damped (Gauss-Newton).
    cholesky : bool
        Solve by Cholesky factorisation while it succeeds and the error falls: a fifth of the cost where a
        frame has many variables. Rounding spoils these steps a little, so that a step by QR may still lower
        the error by more than the tolerance, see `marginals.Marginals.predicted_decrease`.
    """

    max_iterations: int = 50
    relative_tolerance: float = 1e-9
    first_damping: float = 1e-6
    cholesky: bool = False

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise EstimationError(f"max_iterations: expected at least 1, found {self.max_iterations}")
        if not self.relative_tolerance >= 0.0:
            raise EstimationError(f"relative_tolerance: expected 0 or more, found {self.relative_tolerance}")
        if not 0.0 < self.first_damping < np.inf:
            raise EstimationError(f"first_damping: expected a positive number, found {self.first_damping}")


@dataclass(frozen=True)
class LmResult:
    """Result of an optimisation.

    Attributes
    ----------
    values : gtsam.Values
    error : float
        Half the sum of squares.
    iterations : int
    converged : bool
        False when the iterations ran out, or where a discontinuity of the error stopped them short of an
        optimum.
    contraction : float
        By what share of the last but one the last step lowered the error; 1 where they were not two.
    """

    values: gtsam.Values
    error: float
    iterations: int
    converged: bool
    contraction: float = 1.0


class _Solver:
    """Minimises the error of a graph's linear ones.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    cholesky : bool
        Whether to begin with Cholesky factorisation; QR takes over from the first graph that it refuses.
    """

    def __init__(self, graph: gtsam.NonlinearFactorGraph, *, cholesky: bool) -> None:
        self._graph = graph
        # That of the first linear graph: all have the same factors.
        self._ordering: gtsam.Ordering | None = None
        self.cholesky = cholesky

    def solve(self, linear: gtsam.GaussianFactorGraph) -> gtsam.VectorValues:
        """Minimise the error of one; RuntimeError where it does not determine all variables."""
        if self.cholesky:
            order = cholesky_order(self._graph, linear)
            with suppress(RuntimeError):
                return order.apart(linear).optimize(order.ordering)
            self.cholesky = False
        if self._ordering is None:
            self._ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        return linear.optimize(self._ordering, gtsam.EliminateQR)


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: LmOptions = LmOptions()
) -> LmResult:
    """Minimise the error of a graph.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Initial values; not changed.
    options : LmOptions

    Returns
    -------
    LmResult

    Raises
    ------
    EstimationError
        When the initial error is not finite.
    """
    error = graph.error(values)
    if not np.isfinite(error):
        raise EstimationError(f"the error at the start is {error}")
    solver = _Solver(graph, cholesky=options.cholesky)
    damping = gain = 0.0
    for iteration in range(1, options.max_iterations + 1):
        linear = graph.linearize(values)
        while True:
            step = _step(linear, values, solver, damping)
            candidate = None if step is None else values.retract(step)
            new_error = np.inf if candidate is None else graph.error(candidate)
            if new_error > error and solver.cholesky:
                solver.cholesky = False
                continue
            if candidate is not None and new_error > error and damping == 0.0:
                # Large turns and shifts together violate the stiff IMU factors to second order. Another step
                # corrects that, where damping would creep along them (the Maratos effect).
                step, second = None, _step(graph.linearize(candidate), candidate, solver, 0.0)
                candidate = None if second is None else candidate.retract(second)
                new_error = np.inf if candidate is None else graph.error(candidate)
            if candidate is not None and new_error <= error:
                break
            if new_error - error <= _gain_that_ends(error, options) or damping > 1e12:
                # At the optimum: rounding decides whether a step goes down.
                return LmResult(values, error, iteration, _at_rest(linear, solver, damping))
            damping = max(10.0 * damping, options.first_damping)
        last, gain = gain, error - new_error
        contraction = gain / last if last > gain else 1.0
        values, error = candidate, new_error
        if damping == 0.0 and step is not None and not solver.cholesky and gain <= MAX_LAST_SHARE * error:
            missed = abs(gain - _predicted_decrease(linear, step))
            if missed <= _gain_that_ends(error, options):
                return LmResult(values, error, iteration, True, contraction)
        damping = 0.1 * damping if damping > options.first_damping else 0.0
        if gain <= _gain_that_ends(error, options):
            return LmResult(values, error, iteration, _at_rest(linear, solver, damping), contraction)
    return LmResult(values, error, options.max_iterations, False)


def _gain_that_ends(error: float, options: LmOptions) -> float:
    """Decrease of the error below which the optimum is reached."""
    return options.relative_tolerance * error + 1e-12


def _at_rest(linear: gtsam.GaussianFactorGraph, solver: _Solver, damping: float) -> bool:
    """Whether damped steps that gain nothing have reached the optimum.

    Steps that shrink at a discontinuity, as where a rim leaves the view, gain as little; a full one predicts
    more.
    """
    if damping == 0.0:
        return True
    try:
        step = solver.solve(linear)
    except RuntimeError:
        return False
    return _predicted_decrease(linear, step) <= MAX_PREDICTED_DECREASE


def _predicted_decrease(linear: gtsam.GaussianFactorGraph, step: gtsam.VectorValues) -> float:
    """By how much a step lowers the error of a linear graph."""
    return float(linear.error(gtsam.VectorValues.Zero(step)) - linear.error(step))


def gauss_newton(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: LmOptions = LmOptions()
) -> LmResult:
    """Minimise the error of a graph by full steps, whether it falls or not, as iSAM2 does.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Initial values; not changed.
    options : LmOptions
        Its damping and `cholesky` are not used.

    Returns
    -------
    LmResult
        Not converged, too, when a step leads to where the graph does not determine all variables.
    """
    solver = _Solver(graph, cholesky=False)
    error = graph.error(values)
    for iteration in range(1, options.max_iterations + 1):
        step = _step(graph.linearize(values), values, solver, 0.0)
        if step is None:
            return LmResult(values, error, iteration, False)
        values = values.retract(step)
        last, error = error, graph.error(values)
        if abs(last - error) <= _gain_that_ends(error, options):
            return LmResult(values, error, iteration, True)
    return LmResult(values, error, options.max_iterations, False)


def _step(
    linear: gtsam.GaussianFactorGraph, values: gtsam.Values, solver: _Solver, damping: float
) -> gtsam.VectorValues | None:
    """Return one step from values; None when the undamped system does not determine all of it."""
    if damping > 0.0:
        linear = _damped(linear, list(values.keys()), damping)
    try:
        return solver.solve(linear)
    except RuntimeError:
        if damping > 0.0:
            raise
        return None


def _damped(linear: gtsam.GaussianFactorGraph, keys: list[int], damping: float) -> gtsam.GaussianFactorGraph:
    """Add to a linear graph the damping of every variable."""
    damped = gtsam.GaussianFactorGraph()
    damped.push_back(linear)
    models = {}
    for letter, scales in STEP_SCALES.items():
        A = np.diag(np.sqrt(damping) / scales)
        models[letter] = (A, np.zeros(len(scales)), gtsam.noiseModel.Unit.Create(len(scales)))
    for key in keys:
        letter = chr(gtsam.Symbol(key).chr())
        if letter not in models:
            raise EstimationError(
                f"variable {gtsam.DefaultKeyFormatter(key)}: expected one of {', '.join(models)} and a number"
            )
        damped.push_back(gtsam.JacobianFactor(key, *models[letter]))
    return damped
