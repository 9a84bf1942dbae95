"""The only place that builds a `gtsam.CustomFactor`.

An unset, mis-shaped or non-finite Jacobian in a callback is a segmentation fault or a silently wrong
answer; here both buffers are allocated once with the right shapes, and what the kernel wrote is checked.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors.errors import FactorError
from factors.kernels.robust import CAUCHY, GEMAN_MCCLURE, HUBER, NONE, TRUNCATED

FloatArray = npt.NDArray[np.float64]

# kernel(gTb, linearise, e, J): writes e (rows,) and, when asked, J (rows, 6).
PoseKernel = Callable[[FloatArray, bool, FloatArray, FloatArray], None]


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


def pose_factor(key: int, rows: int, kernel: PoseKernel) -> gtsam.CustomFactor:
    """Build a factor of one pose, whitened inside.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    rows : int
        Length of the residual, at least 1.
    kernel : callable
        Writes the whitened residual and its Jacobian for the right twist [w, rho].

    Returns
    -------
    gtsam.CustomFactor
        Its callback raises `FactorError` when the kernel wrote something that is not finite.

    Raises
    ------
    FactorError
        When `rows` is not positive.
    """
    if rows < 1:
        raise FactorError(f"rows: expected at least one, found {rows}")
    e = np.empty(rows)
    J = np.zeros((rows, 6))

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        linearise = H is not None
        kernel(values.atPose3(key).matrix(), linearise, e, J)
        if not np.isfinite(e @ e):
            raise FactorError(f"factor at {gtsam.DefaultKeyFormatter(key)}: residual is not finite")
        if linearise:
            if not np.isfinite(J).all():
                raise FactorError(f"factor at {gtsam.DefaultKeyFormatter(key)}: Jacobian is not finite")
            H[0] = J
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), [key], evaluate)
