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
from factors.custom import Loss, constant_mounting, packed_pose_factor, packed_pose_factor_with_errors
from factors.errors import FactorError
from factors.kernels import packed, rim_errors, robust

FloatArray = npt.NDArray[np.float64]

# Six for the pose, and one that keeps the error's constant.
REDUCED_ROWS = 7


@dataclass(frozen=True)
class ChartError:
    """An error of rims' images that is a variable, such as what one rim's images have in common.

    Attributes
    ----------
    key : int
        Key of the variable, a vector of length m.
    rims : sequence of int, length k
        Rows of the rims that it moves.
    roots : array_like, shape (k, 5, m)
        It adds roots @ vector to their predicted charts.
    """

    key: int
    rims: Sequence[int]
    roots: npt.ArrayLike


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
    errors: Sequence[ChartError] = (),
    reduced: bool = False,
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
    errors : sequence of ChartError
        Errors of the charts, beside those of `covariances`, to be estimated.
    reduced : bool
        Whether the rows of several rims without `errors` are turned into seven that optimisers cannot tell
        from them: less to copy and to eliminate. The residual of a single rim can then not be read.

    Returns
    -------
    gtsam.CustomFactor
        With 5 n whitened rows, or `REDUCED_ROWS`; of the pose, the mounting if it is a variable, and the
        errors' variables.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive definite.
    """
    n = validation.count("charts", charts)
    if not errors and mounting_key is None:
        data = _packed(n, (bTc, centres, axes, charts, covariances), loss)
        if len(data):
            return _without_errors(key, n, data, None, reduced=reduced)
    centres = validation.array("centres", centres, (n, 3))
    axes = validation.rim_axes("axes", axes, n)
    charts = validation.charts("charts", charts, n)
    W = validation.whitening("covariances", covariances, n, 5)
    mounting = constant_mounting(key, bTc, mounting_key)
    if errors:
        data = packed.pack(mounting, centres, axes, charts, W, robust.NONE, 1.0)
        lengths = [_length(k, error) for k, error in enumerate(errors)]
        ends = np.cumsum([0, *lengths])
        roots = np.zeros((n, 5, ends[-1]))
        for k, error in enumerate(errors):
            shape = (len(error.rims), 5, lengths[k])
            roots[list(error.rims), :, ends[k] : ends[k + 1]] += validation.array(
                f"errors[{k}].roots", error.roots, shape
            )
        white = np.ascontiguousarray((W @ roots).reshape(5 * n, -1))
        roots = roots.reshape(5 * n, -1)

        def kernel(
            T: FloatArray, z: FloatArray, linearise: bool, out: FloatArray, slopes: FloatArray
        ) -> float:
            return rim_errors.shape_residuals_with_errors(
                T, z, data, charts, roots, white, loss.kind, loss.scale, linearise, out, slopes
            )

        keys = [(error.key, length) for error, length in zip(errors, lengths, strict=True)]
        return packed_pose_factor_with_errors(key, 5 * n, kernel, keys, mounting_key)
    data = packed.pack(mounting, centres, axes, charts, W, loss.kind, loss.scale)
    return _without_errors(key, n, data, mounting_key, reduced=reduced)


def _packed(n: int, fields: tuple[npt.ArrayLike | None, ...], loss: Loss) -> FloatArray:
    """Check all fields at once, and pack them; empty where one is to be looked at by itself."""
    shapes = ((4, 4), (n, 3), (n, 2, 3), (n, 5), (n, 5, 5))
    for value, shape in zip(fields, shapes, strict=True):
        # No subclass: masked arrays are refused by name.
        if not (type(value) is np.ndarray and value.dtype == np.float64 and value.shape == shape):
            return np.empty(0)
        if not value.flags.carray:
            return np.empty(0)
    return packed.pack_if_sound(*fields, loss.kind, loss.scale)


def _without_errors(
    key: int, n: int, data: FloatArray, mounting_key: int | None, *, reduced: bool
) -> gtsam.CustomFactor:
    """Build the factor of packed rims whose errors are no variables."""
    if reduced and n > 1:
        return packed_pose_factor(key, REDUCED_ROWS, packed.reduced_shape_residuals, data, mounting_key)
    return packed_pose_factor(key, 5 * n, packed.shape_residuals, data, mounting_key)


def _length(number: int, error: ChartError) -> int:
    shape = np.shape(error.roots)
    if len(shape) != 3 or shape[2] < 1:
        raise FactorError(f"errors[{number}].roots: expected shape (k, 5, m), found {shape}")
    return int(shape[2])
