"""The only place that builds a `gtsam.CustomFactor`.

An unset, mis-shaped or non-finite Jacobian in a callback is a segmentation fault or a silently wrong answer.
Here both buffers are allocated once with the right shapes, and what the kernel wrote is checked.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.ahead import Ahead
from factors.arrays import FloatArray
from factors.errors import FactorError
from factors.kernels import conic
from factors.kernels.robust import CAUCHY, GEMAN_MCCLURE, HUBER, NONE, TRUNCATED, apply_loss

# Looked up once: calling a method through its object costs as much as a crater.
_at_pose = gtsam.Values.atPose3
_at_vector = gtsam.Values.atVector
_matrix = gtsam.Pose3.matrix
# Of factors that nothing is evaluated for before GTSAM asks.
_NEVER = Ahead()

# kernel(gTb, bTc, linearise, e, J): writes e (rows,) and, when asked, J (rows, 6) for the body's twist.
PoseKernel = Callable[[FloatArray, FloatArray, bool, FloatArray, FloatArray], None]
# kernel(gTb, data, linearise, out): writes out (7, rows), J' above e; gives a sum finite only where that is.
PackedKernel = Callable[[FloatArray, FloatArray, bool, FloatArray], float]


@dataclass(frozen=True)
class Loss:
    """Robust loss on the norm of one crater's whitened residual.

    Attributes
    ----------
    kind : int
        `robust.NONE`, `HUBER`, `CAUCHY`, `GEMAN_MCCLURE` or `TRUNCATED`.
    scale_sigmas : float
        Norm, in sigmas, beyond which a crater loses weight; the truncated loss leaves it none.
    """

    kind: int = NONE
    scale_sigmas: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in (NONE, HUBER, CAUCHY, GEMAN_MCCLURE, TRUNCATED):
            raise FactorError(
                f"loss.kind: expected NONE, HUBER, CAUCHY, GEMAN_MCCLURE or TRUNCATED, found {self.kind}"
            )
        if not (isinstance(self.scale_sigmas, int | float) and 0.0 < self.scale_sigmas < np.inf):
            raise FactorError(f"loss.scale_sigmas: expected a positive number, found {self.scale_sigmas}")


def constant_mounting(key: int, bTc: npt.ArrayLike | None, mounting_key: int | None) -> FloatArray:
    """Return the mounting that a kernel works with: `bTc`, or the identity where the mounting is a variable.

    With the identity a kernel's body is the camera, and its Jacobian is for the camera's own twist: that of a
    variable bTc.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4), or None
        Mounting of the camera when it is known.
    mounting_key : int or None
        Key of the mounting when it is a variable.

    Returns
    -------
    ndarray, shape (4, 4)
        Mounting of the camera, or the identity.

    Raises
    ------
    FactorError
        When the mounting is given twice, not at all, or with a matrix that is no pose.
    """
    if bTc is not None and mounting_key is None:
        return validation.pose("bTc", bTc)
    if bTc is not None or mounting_key is None:
        raise FactorError("bTc: expected either a constant mounting or the key of one, never both")
    if mounting_key == key:
        raise FactorError("mounting_key: expected another key than the pose's")
    return np.eye(4)


def pose_factor(
    key: int,
    rows: int,
    kernel: PoseKernel,
    bTc: npt.ArrayLike | None = None,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of one pose, and of the camera's mounting if that is to be estimated, whitened inside.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    rows : int
        Length of the residual, at least 1.
    kernel : callable
        Writes the whitened residual and its Jacobian for the body's right twist [w, rho].
    bTc : array_like, shape (4, 4), optional
        Mounting of the camera when it is known.
    mounting_key : int, optional
        Key of the mounting (`Pose3`) when it is a variable; exactly one of the two must be given.

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when the kernel wrote something that is not finite.

    Raises
    ------
    FactorError
        When `rows` is not positive, or as `constant_mounting` says.
    """
    constant = constant_mounting(key, bTc, mounting_key)
    e = np.empty(_positive(rows))
    J = np.zeros((rows, 6))
    J_flat = J.reshape(-1)

    def run(T: FloatArray, linearise: bool) -> bool:
        kernel(T, constant, linearise, e, J)
        # One sum of squares finds NaN and infinity at a fraction of an element-wise test's cost.
        return math.isfinite(e @ e) and (not linearise or math.isfinite(J_flat @ J_flat))

    if mounting_key is not None:
        return _of_both(key, mounting_key, run, e, J)

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        if not run(_matrix(_at_pose(values, key)), linearise):
            raise _not_finite(key)
        if linearise:
            H[0] = J
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), [key], evaluate)


