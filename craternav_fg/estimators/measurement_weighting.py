"""Weights of measurements: covariances evaluated at the predicted measurement, and limits on innovations.

A fit gives its covariance at what it measured. There the weight depends on the measurement's own error: a rim
measured too small gets a larger error of its logarithm and less weight, so that on average all rims seem too
large. Evaluated at the image that a pose from other data predicts, the weights do not depend on it. The
smoothers take that pose from their own first solution, the online smoother and the filter from the
prediction.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]


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
    return replace(frame, rims=frame.rims.expected_at(charts))


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
    covariance : ndarray, shape (k, k)
        Covariance of the prior's error.
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
    predicted = A @ covariance @ np.swapaxes(A, 1, 2)
    # Whitened: no scaling is needed.
    solved = np.linalg.solve(predicted + np.eye(A.shape[1]), residual[:, :, None])[:, :, 0]
    squared = np.sum(residual * solved, axis=1)
    factor = np.ones(len(A))
    for i in np.flatnonzero(squared > limit * limit):
        values, vectors = np.linalg.eigh(predicted[i])
        values = np.maximum(values, 0.0)
        parts = (vectors.T @ residual[i]) ** 2
        # Convex and falling in the factor: Newton from the left cannot overshoot.
        for _ in range(50):
            excess = float(np.sum(parts / (values + factor[i]))) - limit * limit
            if excess <= 1e-9 * limit * limit:
                break
            factor[i] += excess / float(np.sum(parts / (values + factor[i]) ** 2))
    return np.sqrt(squared), factor
