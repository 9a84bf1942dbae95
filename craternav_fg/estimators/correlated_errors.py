"""Time-correlated errors of rims as variables of the graph.

A rim's image deviates from the prediction by the ground's deviation from an ellipse, by errors of the map and
by the illumination. This error is nearly the same in the next frame, and less and less so as the rim is seen
in another size and from another side. A measurement says how large this part is. Here it becomes a
Gauss-Markov process of unit variance for each crater (`RimSet.correlated`) and one constant vector for what
all rims of a descent share (`RimSet.shared`). Errors without such a variable are treated as white and their
variance is inflated: those of arcs, and all of them in estimators that have no such variables.

The error of a rim's place drifts smoothly, as shading moves along a crest: its process is a Matern process
of order 3/2, which has a derivative. If it had none, its drift from frame to frame would count as
independent, and the smoother would take it for motion. The other errors follow an Ornstein-Uhlenbeck process:
derivatives of them, too, are likelier, but double the unknowns and hardly change poses.
"""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import shape_change
from craternav_fg.errors import EstimationError
from craternav_fg.linalg import whitening
from craternav_fg.measurements import CORRELATED_SIZE, SHARED_SIZE, RimSet
from factors.conic_shape import ChartError

FloatArray = npt.NDArray[np.float64]

ERROR_LETTER = "r"
# Of the columns of `RimSet.correlated`, those that move a rim within its plane come first.
PLACE_SIZE = 2
# A variable of a crater: its error, then the derivatives of the error of its place.
STATE_SIZE = CORRELATED_SIZE + PLACE_SIZE
# Least change of an image after which a process goes on: below, nothing new is to be seen.
_LEAST_CHANGE = 1e-3
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
        Change of a rim's image, see `ellipse.shape_change`, that is the scale of the correlation of its
        errors, see `correlation`. Fitted by `craternav_fg.calibration.correlated_errors`.
    step : float
        Change below which the error is the same variable; 0 makes one for every rim of every frame. Within a
        step a rim's place drifts as the variable says, and its other errors are constant.
    freedom : float
        Degrees of freedom of Student's t distribution that the errors which craters keep follow in the batch
        smoother, see `crater_scatter`; infinite for a normal one. Fitted to rims on real ground against a
        published map by `craternav_fg.calibration.common_shift`.
    """

    decay: float = 0.8
    step: float = 0.1
    freedom: float = 4.0

    def __post_init__(self) -> None:
        if not 0.0 < self.decay < np.inf:
            raise EstimationError(f"decay: expected a positive number, found {self.decay}")
        if not 0.0 <= self.step < np.inf:
            raise EstimationError(f"step: expected 0 or more, found {self.step}")
        if not self.freedom > 0.0:
            raise EstimationError(f"freedom: expected a positive number, found {self.freedom}")


def correlation(change: FloatArray, decay: float) -> tuple[FloatArray, FloatArray]:
    """Correlation of a crater's errors in two images.

    Parameters
    ----------
    change : ndarray, any shape
        Change of the rim's image between them, see `ellipse.shape_change`.
    decay : float
        See `RimErrorOptions`.

    Returns
    -------
    of_place, of_others : ndarray, shape of `change`
        (1 + sqrt(3) c) exp(-sqrt(3) c) for the error of the rim's place and exp(-c) for the others, with the
        change c in units of the decay.

    References
    ----------
    Rasmussen, Williams, Gaussian Processes for Machine Learning (2006), section 4.2.
    """
    u = np.sqrt(3.0) * change / decay
    return (1.0 + u) * np.exp(-u), np.exp(-change / decay)


def transition(change: float, decay: float) -> FloatArray:
    """Transition of a crater's state, whose stationary covariance is the identity.

    The noise that a change adds has the covariance 1 - F F'.

    Parameters
    ----------
    change : float
        Change of the rim's image.
    decay : float
        See `RimErrorOptions`.

    Returns
    -------
    ndarray, shape (8, 8)
        F. Of the state, the first six entries are the errors, those of the place first, in units of their
        standard deviations; the last two are the derivatives of those of the place, likewise.
    """
    F = np.exp(-change / decay) * np.eye(STATE_SIZE)
    u = np.sqrt(3.0) * change / decay
    for i, j in zip(range(PLACE_SIZE), range(CORRELATED_SIZE, STATE_SIZE), strict=True):
        F[np.ix_([i, j], [i, j])] = np.exp(-u) * np.array([[1.0 + u, u], [-u, 1.0 - u]])
    return F


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
            roots = np.zeros((len(rims), 5, STATE_SIZE))
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
                if track is None or change > max(self._options.step, _LEAST_CHANGE):
                    key = self._next(None if track is None else track.key, change, graph, values)
                    track = _Track(key, chart)
                    self._rims[crater] = track
                elif change > 0.0:
                    drift = transition(change, self._options.decay)[:PLACE_SIZE]
                    of_place = roots[i, :, :PLACE_SIZE] @ drift
                    roots[i, :, :PLACE_SIZE] = 0.0
                    roots[i] += of_place
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
        values.insert(key, np.zeros(STATE_SIZE))
        unit, zero = np.eye(STATE_SIZE), np.zeros(STATE_SIZE)
        white = gtsam.noiseModel.Unit.Create(STATE_SIZE)
        point = gtsam.Values()
        point.insert(key, zero)
        if before is None:
            linear = gtsam.JacobianFactor(key, unit, zero, white)
        else:
            point.insert(before, zero)
            F = transition(change, self._options.decay)
            W = whitening(unit - F @ F.T)
            linear = gtsam.JacobianFactor(key, W, before, -W @ F, zero, white)
        graph.push_back(gtsam.LinearContainerFactor(linear, point))
        return key
