"""A predicted pose corrected by rims, as far as the search for further rims needs it."""

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from craternav_fg import frames

FloatArray = npt.NDArray[np.float64]

# The scatter of fewer rims about one pose says little about their covariances.
_MIN_RIMS = 6
# Weights that change by less are right.
_WEIGHT_TOLERANCE = 1e-3


def squared_distance(residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared Mahalanobis distances (n,) of residuals (n, k) under covariances (n, k, k)."""
    return np.einsum("ni,ni->n", residual, np.linalg.solve(covariance, residual[..., None])[..., 0])


def corrected_pose(
    predicted: FloatArray,
    prior: FloatArray,
    pose: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Robust maximum a posteriori pose and its covariance (6, 6), one linearisation at `pose`.

    `residual` (n, k) is measured minus predicted at `pose`, `H` (n, k, 6) its derivative for the right
    twist; `predicted` with `prior` (6, 6, same twist) is what was known before.
    """
    Rt = predicted[:3, :3].T
    moved = np.concatenate([frames.rotation_log(Rt @ pose[:3, :3]), Rt @ (pose[:3, 3] - predicted[:3, 3])])
    information = np.linalg.inv(prior)
    white = np.linalg.solve(np.linalg.cholesky(covariance), np.concatenate([H, residual[..., None]], axis=2))
    H, residual = white[..., :6], white[..., 6]
    each = np.swapaxes(H, 1, 2) @ H
    pull = np.einsum("nij,ni->nj", H, residual)
    delta, last = np.zeros(6), np.zeros(len(H))
    for _ in range(12):
        off2 = np.mean((residual - H @ delta) ** 2, axis=1)
        # Redescending (Geman-McClure), from the median outwards: what fits nothing pulls nothing.
        weight = 1.0 / (1.0 + off2 / max(1.0, 2.0 * float(np.median(off2)))) ** 2
        N = information + np.einsum("n,nij->ij", weight, each)
        delta = np.linalg.solve(N, weight @ pull - information @ moved)
        if np.max(np.abs(weight - last)) < _WEIGHT_TOLERANCE:
            break
        last = weight
    out = pose.copy()
    out[:3, :3] = pose[:3, :3] @ frames.rotation_exp(delta[:3])
    out[:3, 3] = pose[:3, 3] + pose[:3, :3] @ delta[3:]
    return out, np.linalg.inv(N)


def variance_factor(distance2: FloatArray, components: int) -> float:
    """Return by what factor, at least 1, residuals exceed their covariances.

    Rims of rough ground scatter more about any pose than their own edges tell; the median does not
    see the rims that are simply wrong.
    """
    if len(distance2) < _MIN_RIMS:
        return 1.0
    return max(1.0, float(np.median(distance2) / chi2.median(components)))
