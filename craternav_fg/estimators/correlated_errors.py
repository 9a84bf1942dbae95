"""Time-correlated errors of rims as variables of the graph.

A rim's image deviates from the prediction by the ground's deviation from an ellipse and by the illumination.
This error is nearly the same in the next frame, and less and less so as the rim is seen in another size and
from another side. A measurement says how large this part is. Here it becomes a Gauss-Markov process of unit
variance for each crater (`RimSet.correlated`). An error of the map is the same in all frames: one constant
vector for each crater (`RimSet.of_map`). So is what all rims of a descent share (`RimSet.shared`), arcs too
(`ArcSet.shared`). Errors without such a variable are treated as white and their variance is inflated: those
that the crater of an arc keeps, and all of them in estimators that have no such variables.

The error of a rim's place drifts smoothly, as shading moves along a crest: its process is a Matern process
of order 3/2, which has a derivative. If it had none, its drift from frame to frame would count as
independent, and the smoother would take it for motion. The other errors follow an Ornstein-Uhlenbeck process:
derivatives of them, too, are likelier, but double the unknowns and hardly change poses.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from craternav_fg.ellipse import shape_change
from craternav_fg.errors import EstimationError
from craternav_fg.measurements import (
    CORRELATED_SIZE,
    MAP_SIZE,
    SHARED_SIZE,
    TILT_SIZE,
    FrameMeasurement,
    RimSet,
)
from factors.arrays import FloatArray, IntArray
from factors.conic_shape import ChartError
from factors.kernels.compiled import njit

ERROR_LETTER = "r"
# Of a key, behind its letter.
_INDEX_BITS = 56
# Of the columns of `RimSet.correlated`, those that displace a rim come first.
PLACE_SIZE = 2
# Letters of the error of a crater on the map, by its size: slopes alone, all but slopes, all.
MAP_LETTERS = {TILT_SIZE: "t", MAP_SIZE: "e", MAP_SIZE + TILT_SIZE: "f"}
# A variable of a crater: its error, then the derivatives of the error of its place.
STATE_SIZE = CORRELATED_SIZE + PLACE_SIZE
_ZERO, _UNIT = np.zeros(STATE_SIZE), gtsam.noiseModel.Unit.Create(STATE_SIZE)
# Least change of an image after which a process goes on: below, nothing new is to be seen.
_LEAST_CHANGE = 1e-3
SHARED_LETTER = "s"
# Frames that involve one variable of the error that all rims share, where it is renewed, and the standard
# deviation by which the next one differs: of no effect after thousands, and harmless to factorisations.
SHARED_FRAMES, _EQUAL = 8, 1e-3
# Columns of `RimSet.shared` that belong to a region, by its slopes and its brightness: the shift towards the
# sun, and what the brightness of the ground does.
REGIONAL = (2, 7)
# Inflation of the variance of time-correlated errors where they are treated as white: they do not average out
# over the frames that show a crater. Half of some ten frames, as the errors of neighbouring rims differ.
# Fitted by `craternav_fg.calibration.variance_inflation`.
VARIANCE_INFLATION = 4.4


@dataclass(frozen=True)
class RimErrorOptions:
    """How time-correlated errors are modelled.

    Attributes
    ----------
    decay_shape_change : float
        Change of a rim's image, see `ellipse.shape_change`, that is the scale of the correlation of its
        errors, see `correlation`. Fitted by `craternav_fg.calibration.correlated_errors`.
    constant_place_share : float
        Share of the variance of a crater's place on the map that is the same in all images. The rest changes
        with the image, like the rim's own errors: heights vary along the rims of real craters, so that their
        centres move as they are seen from other sides. With a map that is wrong but for that, 1 is right.
        Chosen, see `craternav_fg.calibration`.
    region_overlap : float
        Share of a frame's craters below which its region is another one than that in which the present
        variable of the error that all rims share began.
    region_correlation : float
        Correlation of the errors that the rims of a region share with those of the next region, see
        `REGIONAL`. Chosen with `region_overlap`, see `craternav_fg.calibration`.
    step_shape_change : float
        Change below which the error is the same variable; 0 makes one for every rim of every frame. Within a
        step a rim's place drifts as the variable says, and its other errors are constant.
    """

    decay_shape_change: float = 0.8
    constant_place_share: float = 0.5
    region_overlap: float = 0.8
    region_correlation: float = 0.7
    step_shape_change: float = 0.1

    def __post_init__(self) -> None:
        if not 0.0 < self.decay_shape_change < np.inf:
            raise EstimationError(
                f"decay_shape_change: expected a positive number, found {self.decay_shape_change}"
            )
        if not 0.0 <= self.constant_place_share <= 1.0:
            raise EstimationError(f"constant_place_share: expected 0 to 1, found {self.constant_place_share}")
        if not 0.0 <= self.region_overlap <= 1.0:
            raise EstimationError(f"region_overlap: expected 0 to 1, found {self.region_overlap}")
        if not 0.0 <= self.region_correlation < 1.0:
            raise EstimationError(
                f"region_correlation: expected 0 to less than 1, found {self.region_correlation}"
            )
        if not 0.0 <= self.step_shape_change < np.inf:
            raise EstimationError(f"step_shape_change: expected 0 or more, found {self.step_shape_change}")


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
    ndarray, shape (7, 7)
        F. Of the state, the first five entries are the errors, those of the place first, in units of their
        standard deviations; the last two are the derivatives of those of the place, likewise.
    """
    return transitions(np.array([change]), decay)[0][0]


