"""From how far a measurement finds its optimum: steps from many starting poses of one image."""

from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.optimise import LmResult, gauss_newton, levenberg_marquardt
from factors.arrays import FloatArray, IntArray

Method = Callable[[gtsam.NonlinearFactorGraph, gtsam.Values], LmResult]

METHODS: dict[str, Method] = {"gauss-newton": gauss_newton, "levenberg-marquardt": levenberg_marquardt}
# Key of the pose in the factors.
POSE = X(0)
# Number of steps that stands for a start from which the optimum is not reached.
NOT_REACHED = -1
# Distance from the optimum, in its standard deviations, that counts as reached.
_TOLERANCE_SIGMAS = 0.1


def steps_to_optimum(
    factors: Sequence[Any], near: FloatArray, starts: FloatArray, method: str = "gauss-newton"
) -> IntArray:
    """Count the steps from each starting pose to the optimum of an image's factors.

    Parameters
    ----------
    factors : sequence of gtsam factors
        On the pose of the key `POSE`; together they determine it.
    near : ndarray, shape (4, 4)
        A pose gTb from which Levenberg-Marquardt reaches the optimum, such as the truth, m.
    starts : ndarray, shape (n, 4, 4)
        Poses gTb, m.
    method : {"gauss-newton", "levenberg-marquardt"}
        Undamped, as iSAM2 steps; or damped, as the batch smoother does.

    Returns
    -------
    ndarray of int, shape (n,)
        Steps; `NOT_REACHED` where the end is not within 0.1 sigma of the optimum.

    Raises
    ------
    EstimationError
        When the factors do not determine the pose.
    """
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    best = levenberg_marquardt(graph, _values(near)).values
    J = graph.linearize(best).jacobian()[0]
    if J.shape[0] < 6 or np.linalg.matrix_rank(J) < 6:
        raise EstimationError("the factors of the image do not determine its pose")
    steps = np.full(len(starts), NOT_REACHED, dtype=np.int64)
    for k, start in enumerate(starts):
        found = METHODS[method](graph, _values(start))
        off = best.atPose3(POSE).localCoordinates(found.values.atPose3(POSE))
        if found.converged and np.linalg.norm(J @ off) < _TOLERANCE_SIGMAS * np.sqrt(6.0):
            steps[k] = found.iterations
    return steps


def _values(gTb: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(POSE, gtsam.Pose3(gTb))
    return values
