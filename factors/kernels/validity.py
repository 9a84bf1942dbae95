"""Where a crater's image says nothing of the pose, and what every kernel answers there.

| a pose that puts the crater | shape, implicit, rim points | line of sight | centre |
|---|---|---|---|
| behind the camera or in its plane (p_z <= 0) | unseen | unseen | unseen |
| above the camera, seen from below (t_z <= 0) | unseen | unseen | seen: a centre has no plane |
| across the camera's plane, a hyperbola (Q*_33 >= 0) | unseen | seen: its direction is regular | seen |

and, of the implicit residual alone, where the predicted conic stands almost at a right angle to the measured
one (`implicit.LEAST_COSINE`): there the residual runs to a pole and comes back with the other sign.

An unseen crater gets the residual `UNSEEN` in each of its rows and no Jacobian: dearer than a visible one,
so that an optimiser steps back, and without pull, so that it spoils no other crater. The loss applies to it
as to any other; a bounded loss makes it as dear as an outlier. The value is large against the residuals at
the farthest start (25 degrees in units of a tenth of a pixel are thousands: were a lost crater cheaper, an
optimiser would settle there) and small against what a sum of squares in double precision can carry beside a
residual of 1, and a relative tolerance of an optimiser beside a change of some tens.

The sun's tilt is undefined within `sun.FLOOR` of the line of sight only; there its factor costs what a tilt
wrong by half a turn does, without pull. No kernel writes NaN or infinity at any pose that is finite; NaN in a
pose counts as unseen.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from factors.kernels.conic import body_columns
from factors.kernels.robust import apply_loss

FloatArray = npt.NDArray[np.float64]

UNSEEN = 1e5


@njit(cache=True, error_model="numpy")
def unseen(e: FloatArray, J: FloatArray, kind: int, scale: float, linearise: bool) -> None:
    """Write the residual e (m,) and Jacobian J (m, 6) of a crater that the pose cannot see."""
    for i in range(e.shape[0]):
        e[i] = UNSEEN
        for j in range(6):
            J[i, j] = 0.0
    apply_loss(e, J, kind, scale, linearise)


@njit(cache=True, error_model="numpy")
def whiten(
    raw: FloatArray, Jc: FloatArray, W: FloatArray, bTc: FloatArray, e: FloatArray, J: FloatArray,
    kind: int, scale: float, linearise: bool,
) -> None:  # fmt: skip
    """Write W raw and W Jc (turned to the body), W lower triangular, with the loss applied."""
    m = raw.shape[0]
    for i in range(m):
        e[i] = 0.0
        for k in range(i + 1):
            e[i] += W[i, k] * raw[k]
    if linearise:
        Jb = np.empty((m, 6))
        body_columns(Jc, bTc, Jb)
        for i in range(m):
            for j in range(6):
                J[i, j] = 0.0
                for k in range(i + 1):
                    J[i, j] += W[i, k] * Jb[k, j]
    apply_loss(e, J, kind, scale, linearise)
