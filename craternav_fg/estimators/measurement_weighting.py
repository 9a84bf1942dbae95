"""Weights of measurements: covariances evaluated at the predicted measurement, and limits on innovations.

The covariance of a fit is evaluated at the measured ellipse, so the weight depends on the measurement's own
error: a rim measured too small has a larger error of its logarithm and less weight, and on average all rims
seem too large. Weights evaluated at the image predicted by a pose from other data avoid this. The smoothers
take that pose from their first solution, the online smoother and the filter from the prediction.
"""

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators import filter_kernel
from craternav_fg.measurements import FrameMeasurement
from factors.arrays import FloatArray
from factors.kernels import conic


def with_predicted_covariances(
    frame: FrameMeasurement, gTb: FloatArray, camera: Camera, catalog: Catalog
) -> FrameMeasurement:
    """Evaluate the covariances of a frame's rims at the images that a pose predicts.

    Parameters
    ----------
    frame : FrameMeasurement
    gTb : ndarray, shape (4, 4)
        Pose of the body in g. It should rest on other frames: then the weights do not depend on the rims' own
        errors, see `RimSet.expected_at`.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    FrameMeasurement
    """
    rows = frame.rims.craters
    gTb = np.ascontiguousarray(gTb)
    charts, _ = conic.project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    return FrameMeasurement(frame.stamp_ns, frame.rims.expected_at(charts), frame.sun, frame.arcs)


def noise_inflation(
    A: FloatArray, residual: FloatArray, covariance: FloatArray, limit: float
) -> tuple[FloatArray, FloatArray]:
    """Normalised innovations of whitened measurements, and the noise factors that limit them.

    Parameters
    ----------
    A : ndarray, shape (n, m, k)
        Whitened derivatives in the prior's error.
    residual : ndarray, shape (n, m)
        Whitened, measured minus predicted.
    covariance : ndarray, shape (K, K), K >= k
        Covariance of the prior's error, whose first k entries count.
    limit : float
        Largest normalised innovation, in sigmas.

    Returns
    -------
    innovation_sigmas : ndarray, shape (n,)
        sqrt(r' (A P A' + I)^-1 r).
    factor : ndarray, shape (n,)
        Scale f >= 1 of each noise covariance at which the innovation is at most the limit; it bounds a
        measurement's influence as Huber's loss does.
    """
    squared = filter_kernel.squared_innovations(A, residual, covariance)
    factor = np.ones(len(A))
    k = A.shape[2]
    beyond = np.flatnonzero(squared > limit * limit)
    if not len(beyond):
        return np.sqrt(squared), factor
    values, vectors = np.linalg.eigh(A[beyond] @ covariance[:k, :k] @ np.swapaxes(A[beyond], 1, 2))
    values = np.maximum(values, 0.0)
    parts = np.einsum("nji,nj->ni", vectors, residual[beyond]) ** 2
    # What all parts are at least, or one alone, bounds the factor from below. The sum is convex and falls as
    # the factor grows: Newton from the left cannot overshoot.
    allowed = parts / (limit * limit)
    least = np.maximum(allowed.sum(axis=1) - values.max(axis=1), (allowed - values).max(axis=1))
    factor[beyond] = np.maximum(least, 1.0)
    for _ in range(50):
        noise = values + factor[beyond, None]
        excess = np.sum(parts / noise, axis=1) - limit * limit
        high = excess > 1e-9 * limit * limit
        if not high.any():
            break
        factor[beyond[high]] += excess[high] / np.sum(parts[high] / noise[high] ** 2, axis=1)
    return np.sqrt(squared), factor