def packed_pose_factor(
    key: int,
    rows: int,
    kernel: PackedKernel,
    data: FloatArray,
    mounting_key: int | None = None,
    ahead: Ahead | None = None,
) -> gtsam.CustomFactor:
    """Build a factor as `pose_factor` does, of a kernel that takes its constants as one array: the fast way.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    rows : int
        Length of the residual, at least 1.
    kernel : callable
        Writes J', columns for the right twist [w, rho], and e below it into one array (7, rows); returns a
        sum that is finite only where all that is.
    data : ndarray, shape (n_data,)
        Constants of the kernel, among them the mounting that `constant_mounting` gives; nobody else may
        change them.
    mounting_key : int, optional
        Key of the mounting (`Pose3`) when it is a variable.
    ahead : Ahead, optional
        Where the kernel is `packed.reduced_shape_residuals` and there is no such key: may evaluate it first.

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when the kernel wrote something that is not finite.

    Raises
    ------
    FactorError
        When `rows` is not positive.
    """
    out = np.zeros((7, _positive(rows)))
    e = out[6]
    # Column-major, as GTSAM's own matrices are: copied without a stride.
    J = out[:6].T
    if mounting_key is not None:
        return _of_both(
            key, mounting_key, lambda T, linearise: math.isfinite(kernel(T, data, linearise, out)), e, J
        )

    first = ahead or _NEVER
    ready = first.add(key, data) if ahead else []

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        if first.written > linearise:
            slopes, residual = ready
            if linearise:
                H[0] = slopes
            return residual
        if not math.isfinite(kernel(_matrix(_at_pose(values, key)), data, linearise, out)):
            raise _not_finite(key)
        if linearise:
            H[0] = J
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), [key], evaluate)


def packed_pose_factor_with_errors(
    key: int,
    rows: int,
    kernel: Callable[[FloatArray, FloatArray, FloatArray, bool, FloatArray], float],
    data: FloatArray,
    errors: Sequence[tuple[int, int]],
) -> gtsam.CustomFactor:
    """Build a factor as `packed_pose_factor` does, of a pose and of errors that enter linearly.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    rows : int
        Length of the residual, at least 1.
    kernel : callable
        kernel(pose, z, data, linearise, out): as a packed kernel; z (m,) are all errors, one after the other,
        and the transposed Jacobian in them is written below the residual: out has the shape (7 + m, rows).
    data : ndarray, shape (n_data,)
        Constants of the kernel, in its units; nobody else may change them.
    errors : sequence of (int, int)
        Key and length of each error.

    Returns
    -------
    gtsam.CustomFactor
        Its keys are the pose and the errors, in this order. Its callback raises `FactorError` when the kernel
        wrote something that is not finite.

    Raises
    ------
    FactorError
        When `rows` is not positive.
    """
    z = np.zeros(sum(length for _, length in errors))
    out = np.zeros((7 + len(z), _positive(rows)))
    e, J = out[6], out[:6].T
    parts = []
    begin = 0
    for number, (error, length) in enumerate(errors, 1):
        end = begin + length
        parts.append((number, error, z[begin:end], out[7 + begin : 7 + end].T))
        begin = end

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        for _number, error, part, _slopes in parts:
            part[:] = _at_vector(values, error)
        if not math.isfinite(kernel(_matrix(_at_pose(values, key)), z, data, linearise, out)):
            raise _not_finite(key)
        if linearise:
            H[0] = J
            for number, _error, _part, slopes in parts:
                H[number] = slopes
        return e

    keys = [key, *[error for error, _ in errors]]
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), keys, evaluate)


def _of_both(
    key: int,
    mounting_key: int,
    run: Callable[[FloatArray, bool], bool],
    e: FloatArray,
    J_mounting: FloatArray,
) -> gtsam.CustomFactor:
    """Build a factor of pose and mounting; run(gTc, linearise) writes e and J for the camera's twist."""
    J = np.zeros((len(e), 6))

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        bTc = values.atPose3(mounting_key)
        if not run(values.atPose3(key).compose(bTc).matrix(), linearise):
            raise _not_finite(key)
        if linearise:
            conic.body_columns(J_mounting, bTc.matrix(), J)
            H[0] = J
            H[1] = J_mounting
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(e)), [key, mounting_key], evaluate)


