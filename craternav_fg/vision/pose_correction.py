"""A predicted pose corrected with measured rims, as far as the search for further rims needs it."""

import numpy as np

from craternav_fg import frames
from craternav_fg.linalg import scaled_inverse, whitening
from craternav_fg.vision.robust_scale import median
from factors.arrays import FloatArray

# Iterations of the weights, and the largest change at which they have converged.
_MAX_ITERATIONS, _WEIGHT_TOLERANCE = 12, 1e-3


def corrected_pose(
    predicted: FloatArray,
    prior: FloatArray,
    pose: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Estimate the pose robustly from a prior and linearised measurements.

    Parameters
    ----------
    predicted : ndarray, shape (4, 4)
        Prior pose of the body in g.
    prior : ndarray, shape (6, 6)
        Its covariance, of the right twist (rotation, rad; translation in b, m).
    pose : ndarray, shape (4, 4)
        Pose of the body in g at which the measurements are linearised.
    H : ndarray, shape (n, k, 6)
        Derivative of the predicted measurements in the right twist.
    residual : ndarray, shape (n, k)
        Measured minus predicted at `pose`.
    covariance : ndarray, shape (n, k, k)
        Covariance of the measurements.

    Returns
    -------
    gTb : ndarray, shape (4, 4)
        Maximum a posteriori pose under a redescending loss.
    covariance : ndarray, shape (6, 6)
        Covariance of its right twist.
    """
    delta, N = _corrections(predicted, prior, pose, H, residual, covariance)
    out = pose.copy()
    out[:3, :3] = pose[:3, :3] @ frames.rotation_exp(delta[:3])
    out[:3, 3] = pose[:3, 3] + pose[:3, :3] @ delta[3:]
    return out, scaled_inverse(N)


def beside_pose(
    predicted: FloatArray,
    prior: FloatArray,
    pose: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Estimate parameters that measurements depend on besides the pose, see `corrected_pose`.

    Parameters
    ----------
    predicted, pose : ndarray, shape (4, 4)
        Poses of the body in g, m.
    prior : ndarray, shape (6 + m, 6 + m)
        Covariance of the right twist and of the parameters, whose prior mean is 0.
    H : ndarray, shape (n, k, 6 + m)
    residual : ndarray, shape (n, k)
        Measured minus predicted at `pose` and 0.
    covariance : ndarray, shape (n, k, k)

    Returns
    -------
    parameters : ndarray, shape (m,)
    covariance : ndarray, shape (m, m)
    """
    delta, N = _corrections(predicted, prior, pose, H, residual, covariance)
    return delta[6:], scaled_inverse(N)[6:, 6:]


def _corrections(
    predicted: FloatArray,
    prior: FloatArray,
    pose: FloatArray,
    H: FloatArray,
    residual: FloatArray,
    covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Maximum a posteriori step from `pose` and 0, and its information."""
    Rt = predicted[:3, :3].T
    moved = np.zeros(len(prior))
    moved[:3], moved[3:6] = frames.rotation_log(Rt @ pose[:3, :3]), Rt @ (pose[:3, 3] - predicted[:3, 3])
    information = scaled_inverse(prior)
    W = whitening(covariance)
    H, residual = W @ H, np.einsum("nij,nj->ni", W, residual)
    each = np.swapaxes(H, 1, 2) @ H
    pull = np.einsum("nij,ni->nj", H, residual)
    delta, last = np.zeros(len(prior)), np.zeros(len(H))
    for _ in range(_MAX_ITERATIONS):
        off2 = np.mean((residual - H @ delta) ** 2, axis=1)
        # Geman-McClure weights, with a scale of at least the median: wrong matches lose their influence.
        weight = 1.0 / (1.0 + off2 / max(1.0, 2.0 * float(median(off2)))) ** 2
        N = information + np.einsum("n,nij->ij", weight, each)
        delta = np.linalg.solve(N, weight @ pull - information @ moved)
        if np.max(np.abs(weight - last)) < _WEIGHT_TOLERANCE:
            break
        last = weight
    return delta, N
