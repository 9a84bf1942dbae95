"""iSAM2 made fast and safe to use from Python, over all states or those of a fixed lag.

QR throughout: GTSAM's Cholesky factorisation refuses realistic IMU information. The linearisation point is
held for as long as the solver lives: callbacks get that object and not a deep copy of all values.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.correlated_errors import ERROR_LETTER, MAP_LETTERS, SHARED_LETTER, STATE_SIZE
from craternav_fg.linalg import whitening
from craternav_fg.measurements import SHARED_SIZE
from factors.arrays import FloatArray

# Relinearise a variable that moved by more: pose (rad, m), velocity (m/s), bias (m/s^2, rad/s). The remaining
# error is of second order: a turn of 0.5 mrad or a shift of 1e-3 of the range are 0.01 sigma of a rim's
# measurement. An IMU factor of a second is linear in velocity and bias far beyond their priors.
RELINEARISE_M = 5.0
# Letter of tracked points.
POINT = "l"
# A sensor's bias has its length for a letter.
SENSOR_BIASES = tuple("123456789")
RELINEARISE_STEPS = {
    "x": np.array([5e-4, 5e-4, 5e-4, RELINEARISE_M, RELINEARISE_M, RELINEARISE_M]),
    "v": np.full(3, 1.0),
    "r": np.full(STATE_SIZE, 1e3),
    **{letter: np.full(size, 1e3) for size, letter in MAP_LETTERS.items()},
    "s": np.full(SHARED_SIZE, 1e3),
    "b": np.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4]),
    "c": np.array([5e-5, 5e-5, 5e-5, 0.1, 0.1, 0.1]),
    POINT: np.full(3, 20.0),
    **{letter: np.full(int(letter), 1e3) for letter in SENSOR_BIASES},
}
# Of a key, behind the letter.
INDEX_BITS = 56
INDEX_MASK = (1 << INDEX_BITS) - 1
# Letters of variables that belong to one state; others, such as the mounting, belong to all of them.
POSE = "x"
STATE_LETTERS = (POSE, "v", "b")
# Errors of one rim, of one crater on the map, and of all rims.
RIM_ERRORS = tuple(map(ord, (ERROR_LETTER, *MAP_LETTERS.values(), SHARED_LETTER)))
# Letters of variables that several states share: errors of rims, tracked points, biases of sensors.
SHARED_LETTERS = (ERROR_LETTER, *MAP_LETTERS.values(), SHARED_LETTER, POINT, *SENSOR_BIASES)
# Letters of variables whose tree can be replaced. Errors of rims are not handed on: those of all rims that
# may be seen again would make one dense factor, dearer than the whole tree; without them the present state
# would seem not to rest on rims that they spoilt.
HANDED_ON = {*STATE_LETTERS, POINT, *SENSOR_BIASES}
# Back-substitution continues into the past until no variable moves by more (in practice: 1 m). The newest
# states are at the root and always exact; GTSAM's 1 mm would visit the whole past at every frame.
WILDFIRE_STEP = 1.0


def parameters(position_m: float = RELINEARISE_M) -> gtsam.ISAM2Params:
    """Parameters of iSAM2: QR, relinearisation by thresholds per kind of variable, checked from the root."""
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
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


# Largest number of variables of a tree, and of those that successive trees share: three minutes and one
# minute of states at one a second.
MAX_VARIABLES, OVERLAP_VARIABLES = 600, 180
# A snapshot is taken when the newest attitude is known to this, as larger errors are not Gaussian. It is used
# when the later estimate agrees with it to this chi-square per degree of freedom.
SNAPSHOT_ATTITUDE_RAD = 0.01
SNAPSHOT_CHI2_RATIO = 50.0 / 15.0
# A tracked point goes on in the next tree when so many of its observations do.
LEAST_OBSERVATIONS = 3


@dataclass(frozen=True)
class _Snapshot:
    """What was known of a state when it was the newest, and of the sensors' biases.

    Attributes
    ----------
    index : int
        Index of the state.
    size, slots : int
        Number of variables, tracked points left out, and of factor slots of the tree at that time.
    prior : gtsam.LinearContainerFactor
        Gaussian of the state and of the biases, from all factors so far.
    """

    index: int
    size: int
    slots: int
    prior: gtsam.LinearContainerFactor


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

    Attributes
    ----------
    relinearise_m : float
        Shift of a pose beyond which it is relinearised; takes effect with the next tree.
    """

    def __init__(self, relinearise_m: float = RELINEARISE_M, *, keep_past: bool = False) -> None:
        self.relinearise_m = relinearise_m
        self._keep_past = keep_past
        self._hold: gtsam.Values
        self._past = gtsam.Values()
        self._snapshot: _Snapshot | None = None
        self._trees = 0
        self._new(gtsam.NonlinearFactorGraph(), gtsam.Values())

    @property
    def trees(self) -> int:
        """Number of trees so far: the slots of one are void in the next."""
        return self._trees

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
            self._take_back(known, drop, dropped, values)
            raise EstimationError(f"iSAM2 update failed and was taken back: {_first_line(error)}") from error
        return list(range(known, known + graph.size()))

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
        self._tree = gtsam.ISAM2(parameters(self.relinearise_m))
        self._hold = self._tree.getLinearizationPoint()
        self._points = 0
        self._bounded = True
        if graph.size():
            self._tree.update(graph, values)
            self._count(values)

    def _apply(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        self._count(values)
        # Only errors of rims, which no snapshot hands on, ask for an order of ours.
        order = None if self._bounded else _order(graph, values)
        self._tree.update(graph, values, drop, order)

    def _count(self, added: gtsam.Values) -> None:
        """Count tracked points, and see whether a snapshot can hand on all other variables."""
        letters = [chr(key >> INDEX_BITS) for key in added.keys()]  # noqa: SIM118 (Values is no mapping)
        self._points += letters.count(POINT)
        self._bounded = self._bounded and HANDED_ON.issuperset(letters)

    def _size(self) -> int:
        """Count the variables but tracked points."""
        return int(self._hold.size()) - self._points

    def _bound(self, added: gtsam.NonlinearFactorGraph) -> None:
        """Take a snapshot of the newest state in time, and replace a large tree by one that begins there.

        Tracked points do not count: a tree with many of them would hold too few states. A tree with errors of
        rims stays, see `HANDED_ON`.
        """
        size = self._size()
        if self._snapshot is None:
            if self._bounded and size > MAX_VARIABLES - OVERLAP_VARIABLES:
                self._snapshot = self._photograph()
            return
        if size <= MAX_VARIABLES or size < self._snapshot.size + OVERLAP_VARIABLES:
            return
        snapshot = self._snapshot
        now = self._tree.calculateBestEstimate()
        if 2.0 * snapshot.prior.error(now) > SNAPSHOT_CHI2_RATIO * snapshot.prior.dim():
            self._snapshot = self._photograph()
            return
        if self._keep_past:
            self._past.insert_or_assign(_without_points(now))
        graph, values = _since(snapshot, self._tree.getFactorsUnsafe(), now, added)
        self._new(graph, values)

    def _photograph(self) -> _Snapshot | None:
        """Take a snapshot of the newest state; None when it is uncertain."""
        symbols = [gtsam.Symbol(key) for key in self._hold.keys()]  # noqa: SIM118 (Values is no mapping)
        last = max(symbol.index() for symbol in symbols if chr(symbol.chr()) in STATE_LETTERS)
        keys = [
            symbol.key()
            for symbol in symbols
            if chr(symbol.chr()) in SENSOR_BIASES
            or (chr(symbol.chr()) in STATE_LETTERS and symbol.index() == last)
        ]
        joint = self._tree.jointMarginalCovariance(keys)
        pose = gtsam.symbol("x", last)
        if pose in keys and not np.diag(joint.at(pose, pose))[:3].max() < SNAPSHOT_ATTITUDE_RAD**2:
            return None
        try:
            W = whitening(joint.fullMatrix())
        except np.linalg.LinAlgError:
            # Rounding: a larger tree is better than a wrong prior.
            return None
        blocks = np.split(W, np.cumsum([joint.at(key, key).shape[0] for key in keys])[:-1], axis=1)
        point = self._tree.calculateBestEstimate()
        for symbol in symbols:
            if symbol.key() not in keys:
                point.erase(symbol.key())
        prior = gtsam.LinearContainerFactor(_jacobian_factor(keys, blocks), point)
        slots = self._tree.getFactorsUnsafe().size()
        return _Snapshot(last, self._size(), slots, prior)

    def _take_back(
        self, known: int, drop: Sequence[int], dropped: list[gtsam.NonlinearFactor], added: gtsam.Values
    ) -> None:
        factors = self.tree.getFactorsUnsafe()
        graph = gtsam.NonlinearFactorGraph()
        for slot in range(known):
            # Whether the update had removed these already is unknown.
            if slot not in drop and factors.exists(slot):
                graph.push_back(factors.at(slot))
        for factor in dropped:
            graph.push_back(factor)
        values = gtsam.Values(self.tree.getLinearizationPoint())
        for key in added.keys():  # noqa: SIM118 (Values is no mapping)
            if values.exists(key):
                values.erase(key)
        try:
            self._new(graph, values)
        except (RuntimeError, ValueError) as error:
            raise EstimationError(
                f"iSAM2 update failed and could not be taken back: {_first_line(error)}"
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
        super().__init__()

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


def _order(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.KeyGroupMap | None:
    """Put last in an elimination what the next frame changes: the newest state, before it errors of rims.

    GTSAM's own order keeps at the root all that new factors involve, also the states between two frames and
    the errors that new variables continue: a quarter of an update's cost. It is kept without such errors.
    """
    newest = max((key for key in values.keys() if key >> INDEX_BITS == ord(POSE)), default=-1)  # noqa: SIM118
    involved = [graph.at(number).keys() for number in range(graph.size())]
    errors = {key for keys in involved if newest in keys for key in keys if key >> INDEX_BITS in RIM_ERRORS}
    if not errors:
        return None
    groups = gtsam.KeyGroupMap()
    for key in errors:
        groups.insert2(key, 1)
    for letter in STATE_LETTERS:
        groups.insert2(gtsam.symbol(letter, newest & INDEX_MASK), 2)
    return groups


def _since(
    snapshot: _Snapshot,
    factors: gtsam.NonlinearFactorGraph,
    now: gtsam.Values,
    added: gtsam.NonlinearFactorGraph,
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the snapshot and the factors since, and the values of their variables.

    For tracked points the observations since then count, without what earlier ones told of the point. Those
    to which factors are about to be added are kept in any case.
    """
    needed = _keys(added)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(snapshot.prior)
    of_points: dict[int, list[gtsam.NonlinearFactor]] = {}
    alone: dict[int, gtsam.NonlinearFactor] = {}
    letters = {ord(letter) for letter in STATE_LETTERS}
    # Priors of points may be older than the snapshot.
    for slot in range(0 if _count_points(now) else snapshot.slots, factors.size()):
        if not factors.exists(slot):
            continue
        factor = factors.at(slot)
        keys = factor.keys()
        # A key's first byte is its letter, the rest its index; a `gtsam.Symbol` takes ten times as long.
        states = [key & INDEX_MASK for key in keys if key >> INDEX_BITS in letters]
        points = [key for key in keys if key >> INDEX_BITS == ord(POINT)]
        if points and not states:
            alone[points[0]] = factor
        elif slot < snapshot.slots or min(states, default=snapshot.index) < snapshot.index:
            continue
        elif points:
            of_points.setdefault(points[0], []).append(factor)
        else:
            graph.push_back(factor)
    for point, prior in alone.items():
        observations = of_points.get(point, [])
        if point in needed or len(observations) >= LEAST_OBSERVATIONS:
            for factor in (prior, *observations):
                graph.push_back(factor)
    kept = _keys(graph)
    values = gtsam.Values(now)
    for key in now.keys():  # noqa: SIM118 (Values is no mapping)
        if key not in kept:
            values.erase(key)
    return graph, values


def _keys(graph: gtsam.NonlinearFactorGraph) -> set[int]:
    """Keys of a graph's variables."""
    factors = [graph.at(number) for number in range(graph.size())]
    return {key for factor in factors for key in factor.keys()}  # noqa: SIM118 (KeyVector is no mapping)


def _count_points(values: gtsam.Values) -> int:
    return sum(key >> INDEX_BITS == ord(POINT) for key in values.keys())  # noqa: SIM118 (Values is no mapping)


def _without_points(values: gtsam.Values) -> gtsam.Values:
    if not _count_points(values):
        return values
    out = gtsam.Values(values)
    for key in values.keys():  # noqa: SIM118 (Values is no mapping)
        if key >> INDEX_BITS == ord(POINT):
            out.erase(key)
    return out


def _jacobian_factor(keys: list[int], blocks: list[FloatArray]) -> gtsam.JacobianFactor:
    """Linear factor |sum A_i x_i|^2 by blocks A_i of columns."""
    rows = len(blocks[0])
    terms: list[Any] = list(zip(keys, blocks, strict=True))
    # The only constructor that takes any number of variables.
    unit = gtsam.noiseModel.Unit.Create(rows)
    return gtsam.JacobianFactor(gtsam.GaussianConditional(terms, len(keys), np.zeros(rows), unit))


def _first_line(error: Exception) -> str:
    """Shorten an error: GTSAM's may print whole graphs."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
