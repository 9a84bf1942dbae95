"""Robust losses on the norm of one crater's whitened residual."""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

NONE, HUBER, CAUCHY, GEMAN_MCCLURE, TRUNCATED = 0, 1, 2, 3, 4


@njit(cache=True, error_model="numpy")
def loss_and_weight(d2: float, kind: int, scale: float) -> tuple[float, float]:
    """Loss 2 rho and weight w of a squared norm d2.

    The loss is d2 for `NONE`; `HUBER` is quadratic up to d = scale, then linear; `CAUCHY` is
    scale^2 ln(1 + d2/scale^2). Two are bounded by scale^2, so that an outlier costs the same wherever it
    lies: `GEMAN_MCCLURE` is d2 scale^2/(d2 + scale^2), `TRUNCATED` quadratic up to d = scale, then constant.
    They have many local minima: start them from a good pose. The weight is d(2 rho)/d(d2).
    """
    if kind == HUBER and d2 > scale * scale:
        d = np.sqrt(d2)
        return scale * (2.0 * d - scale), scale / d
    if kind == CAUCHY:
        r = d2 / (scale * scale)
        return scale * scale * np.log1p(r), 1.0 / (1.0 + r)
    if kind == GEMAN_MCCLURE:
        weight = 1.0 / (1.0 + d2 / (scale * scale))
        return d2 * weight, weight * weight
    if kind == TRUNCATED and d2 > scale * scale:
        return scale * scale, 0.0
    return d2, 1.0


@njit(cache=True, error_model="numpy")
def apply_loss(e: FloatArray, J: FloatArray, kind: int, scale: float, linearise: bool) -> None:
    """Scale one crater's whitened residual and Jacobian by a robust loss, in place.

    To linearise: sqrt(w) e and sqrt(w) J. For the error alone: e sqrt(2 rho)/|e|, so that half the squared
    norm is the loss. Equal to GTSAM's `noiseModel.Robust` on a factor of this crater alone.

    Parameters
    ----------
    e : ndarray, shape (m,)
        Whitened residual.
    J : ndarray, shape (m, k)
        Its Jacobian; not used unless `linearise`.
    kind : int
        `NONE`, `HUBER`, `CAUCHY`, `GEMAN_MCCLURE` or `TRUNCATED`.
    scale : float
        Norm of e, in sigmas, beyond which the loss bites.
    linearise : bool
    """
    if kind == NONE:
        return
    d2 = 0.0
    for i in range(e.shape[0]):
        d2 += e[i] * e[i]
    loss, weight = loss_and_weight(d2, kind, scale)
    if linearise:
        factor = np.sqrt(weight)
        for i in range(e.shape[0]):
            for j in range(J.shape[1]):
                J[i, j] *= factor
    else:
        factor = np.sqrt(loss / d2) if d2 > 0.0 else 1.0
    for i in range(e.shape[0]):
        e[i] *= factor
