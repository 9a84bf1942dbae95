"""Poses from which a crater has no image, and what every kernel writes there.

| a pose that puts the crater | shape, implicit (whole or beside (11)), rim points | line of sight | centre |
|---|---|---|---|
| behind the camera or in its plane (p_z <= 0) | unseen | unseen | unseen |
| above the camera, seen from below (t_z <= 0) | unseen | unseen | seen: a centre has no plane |
| across the camera's plane, a hyperbola (Q*_33 >= 0) | unseen | seen: its direction is regular | seen |

and, in the implicit residual alone, where the predicted conic is almost orthogonal to the measured one
(`implicit.LEAST_COSINE`): there the residual runs to a pole and comes back with the other sign.

An unseen crater gets the residual `UNSEEN` in each of its rows and no Jacobian. It costs more than a visible
one, so that an optimiser steps back; it has no slope, so that it disturbs no other crater. The loss applies
to it as to any other; with a bounded loss it costs as much as an outlier. The value is large against the
residuals at the farthest start: 25 degrees in units of a tenth of a pixel are thousands, and were an unseen
crater cheaper, an optimiser would settle there. It is small against what a sum of squares in double precision
can hold beside a residual of 1, and a relative tolerance of an optimiser beside a change of some tens.

The sun's tilt is undefined only within `sun.FLOOR` of the line of sight; there its factor costs what a tilt
wrong by half a turn does, without a slope. No kernel writes NaN or infinity at a finite pose; a pose that
holds NaN sees nothing.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import body_columns
from factors.kernels.robust import apply_loss

# Whitened residual of a crater that the pose cannot see, see above.
UNSEEN = 1e5


@njit(cache=True, error_model="numpy")
def unseen(e: FloatArray, J: FloatArray, kind: int, scale: float, linearise: bool) -> None:
    """Write residual and Jacobian of a crater that the pose cannot see.

    Parameters
    ----------
    e : ndarray, shape (m,)
        Written: the whitened residual.
    J : ndarray, shape (m, k)
        Written: zero.
    kind, scale : int, float
        Loss, see `robust`.
    linearise : bool
        Whether e is scaled as for a linearisation.
    """
    for i in range(e.shape[0]):
        e[i] = UNSEEN
        for j in range(J.shape[1]):
            J[i, j] = 0.0
    apply_loss(e, J, kind, scale, linearise)


@njit(cache=True, error_model="numpy")
def whiten(
    raw: FloatArray, Jc: FloatArray, W: FloatArray, bTc: FloatArray, e: FloatArray, J: FloatArray,
    kind: int, scale: float, linearise: bool,
) -> None:  # fmt: skip
    """Whiten a residual and its Jacobian, turn the Jacobian to the body, and apply the loss.

    Parameters
    ----------
    raw : ndarray, shape (m,)
        Residual in its own units.
    Jc : ndarray, shape (m, 6)
        Its derivatives in the camera's right twist.
    W : ndarray, shape (m, m)
        Lower triangular whitening matrix.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    e : ndarray, shape (m,)
        Written: W raw, whitened.
    J : ndarray, shape (m, 6)
        Written when `linearise`: W Jc, for the body's right twist.
    kind, scale : int, float
        Loss, see `robust`.
    linearise : bool
    """
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
