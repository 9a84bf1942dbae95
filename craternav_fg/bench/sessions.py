"""The reference of the online estimators: the same frames, IMU and solver, with GTSAM's own factors."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.bench.problems import Bench
from craternav_fg.estimators.graph import FactorGraph, add_imu, add_prior, bias_vector, insert_state
from craternav_fg.estimators.incremental import FixedLagIsam, Isam


class Reference:
    """One update per frame, and the newest state with its joint covariance, as our session gives them.

    Parameters
    ----------
    bench : Bench
    solver : Isam or FixedLagIsam
    """

    def __init__(self, bench: Bench, solver: Isam | FixedLagIsam) -> None:
        self._bench = bench
        self._solver = solver
        self._number = 0
        self._state = gtsam.NavState(gtsam.Pose3(bench.gTb[0]), bench.gV[0])
        self._bias = np.zeros(6)
        graph = gtsam.NonlinearFactorGraph()
        values = gtsam.Values()
        add_prior(graph, bench.problem.initial)
        bench.landmark_factors(graph, 0)
        insert_state(values, 0, self._state, self._bias)
        solver.update(graph, values, 0.0)

    def update(self) -> None:
        """Take the next frame."""
        problem = self._bench.problem
        i = self._number
        begin_ns, end_ns = (problem.frames[k].stamp_ns for k in (i, i + 1))
        graph = FactorGraph()
        values = gtsam.Values()
        midpoint = self._state.position() + 0.5e-9 * (end_ns - begin_ns) * self._state.velocity()
        pim = add_imu(graph, problem, i, begin_ns, end_ns, midpoint, self._bias).pim
        bias = gtsam.imuBias.ConstantBias(self._bias[3:], self._bias[:3])
        insert_state(values, i + 1, pim.predict(self._state, bias), self._bias)
        self._number = i = i + 1
        self._bench.landmark_factors(graph, i)
        self._solver.update(graph, values, 1e-9 * end_ns)
        tree = self._solver.tree
        self._state = gtsam.NavState(tree.calculateEstimatePose3(X(i)), tree.calculateEstimateVector(V(i)))
        self._bias = bias_vector(tree.calculateEstimateConstantBias(B(i)))
        tree.jointMarginalCovariance([X(i), V(i), B(i)]).fullMatrix()
