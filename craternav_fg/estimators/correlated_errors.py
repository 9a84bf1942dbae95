"""Time-correlated errors of rims as variables of the graph.

A rim's image deviates from the prediction by the ground's deviation from an ellipse, by errors of the map and
by the illumination. This error is nearly the same in the next frame, and less and less so as the rim is seen
in another size and from another side. A measurement says how large this part is. Here it becomes a
Gauss-Markov process of unit variance for each crater (`RimSet.correlated`) and one constant vector for what
all rims of a descent share (`RimSet.shared`). Errors without such a variable are treated as white and their
variance is inflated: those of arcs, and all of them in estimators that have no such variables.
"""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import shape_change
from craternav_fg.errors import EstimationError
from craternav_fg.measurements import CORRELATED_SIZE, SHARED_SIZE, RimSet
from factors.conic_shape import ChartError

FloatArray = npt.NDArray[np.float64]

ERROR_LETTER = "r"
SHARED_KEY: int = gtsam.symbol("s", 0)
# Inflation of the variance of time-correlated errors where they are treated as white: they do not average out
# over the frames that show a crater. Half of some ten frames, as the errors of neighbouring rims differ.
# Fitted by `craternav_fg.calibration.variance_inflation`.
VARIANCE_INFLATION = 5.0


@dataclass(frozen=True)
class RimErrorOptions:
    """How time-correlated errors are modelled.

    Attributes
    ----------
    decay : float
        Change of a rim's image, see `ellipse.shape_change`, over which the correlation of its error falls to
        1/e. Fitted by `craternav_fg.calibration.correlated_errors`.
    step : float
        Change below which the error is the same variable; 0 makes one for every rim of every frame. Within a
        step the drift of the error is left out, which the smoother then takes for motion: at 0.2 its ANEES
        over real ground is up to a quarter larger than at 0.1. Smaller steps gain little.
    """

    decay: float = 0.8
    step: float = 0.1

    def __post_init__(self) -> None:
        if not 0.0 < self.decay < np.inf:
            raise EstimationError(f"decay: expected a positive number, found {self.decay}")
        if not 0.0 <= self.step < np.inf:
            raise EstimationError(f"step: expected 0 or more, found {self.step}")


@dataclass(frozen=True)
class _Track:
    key: int
    chart: FloatArray


class RimErrorStates:
    """The variables of time-correlated errors, frame by frame.

    Parameters
    ----------
    options : RimErrorOptions
    """

    def __init__(self, options: RimErrorOptions) -> None:
        self._options = options
        self._rims: dict[int, _Track] = {}
        self._shared = False
        self._count = 0

    def enter(
        self,
        rims: RimSet,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        holds: Callable[[int], bool] | None = None,
    ) -> list[ChartError]:
        """Add the variables that a frame's rims need to values, and their priors to a graph.

        Parameters
        ----------
        rims : RimSet
        graph : gtsam.NonlinearFactorGraph
        values : gtsam.Values
        holds : callable, optional
            holds(key): whether the solver still has a variable of an earlier frame. Without it, all of them
            are held.

        Returns
        -------
        list of ChartError
            For the frame's factor.
        """
        out: list[ChartError] = []
        if rims.correlated is not None:
            roots = np.zeros((len(rims), 5, CORRELATED_SIZE))
            roots[:, :, : rims.correlated.shape[2]] = rims.correlated
            for i, crater in enumerate(rims.craters.tolist()):
                chart = rims.chart[i]
                track = self._rims.get(crater)
                if (
                    track is not None
                    and holds is not None
                    and not (values.exists(track.key) or holds(track.key))
                ):
                    track = None
                change = np.inf if track is None else float(shape_change(track.chart, chart))
                if track is None or change > self._options.step:
                    key = self._next(None if track is None else track.key, change, graph, values)
                    track = _Track(key, chart)
                    self._rims[crater] = track
                out.append(ChartError(track.key, [i], roots[i : i + 1]))
        if rims.shared is not None and len(rims):
            if not self._shared or (holds is not None and not holds(SHARED_KEY)):
                self._shared = True
                values.insert(SHARED_KEY, np.zeros(SHARED_SIZE))
                unit = gtsam.noiseModel.Unit.Create(SHARED_SIZE)
                graph.push_back(gtsam.PriorFactorVector(SHARED_KEY, np.zeros(SHARED_SIZE), unit))
            out.append(ChartError(SHARED_KEY, range(len(rims)), rims.shared))
        return out

    def _next(
        self, before: int | None, change: float, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> int:
        key: int = gtsam.symbol(ERROR_LETTER, self._count)
        self._count += 1
        values.insert(key, np.zeros(CORRELATED_SIZE))
        correlation = 0.0 if before is None else float(np.exp(-change / self._options.decay))
        noise = gtsam.noiseModel.Isotropic.Sigma(CORRELATED_SIZE, np.sqrt(1.0 - correlation * correlation))
        unit, zero = np.eye(CORRELATED_SIZE), np.zeros(CORRELATED_SIZE)
        point = gtsam.Values()
        point.insert(key, zero)
        if before is None:
            linear = gtsam.JacobianFactor(key, unit, zero, noise)
        else:
            point.insert(before, zero)
            linear = gtsam.JacobianFactor(key, unit, before, -correlation * unit, zero, noise)
        graph.push_back(gtsam.LinearContainerFactor(linear, point))
        return key