@njit(cache=True, error_model="numpy")
def transitions(changes: FloatArray, decay: float) -> tuple[FloatArray, FloatArray]:
    """Transitions of craters' states, see `transition`, and the whitening matrices of the noise they add.

    Parameters
    ----------
    changes : ndarray, shape (n,)
        Changes of the rims' images, dimensionless.
    decay : float
        See `RimErrorOptions`.

    Returns
    -------
    F, W : ndarray, shape (n, 7, 7)
        W is lower triangular, with W (1 - F F') W' = 1; not finite where nothing changes.
    """
    shape = len(changes), STATE_SIZE, STATE_SIZE
    F, W = np.zeros(shape), np.zeros(shape)
    for k in range(len(changes)):
        for i in range(PLACE_SIZE, CORRELATED_SIZE):
            F[k, i, i] = np.exp(-changes[k] / decay)
            W[k, i, i] = 1.0 / np.sqrt(-np.expm1(-2.0 * changes[k] / decay))
        u = np.sqrt(3.0) * changes[k] / decay
        left = np.exp(-u)
        a, b, c, d = left * (1.0 + u), left * u, -left * u, left * (1.0 - u)
        # Noise of the error and of its derivative: the root of their covariance, inverted.
        root = np.sqrt(1.0 - (a * a + b * b))
        low = -(a * c + b * d) / root
        rest = np.sqrt(1.0 - (c * c + d * d) - low * low)
        for i in range(PLACE_SIZE):
            j = CORRELATED_SIZE + i
            F[k, i, i], F[k, i, j], F[k, j, i], F[k, j, j] = a, b, c, d
            W[k, i, i], W[k, j, i], W[k, j, j] = 1.0 / root, -low / (root * rest), 1.0 / rest
    return F, W


def next_region(region: frozenset[int], craters: IntArray, options: RimErrorOptions) -> frozenset[int]:
    """Tell whether a frame still sees a region, by the craters of its rims.

    Parameters
    ----------
    region : frozenset of int
        Craters of the first frame of the present region.
    craters : ndarray of int, shape (n,)
        Those of the frame.
    options : RimErrorOptions

    Returns
    -------
    frozenset of int
        The same object, or the craters of the frame, which begins another region.
    """
    here = frozenset(craters.tolist())
    return region if len(here & region) >= options.region_overlap * len(here) else here


def correlation_of_regions(options: RimErrorOptions) -> FloatArray:
    """Correlation of the errors that all rims of a region share with those of the next one.

    Parameters
    ----------
    options : RimErrorOptions

    Returns
    -------
    ndarray, shape (8,)
        By the columns of `RimSet.shared`; almost 1 for errors that do not belong to a region.
    """
    correlation = np.full(SHARED_SIZE, np.sqrt(1.0 - _EQUAL**2))
    correlation[list(REGIONAL)] = options.region_correlation
    return correlation


