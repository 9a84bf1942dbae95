"""Whether the rims of all frames, each frame's by themselves, contradict the camera's intrinsics."""

from collections.abc import Sequence

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.resection.intrinsics import IntrinsicsFit, IntrinsicsPrior, fit_intrinsics
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Fewer rims leave no redundancy; fewer frames do not show how far their estimates scatter.
_MIN_RIMS, _MIN_FRAMES = 6, 4
# Deviation of a pooled intrinsic, in standard deviations. The scatter between frames does not show the errors
# that their rims share.
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
        False also when it does not show. Frames whose pose does not see all of their rims do not count, as
        those of a filter that has diverged.
    """
    prior = IntrinsicsPrior.of(camera)
    if not all(prior.sigmas):
        return False
    fits = [
        fit_intrinsics(ResectionProblem(MatchedRims.of(frame.rims, catalog), camera.bTc), pose, prior)
        for frame, pose in zip(frames, gTb, strict=True)
        if len(frame.rims) >= _MIN_RIMS and _sees(pose, frame, camera, catalog)
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


def _sees(gTb: FloatArray, frame: FrameMeasurement, camera: Camera, catalog: Catalog) -> bool:
    rows = frame.rims.craters
    _, visible = project_rims(
        np.ascontiguousarray(gTb), camera.bTc, catalog.centres[rows], catalog.axes[rows]
    )
    return bool(visible.all())


def _sigmas(fit: IntrinsicsFit) -> FloatArray:
    return np.array([fit.focal_scale_sigma, *np.sqrt(np.diag(fit.principal_covariance_px2))])
