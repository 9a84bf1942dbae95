"""iSAM2 made fast and safe to use from Python, over all states or those of a fixed lag.

GTSAM's Cholesky factorisation refuses realistic IMU information, but for an order as in `elimination`. Trees
that begin with errors of rims use it until it fails, as QR takes three times as long for them; all others use
QR. The linearisation point is held for as long as the solver lives: callbacks get that object and not a deep
copy of all values.
"""

from collections.abc import Sequence
from typing import SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.correlated_errors import ERROR_LETTER, MAP_LETTERS, SHARED_LETTER, STATE_SIZE
from craternav_fg.estimators.elimination import (
    APART_LETTER,
    SENSOR_BIASES,
    apart_key,
    has_rim_errors,
    newest_last,
    rounding,
)
from craternav_fg.estimators.tree_snapshot import (
    POINT,
    Snapshot,
    handed_on,
    letters_of,
    photograph,
    since,
    without_points,
)
from craternav_fg.measurements import SHARED_SIZE
from factors.arrays import FloatArray

# Relinearise a variable that moved by more: pose (rad, m), velocity (m/s), bias (m/s^2, rad/s). The remaining
# error is of second order: a turn of 0.5 mrad or a shift of 1e-3 of the range are 0.01 sigma of a rim's
# measurement. An IMU factor of a second is linear in velocity and bias far beyond their priors.
RELINEARISE_M = 5.0
RELINEARISE_STEPS = {
    "x": np.array([5e-4, 5e-4, 5e-4, RELINEARISE_M, RELINEARISE_M, RELINEARISE_M]),
    "v": np.full(3, 1.0),
    "r": np.full(STATE_SIZE, 1e3),
    **{letter: np.full(size, 1e3) for size, letter in MAP_LETTERS.items()},
    "s": np.full(SHARED_SIZE, 1e3),
    "b": np.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4]),
    APART_LETTER: np.full(1, 1e3),
    "c": np.array([5e-5, 5e-5, 5e-5, 0.1, 0.1, 0.1]),
    POINT: np.full(3, 20.0),
    **{letter: np.full(int(letter), 1e3) for letter in SENSOR_BIASES},
}
# Letters of variables that several states share: errors of rims, tracked points, biases of sensors.
SHARED_LETTERS = (ERROR_LETTER, *MAP_LETTERS.values(), SHARED_LETTER, POINT, *SENSOR_BIASES)
# Back-substitution continues into the past until no variable moves by more (in practice: 1 m). The newest
# states are at the root and always exact; GTSAM's 1 mm would visit the whole past at every frame.
WILDFIRE_STEP = 1.0


def parameters(position_m: float = RELINEARISE_M, *, cholesky: bool = False) -> gtsam.ISAM2Params:
    """Parameters of iSAM2: relinearisation by thresholds per kind of variable, checked from the root."""
    params = gtsam.ISAM2Params()
    params.setFactorization("CHOLESKY" if cholesky else "QR")
    params.relinearizeSkip = 1
    params.enablePartialRelinearizationCheck = True
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, steps in RELINEARISE_STEPS.items():
        if letter == "x":
            steps = np.concatenate([steps[:3], np.full(3, position_m)])
        thresholds.insert((letter, steps))
    params.setRelinearizeThreshold(thresholds)
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(WILDFIRE_STEP))
    return params


# What GTSAM says where it refuses a Cholesky factorisation.
_INDETERMINATE = "Indeterminate linear system"
# Estimate of lost digits beyond which QR takes over. Variances are wrong by up to thirty times it.
MAX_ROUNDING = 3e-5
# Largest number of variables of a tree, and of those that successive trees share: three minutes and one
# minute of states at one a second.
MAX_VARIABLES, OVERLAP_VARIABLES = 600, 180


