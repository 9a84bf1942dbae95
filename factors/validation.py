"""Checks that every factor makes of what it is built from."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.errors import FactorError

FloatArray = npt.NDArray[np.float64]


def array(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Give a finite, C-ordered float array of one shape, a copy that nobody else can change.

    Raises
    ------
    FactorError
        Naming the field, when it is no array of numbers, the shape differs or an element is not finite.
    """
    try:
        out = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise FactorError(f"{name}: expected numbers of shape {shape}") from error
    if out.shape != shape:
        raise FactorError(f"{name}: expected shape {shape}, found {out.shape}")
    if not np.isfinite(out).all():
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
    """Give the number of craters, the length of a field.

    Raises
    ------
    FactorError
        When the field has none.
    """
    try:
        return len(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise FactorError(f"{name}: expected one row of numbers per crater") from error


def whitening(name: str, covariances: npt.ArrayLike, n: int, m: int) -> FloatArray:
    """Lower triangular W (n, m, m) with W S W' = 1, of covariances S (n, m, m).

    Raises
    ------
    FactorError
        When one is not symmetric or not positive definite.
    """
    S = array(name, covariances, (n, m, m))
    if not np.allclose(S, np.swapaxes(S, -1, -2), rtol=1e-9, atol=0.0):
        raise FactorError(f"{name}: expected symmetric matrices")
    # Scaled to unit diagonal first: a chart's components differ by orders of magnitude.
    diagonal = np.einsum("nii->ni", S)
    if not (diagonal > 0.0).all():
        raise FactorError(
            f"{name}: expected positive definite matrices, found a variance of {diagonal.min()}"
        )
    scale = np.sqrt(diagonal)
    try:
        L = np.linalg.cholesky(S / (scale[:, :, None] * scale[:, None, :]))
    except np.linalg.LinAlgError as error:
        raise FactorError(f"{name}: expected positive definite matrices") from error
    identity = np.broadcast_to(np.eye(m), (n, m, m))
    return np.ascontiguousarray(np.linalg.solve(L, identity) / scale[:, None, :])


def rotation(name: str, value: npt.ArrayLike) -> FloatArray:
    """Give a proper rotation matrix (3, 3).

    Raises
    ------
    FactorError
        When it is none.
    """
    R = array(name, value, (3, 3))
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
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
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0 or (T[3] != [0, 0, 0, 1]).any():
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
    a = np.linalg.norm(axes[:, 0], axis=-1)
    b = np.linalg.norm(axes[:, 1], axis=-1)
    dot = np.abs(np.einsum("ni,ni->n", axes[:, 0], axes[:, 1]))
    # The negated form also catches what is neither.
    bad = np.flatnonzero(~((b > 0.0) & (a >= b * (1.0 - 1e-9)) & (dot <= 1e-9 * a * b)))
    if len(bad):
        k = int(bad[0])
        raise FactorError(
            f"{name}[{k}]: expected perpendicular semi-axes a >= b > 0, found lengths {a[k]:g} and {b[k]:g}"
        )
    return axes
