"""Checks of the measurements and constants that every factor is built from."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray
from factors.errors import FactorError
from factors.kernels import admission


def array(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Check that a field holds finite numbers, and copy it.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (...,)
        In any unit.
    shape : tuple of int
        Expected shape of `value`.

    Returns
    -------
    ndarray, shape (...,)
        C-ordered, in the unit of `value`: a copy that nobody else can change.

    Raises
    ------
    FactorError
        Naming the field, when it is no array of numbers, the shape differs or an element is not finite.
    """
    try:
        given = np.asarray(value)
        # Complex numbers would lose their imaginary part, masked ones their mask.
        real = given.dtype.kind in "biuf" and not np.ma.is_masked(value)
    except (TypeError, ValueError):
        real = False
    if not real:
        raise FactorError(f"{name}: expected real numbers of shape {shape}")
    out = np.array(given, dtype=np.float64, order="C")
    if out.shape != shape:
        raise FactorError(f"{name}: expected shape {shape}, found {out.shape}")
    # One sum of squares finds NaN and infinity at a fraction of an element-wise test's cost; it can overflow.
    if not (math.isfinite(admission.sum_of_squares(out.reshape(-1))) or np.isfinite(out).all()):
        raise FactorError(f"{name}: expected finite numbers, found {out[~np.isfinite(out)][0]}")
    return out


def length(name: str, value: Sequence[npt.ArrayLike]) -> int:
    """Count the craters of a sequence with an array per crater.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : sequence of array_like, shape (n, ...)
        One array per crater, in any unit.

    Returns
    -------
    int
        Number n of craters.

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
    """Count the rows of a field.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (n, ...)
        In any unit.

    Returns
    -------
    int
        Number n of rows.

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
    """Check the charts of ellipses.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (n, 5)
        Ellipse charts, normalised.
    n : int

    Returns
    -------
    ndarray, shape (n, 5)
        Charts of ellipses that double precision can hold as conics.

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
    """Whitening matrices of covariances.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    covariances : array_like, shape (n, m, m)
    n, m : int

    Returns
    -------
    ndarray, shape (n, m, m)
        Lower triangular W with W S W' = 1, for each covariance S.

    Raises
    ------
    FactorError
        Naming the first covariance that is not symmetric or not positive definite.
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
    """Check a rotation matrix.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (3, 3)
        Rotation between any frames.

    Returns
    -------
    ndarray, shape (3, 3)
        The rotation.

    Raises
    ------
    FactorError
        When it is no proper rotation.
    """
    R = array(name, value, (3, 3))
    if not admission.is_rotation(R):
        raise FactorError(f"{name}: expected a proper rotation")
    return R


def unit_vectors(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Check unit vectors.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (n, 3)
        Directions in any frame.
    n : int

    Returns
    -------
    ndarray, shape (n, 3)
        The directions in the same frame.

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
    """Check the homogeneous matrix of a pose.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (4, 4)
        Pose of any frame in another, m.

    Returns
    -------
    ndarray, shape (4, 4)
        The pose.

    Raises
    ------
    FactorError
        When it is not a proper rotation and a position above a last row (0, 0, 0, 1).
    """
    T = array(name, value, (4, 4))
    if not (admission.is_rotation(T) and T[3].tolist() == [0.0, 0.0, 0.0, 1.0]):
        raise FactorError(f"{name}: expected a homogeneous matrix with a proper rotation")
    return T


def rim_axes(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    """Check the semi-axes of rims.

    Parameters
    ----------
    name : str
        Name of the field, for the error message.
    value : array_like, shape (n, 2, 3)
        Semi-axes a l1 and b l2 in any frame, m.
    n : int

    Returns
    -------
    ndarray, shape (n, 2, 3)
        The semi-axes in the same frame, m.

    Raises
    ------
    FactorError
        Naming the first crater whose semi-axes are not perpendicular with a >= b > 0.
    """
    axes = array(name, value, (n, 2, 3))
    k, a, b = admission.first_bad_axes(axes)
    if k >= 0:
        raise FactorError(
            f"{name}[{k}]: expected perpendicular semi-axes a >= b > 0, found lengths {a:g} and {b:g}"
        )
    return axes
