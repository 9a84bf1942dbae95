"""Small dense linear algebra for the compiled ellipse fit.

Written out: numba takes seconds to compile the library functions.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import substitute

# Least pivot of a Cholesky factorisation, relative to the diagonal.
_MIN_PIVOT = 1e-12


@njit(cache=True, error_model="numpy")
def factorised(N: FloatArray, L: FloatArray) -> bool:
    """Factorise a symmetric matrix by Cholesky.

    Parameters
    ----------
    N : ndarray, shape (n, n)
        Symmetric, in any units.
    L : ndarray, shape (n, n)
        Written: the lower triangular factor.

    Returns
    -------
    bool
        False when N is not well determined; L is then not valid.
    """
    n = N.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = N[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                # Also False for NaN.
                if not total > _MIN_PIVOT * N[i, i]:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
        for j in range(i + 1, n):
            L[i, j] = 0.0
    return True


@njit(cache=True, error_model="numpy")
def solved(L: FloatArray, rhs: FloatArray) -> FloatArray:
    """Solve L L' x = rhs.

    Parameters
    ----------
    L : ndarray, shape (n, n)
        Lower triangular, in any units.
    rhs : ndarray, shape (n,)
        In the units of L L' x.

    Returns
    -------
    ndarray, shape (n,)
    """
    x = rhs.copy()
    substitute(L, x)
    return x


@njit(cache=True, error_model="numpy")
def inverse_block(N: FloatArray, C: FloatArray) -> bool:
    """Invert a matrix and keep the leading block of the inverse.

    Parameters
    ----------
    N : ndarray, shape (n, n)
        Symmetric, in any units.
    C : ndarray, shape (m, m)
        Written: the first m rows and columns of the inverse of N.

    Returns
    -------
    bool
        False when N is not well determined; C is then not valid.
    """
    L = np.zeros_like(N)
    if not factorised(N, L):
        return False
    unit = np.zeros(N.shape[0])
    for a in range(C.shape[0]):
        unit[:] = 0.0
        unit[a] = 1.0
        column = solved(L, unit)
        for b in range(C.shape[0]):
            C[b, a] = column[b]
    return True


@njit(cache=True, error_model="numpy")
def ordered(values: FloatArray) -> FloatArray:
    """Sort a copy by insertion: the values are few and often almost in order.

    Parameters
    ----------
    values : ndarray, shape (n,)
        In any unit.

    Returns
    -------
    ndarray, shape (n,)
        Ascending.
    """
    out = values.copy()
    for i in range(1, len(out)):
        value = out[i]
        j = i
        while j > 0 and out[j - 1] > value:
            out[j] = out[j - 1]
            j -= 1
        out[j] = value
    return out
