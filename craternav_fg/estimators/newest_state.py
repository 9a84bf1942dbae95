"""The newest state of an online smoother, as a filter gives it."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import ImuInterval, bias_vector
from craternav_fg.estimators.incremental import Isam
from craternav_fg.estimators.sensor_bank import SensorBank, gyro_at, gyro_variance
from factors.arrays import FloatArray, IntArray
from factors.kernels import strapdown
from factors.kernels.compiled import njit


def _source() -> IntArray:
    """Of each entry of `strapdown`'s error state, where it is in GTSAM's."""
    source = np.empty(strapdown.SIZE, dtype=np.int64)
    for part, begin in (
        (strapdown.ATTITUDE, 0), (strapdown.POSITION, 3), (strapdown.VELOCITY, 6),
        (strapdown.ACCELEROMETER_BIAS, 9), (strapdown.GYRO_BIAS, 12), (strapdown.RATE, 12),
    ):  # fmt: skip
        source[part] = begin + np.arange(3)
    return source


_SOURCE = _source()
_POSITION = strapdown.POSITION.start
_RATES = tuple(range(strapdown.RATE.start, strapdown.RATE.stop))


@njit(cache=True, error_model="numpy")
def _covariance(joint: FloatArray, gTb: FloatArray, rate_variance: float) -> FloatArray:
    """Covariance (18 + m, 18 + m) in the error state of `strapdown`, then m biases of sensors.

    From that (15 + m, 15 + m) of GTSAM's rotation, translation in b, velocity, accelerometer bias, gyro bias,
    then the sensors' biases. The angular velocity is that of an IMU row less the gyro bias; the row's noise
    adds its variance.
    """
    n, begin = len(joint) + 3, _POSITION
    out = np.empty((n, n))
    for i in range(n):
        of_i = _SOURCE[i] if i < len(_SOURCE) else i - 3
        for j in range(n):
            of_j = _SOURCE[j] if j < len(_SOURCE) else j - 3
            turned = (i in _RATES) != (j in _RATES)
            out[i, j] = -joint[of_i, of_j] if turned else joint[of_i, of_j]
    for j in range(n):
        x, y, z = out[begin, j], out[begin + 1, j], out[begin + 2, j]
        for k in range(3):
            out[begin + k, j] = gTb[k, 0] * x + gTb[k, 1] * y + gTb[k, 2] * z
    for i in range(n):
        x, y, z = out[i, begin], out[i, begin + 1], out[i, begin + 2]
        for k in range(3):
            out[i, begin + k] = gTb[k, 0] * x + gTb[k, 1] * y + gTb[k, 2] * z
    for k in _RATES:
        out[k, k] += rate_variance
    return out


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
    rate = gyro_at(descent, stamp_ns) - bias[:3]
    gV = tree.calculateEstimateVector(V(index))
    # What the row's noise turned is far less than the attitude's own error. GTSAM's matrices are
    # column-major, and the kernel is compiled for the other order: the transpose is the same.
    covariance = _covariance(joint.T, gTb, gyro_variance(descent, stamp_ns))
    sigmas = bank.sigmas
    if not len(sigmas):
        return FilterState(gTb, gV, rate, bias, covariance)
    # A sensor that has not measured yet has the bias of its prior.
    sensor_bias, scale, places = np.zeros(len(sigmas)), np.ones(len(covariance)), list(range(strapdown.SIZE))
    for part, key in known:
        sensor_bias[part] = sigmas[part] * tree.calculateEstimateVector(key)
        own = range(*part.indices(len(sigmas)))
        scale[len(places) : len(places) + len(own)] = sigmas[part]
        places += [strapdown.SIZE + number for number in own]
    whole = np.diag(np.concatenate([np.zeros(strapdown.SIZE), sigmas**2]))
    whole[np.ix_(places, places)] = scale[:, None] * covariance * scale
    return FilterState(gTb, gV, rate, bias, whole, sensor_bias)
