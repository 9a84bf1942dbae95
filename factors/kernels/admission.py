"""Checks of the numbers that a factor is built from, at the cost of a few craters' residuals."""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Smallest pivot of a matrix of unit diagonal: a smaller one is rounding of a singular matrix.
_LEAST_PIVOT = 1e-12
SOUND, ASYMMETRIC, VARIANCE, INDEFINITE = 0, 1, 2, 3


@njit(cache=True, error_model="numpy")
def whiten_all(S: FloatArray, W: FloatArray) -> tuple[int, int]:
    """Write the whitening matrices of covariances.

    Parameters
    ----------
    S : ndarray, shape (n, m, m)
        Covariances.
    W : ndarray, shape (n, m, m)
        Written: lower triangular, with W S W' = 1.

    Returns
    -------
    fault : int
        `SOUND`, or the fault of the first covariance that has one: `ASYMMETRIC`, `VARIANCE` (a variance that
        is not positive) or `INDEFINITE`.
    index : int
        Row of that covariance; -1 when all are sound.
    """
    m = S.shape[1]
    scale = np.empty(m)
    L = np.empty((m, m))
    for k in range(S.shape[0]):
        for i in range(m):
            if not S[k, i, i] > 0.0:
                return VARIANCE, k
            scale[i] = 1.0 / np.sqrt(S[k, i, i])
            for j in range(i):
                if not abs(S[k, i, j] - S[k, j, i]) * scale[i] * scale[j] <= 1e-9:
                    return ASYMMETRIC, k
        # Scaled to unit diagonal: a chart's components differ by orders of magnitude.
        for i in range(m):
            for j in range(i + 1):
                total = S[k, i, j] * scale[i] * scale[j]
                for r in range(j):
                    total -= L[i, r] * L[j, r]
                if j < i:
                    L[i, j] = total / L[j, j]
                elif total > _LEAST_PIVOT:
                    L[i, i] = np.sqrt(total)
                else:
                    return INDEFINITE, k
        for j in range(m):
            for i in range(m):
                if i < j:
                    W[k, i, j] = 0.0
                    continue
                total = 1.0 if i == j else 0.0
                for r in range(j, i):
                    # The factor that scales column j was applied to these already.
                    total -= L[i, r] * W[k, r, j] / scale[j]
                W[k, i, j] = total / L[i, i] * scale[j]
    return SOUND, -1


@njit(cache=True, error_model="numpy")
def sum_of_squares(a: FloatArray) -> float:
    """Sum of squares of an array, infinite without a warning where it overflows.

    Parameters
    ----------
    a : ndarray, shape (n,)
        In any unit.

    Returns
    -------
    float
        Finite only where all elements are.
    """
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * a[i]
    return total


# Bounds of a chart's logarithms and of its other components, normalised: far beyond any image.
_LOGARITHM, _COMPONENT = 50.0, 1e10


@njit(cache=True, error_model="numpy")
def first_bad_chart(charts: FloatArray) -> int:
    """Find the first chart whose conic would leave double precision.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        Ellipse charts in normalised image coordinates.

    Returns
    -------
    int
        Its index, or -1.
    """
    for k in range(charts.shape[0]):
        for i in range(5):
            if not abs(charts[k, i]) < (_LOGARITHM if i in (2, 4) else _COMPONENT):
                return k
    return -1


@njit(cache=True, error_model="numpy")
def first_bad_axes(axes: FloatArray) -> tuple[int, float, float]:
    """Find the first pair of semi-axes that is not perpendicular with a >= b > 0.

    Parameters
    ----------
    axes : ndarray, shape (n, 2, 3)
        Semi-axes a l1 and b l2 in any frame, m.

    Returns
    -------
    index : int
        Row of that pair, or -1.
    a, b : float
        Its lengths, m.
    """
    for k in range(axes.shape[0]):
        a2 = b2 = dot = 0.0
        for i in range(3):
            a2 += axes[k, 0, i] * axes[k, 0, i]
            b2 += axes[k, 1, i] * axes[k, 1, i]
            dot += axes[k, 0, i] * axes[k, 1, i]
        a, b = np.sqrt(a2), np.sqrt(b2)
        # The negated form also catches what is neither.
        if not (b > 0.0 and a >= b * (1.0 - 1e-9) and abs(dot) <= 1e-9 * a * b):
            return k, a, b
    return -1, 0.0, 0.0


@njit(cache=True, error_model="numpy")
def is_rotation(R: FloatArray) -> bool:
    """Whether the upper left (3, 3) of a matrix is a proper rotation, to 1e-6.

    Parameters
    ----------
    R : ndarray, shape (3, 3) or (4, 4)
        A rotation or a pose, between any frames.

    Returns
    -------
    bool
    """
    for i in range(3):
        for j in range(i + 1):
            dot = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2]
            if not abs(dot - (i == j)) <= 1e-6:
                return False
    det = (
        R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
        - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
        + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    )
    return det > 0.0
