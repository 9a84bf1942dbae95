"""Rim-point factor: edge points against the predicted rim, for arcs too short for an ellipse fit.

Zero when every edge point lies on its predicted rim. Under about a third of a rim no ellipse fit is usable,
while each of its points still tells its distance; on a full rim the factor has the optimum of the
conic-shape factor, to the second order of the points' noise, with a narrower basin of convergence, under
Gauss-Newton (as iSAM2 steps) much narrower. Never put both on one crater.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.custom import Loss, constant_mounting, packed_pose_factor_with_errors, pose_factor
from factors.errors import FactorError
from factors.kernels import rim

# The square of a weight of less overflows.
LEAST_SIGMA = 1e-150


def rim_points_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    centres: npt.ArrayLike,
    axes: npt.ArrayLike,
    points: Sequence[npt.ArrayLike],
    sigmas: Sequence[npt.ArrayLike],
    loss: Loss = Loss(),
    *,
    mounting_key: int | None = None,
    error: tuple[int, npt.ArrayLike] | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of the body's pose from edge points of a frame's rims.

    Zero when every point lies on its predicted rim.

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
    points : sequence of n array_like, shape (m_i, 2)
        Edge points of every rim, normalised coordinates, at least one each.
    sigmas : sequence of n array_like, shape (m_i,) or ()
        Standard deviations along the rim's normal, normalised coordinates.
    loss : Loss
        Applied to each crater as a whole; it bites where the root mean square of the crater's whitened
        distances exceeds `loss.scale_sigmas`.
    mounting_key : int, optional
        Key of the mounting as a variable (`Pose3`), to be estimated.
    error : (int, array_like of shape (n, 5, k)), optional
        Key of an error that all the rims share, a vector to be estimated, and its roots: it adds roots @
        vector to the predicted charts. Not beside `mounting_key`.

    Returns
    -------
    gtsam.CustomFactor
        With one whitened row per point, in the order of the craters; of the pose, then of the mounting or the
        error if it is a variable.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive.
    """
    n = validation.length("points", points)
    centres = validation.array("centres", centres, (n, 3))
    axes = validation.rim_axes("axes", axes, n)
    if validation.length("sigmas", sigmas) != n:
        raise FactorError(f"sigmas: expected {n} craters, found {len(sigmas)}")
    stacked_points, stacked_sigmas = [np.empty((0, 2))], [np.empty(0)]
    offsets = np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        m = validation.count(f"points[{i}]", points[i])
        offsets[i + 1] = offsets[i] + m
        stacked_points.append(validation.array(f"points[{i}]", points[i], (m, 2)))
        shape = () if np.ndim(sigmas[i]) == 0 else (m,)
        sigma = validation.array(f"sigmas[{i}]", sigmas[i], shape)
        if not (sigma > LEAST_SIGMA).all():
            raise FactorError(f"sigmas[{i}]: expected positive numbers, found {sigma.min()}")
        stacked_sigmas.append(np.broadcast_to(sigma, (m,)))
    u = np.concatenate(stacked_points)
    sigma_u = np.concatenate(stacked_sigmas)
    kind, scale = loss.kind, loss.scale_sigmas
    if error is not None:
        error_key, roots = error
        constant = constant_mounting(key, bTc, mounting_key)
        if mounting_key is not None:
            raise FactorError("error: expected a known mounting beside it")
        size = np.shape(roots)[-1] if np.ndim(roots) == 3 else 0
        roots = validation.array("error", roots, (n, 5, max(size, 1)))
        slopes = np.zeros((len(u), 6 + size))

        def kernel_with_error(
            gTb: FloatArray, z: FloatArray, _: FloatArray, linearise: bool, out: FloatArray
        ) -> float:
            rim.rim_residuals(
                gTb, constant, centres, axes, offsets, u, sigma_u, roots, z, kind, scale, linearise, out[6],
                slopes,
            )  # fmt: skip
            if linearise:
                out[:6], out[7:] = slopes[:, :6].T, slopes[:, 6:].T
            written = out.reshape(-1)
            # One sum of squares finds NaN and infinity.
            return float(written @ written)

        return packed_pose_factor_with_errors(
            key, len(u), kernel_with_error, np.empty(0), [(error_key, size)]
        )

    no_roots, no_error = np.empty((n, 5, 0)), np.empty(0)

    def kernel(gTb: FloatArray, bTc: FloatArray, linearise: bool, e: FloatArray, J: FloatArray) -> None:
        rim.rim_residuals(
            gTb, bTc, centres, axes, offsets, u, sigma_u, no_roots, no_error, kind, scale, linearise, e, J
        )

    return pose_factor(key, len(u), kernel, bTc, mounting_key)
