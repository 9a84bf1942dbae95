"""iSAM2 with what it needs to be fast and safe from Python, over all states or those of a fixed lag.

QR throughout: the Cholesky of GTSAM refuses realistic IMU information. The linearisation point is held for
as long as the solver lives: callbacks get that object and not a deep copy of all values.
"""

from typing import Protocol

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


class Solver(Protocol):
    """What a session asks of its incremental solver."""

    @property
    def tree(self) -> gtsam.ISAM2:
        """Gives estimates and marginal covariances; not to be kept."""
        ...

    def update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float) -> None:
        """Add factors, and values of new variables; `time_s` is that of the newest."""
        ...

    def again(self) -> None:
        """Relinearise what moved, and solve again."""
        ...


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


class Isam:
    """iSAM2 over all states, that survives a failed update.

    A callback that raises leaves iSAM2 with half of an update. Then the solver is built anew from the
    factors and the linearisation point of before; a copy ahead of every update would be just as safe, but
    its cost grows with the descent.
    """

    def __init__(self) -> None:
        self._tree = gtsam.ISAM2(parameters())
        self._hold: gtsam.Values | None = None

    @property
    def tree(self) -> gtsam.ISAM2:
        """Gives estimates and marginal covariances; replaced after a failed update."""
        return self._tree

    def update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float) -> None:
        """Add factors, and values of new variables.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
        values : gtsam.Values
        time_s : float
            Not used: every state is kept.

        Raises
        ------
        EstimationError
            When a factor raised or the system is indeterminate; the solver is then as it was before.
        """
        known = self._tree.getFactorsUnsafe().size()
        try:
            self._tree.update(graph, values)
        except (RuntimeError, ValueError) as error:
            self._restore(known, list(values.keys()))
            raise EstimationError(f"iSAM2 update failed and was taken back: {_first_line(error)}") from error
        if self._hold is None:
            self._hold = self._tree.getLinearizationPoint()

    def again(self) -> None:
        """Relinearise what moved, and solve again.

        Raises
        ------
        EstimationError
            As `update` does.
        """
        self.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), 0.0)

    def _restore(self, known: int, added: list[int]) -> None:
        values = gtsam.Values(self._tree.getLinearizationPoint())
        factors = self._tree.getFactorsUnsafe()
        graph = gtsam.NonlinearFactorGraph()
        for i in range(known):
            graph.push_back(factors.at(i))
        for key in added:
            if values.exists(key):
                values.erase(key)
        self._tree = gtsam.ISAM2(parameters())
        self._hold = None
        if known:
            self._tree.update(graph, values)
            self._hold = self._tree.getLinearizationPoint()


class FixedLagIsam:
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
        params = parameters()
        # Slots of marginalised factors are used again: else their number grows with the descent.
        params.findUnusedFactorSlots = True
        self._smoother = gtsam.IncrementalFixedLagSmoother(lag_s, params)
        self._hold: gtsam.Values | None = None

    @property
    def tree(self) -> gtsam.ISAM2:
        """Gives estimates and marginal covariances of the states inside the lag."""
        return self._smoother.getISAM2()

    def update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, time_s: float) -> None:
        """Add factors, and values of new variables, all of them stamped `time_s`."""
        self._smoother.update(graph, values, dict.fromkeys(values.keys(), time_s))
        if self._hold is None:
            self._hold = self._smoother.getLinearizationPoint()

    def again(self) -> None:
        """Relinearise what moved, and solve again."""
        self._smoother.update()


def _first_line(error: Exception) -> str:
    """Shorten an error: GTSAM's may print whole graphs."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
