"""Checks that every factor makes of what it is built from."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.errors import FactorError
from factors.kernels import admission

FloatArray = npt.NDArray[np.float64]


def array(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Give a finite, C-ordered float array of one shape, a copy that nobody else can change.

    Raises
    ------
    FactorError
        Naming the field, when it is no array of numbers, the shape differs or an element is not finite.
    """
    try:
        given = np.asarray(value)
        # Complex numbers would lose their imaginary part, masked ones their mask.
        if given.dtype.kind not in "biuf" or np.ma.is_masked(value):
            raise TypeError(f"found {given.dtype}")
        out = np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise FactorError(f"{name}: expected real numbers of shape {shape}") from error
    if out.shape != shape:
        raise FactorError(f"{name}: expected shape {shape}, found {out.shape}")
    # One sum of squares finds NaN and infinity at a fraction of an element-wise test's cost; it can overflow.
    if not (math.isfinite(admission.sum_of_squares(out.reshape(-1))) or np.isfinite(out).all()):
        raise FactorError(f"{name}: expected finite numbers, found {out[~np.isfinite(out)][0]}")
    return out


def length(name: str, value: Sequence[npt.ArrayLike]) -> int:
    """Give the number of craters, the length of a sequence with an array per crater.

    Raises
    ------
    FactorError
        When the field is no sequence.
    """
    try:
        return len(value)
    except TypeError as error:
        raise FactorError(f"{name}: expected a sequence with an array per crater") from error


def count(name: str, value: npt.ArrayLike) -> int:
    """Give the number of rows of a field.

    Raises
    ------
    FactorError
        When the field has no rows.
    """
    try:
        n = len(np.asarray(value))
    except (TypeError, ValueError) as error:
        raise FactorError(f"{name}: expected rows of numbers") from error
    if n == 0:
        raise FactorError(f"{name}: expected at least one row, found none")
    return n


def charts(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Give charts (n, 5) of ellipses that double precision can hold as conics.

    Raises
    ------
    FactorError
        Naming the first crater at fault.
    """
    out = array(name, value, (n, 5))
    k = admission.first_bad_chart(out)
    if k >= 0:
        raise FactorError(f"{name}[{k}]: expected the chart of an ellipse in normalised coordinates")
    return out


def whitening(name: str, covariances: npt.ArrayLike, n: int, m: int) -> FloatArray:
    """Lower triangular W (n, m, m) with W S W' = 1, of covariances S (n, m, m).

    Raises
    ------
    FactorError
        Naming the first that is not symmetric or not positive definite.
    """
    S = array(name, covariances, (n, m, m))
    W = np.empty((n, m, m))
    fault, k = admission.whiten_all(S, W)
    if fault == admission.ASYMMETRIC:
        raise FactorError(f"{name}[{k}]: expected a symmetric matrix")
    if fault == admission.VARIANCE:
        raise FactorError(
            f"{name}[{k}]: expected a positive definite matrix, found a variance of {np.diag(S[k]).min():g}"
        )
    if fault == admission.INDEFINITE:
        raise FactorError(f"{name}[{k}]: expected a positive definite matrix")
    if not math.isfinite(admission.sum_of_squares(W.reshape(-1))):
        raise FactorError(f"{name}: expected variances that have an inverse, found {S[S > 0.0].min():g}")
    return W


def rotation(name: str, value: npt.ArrayLike) -> FloatArray:
    """Give a proper rotation matrix (3, 3).

    Raises
    ------
    FactorError
        When it is none.
    """
    R = array(name, value, (3, 3))
    if not admission.is_rotation(R):
        raise FactorError(f"{name}: expected a proper rotation")
    return R


def unit_vectors(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Give unit vectors (n, 3).

    Raises
    ------
    FactorError
        When the length of one is not 1.
    """
    vectors = array(name, value, (n, 3))
    length = np.linalg.norm(vectors, axis=-1)
    if (np.abs(length - 1.0) > 1e-6).any():
        raise FactorError(
            f"{name}: expected unit vectors, found a length of {length[np.argmax(np.abs(length - 1.0))]:g}"
        )
    return vectors


def pose(name: str, value: npt.ArrayLike) -> FloatArray:
    """Give a homogeneous matrix (4, 4) whose rotation is one.

    Raises
    ------
    FactorError
        When it is not a proper rotation with a last row (0, 0, 0, 1).
    """
    T = array(name, value, (4, 4))
    if not (admission.is_rotation(T) and T[3].tolist() == [0.0, 0.0, 0.0, 1.0]):
        raise FactorError(f"{name}: expected a homogeneous matrix with a proper rotation")
    return T


def rim_axes(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Give semi-axes (n, 2, 3): perpendicular, the first not shorter than the second, neither zero.

    Raises
    ------
    FactorError
        Naming the first crater at fault.
    """
    axes = array(name, value, (n, 2, 3))
    k, a, b = admission.first_bad_axes(axes)
    if k >= 0:
        raise FactorError(
            f"{name}[{k}]: expected perpendicular semi-axes a >= b > 0, found lengths {a:g} and {b:g}"
        )
    return axes