class Isam:
    """iSAM2 that survives a failed update, and whose cost does not grow with the descent.

    GTSAM visits all cliques at every update. So a tree that has grown to `MAX_VARIABLES` is replaced by one
    of its newest states: those since a snapshot of an earlier state, which stands for all before it. Earlier
    states keep their linearisation; of their estimates, those at the time of the replacement can be kept.

    A callback that raises leaves iSAM2 with half of an update. Then the solver is rebuilt from the factors of
    before at the present linearisation point. A copy before every update would be safer still, but its cost
    grows with the tree.

    Parameters
    ----------
    relinearise_m : float
        See the attribute.
    keep_past : bool
        Whether the estimates of earlier states are kept for `estimate`; memory then grows with the descent.
    qr_alone : bool
        Whether Cholesky factorisation is never tried.

    Attributes
    ----------
    relinearise_m : float
        Shift of a pose beyond which it is relinearised; takes effect with the next tree.
    """

    def __init__(
        self, relinearise_m: float = RELINEARISE_M, *, keep_past: bool = False, qr_alone: bool = False
    ) -> None:
        self.relinearise_m = relinearise_m
        self._keep_past = keep_past
        self._hold: gtsam.Values
        self._past = gtsam.Values()
        self._snapshot: Snapshot | None = None
        # Whether the tree is factorised by Cholesky, and whether that is not to be tried again.
        self._cholesky, self._refused = False, qr_alone
        # Of the last update with new variables.
        self._order: gtsam.KeyGroupMap | None = None
        self._trees = 0
        self._new(gtsam.NonlinearFactorGraph(), gtsam.Values())

    @property
    def trees(self) -> int:
        """Number of trees so far: the slots of one are void in the next."""
        return self._trees

    @property
    def by_cholesky(self) -> bool:
        """Whether the present tree is factorised by Cholesky."""
        return self._cholesky

    @property
    def may_use_cholesky(self) -> bool:
        """Whether a tree with errors of rims is, or will be, factorised by Cholesky."""
        return not self._refused

    @property
    def tree(self) -> gtsam.ISAM2:
        """The present tree: estimates and covariances of the newest states; not to be kept, it changes."""
        return self._tree

    def estimate(self) -> gtsam.Values:
        """Estimates of all states in the tree; of earlier ones, if they are kept, those when they left it."""
        values = gtsam.Values(self._past)
        values.insert_or_assign(self.tree.calculateBestEstimate())
        return values

    def update(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int] = ()
    ) -> list[int]:
        """Add factors, and values of new variables.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
        values : gtsam.Values
        time_s : float
            Time of the new variables.
        drop : sequence of int
            Slots of factors to remove.

        Returns
        -------
        list of int
            Slots of the added factors, in their order, for as long as `trees` does not change.

        Raises
        ------
        EstimationError
            When a variable is there already, a slot is void, a factor raised or the system is indeterminate.
            The solver then holds what it held before.
        """
        # Not between a state's update and its repetition: slots that are to be dropped would be void.
        if values.size():
            self._bound(graph)
        factors = self.tree.getFactorsUnsafe()
        known = factors.size()
        point = self.tree.getLinearizationPoint()
        for key in values.keys():  # noqa: SIM118 (Values is no mapping)
            if point.exists(key):
                raise EstimationError(f"variable {gtsam.DefaultKeyFormatter(key)} is in the solver already")
        for slot in drop:
            if not (0 <= slot < known and factors.exists(slot)):
                raise EstimationError(f"slot {slot} holds no factor")
        dropped = [factors.at(slot) for slot in drop]
        try:
            self._apply(graph, values, time_s, drop)
        except (RuntimeError, ValueError) as error:
            refused = self._is_refusal(error)
            if refused:
                self._refused, self._cholesky = True, False
            self._take_back(known, drop, dropped, values)
            if refused:
                known = self.tree.getFactorsUnsafe().size()
                return self.update(graph, values, time_s, range(known - len(dropped), known))
            raise EstimationError(f"iSAM2 update failed and was taken back: {_first_line(error)}") from error
        return list(range(known, known + graph.size()))

    def joint_covariance(self, keys: Sequence[int], stiffness: FloatArray | None = None) -> FloatArray:
        """Give the joint covariance of variables; by QR where Cholesky factorisation loses too many digits.

        Parameters
        ----------
        keys : sequence of int
        stiffness : ndarray, shape (n,), optional
            Information of the first n entries given all else, to count lost digits: inverse squares of the
            units of each variable's tangent space.

        Returns
        -------
        ndarray, shape (m, m)
            In the order of the keys, in the units of each variable's tangent space.

        Raises
        ------
        EstimationError
            When the tree cannot be built anew by QR.
        RuntimeError
            When a variable is unknown.
        """
        try:
            joint = np.asarray(self.tree.jointMarginalCovariance(keys).fullMatrix())
        except RuntimeError as error:
            if not self._is_refusal(error):
                raise
        else:
            if not self._cholesky or stiffness is None:
                return joint
            n = len(stiffness)
            if rounding(stiffness, joint[:n, :n]) < MAX_ROUNDING:
                return joint
        self._refused, self._cholesky = True, False
        self._take_back(self.tree.getFactorsUnsafe().size(), (), [], gtsam.Values())
        return self.joint_covariance(keys)

    def _is_refusal(self, error: Exception) -> bool:
        """Whether GTSAM refused a Cholesky factorisation, which QR may not."""
        return self._cholesky and _INDETERMINATE in str(error)

    def again(self) -> None:
        """Relinearise the variables that moved, and solve again.

        Raises
        ------
        EstimationError
            As `update` does.
        """
        self.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), 0.0)

    def _new(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """Replace the tree by one of these factors."""
        self._trees += 1
        self._snapshot = None
        self._tree = gtsam.ISAM2(parameters(self.relinearise_m, cholesky=self._cholesky))
        self._hold = self._tree.getLinearizationPoint()
        self._points = 0
        self._bounded, self._with_errors = True, False
        if graph.size():
            self._tree.update(graph, values, [], self._order)
            self._count(values)

    def _apply(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        by_cholesky = not self._refused and has_rim_errors(values)
        if self._hold.empty() and by_cholesky != self._cholesky:
            self._cholesky = by_cholesky
            self._new(gtsam.NonlinearFactorGraph(), gtsam.Values())
        self._count(values)
        if not self._with_errors:
            self._tree.update(graph, values, drop)
            return
        order = None
        if values.size():
            graph, values, order = newest_last(graph, values)
        self._tree.update(graph, values, drop, self._order if order is None else order.update)
        if order is not None:
            self._order = order.later

    def _count(self, added: gtsam.Values) -> None:
        """Count tracked points, and see whether a snapshot can hand on all others, and which are errors."""
        self._points += letters_of(added).count(POINT)
        self._bounded = self._bounded and handed_on(added)
        self._with_errors = self._with_errors or has_rim_errors(added)

    def _size(self) -> int:
        """Count the variables but tracked points."""
        return int(self._hold.size()) - self._points

    def _bound(self, added: gtsam.NonlinearFactorGraph) -> None:
        """Take a snapshot of the newest state in time, and replace a large tree by one that begins there.

        Tracked points do not count: a tree with many of them would hold too few states. A tree with errors of
        rims stays, see `tree_snapshot.HANDED_ON`.
        """
        size = self._size()
        if self._snapshot is None:
            if self._bounded and size > MAX_VARIABLES - OVERLAP_VARIABLES:
                self._snapshot = photograph(self._tree, self._size())
            return
        if size <= MAX_VARIABLES or size < self._snapshot.size + OVERLAP_VARIABLES:
            return
        snapshot = self._snapshot
        now = self._tree.calculateBestEstimate()
        if snapshot.contradicts(now):
            self._snapshot = photograph(self._tree, self._size())
            return
        if self._keep_past:
            self._past.insert_or_assign(without_points(now))
        graph, values = since(snapshot, self._tree.getFactorsUnsafe(), now, added)
        self._new(graph, values)

    def _take_back(
        self, known: int, drop: Sequence[int], dropped: list[gtsam.NonlinearFactor], added: gtsam.Values
    ) -> None:
        """Build the tree of before an update that failed; the factors it was to drop come last."""
        factors = self.tree.getFactorsUnsafe()
        graph = gtsam.NonlinearFactorGraph()
        for slot in range(known):
            # Whether the update had removed these already is unknown.
            if slot not in drop and factors.exists(slot):
                graph.push_back(factors.at(slot))
        for factor in dropped:
            graph.push_back(factor)
        values = gtsam.Values(self.tree.getLinearizationPoint())
        for key in (*added.keys(), apart_key(added)):
            if values.exists(key):
                values.erase(key)
        try:
            self._new(graph, values)
        except (RuntimeError, ValueError) as error:
            raise EstimationError(
                f"iSAM2's factors could not be eliminated again: {_first_line(error)}"
            ) from error


class FixedLagIsam(Isam):
    """iSAM2 over the states of the last `lag_s` seconds; older ones are marginalised.

    Parameters
    ----------
    lag_s : float

    Raises
    ------
    EstimationError
        When the lag is not positive.
    """

    def __init__(self, lag_s: float) -> None:
        if not lag_s > 0.0:
            raise EstimationError(f"lag_s: expected a positive number, found {lag_s}")
        self._lag_s = lag_s
        self._smoother: gtsam.IncrementalFixedLagSmoother
        # It chooses the order of elimination itself.
        super().__init__(qr_alone=True)

    @property
    def tree(self) -> gtsam.ISAM2:
        """The present tree, for estimates and marginal covariances of the states inside the lag."""
        return self._smoother.getISAM2()

    def _new(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self._trees += 1
        stamps_s = self._smoother.timestamps() if graph.size() else {}
        self._smoother = gtsam.IncrementalFixedLagSmoother(self._lag_s, parameters())
        self._hold = self._smoother.getLinearizationPoint()
        if graph.size():
            self._smoother.update(graph, values, {key: stamps_s[key] for key in values.keys()})  # noqa: SIM118

    def _bound(self, added: gtsam.NonlinearFactorGraph) -> None:
        """Do nothing: the lag bounds the tree."""

    def _apply(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        stamps_s: dict[SupportsInt | SupportsIndex, SupportsFloat | SupportsIndex] = dict.fromkeys(
            values.keys(), time_s
        )
        # A shared variable lives for as long as new factors involve it.
        for number in range(graph.size()):
            keys = graph.at(number).keys()
            stamps_s.update((key, time_s) for key in keys if chr(gtsam.Symbol(key).chr()) in SHARED_LETTERS)
        self._smoother.update(graph, values, stamps_s, drop)


def _first_line(error: Exception) -> str:
    """Shorten an error: GTSAM's may print whole graphs."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
