"""Conic-shape factor: the rim's image against its prediction, in the ellipse chart.

Zero when every predicted rim has the measured image. It carries the same information as eq. (19) whitened and
has the same optimum, with a far wider basin of convergence (docs/equations.md, "The chart").
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.ahead import Ahead
from factors.arrays import FloatArray
from factors.custom import Loss, constant_mounting, packed_pose_factor, packed_pose_factor_with_errors
from factors.errors import FactorError
from factors.kernels import packed, rim_errors

# Six for the pose, and one that keeps the error's constant.
REDUCED_ROWS = 7


@dataclass(frozen=True)
class ChartError:
    """An error of rims' images that is a variable, such as what one rim's images have in common.

    Attributes
    ----------
    keys : sequence of int, length n
        Key of the variable that moves each of n rims, a vector of length m; several rims may share one.
    roots : ndarray, shape (n, 5, m)
        It adds roots @ vector to their predicted charts.
    """

    keys: Sequence[int]
    roots: FloatArray


def conic_shape_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    centres: npt.ArrayLike,
    axes: npt.ArrayLike,
    charts: npt.ArrayLike,
    covariances: npt.ArrayLike,
    loss: Loss = Loss(),
    *,
    mounting_key: int | None = None,
    reduced: bool = False,
    ahead: Ahead | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of the body's pose from the rims of a frame.

    Zero when the predicted images of all rims are the measured ones.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4), or None
        Mounting of the camera; None when `mounting_key` is given.
    centres : array_like, shape (n, 3)
        Rim centres in g, m.
    axes : array_like, shape (n, 2, 3)
        Semi-axes a l1, b l2 in g, m, with l1 x l2 outward: a rim is seen from that side only.
    charts : array_like, shape (n, 5)
        Measured images in the ellipse chart, normalised coordinates.
    covariances : array_like, shape (n, 5, 5)
        Covariances of the charts.
    loss : Loss
        Applied to each crater's 5-dimensional norm.
    mounting_key : int, optional
        Key of the mounting as a variable (`Pose3`), to be estimated.
    reduced : bool
        Whether the rows of several rims are turned into seven that optimisers cannot tell from them: less to
        copy and to eliminate. The residual of a single rim can then not be read.
    ahead : Ahead, optional
        Evaluates the rims of many frames at once, where they are reduced and the mounting is known.

    Returns
    -------
    gtsam.CustomFactor
        With 5 n whitened rows, or `REDUCED_ROWS`; of the pose, and of the mounting if it is a variable.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive definite.
    """
    n = validation.count("charts", charts)
    if mounting_key is None:
        data = _packed(n, (bTc, centres, axes, charts, covariances), loss)
        if len(data):
            return _of_packed(key, n, data, None, ahead, reduced=reduced)
    centres = validation.array("centres", centres, (n, 3))
    axes = validation.rim_axes("axes", axes, n)
    charts = validation.charts("charts", charts, n)
    W = validation.whitening("covariances", covariances, n, 5)
    mounting = constant_mounting(key, bTc, mounting_key)
    data = packed.pack(mounting, centres, axes, charts, W, loss.kind, loss.scale_sigmas)
    return _of_packed(key, n, data, mounting_key, ahead, reduced=reduced)


def conic_shape_factors(
    key: int,
    bTc: npt.ArrayLike,
    centres: npt.ArrayLike,
    axes: npt.ArrayLike,
    charts: npt.ArrayLike,
    covariances: npt.ArrayLike,
    errors: Sequence[ChartError],
    loss: Loss = Loss(),
) -> list[gtsam.CustomFactor]:
    """Build factors of the body's pose and of errors of the rims of a frame: one for each rim.

    One factor of all rims would have zeros for the errors of all others, and an elimination would fill them
    in.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4)
        Mounting of the camera.
    centres : array_like, shape (n, 3)
        Rim centres in g, m.
    axes : array_like, shape (n, 2, 3)
        Semi-axes as in `conic_shape_factor`, m.
    charts : array_like, shape (n, 5)
        Measured images in the ellipse chart, normalised coordinates.
    covariances : array_like, shape (n, 5, 5)
        Covariances of the charts without `errors`.
    errors : sequence of ChartError
        Errors of the charts, to be estimated.
    loss : Loss
        Applied to each crater's 5-dimensional norm.

    Returns
    -------
    list of gtsam.CustomFactor
        With 5 whitened rows, of the pose and of one variable of each error.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive definite.
    """
    data = pack_with_errors(bTc, centres, axes, charts, covariances, errors, loss)
    lengths = [error.roots.shape[2] for error in errors]
    kernel = rim_errors.shape_residuals_with_errors
    return [
        packed_pose_factor_with_errors(key, 5, kernel, of_rim, list(zip(keys, lengths, strict=True)))
        for of_rim, keys in zip(data, zip(*(error.keys for error in errors), strict=True), strict=True)
    ]


