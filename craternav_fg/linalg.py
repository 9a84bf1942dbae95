"""Linear algebra of small matrices whose unknowns differ by orders of magnitude, and orthonormal triads."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def scaled_inverse(N: FloatArray) -> FloatArray:
    """Inverse of positive definite matrices (..., n, n), scaled to a unit diagonal before it is taken."""
    s = 1.0 / np.sqrt(np.diagonal(N, axis1=-2, axis2=-1))
    scale = s[..., :, None] * s[..., None, :]
    return np.asarray(np.linalg.inv(N * scale) * scale)


def triads(along: FloatArray, aside: FloatArray) -> FloatArray:
    """Rotations with a first column along given unit vectors.

    Parameters
    ----------
    along : ndarray, shape (..., 3)
        Unit vectors: the first columns.
    aside : ndarray, shape (..., 3)
        Its part orthogonal to `along` gives the second columns.

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    e = aside - np.sum(aside * along, axis=-1, keepdims=True) * along
    e /= np.linalg.norm(e, axis=-1, keepdims=True) + 1e-300
    return np.stack([along, e, np.cross(along, e)], axis=-1)


def bisecting_triads(one: FloatArray, other: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) with columns along the sum and the difference of unit vectors (..., 3)."""
    middle = one + other
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    across = one - other
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.stack([middle, across, np.cross(middle, across)], axis=-1)
