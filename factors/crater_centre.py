"""Crater-centre factor: the image ellipse's centre taken for the image of the crater's centre.

Zero when they coincide. Perspective shifts one from the other: this is the assumption of eq. (10), kept for
comparison. The paper compares cosines of the angles between pairs of centres. Here each centre is
reprojected: the same assumption with each point's own noise, and with a derivative in the attitude.
"""

import gtsam
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.custom import Loss, pose_factor
from factors.kernels import stacked


def crater_centre_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    centres: npt.ArrayLike,
    points: npt.ArrayLike,
    covariances: npt.ArrayLike,
    loss: Loss = Loss(),
    *,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of the body's pose from the crater centres of a frame.

    Zero when the predicted images of all centres are the measured points.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4), or None
        Mounting of the camera; None when `mounting_key` is given.
    centres : array_like, shape (n, 3)
        Crater centres in g, m.
    points : array_like, shape (n, 2)
        Centres of the image ellipses, normalised.
    covariances : array_like, shape (n, 2, 2)
        Covariances of the points.
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
    """
    n = validation.count("points", points)
    centres = validation.array("centres", centres, (n, 3))
    points = validation.array("points", points, (n, 2))
    W = validation.whitening("covariances", covariances, n, 2)
    kind, scale = loss.kind, loss.scale_sigmas

    def kernel(gTb: FloatArray, bTc: FloatArray, linearise: bool, e: FloatArray, J: FloatArray) -> None:
        stacked.centre_residuals(gTb, bTc, centres, points, W, kind, scale, linearise, e, J)

    return pose_factor(key, 2 * n, kernel, bTc, mounting_key)