def pack_with_errors(
    bTc: npt.ArrayLike,
    centres: npt.ArrayLike,
    axes: npt.ArrayLike,
    charts: npt.ArrayLike,
    covariances: npt.ArrayLike,
    errors: Sequence[ChartError],
    loss: Loss,
) -> FloatArray:
    """Check the rims of a frame and pack them, each by itself.

    Parameters
    ----------
    bTc, centres, axes : array_like, shapes (4, 4), (n, 3), (n, 2, 3)
        Lengths in m, as for `conic_shape_factors`.
    charts, covariances : array_like, shapes (n, 5), (n, 5, 5)
        In normalised coordinates; without the errors.
    errors : sequence of ChartError
        Errors of the charts, to be estimated.
    loss : Loss
        Applied to each crater's 5-dimensional norm.

    Returns
    -------
    ndarray, shape (n, n_data)
        From `rim_errors.pack_apart`, with the errors' columns one after the other.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive definite.
    """
    n = validation.count("charts", charts)
    for k, error in enumerate(errors):
        shape = np.shape(error.roots)
        if len(error.keys) != n or len(shape) != 3 or shape[:2] != (n, 5) or shape[2] < 1:
            raise FactorError(f"errors[{k}]: expected {n} keys and roots of shape ({n}, 5, m), found {shape}")
    roots = np.concatenate([error.roots for error in errors], axis=2)
    data = _packed(n, (bTc, centres, axes, charts, covariances), loss)
    if not len(data):
        charts = validation.charts("charts", charts, n)
        data = packed.pack(
            validation.pose("bTc", bTc),
            validation.array("centres", centres, (n, 3)),
            validation.rim_axes("axes", axes, n),
            charts,
            validation.whitening("covariances", covariances, n, 5),
            loss.kind,
            loss.scale_sigmas,
        )
    apart = rim_errors.pack_apart(data, charts, roots)
    if not len(apart):
        validation.array("errors.roots", roots, roots.shape)
    return np.asarray(apart)


def _packed(n: int, fields: tuple[npt.ArrayLike | None, ...], loss: Loss) -> FloatArray:
    """Check all fields at once, and pack them; empty where one is to be looked at by itself."""
    return (
        packed.pack_if_sound(*fields, loss.kind, loss.scale_sigmas) if _are_plain(n, fields) else np.empty(0)
    )


def _are_plain(n: int, fields: tuple[npt.ArrayLike | None, ...]) -> bool:
    """Whether kernels can take the fields as they are."""
    shapes = ((4, 4), (n, 3), (n, 2, 3), (n, 5), (n, 5, 5))
    return all(
        # No subclass: masked arrays are refused by name.
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.shape == shape
        and value.flags.carray
        for value, shape in zip(fields, shapes, strict=True)
    )


def _of_packed(
    key: int, n: int, data: FloatArray, mounting_key: int | None, ahead: Ahead | None, *, reduced: bool
) -> gtsam.CustomFactor:
    """Build the factor of packed rims."""
    if reduced and n > 1:
        kernel = packed.reduced_shape_residuals
        first = ahead if mounting_key is None else None
        return packed_pose_factor(key, REDUCED_ROWS, kernel, data, mounting_key, first)
    return packed_pose_factor(key, 5 * n, packed.shape_residuals, data, mounting_key)
