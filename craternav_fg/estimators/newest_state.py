"""The newest state of an online smoother, as a filter gives it."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import ImuInterval, bias_vector
from craternav_fg.estimators.incremental import Isam
from craternav_fg.estimators.sensor_bank import SensorBank, gyro_at, gyro_variance
from factors.arrays import FloatArray
from factors.kernels import strapdown


def _from_gtsam() -> FloatArray:
    """Jacobian (18, 15) from GTSAM's rotation, translation in b, velocity, accelerometer bias, gyro bias."""
    T = np.zeros((strapdown.SIZE, 15))
    T[strapdown.ATTITUDE, 0:3] = np.eye(3)
    T[strapdown.VELOCITY, 6:9] = np.eye(3)
    T[strapdown.ACCELEROMETER_BIAS, 9:12] = np.eye(3)
    T[strapdown.GYRO_BIAS, 12:15] = np.eye(3)
    T[strapdown.RATE, 12:15] = -np.eye(3)
    return T


# All but the position, which is turned from b to g.
_FROM_GTSAM = _from_gtsam()
_RATES = np.arange(strapdown.RATE.start, strapdown.RATE.stop)


def newest_state(
    solver: Isam,
    descent: Descent,
    bank: SensorBank,
    index: int,
    stamp_ns: int,
    pose: gtsam.Pose3 | None = None,
    interval: ImuInterval | None = None,
) -> FilterState:
    """Read the newest state and its covariance from a solver.

    Parameters
    ----------
    solver : Isam
        May replace its tree, see `Isam.joint_covariance`.
    descent : Descent
    bank : SensorBank
        Sensors whose biases are estimated.
    index : int
        Of the state.
    stamp_ns : int
    pose : gtsam.Pose3, optional
        The state's pose gTb (translation in m), where it is known already; read again from a new tree.
    interval : ImuInterval, optional
        That ends at the state.

    Returns
    -------
    FilterState

    Raises
    ------
    EstimationError
        When the solver's tree has to be replaced and cannot be.
    """
    known = [one for one in bank.biases if solver.tree.valueExists(one[1])]
    keys = [X(index), V(index), B(index), *(key for _, key in known)]
    stiffness = interval.stiffness if interval is not None and solver.by_cholesky else None
    trees = solver.trees
    joint = solver.joint_covariance(keys, stiffness)
    tree = solver.tree
    if pose is None or solver.trees != trees:
        pose = tree.calculateEstimatePose3(X(index))
    gTb = np.ascontiguousarray(pose.matrix())
    bias = bias_vector(tree.calculateEstimateConstantBias(B(index)))
    T = _FROM_GTSAM.copy()
    T[strapdown.POSITION, 3:6] = gTb[:3, :3]
    rate = gyro_at(descent, stamp_ns) - bias[:3]
    # What this noise turned in its row is far less than the attitude's own error.
    of_row = gyro_variance(descent, stamp_ns)
    gV = tree.calculateEstimateVector(V(index))
    sigmas = bank.sigmas
    if not len(sigmas):
        covariance = T @ joint @ T.T
        covariance[_RATES, _RATES] += of_row
        return FilterState(gTb, gV, rate, bias, covariance)
    # A sensor that has not measured yet has the bias of its prior.
    sensor_bias, measured = np.zeros(len(sigmas)), np.zeros(len(sigmas), dtype=np.bool_)
    for part, key in known:
        sensor_bias[part] = sigmas[part] * tree.calculateEstimateVector(key)
        measured[part] = True
    whole = np.zeros((strapdown.SIZE + len(sigmas), len(joint)))
    whole[: strapdown.SIZE, :15] = T
    whole[strapdown.SIZE + np.flatnonzero(measured), 15:] = np.diag(sigmas[measured])
    covariance = whole @ joint @ whole.T
    covariance[_RATES, _RATES] += of_row
    rest = strapdown.SIZE + np.flatnonzero(~measured)
    covariance[rest, rest] = sigmas[~measured] ** 2
    return FilterState(gTb, gV, rate, bias, covariance, sensor_bias)
