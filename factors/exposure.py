"""Exposure factor: pose of the body at an exposure, from that at the image's stamp and the camera's mounting.

Zero when the exposure's pose is gTb Exp(delay [w, v]) bTb': the pose at the image's stamp, moved on for as
long as the exposure was later than its stamp, and turned by the error of the camera's mounting. Image factors
of the exposure's pose then hold as they are, with the nominal mounting.
"""

from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors import validation
from factors.arrays import FloatArray
from factors.errors import FactorError

# Noise of the definition: the factor stands for an equality. An image's own noise is a hundred times larger.
ROTATION_SIGMA_RAD = 1e-7
POSITION_SIGMA_M = 1e-4


def exposure_factor(
    key: int,
    exposure_key: int,
    twist: npt.ArrayLike = (0.0,) * 6,
    *,
    delay_key: int | None = None,
    mounting_key: int | None = None,
) -> gtsam.CustomFactor:
    """Build a factor that defines the pose of an exposure, with a time offset or mounting error as variable.

    Parameters
    ----------
    key : int
        Key of the pose `gTb` at the image's stamp.
    exposure_key : int
        Key of the exposure's pose (`Pose3`).
    twist : array_like, shape (6,)
        Angular velocity of b relative to g, rad/s, and velocity relative to g, m/s, both in b.
    delay_key : int, optional
        Key of the camera-IMU time offset, s (vector of one).
    mounting_key : int, optional
        Key of the mounting's error `bTb'` (`Pose3`): the camera's mounting is that times the nominal one.

    Returns
    -------
    gtsam.CustomFactor
        With 6 whitened rows.

    Raises
    ------
    FactorError
        When the twist is not six finite numbers, or there is neither a delay nor a mounting to estimate.
    """
    twist = validation.array("twist", twist, (6,))
    if delay_key is None and mounting_key is None:
        raise FactorError("exposure_factor: expected a delay_key, a mounting_key or both")
    keys = [key, exposure_key]
    delay_at = mounting_at = -1
    if delay_key is not None:
        delay_at = len(keys)
        keys.append(delay_key)
    if mounting_key is not None:
        mounting_at = len(keys)
        keys.append(mounting_key)
    weights = 1.0 / np.repeat([ROTATION_SIGMA_RAD, POSITION_SIGMA_M], 3)

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> FloatArray:
        exposed = values.atPose3(exposure_key)
        delay_s = 0.0 if delay_key is None else float(values.atVector(delay_key)[0])
        step = gtsam.Pose3.Expmap(delay_s * twist)
        mounting = gtsam.Pose3() if mounting_key is None else values.atPose3(mounting_key)
        off = values.atPose3(key).compose(step).compose(mounting).between(exposed)
        e = gtsam.Pose3.Logmap(off)
        if H is not None:
            D = weights[:, None] * gtsam.Pose3.LogmapDerivative(off)
            # What moves the prediction by its right-hand twist moves `off` the other way, from its left.
            left = -D @ off.inverse().AdjointMap()
            from_step = left @ mounting.inverse().AdjointMap()
            H[0] = from_step @ step.inverse().AdjointMap()
            H[1] = D
            if delay_at > 0:
                H[delay_at] = (from_step @ twist)[:, None]
            if mounting_at > 0:
                H[mounting_at] = left
        return np.asarray(weights * e)

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(6), keys, evaluate)