class RimErrorStates:
    """The variables of rims' errors, frame by frame: time-correlated ones, those of the map, the shared one.

    Parameters
    ----------
    options : RimErrorOptions
    renewed : bool
        Whether the error that all rims share gets a new variable every `SHARED_FRAMES` frames, equal to the
        one before. For iSAM2: a variable that all frames involve makes each update visit all of them.
    """

    def __init__(self, options: RimErrorOptions, *, renewed: bool = False) -> None:
        self._options = options
        self._renewed = renewed
        # Of each crater: its present variable, and the chart at which it is the error itself.
        self._rims: dict[int, tuple[int, FloatArray]] = {}
        # Of each crater: the variable of its error on the map.
        self._of_map: dict[int, int] = {}
        self._count = self._map_count = 0
        # Variables of the shared error so far, the frames that involve the last one, and the craters of the
        # first frame of its region.
        self._shared = self._frames = 0
        self._region = frozenset[int]()
        # What `take_back` returns to: counts, and the former entries of both tables that have changed.
        self._counts = 0, 0, 0, 0, self._region
        self._former: list[tuple[dict[int, Any], int, Any]] = []

    def mark(self) -> None:
        """Note the present state: `take_back` returns to it."""
        self._counts = self._count, self._map_count, self._shared, self._frames, self._region
        self._former.clear()

    def take_back(self) -> None:
        """Forget the frames that have entered since `mark`."""
        self._count, self._map_count, self._shared, self._frames, self._region = self._counts
        for table, crater, former in reversed(self._former):
            if former is None:
                del table[crater]
            else:
                table[crater] = former
        self._former.clear()

    def _note(self, table: dict[int, Any], crater: int, value: object) -> None:
        """Change an entry of a table; `take_back` undoes it."""
        self._former.append((table, crater, table.get(crater)))
        table[crater] = value

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
            For the frame's factors.
        """
        rims = rims.with_changing_place(1.0 - self._options.constant_place_share)
        out: list[ChartError] = []
        if rims.correlated is not None and len(rims):
            out.append(self._of_craters(rims, rims.correlated, graph, values, holds))
        if rims.of_map is not None and len(rims):
            out.append(self._of_maps(rims, rims.of_map, graph, values, holds))
        if rims.shared is not None and len(rims):
            key = self._of_all(rims.craters, graph, values, holds)
            out.append(ChartError([key] * len(rims), rims.shared))
        return out

    def enter_arcs(
        self,
        frame: FrameMeasurement,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        holds: Callable[[int], bool] | None = None,
    ) -> tuple[int, FloatArray] | None:
        """Add the variable that a frame's arcs share with all rims, unless it is there.

        Parameters
        ----------
        frame : FrameMeasurement
            Its rims have entered.
        graph, values, holds
            See `enter`.

        Returns
        -------
        (int, ndarray of shape (n, 5, 8)) or None
            Key of the variable, and its roots: for the arcs' factor. None where nothing is shared.
        """
        roots = frame.arcs.shared
        if roots is None or not len(frame.arcs):
            return None
        if frame.rims.shared is None or not len(frame.rims):
            return self._of_all(frame.arcs.craters, graph, values, holds), roots
        return gtsam.symbol(SHARED_LETTER, self._shared - 1), roots

    def _of_all(
        self,
        craters: IntArray,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        holds: Callable[[int], bool] | None,
    ) -> int:
        """Go on with the variable that all rims share, or begin another."""
        last: int = gtsam.symbol(SHARED_LETTER, max(self._shared - 1, 0))
        held = self._shared > 0 and (holds is None or values.exists(last) or holds(last))
        region = next_region(self._region, craters, self._options)
        same = held and region is self._region
        if same and not (self._renewed and self._frames == SHARED_FRAMES):
            self._frames += 1
            return last
        key: int = gtsam.symbol(SHARED_LETTER, self._shared)
        self._shared, self._frames = self._shared + 1, 1
        zero, unit = np.zeros(SHARED_SIZE), gtsam.noiseModel.Unit.Create(SHARED_SIZE)
        values.insert(key, zero)
        if not held:
            graph.push_back(gtsam.PriorFactorVector(key, zero, unit))
        elif same:
            model = gtsam.noiseModel.Isotropic.Sigma(SHARED_SIZE, _EQUAL)
            graph.push_back(gtsam.BetweenFactorVector(last, key, zero, model))
        else:
            correlation = correlation_of_regions(self._options)
            W = np.diag(1.0 / np.sqrt(1.0 - correlation**2))
            graph.push_back(_link(key, W, last, W * correlation, unit))
        self._region = region
        return key

    def _of_maps(
        self,
        rims: RimSet,
        roots: FloatArray,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        holds: Callable[[int], bool] | None,
    ) -> ChartError:
        """Go on with the errors of craters on the map, and begin those of new craters."""
        size = roots.shape[2]
        letter = MAP_LETTERS[size]
        keys = []
        for crater in rims.craters.tolist():
            key = self._of_map.get(crater)
            # A crater may be seen with errors of another size.
            if (
                key is None
                or key >> _INDEX_BITS != ord(letter)
                or not (holds is None or values.exists(key) or holds(key))
            ):
                key = int(gtsam.symbol(letter, self._map_count))
                self._map_count += 1
                self._note(self._of_map, crater, key)
                values.insert(key, np.zeros(size))
                unit = gtsam.noiseModel.Unit.Create(size)
                graph.push_back(gtsam.PriorFactorVector(key, np.zeros(size), unit))
            keys.append(key)
        return ChartError(keys, roots)

    def _of_craters(
        self,
        rims: RimSet,
        correlated: FloatArray,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        holds: Callable[[int], bool] | None,
    ) -> ChartError:
        """Go on with the variables of craters that have changed little, and begin others."""
        craters = rims.craters.tolist()
        tracks = [self._rims.get(crater) for crater in craters]
        if holds is not None:
            tracks = [
                track if track is not None and (values.exists(track[0]) or holds(track[0])) else None
                for track in tracks
            ]
        before = np.array(
            [chart if track is None else track[1] for track, chart in zip(tracks, rims.chart, strict=True)]
        )
        changes = shape_change(before, rims.chart)
        ends = changes > max(self._options.step_shape_change, _LEAST_CHANGE)
        F, W = transitions(changes, self._options.decay_shape_change)
        # Within a step a place drifts as the variable says.
        drift = np.where(ends[:, None, None], np.eye(PLACE_SIZE, STATE_SIZE), F[:, :PLACE_SIZE])
        roots = np.zeros((len(rims), 5, STATE_SIZE))
        roots[:, :, PLACE_SIZE:CORRELATED_SIZE] = correlated[:, :, PLACE_SIZE:]
        roots += correlated[:, :, :PLACE_SIZE] @ drift
        keys = []
        for i, (crater, track) in enumerate(zip(craters, tracks, strict=True)):
            if track is None or ends[i]:
                key = gtsam.symbol(ERROR_LETTER, self._count)
                self._count += 1
                self._note(self._rims, crater, (key, rims.chart[i]))
                values.insert(key, _ZERO)
                if track is None:
                    graph.push_back(gtsam.PriorFactorVector(key, _ZERO, _UNIT))
                else:
                    graph.push_back(_link(key, W[i], track[0], W[i] @ F[i], _UNIT))
            else:
                key = track[0]
            keys.append(key)
        return ChartError(keys, roots)


def _link(
    key: int, W: FloatArray, before: int, WF: FloatArray, unit: gtsam.noiseModel.Unit
) -> gtsam.LinearContainerFactor:
    """Factor between two variables of an error of which one continues the other: W z = W F z_before."""
    zero, point = np.zeros(len(W)), gtsam.Values()
    for end in (key, before):
        point.insert(end, zero)
    return gtsam.LinearContainerFactor(gtsam.JacobianFactor(key, W, before, -WF, zero, unit), point)
