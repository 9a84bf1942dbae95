"""Conic-shape factor: the rim's image against its prediction, in the ellipse chart.

Zero when every predicted rim has the measured image. It carries the same information as eq. (19) whitened
and has the same optimum, with a far wider basin of convergence.
"""

import gtsam
import numpy.typing as npt

from factors import validation
from factors.custom import Loss, constant_mounting, packed_pose_factor
from factors.kernels import packed


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
) -> gtsam.CustomFactor:
    """All rims of a frame as one factor of the body's pose.

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
        Of the charts.
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
    """
    n = validation.count("charts", charts)
    centres = validation.array("centres", centres, (n, 3))
    axes = validation.rim_axes("axes", axes, n)
    charts = validation.charts("charts", charts, n)
    W = validation.whitening("covariances", covariances, n, 5)
    mounting = constant_mounting(key, bTc, mounting_key)
    data = packed.pack(mounting, centres, axes, charts, W, loss.kind, loss.scale)
    return packed_pose_factor(key, 5 * n, packed.shape_residuals, data, mounting_key)
