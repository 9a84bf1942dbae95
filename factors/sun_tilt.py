"""Sun-tilt factor, eq. (24) in its perspective form: the direction of illumination in the image.

Zero when the predicted tilt of the sun's ground azimuth is the measured one; the difference is wrapped.
"""

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.custom import constant_mounting, packed_pose_factor
from factors.errors import FactorError
from factors.kernels import sun

# The square of a weight of less overflows.
LEAST_SIGMA_RAD = 1e-150


def sun_tilt_factor(
    key: int,
    bTc: npt.ArrayLike | None,
    direction: npt.ArrayLike,
    tilt_rad: float,
    sigma_rad: float,
    point: npt.ArrayLike = (0.0, 0.0),
    *,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build a factor of the body's pose from the tilt of the illumination in one image.

    Zero when the predicted tilt is the measured one.

    Parameters
    ----------
    key : int
        Key of the pose `gTb`.
    bTc : array_like, shape (4, 4), or None
        Mounting of the camera; None when `mounting_key` is given.
    direction : array_like, shape (3,)
        In g: the direction towards the sun along the ground, s - (s.n) n. With the sun's own direction and
        the point (0, 0) this is eq. (24) as printed, with atan2.
    tilt_rad : float
        Measured, from the image's x axis towards its y axis.
    sigma_rad : float
        Standard deviation in the view it was measured in. Where a pose turns the direction into the line of
        sight (image direction shorter than `sun.FLOOR`) the tilt is undefined: the factor costs what the
        worst tilt does, and has no slope.
    point : array_like, shape (2,)
        Normalised image point.
    mounting_key : int, optional
        Key of the mounting as a variable (`Pose3`), to be estimated.

    Returns
    -------
    gtsam.CustomFactor
        With one whitened row.

    Raises
    ------
    FactorError
        Naming the field at fault.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (24); docs/equations.md.
    """
    direction = validation.array("direction", direction, (3,))
    u, v = validation.array("point", point, (2,))
    measured = float(validation.array("tilt_rad", tilt_rad, ()))
    longest = np.abs(direction).max()
    if not longest > 0.0:
        raise FactorError("direction: expected a vector, found zero")
    # Its length does not matter; squared, it must stay a number.
    direction /= longest
    sigma_rad = float(validation.array("sigma_rad", sigma_rad, ()))
    if not sigma_rad > LEAST_SIGMA_RAD:
        raise FactorError(f"sigma_rad: expected a positive number, found {sigma_rad}")

    mounting = constant_mounting(key, bTc, mounting_key)
    data = np.concatenate([mounting.ravel(), direction, [u, v, measured, sigma_rad]])
    return packed_pose_factor(key, 1, sun.tilt_residual, data, mounting_key)