def _positive(rows: int) -> int:
    if rows < 1:
        raise FactorError(f"rows: expected at least one, found {rows}")
    return rows


def _not_finite(key: int) -> FactorError:
    return FactorError(f"factor at {gtsam.DefaultKeyFormatter(key)}: residual or Jacobian is not finite")


def state_factor(
    keys: tuple[int, int, int],
    rows: int,
    evaluate: Callable[[FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, list[FloatArray]]],
    bias_key: int | None,
    loss: Loss,
) -> gtsam.CustomFactor:
    """Build a factor of pose, velocity, IMU bias and, if there is one, a further bias.

    Parameters
    ----------
    keys : tuple of int
        Keys of the pose `gTb`, the velocity and the IMU's bias.
    rows : int
        Length m of the residual, at least 1.
    evaluate : callable
        evaluate(gTb, gV, imu_bias, bias) gives the whitened residual (m,) and the Jacobians in the four:
        of the pose for the right twist [w, rho], of the IMU's bias in GTSAM's order.
    bias_key : int or None
        Key of a vector.
    loss : Loss
        On the norm of the residual.

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when something is not finite or of another shape.

    Raises
    ------
    FactorError
        When `rows` is not positive.
    """
    _positive(rows)
    pose_key, velocity_key, imu_key = keys
    every = [*keys] if bias_key is None else [*keys, bias_key]
    none = np.empty(0)

    def run(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        bias = none if bias_key is None else values.atVector(bias_key)
        e, jacobians = evaluate(
            _matrix(_at_pose(values, pose_key)),
            values.atVector(velocity_key),
            values.atConstantBias(imu_key).vector(),
            bias,
        )
        e = np.array(e, dtype=np.float64)
        if e.shape != (rows,) or not math.isfinite(e @ e):
            raise _not_finite(pose_key)
        whole = np.array(np.hstack(jacobians), dtype=np.float64)
        if whole.shape != (rows, 15 + len(bias)) or not np.isfinite(whole).all():
            raise _not_finite(pose_key)
        apply_loss(e, whole, loss.kind, loss.scale_sigmas, H is not None)
        if H is not None:
            ends = (0, 6, 9, 15, 15 + len(bias))
            for k in range(len(every)):
                H[k] = np.asfortranarray(whole[:, ends[k] : ends[k + 1]])
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), every, run)


def two_state_factor(
    keys: Sequence[int],
    rows: int,
    evaluate: Callable[
        [tuple[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
        tuple[FloatArray, FloatArray, FloatArray],
    ],
) -> gtsam.CustomFactor:
    """Build a factor of two states, each of pose, velocity and IMU bias.

    Parameters
    ----------
    keys : sequence of int, length 6
        Pose, velocity and bias of the first state, then those of the second.
    rows : int
        Length m of the residual, at least 1.
    evaluate : callable
        evaluate(first, second), each gTb, gV and the bias (gyro, accelerometer), gives the whitened residual
        (m,) and the Jacobians (m, 15) in the two states: right twist [w, rho], velocity, accelerometer's
        bias, gyro's bias.

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when something is not finite or of another shape.

    Raises
    ------
    FactorError
        When `rows` is not positive, or the keys are not six different ones.
    """
    _positive(rows)
    if len(keys) != 6 or len(set(keys)) != 6:
        raise FactorError(f"keys: expected six different keys, found {len(set(keys))} among {len(keys)}")
    ends = ((0, 6), (6, 9), (9, 15))

    def state(values: gtsam.Values, first: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        bias = values.atConstantBias(keys[first + 2])
        return (
            _matrix(_at_pose(values, keys[first])),
            values.atVector(keys[first + 1]),
            np.concatenate([bias.gyroscope(), bias.accelerometer()]),
        )

    def run(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        e, *jacobians = evaluate(state(values, 0), state(values, 3))
        whole = np.hstack(jacobians)
        if e.shape != (rows,) or whole.shape != (rows, 30):
            raise _not_finite(keys[0])
        if not (math.isfinite(e @ e) and np.isfinite(whole).all()):
            raise _not_finite(keys[0])
        if H is not None:
            for side, J in enumerate(jacobians):
                for k, (begin, end) in enumerate(ends):
                    H[3 * side + k] = np.asfortranarray(J[:, begin:end])
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), list(keys), run)
