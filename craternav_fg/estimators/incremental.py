"""iSAM2 with what it needs to be fast and safe from Python, over all states or those of a fixed lag.

QR throughout: the Cholesky of GTSAM refuses realistic IMU information. The linearisation point is held for
as long as the solver lives: callbacks get that object and not a deep copy of all values.
"""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from craternav_fg.errors import EstimationError

# Relinearise a variable that moved by more: pose (rad, m), velocity (m/s), bias (m/s^2, rad/s). What is left
# out is of second order: a turn of 0.5 mrad or a shift of 1e-3 of the range are 0.01 sigma of a rim's
# measurement. Velocity and bias are linear in an IMU factor of a second, far beyond their priors.
RELINEARISE = {
    "x": np.array([5e-4, 5e-4, 5e-4, 5.0, 5.0, 5.0]),
    "v": np.full(3, 1.0),
    "b": np.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4]),
}
# Back-substitution goes on into the past until nothing moves by more (in practice: 1 m). The newest states
# are at the root and always exact; GTSAM's 1 mm would walk the whole past at every frame.
WILDFIRE = 1.0


def parameters() -> gtsam.ISAM2Params:
    """Parameters of iSAM2: QR, relinearisation by thresholds per kind of variable, checked from the root."""
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.relinearizeSkip = 1
    params.enablePartialRelinearizationCheck = True
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, steps in RELINEARISE.items():
        thresholds.insert((letter, steps))
    params.setRelinearizeThreshold(thresholds)
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(WILDFIRE))
    return params


# Variables after which the tree begins anew: five minutes of states at one a second.
MAX_VARIABLES = 900


class Isam:
    """iSAM2 that survives a failed update and costs the same however long the descent.

    GTSAM walks all cliques at every update. So a tree that has grown to `MAX_VARIABLES` hands its newest
    state on to a new one, as a Gaussian prior with the joint covariance: what lies before keeps its
    linearisation and its estimate of that moment.

    A callback that raises leaves iSAM2 with half of an update. Then the solver is built anew from the
    factors and the linearisation point of before; a copy ahead of every update would be just as safe, but
    its cost grows with the descent.
    """

    def __init__(self) -> None:
        self._hold: gtsam.Values | None = None
        self._past = gtsam.Values()
        self._new(gtsam.NonlinearFactorGraph(), gtsam.Values())

    @property
    def tree(self) -> gtsam.ISAM2:
        """Gives estimates and marginal covariances of the newest states; not to be kept: it gets replaced."""
        return self._tree

    def estimate(self) -> gtsam.Values:
        """Estimates of all states: those no longer in the tree as they were when they left it."""
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
            Of the new variables.
        drop : sequence of int
            Slots of factors to remove.

        Returns
        -------
        list of int
            Slots of the added factors, in their order, for as long as their variables are in the tree; a
            failed update makes all slots void.

        Raises
        ------
        EstimationError
            When a factor raised or the system is indeterminate; the solver is then as it was before.
        """
        factors = self.tree.getFactorsUnsafe()
        known = factors.size()
        dropped = [factors.at(slot) for slot in drop]
        try:
            self._apply(graph, values, time_s, drop)
        except (RuntimeError, ValueError) as error:
            self._take_back(known, drop, dropped, values)
            raise EstimationError(f"iSAM2 update failed and was taken back: {_first_line(error)}") from error
        if self._hold is None:
            self._hold = self.tree.getLinearizationPoint()
        return list(range(known, known + graph.size()))

    def again(self) -> None:
        """Relinearise what moved, and solve again.

        Raises
        ------
        EstimationError
            As `update` does.
        """
        self.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), 0.0)

    def _new(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """Begin again with these."""
        self._tree = gtsam.ISAM2(parameters())
        if graph.size():
            self._tree.update(graph, values)

    def _apply(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        self._tree.update(graph, values, drop)
        if self._tree.getLinearizationPoint().size() > MAX_VARIABLES:
            self._hand_on()

    def _hand_on(self) -> None:
        """Begin anew with the newest state."""
        estimate = self._tree.calculateBestEstimate()
        self._past.insert_or_assign(estimate)
        symbols = [gtsam.Symbol(key) for key in estimate.keys()]  # noqa: SIM118 (Values is no mapping)
        last = max(symbol.index() for symbol in symbols)
        keys = [symbol.key() for symbol in symbols if symbol.index() == last]
        point = gtsam.Values(estimate)
        for symbol in symbols:
            if symbol.index() != last:
                point.erase(symbol.key())
        joint = self._tree.jointMarginalCovariance(keys)
        whitening = np.linalg.inv(np.linalg.cholesky(joint.fullMatrix()))
        widths = [joint.at(key, key).shape[0] for key in keys]
        blocks = np.split(whitening, np.cumsum(widths)[:-1], axis=1)
        terms: list[Any] = [term for pair in zip(keys, blocks, strict=True) for term in pair]
        rows = len(whitening)
        prior = gtsam.JacobianFactor(*terms, np.zeros(rows), gtsam.noiseModel.Unit.Create(rows))  # type: ignore[call-overload]
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(gtsam.LinearContainerFactor(prior, point))
        self._new(graph, point)
        self._hold = None

    def _take_back(
        self, known: int, drop: Sequence[int], dropped: list[gtsam.NonlinearFactor], added: gtsam.Values
    ) -> None:
        factors = self.tree.getFactorsUnsafe()
        graph = gtsam.NonlinearFactorGraph()
        for slot in range(known):
            # Whether the update came as far as removing these is not known.
            if slot not in drop and factors.exists(slot):
                graph.push_back(factors.at(slot))
        for factor in dropped:
            graph.push_back(factor)
        values = gtsam.Values(self.tree.getLinearizationPoint())
        for key in added.keys():  # noqa: SIM118 (Values is no mapping)
            if values.exists(key):
                values.erase(key)
        self._hold = None
        self._new(graph, values)
        if graph.size():
            self._hold = self.tree.getLinearizationPoint()


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
        """Gives estimates and marginal covariances of the states inside the lag."""
        return self._smoother.getISAM2()

    def _new(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        stamps_s = self._smoother.timestamps() if graph.size() else {}
        self._smoother = gtsam.IncrementalFixedLagSmoother(self._lag_s, parameters())
        if graph.size():
            self._smoother.update(graph, values, {key: stamps_s[key] for key in values.keys()})  # noqa: SIM118

    def _apply(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float, drop: Sequence[int]
    ) -> None:
        self._smoother.update(graph, values, dict.fromkeys(values.keys(), time_s), drop)


def _first_line(error: Exception) -> str:
    """Shorten an error: GTSAM's may print whole graphs."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
