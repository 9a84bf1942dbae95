"""The only place that builds a `gtsam.CustomFactor`.

An unset, mis-shaped or non-finite Jacobian in a callback is a segmentation fault or a silently wrong
answer; here both buffers are allocated once with the right shapes, and what the kernel wrote is checked.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.errors import FactorError
from factors.kernels import conic
from factors.kernels.robust import CAUCHY, GEMAN_MCCLURE, HUBER, NONE, TRUNCATED

FloatArray = npt.NDArray[np.float64]

# kernel(gTb, bTc, linearise, e, J): writes e (rows,) and, when asked, J (rows, 6) for the body's twist.
PoseKernel = Callable[[FloatArray, FloatArray, bool, FloatArray, FloatArray], None]

_Evaluate = Callable[[gtsam.CustomFactor, gtsam.Values, Any], FloatArray]


@dataclass(frozen=True)
class Loss:
    """Robust loss on the norm of one crater's whitened residual.

    Attributes
    ----------
    kind : int
        `robust.NONE`, `HUBER`, `CAUCHY`, `GEMAN_MCCLURE` or `TRUNCATED`.
    scale : float
        Norm, in sigmas, beyond which a crater loses weight; the truncated loss leaves it none.
    """

    kind: int = NONE
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in (NONE, HUBER, CAUCHY, GEMAN_MCCLURE, TRUNCATED):
            raise FactorError(
                f"loss.kind: expected NONE, HUBER, CAUCHY, GEMAN_MCCLURE or TRUNCATED, found {self.kind}"
            )
        if not 0.0 < self.scale < np.inf:
            raise FactorError(f"loss.scale: expected a positive number, found {self.scale}")


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
        When `rows` is not positive, or the mounting is given twice, not at all, or with a matrix that is
        no pose.
    """
    if rows < 1:
        raise FactorError(f"rows: expected at least one, found {rows}")
    unit = gtsam.noiseModel.Unit.Create(rows)
    if bTc is not None and mounting_key is None:
        constant = validation.pose("bTc", bTc)
        return gtsam.CustomFactor(unit, [key], _of_pose(key, rows, kernel, constant))
    if bTc is not None or mounting_key is None:
        raise FactorError("bTc: expected either a constant mounting or the key of one, never both")
    if mounting_key == key:
        raise FactorError("mounting_key: expected another key than the pose's")
    return gtsam.CustomFactor(unit, [key, mounting_key], _of_both(key, rows, kernel, mounting_key))


def _of_pose(key: int, rows: int, kernel: PoseKernel, bTc: FloatArray) -> _Evaluate:
    e = np.empty(rows)
    J = np.zeros((rows, 6))
    J_flat = J.reshape(-1)

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        kernel(values.atPose3(key).matrix(), bTc, linearise, e, J)
        _check(key, "residual", e)
        if linearise:
            _check(key, "Jacobian", J_flat)
            H[0] = J
        return e

    return evaluate


def _of_both(key: int, rows: int, kernel: PoseKernel, mounting_key: int) -> _Evaluate:
    e = np.empty(rows)
    J_mounting = np.zeros((rows, 6))
    J_flat = J_mounting.reshape(-1)
    J = np.zeros((rows, 6))
    identity = np.eye(4)

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        bTc = values.atPose3(mounting_key)
        # For a body that is the camera a kernel gives the camera's own twist: that of bTc.
        kernel(values.atPose3(key).compose(bTc).matrix(), identity, linearise, e, J_mounting)
        _check(key, "residual", e)
        if linearise:
            _check(key, "Jacobian", J_flat)
            conic.body_columns(J_mounting, bTc.matrix(), J)
            H[0] = J
            H[1] = J_mounting
        return e

    return evaluate


def _check(key: int, name: str, written: FloatArray) -> None:
    # One sum of squares finds NaN and infinity at a fraction of an element-wise test's cost.
    if not math.isfinite(written @ written):
        raise FactorError(f"factor at {gtsam.DefaultKeyFormatter(key)}: {name} is not finite")
