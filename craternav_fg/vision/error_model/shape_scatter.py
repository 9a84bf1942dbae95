"""Rims whose shape contradicts the map: larger variances, before any pose tells how far they are off.

Rims on real ground, and their circles on a published map, err with heavy tails, and one that is badly seen or
badly mapped errs in all respects: place, size and shape. Of these the pose of the camera explains the first
two, but hardly the shape. So the variance of a rim's errors, in Student's t distribution, is estimated from
its shape alone, and is larger from the first image on, where three rims support a pose whatever they show.
"""

import numpy as np

from craternav_fg.catalogs.map_errors import CRATER_FREEDOM
from craternav_fg.linalg import squared_distance
from factors.arrays import FloatArray

# Difference of the growths along both axes, and shear: of the columns of `correlated.in_plane_slopes`.
_SHAPE = np.array([[0.0, 0.0, 1.0, 0.0, -1.0], [0.0, 0.0, 0.0, 1.0, 0.0]])


def shape_variance_factors(errors: FloatArray, covariance: FloatArray, slopes: FloatArray) -> FloatArray:
    """Compute by how much the variances of rims are larger than stated, as far as their shape shows it.

    It is the expectation of the variance in Student's t distribution, given the errors of the shape. No
    variance is made smaller than stated: a rim whose shape fits by chance is not a better one.

    Parameters
    ----------
    errors : ndarray, shape (n, 5)
        Measured less predicted charts, in normalised image coordinates.
    covariance : ndarray, shape (n, 5, 5)
        Of these, with the errors of the map.
    slopes : ndarray, shape (n, 5, 5)
        See `correlated.in_plane_slopes`.

    Returns
    -------
    ndarray, shape (n,)
        Variance factors, at least 1.

    References
    ----------
    Lange, Little, Taylor, J. American Statistical Association 84 (1989) 881,
    DOI 10.1080/01621459.1989.10478852.
    """
    of_shape = _SHAPE @ np.linalg.inv(slopes)
    deviation = np.einsum("nij,nj->ni", of_shape, errors)
    distance2 = squared_distance(deviation, of_shape @ covariance @ np.swapaxes(of_shape, 1, 2))
    return np.maximum(1.0, (CRATER_FREEDOM + distance2) / (CRATER_FREEDOM + len(_SHAPE)))
