"""Scatter of a frame's rims about their common pose, beyond what their covariances claim."""

import numpy as np
from scipy.special import chdtri

from factors.arrays import FloatArray

# With fewer rims the scatter about a pose of six unknowns shows little of the covariances.
_MIN_RIMS = 6


def variance_factor(distance2: FloatArray, components: int) -> float:
    """Compute the factor, at least 1, by which residuals exceed their covariances.

    Rims on rough terrain scatter more about any pose than their own edge points show. The median is robust
    against rims that are matched to the wrong crater.

    Parameters
    ----------
    distance2 : ndarray, shape (n,)
        Squared Mahalanobis distances of the residuals.
    components : int
        Components of each residual.

    Returns
    -------
    float
        Variance factor; 1 with too few rims.
    """
    if len(distance2) < _MIN_RIMS:
        return 1.0
    return max(1.0, float(np.median(distance2) / chdtri(components, 0.5)))
