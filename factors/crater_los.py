"""Line-of-sight factor, eq. (11) corrected: the direction of the true crater centre, from the rim's conic.

Zero when K n_c points to the crater's centre. It is contained in rows 2 to 4 of eq. (19): never put it on a
crater that already has a conic-shape factor.
"""

from typing import NamedTuple

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.custom import Loss, pose_factor
from factors.kernels import conic, los, stacked


class LineOfSight(NamedTuple):
    """Direction of a crater's true centre.

    Attributes
    ----------
    direction : ndarray, shape (3,)
        Unit vector in c.
    covariance : ndarray, shape (3, 3)
        Covariance of the direction in c; rank 2, as there is no error along it.
    """

    direction: FloatArray
    covariance: FloatArray


def line_of_sight(chart: FloatArray, covariance: FloatArray, n_c: FloatArray) -> LineOfSight:
    """Direction of a crater's true centre, and its covariance from the rim's.

    Parameters
    ----------
    chart : ndarray, shape (5,)
        Measured image of the rim: an ellipse chart, normalised.
    covariance : ndarray, shape (5, 5)
        Covariance of the chart.
    n_c : ndarray, shape (3,)
        Outward normal of the rim's plane in c, a unit vector.

    Returns
    -------
    LineOfSight
    """
    q = conic.chart_to_conic(chart)
    D = los.line_of_sight_jacobian(q, n_c) @ conic.chart_to_conic_jacobian(chart)
    return LineOfSight(los.line_of_sight(q, n_c), D @ covariance @ D.T)


def tangents(direction: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the plane across a direction.

    Parameters
    ----------
    direction : ndarray, shape (3,)
        Unit vector in c.

    Returns
    -------
    ndarray, shape (3, 2)
    """
    # The two right singular vectors that are perpendicular to it.
    return np.asarray(np.linalg.svd(direction[None])[2][1:].T)


def crater_los_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    centres: npt.ArrayLike,
    normals: npt.ArrayLike,
    charts: npt.ArrayLike,
    covariances: npt.ArrayLike,
    gRc_nominal: npt.ArrayLike,
    loss: Loss = Loss(),
    *,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of the body's pose from the lines of sight of a frame.

    Zero when each of them points to its crater's centre.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4), or None
        Mounting of the camera; None when `mounting_key` is given.
    centres, normals : array_like, shape (n, 3)
        Crater centres, m, and outward unit normals, in g.
    charts, covariances : array_like, shape (n, 5), (n, 5, 5)
        Measured rims: ellipse charts, normalised, and their covariances.
    gRc_nominal : array_like, shape (3, 3)
        Attitude of the camera at which the noise and the tangents are evaluated; a few degrees do not matter.
    loss : Loss
        Applied to each crater's 2-dimensional norm.
    mounting_key : int, optional
        Key of the mounting as a variable (`Pose3`), to be estimated.

    Returns
    -------
    gtsam.CustomFactor
        With 2 n whitened rows.

    Raises
    ------
    FactorError
        Naming the field at fault.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (8), (9), (11), (12);
    docs/equations.md.
    """
    n = validation.count("charts", charts)
    centres = validation.array("centres", centres, (n, 3))
    normals = validation.unit_vectors("normals", normals, n)
    charts = validation.charts("charts", charts, n)
    validation.whitening("covariances", covariances, n, 5)
    covariances = validation.array("covariances", covariances, (n, 5, 5))
    gRc = validation.rotation("gRc_nominal", gRc_nominal)
    conics = np.empty((n, 6))
    bases = np.empty((n, 3, 2))
    tangent_covariances = np.empty((n, 2, 2))
    for i in range(n):
        conics[i] = conic.chart_to_conic(charts[i])
        direction, S = line_of_sight(charts[i], covariances[i], gRc.T @ normals[i])
        bases[i] = tangents(direction)
        tangent_covariances[i] = bases[i].T @ S @ bases[i]
    tangent_covariances = 0.5 * (tangent_covariances + np.swapaxes(tangent_covariances, 1, 2))
    W = validation.whitening("covariances", tangent_covariances, n, 2)
    kind, scale = loss.kind, loss.scale_sigmas

    def kernel(gTb: FloatArray, bTc: FloatArray, linearise: bool, e: FloatArray, J: FloatArray) -> None:
        stacked.los_residuals(gTb, bTc, centres, normals, conics, bases, W, kind, scale, linearise, e, J)

    return pose_factor(key, 2 * n, kernel, bTc, mounting_key)
