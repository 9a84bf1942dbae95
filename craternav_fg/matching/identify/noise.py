"""Error model of the rims of one image, and how its parameters are estimated from the image.

The noise of an image's rims is an array (3,):

0. standard deviation of each coordinate of a centre, px;
1. standard deviation of the semi-axes over `AXIS_SIGMA_PX`, px;
2. relative standard deviation of the semi-axes.

Errors of the axes are constant in pixels where they come from blur, and proportional to the axes where they
come from maps and irregular outlines; which of the two prevails is estimated from the rims themselves.
"""

import numpy as np

from craternav_fg.matching.identify.view import AXIS_SIGMA_PX, View
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Standard deviations of centres that are considered, px: from a well-fitted rim to a poor one.
CENTRE_SIGMA_RANGE_PX = (0.25, 8.0)
# Median of a chi-square variable of two degrees of freedom, 2 ln 2.
CHI2_2_MEDIAN = 1.386
# Noise of the axes that is considered: elements 1 and 2 of the noise.
AXIS_LEVELS = 0.25 * 2.0 ** np.arange(0.0, 5.5, 0.5)
AXIS_SHARES = np.array([0.01, 0.02, 0.04, 0.08, 0.12])
# Scale of the Cauchy prior on the logarithm of the ratio of elements 1 and 0: usually within a factor of 2.
_LOG_RATIO_SCALE = 0.7
# Degrees of freedom of the Student distribution of errors of shape: tails heavier than Gaussian ones.
_STUDENT_DOF = 5.0


@njit(cache=True, error_model="numpy")
def shape_scale(view: View, i: int, sigma: FloatArray) -> float:
    """Compute the standard deviation of a rim's shape over that at a noise of 1 px.

    Parameters
    ----------
    view : View
    i : int
        The rim.
    sigma : ndarray, shape (3,)
        Noise of the image's rims.
    """
    return np.sqrt(sigma[1] ** 2 + (sigma[2] * view.radius_px[i] / AXIS_SIGMA_PX) ** 2)


@njit(cache=True, error_model="numpy")
def median(values: FloatArray, count: int) -> float:
    """Median of the first `count` values, by sorting them in place: NumPy's takes seconds to compile.

    Parameters
    ----------
    values : ndarray, shape (n,)
        The first `count` are sorted.
    count : int
        At least one.
    """
    for i in range(1, count):
        value = values[i]
        j = i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@njit(cache=True, error_model="numpy")
def log_axis_prior(axis: float, centre: float) -> float:
    """Logarithm of the prior density of the axes' noise given that of the centres, but for a constant.

    Parameters
    ----------
    axis, centre : float
        Elements 1 and 0 of the noise.
    """
    return -np.log1p((np.log(axis / centre) / _LOG_RATIO_SCALE) ** 2)


@njit(cache=True, error_model="numpy")
def fit_axis_noise(
    d2: FloatArray, radius: FloatArray, count: int, left: float, centre: float, sigma: FloatArray
) -> None:
    """Find the most probable noise of the axes of matched rims.

    Parameters
    ----------
    d2 : ndarray, shape (n,)
        Squared errors of the shapes, three degrees of freedom, at a noise of 1 px.
    radius : ndarray, shape (n,)
        Mean radii, px.
    count : int
        Rims: the first of these arrays.
    left : float
        Share of the degrees of freedom that the fit of the pose has left.
    centre : float
        Noise of the centres, px, for the prior.
    sigma : ndarray, shape (3,)
        Noise; its last two elements are written.
    """
    best = -np.inf
    for size in AXIS_LEVELS:
        for share in AXIS_SHARES:
            total = log_axis_prior(size, centre)
            for k in range(count):
                scale2 = size * size + (share * radius[k] / AXIS_SIGMA_PX) ** 2
                total -= 0.5 * (_STUDENT_DOF + 3.0) * np.log1p(d2[k] / (_STUDENT_DOF * scale2))
                total -= 1.5 * left * np.log(scale2)
            if total > best:
                best = total
                sigma[1], sigma[2] = size, share
