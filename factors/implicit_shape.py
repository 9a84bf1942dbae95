"""Implicit shape factor, eq. (19) as printed, whitened by J_q S_q J_q' at every pose.

Zero when every measured conic is the image of its rim. It carries the information of the conic-shape factor
and has its optimum, up to the curvature of the map between conic and chart. Its basin of convergence is
narrower, under Gauss-Newton (as iSAM2 steps) much narrower.

The whitening depends on the pose, and the derivative includes that: `factors.kernels.implicit` shows that the
whitened residual is a constant-noise residual in q, exactly, and differentiates that.
"""

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.custom import Loss, pose_factor
from factors.kernels import conic, implicit


def implicit_shape_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    centres: npt.ArrayLike,
    axes: npt.ArrayLike,
    charts: npt.ArrayLike,
    covariances: npt.ArrayLike,
    loss: Loss = Loss(),
    *,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of the body's pose from the rims of a frame.

    Zero when the residual of eq. (19) is, for each of them.

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
        Measured images in the ellipse chart, normalised coordinates: q is the unit-norm conic of each.
    covariances : array_like, shape (n, 5, 5)
        Covariances of the charts: S_q follows by the conic's derivative, and has rank 5.
    loss : Loss
        Applied to each crater's 5-dimensional norm.
    mounting_key : int, optional
        Key of the mounting as a variable (`Pose3`), to be estimated.

    Returns
    -------
    gtsam.CustomFactor
        With 5 n whitened rows.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive definite.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (19); docs/equations.md.
    """
    n = validation.count("charts", charts)
    centres = validation.array("centres", centres, (n, 3))
    axes = validation.rim_axes("axes", axes, n)
    charts = validation.charts("charts", charts, n)
    W = validation.whitening("covariances", covariances, n, 5)
    conics = np.empty((n, 6))
    projections = np.empty((n, 5, 6))
    for i in range(n):
        conics[i] = conic.chart_to_conic(charts[i])
        projections[i] = W[i] @ np.linalg.pinv(conic.chart_to_conic_jacobian(charts[i]))
    kind, scale = loss.kind, loss.scale_sigmas

    def kernel(gTb: FloatArray, bTc: FloatArray, linearise: bool, e: FloatArray, J: FloatArray) -> None:
        implicit.implicit_residuals(
            gTb, bTc, centres, axes, conics, projections, kind, scale, linearise, e, J
        )

    return pose_factor(key, 5 * n, kernel, bTc, mounting_key)
