"""Linear algebra of small covariances whose unknowns differ by orders of magnitude, and orthonormal triads.

Radians stand beside metres. So matrices are scaled to a unit diagonal before they are factored or inverted,
and the result is scaled back: it does not depend on the units of the unknowns.
"""

import numpy as np

from factors.arrays import FloatArray

# Cyclic permutations of three components.
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def scaled_inverse(N: FloatArray) -> FloatArray:
    """Invert positive definite matrices, scaled to a unit diagonal.

    Parameters
    ----------
    N : ndarray, shape (..., n, n)
        Covariances or information matrices.

    Returns
    -------
    ndarray, shape (..., n, n)
        Inverses.
    """
    s = 1.0 / np.sqrt(np.diagonal(N, axis1=-2, axis2=-1))
    scale = s[..., :, None] * s[..., None, :]
    return np.asarray(np.linalg.inv(N * scale) * scale)


def square_root(covariance: FloatArray) -> FloatArray:
    """Factor covariances by Cholesky, scaled to a unit diagonal.

    Parameters
    ----------
    covariance : ndarray, shape (..., n, n)
        Positive definite.

    Returns
    -------
    ndarray, shape (..., n, n)
        Lower triangular L with L L' = covariance.

    Raises
    ------
    LinAlgError
        When a covariance is not positive definite.
    """
    L, sigmas = _scaled_root(covariance)
    return np.asarray(sigmas[..., :, None] * L)


def whitening(covariance: FloatArray) -> FloatArray:
    """Compute matrices that turn errors of some covariances into errors of unit covariance.

    Parameters
    ----------
    covariance : ndarray, shape (..., n, n)
        Positive definite.

    Returns
    -------
    ndarray, shape (..., n, n)
        W with W covariance W' = I and W' W = covariance^-1; lower triangular, to rounding.

    Raises
    ------
    LinAlgError
        When a covariance is not positive definite.
    """
    L, sigmas = _scaled_root(covariance)
    # The inverse of a small factor, not a triangular solve: LAPACK's starts threads whatever the size.
    return np.asarray(np.linalg.inv(L) / sigmas[..., None, :])


def squared_distance(residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """Compute squared Mahalanobis distances r' C^-1 r.

    Parameters
    ----------
    residual : ndarray, shape (..., n)
        Residuals r.
    covariance : ndarray, shape (..., n, n)
        Covariances C, positive definite.

    Returns
    -------
    ndarray, shape (...,)
        Chi-square with n degrees of freedom when C is the covariance of r; inf where C is singular.
    """
    sigmas = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    e = residual / sigmas
    correlation = covariance / (sigmas[..., :, None] * sigmas[..., None, :])
    try:
        solved = np.linalg.solve(correlation, e[..., None])
    except np.linalg.LinAlgError:
        singular = np.linalg.det(correlation) == 0.0
        if not singular.any():
            raise
        regular = np.where(singular[..., None, None], np.eye(correlation.shape[-1]), correlation)
        solved = np.linalg.solve(regular, e[..., None])
        return np.where(singular, np.inf, np.sum(e * solved[..., 0], axis=-1))
    return np.asarray(np.sum(e * solved[..., 0], axis=-1))


def _scaled_root(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cholesky factors of the correlations, and the standard deviations."""
    sigmas = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return np.linalg.cholesky(covariance / (sigmas[..., :, None] * sigmas[..., None, :])), sigmas


def triads(along: FloatArray, aside: FloatArray) -> FloatArray:
    """Build rotations whose first column is along a given direction (TRIAD).

    Parameters
    ----------
    along : ndarray, shape (..., 3)
        Unit vectors in any frame: the first columns.
    aside : ndarray, shape (..., 3)
        Vectors of any length in the same frame; their part orthogonal to `along` gives the second columns.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Right-handed rotations.
    """
    e = aside - np.sum(aside * along, axis=-1, keepdims=True) * along
    # Where both are parallel the second column is zero, not NaN.
    e /= np.linalg.norm(e, axis=-1, keepdims=True) + 1e-300
    return np.stack([along, e, _cross(along, e)], axis=-1)


def bisecting_triads(one: FloatArray, other: FloatArray) -> FloatArray:
    """Build rotations from pairs of directions that count alike: along their sum and their difference.

    Parameters
    ----------
    one, other : ndarray, shape (..., 3)
        Unit vectors in one frame, neither equal nor opposite.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Right-handed rotations.
    """
    middle = one + other
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    across = one - other
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.stack([middle, across, _cross(middle, across)], axis=-1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (..., 3): of a few vectors, `numpy.cross` takes three times as long."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT])
