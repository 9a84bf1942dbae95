"""Robust standard deviation from the median absolute deviation."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64] | npt.NDArray[np.float32]

# Standard deviation of a Gaussian over its median absolute deviation, 1 / Phi^-1(3/4).
MAD_TO_SIGMA = 1.4826


def robust_sigma(deviations: FloatArray) -> float:
    """Estimate the standard deviation of values about zero; outliers hardly count.

    Parameters
    ----------
    deviations : ndarray, shape (n,) or (m, n)
        In any unit; at least one.

    Returns
    -------
    float
        In the unit of the deviations.
    """
    return MAD_TO_SIGMA * float(np.median(np.abs(deviations)))
