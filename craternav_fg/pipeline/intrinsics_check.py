"""Whether the rims of all frames, each frame's by themselves, contradict the camera's intrinsics."""

from collections.abc import Sequence

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.resection.intrinsics import IntrinsicsFit, IntrinsicsPrior, fit_intrinsics
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import FloatArray

# Fewer rims leave no redundancy; fewer frames do not show how far their estimates scatter.
_MIN_RIMS, _MIN_FRAMES = 6, 4
# Deviation of a pooled intrinsic, in standard deviations. Neither the scatter between frames nor their
# covariances show errors that their rims share unstated.
_MAX_SIGMAS = 6.0


def contradicted_intrinsics(
    frames: Sequence[FrameMeasurement], gTb: FloatArray, camera: Camera, catalog: Catalog
) -> bool:
    """Whether the rims contradict the focal length or the principal point.

    Neither the IMU nor the camera's mounting matter: each frame has a pose of its own. By how much is not
    said: a lens that distorts, or pixels that are not square, change the estimates, too.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m, near which those of the rims are.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    bool
        False also when it does not show.
    """
    prior = IntrinsicsPrior.of(camera)
    if not all(prior.sigmas):
        return False
    each = zip((frame.rims for frame in frames), gTb, strict=True)
    seen = [(rims, pose) for rims, pose in each if len(rims) >= _MIN_RIMS]
    # What craters keep, as errors of the map, is the same in all frames: a mean does not average it out.
    fits = [
        fit_intrinsics(
            ResectionProblem(MatchedRims.of(rims.inflate_correlated(len(seen)), catalog), camera.bTc),
            pose,
            prior,
        )
        for rims, pose in seen
    ]
    told = [fit for fit in fits if fit.converged and np.isfinite(_sigmas(fit)).all()]
    if len(told) < _MIN_FRAMES:
        return False
    values = np.array([[np.log(fit.focal_scale), *fit.principal_shift_px] for fit in told])
    weights = np.array([_sigmas(fit) for fit in told]) ** -2.0
    mean = np.sum(weights * values, axis=0) / weights.sum(axis=0)
    scatter = np.sum(weights * (values - mean) ** 2, axis=0) / (len(told) - 1)
    sigma = np.sqrt(np.maximum(scatter, 1.0) / weights.sum(axis=0))
    return bool((np.abs(mean) > _MAX_SIGMAS * sigma).any())


def _sigmas(fit: IntrinsicsFit) -> FloatArray:
    return np.array([fit.focal_scale_sigma, *np.sqrt(np.diag(fit.principal_covariance_px2))])
