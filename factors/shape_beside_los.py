"""What eq. (19) says of a pose beside the line of sight, eq. (11): three of its five dimensions.

The line of sight is contained in eq. (19), so both of a crater may not be used as they are. Of the whitened
residual of (19) this factor keeps the part whose noise is uncorrelated with that of the measured line of
sight: together they carry what (19) carries, to first order in the noise. Zero when every measured conic is
the image of its rim.
"""

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.crater_los import line_of_sight, tangents
from factors.custom import Loss, pose_factor
from factors.kernels import conic, implicit, los

ROWS = 3


def shape_beside_los_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    centres: npt.ArrayLike,
    axes: npt.ArrayLike,
    charts: npt.ArrayLike,
    covariances: npt.ArrayLike,
    gRc_nominal: npt.ArrayLike,
    loss: Loss = Loss(),
    *,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build one factor of the body's pose of a frame's rims, to stand beside `crater_los_factor`.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4), or None
        Mounting of the camera in b, m; None when `mounting_key` is given.
    centres : array_like, shape (n, 3)
        Rim centres in g, m.
    axes : array_like, shape (n, 2, 3)
        Semi-axes a l1, b l2 in g, m, with l1 x l2 outward.
    charts : array_like, shape (n, 5)
        Measured images in the ellipse chart, normalised image coordinates of c.
    covariances : array_like, shape (n, 5, 5)
        Covariances of the charts, in their units squared.
    gRc_nominal : array_like, shape (3, 3)
        Attitude of the camera in g at which the line of sight's noise is evaluated, without a unit.
    loss : Loss
        Applied to each crater's 3-dimensional norm.
    mounting_key : int, optional
        Key of the mounting as a variable (`Pose3`), to be estimated.

    Returns
    -------
    gtsam.CustomFactor
        With 3 n whitened rows.

    Raises
    ------
    FactorError
        Naming the field that is not finite, mis-shaped, or not positive definite.

    References
    ----------
    Tian et al. (2019), eqs. (11) and (19), DOI 10.1017/S0373463318000966; docs/equations.md.
    """
    n = validation.count("charts", charts)
    centres = validation.array("centres", centres, (n, 3))
    axes = validation.rim_axes("axes", axes, n)
    charts = validation.charts("charts", charts, n)
    W = validation.whitening("covariances", covariances, n, 5)
    covariances = validation.array("covariances", covariances, (n, 5, 5))
    gRc = validation.rotation("gRc_nominal", gRc_nominal)
    conics = np.empty((n, 6))
    projections = np.empty((n, ROWS, 6))
    for i in range(n):
        q = conics[i] = conic.chart_to_conic(charts[i])
        A = conic.chart_to_conic_jacobian(charts[i])
        normal = np.cross(axes[i, 0], axes[i, 1])
        n_c = gRc.T @ (normal / np.linalg.norm(normal))
        basis = tangents(line_of_sight(charts[i], covariances[i], n_c).direction)
        # Line of sight as a function of the chart's whitened error: L = W^-1.
        D = basis.T @ los.line_of_sight_jacobian(q, n_c) @ A @ np.linalg.inv(W[i])
        beside = np.linalg.svd(D)[2][2:]
        projections[i] = beside @ W[i] @ np.linalg.pinv(A)
    kind, scale = loss.kind, loss.scale_sigmas

    def kernel(gTb: FloatArray, bTc: FloatArray, linearise: bool, e: FloatArray, J: FloatArray) -> None:
        implicit.implicit_residuals(
            gTb, bTc, centres, axes, conics, projections, kind, scale, linearise, e, J
        )

    return pose_factor(key, ROWS * n, kernel, bTc, mounting_key)
