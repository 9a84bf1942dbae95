"""Whether the rims of all frames, each frame's by themselves, contradict the camera's intrinsics."""

from collections.abc import Sequence

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.resection.intrinsics import IntrinsicsFit, IntrinsicsPrior, fit_intrinsics
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import BoolArray, FloatArray
from factors.kernels.conic import project_rims

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
    each = zip((frame.rims for frame in frames), np.ascontiguousarray(gTb), strict=True)
    # A wrong match may be with a crater beyond the horizon.
    seen = [(rims.take(_in_sight(rims, pose, camera, catalog)), pose) for rims, pose in each]
    seen = [(rims, pose) for rims, pose in seen if len(rims) >= _MIN_RIMS]
    return contradicted_by(
        [fit for rims, pose in seen for fit in _fits(rims, pose, len(seen), camera, catalog, prior)]
    )


def contradicted_by(fits: Sequence[IntrinsicsFit]) -> bool:
    """Whether the intrinsics of several frames, pooled, are others than the camera's.

    Parameters
    ----------
    fits : sequence of IntrinsicsFit

    Returns
    -------
    bool
        False also when too few frames tell them.
    """
    told = [fit for fit in fits if fit.converged and np.isfinite(_sigmas(fit)).all()]
    if len(told) < _MIN_FRAMES:
        return False
    values = np.array([[np.log(fit.focal_scale), *fit.principal_shift_px] for fit in told])
    weights = np.array([_sigmas(fit) for fit in told]) ** -2.0
    mean = np.sum(weights * values, axis=0) / weights.sum(axis=0)
    scatter = np.sum(weights * (values - mean) ** 2, axis=0) / (len(told) - 1)
    sigma = np.sqrt(np.maximum(scatter, 1.0) / weights.sum(axis=0))
    return bool((np.abs(mean) > _MAX_SIGMAS * sigma).any())


def _fits(
    rims: RimSet, gTb: FloatArray, count: int, camera: Camera, catalog: Catalog, prior: IntrinsicsPrior
) -> list[IntrinsicsFit]:
    """Fit the intrinsics to one of several frames; none when its rims do not tell them."""
    # What craters keep, as errors of the map, is the same in all frames: a mean does not average it out.
    matched = MatchedRims.of(rims.inflate_correlated(count), catalog)
    try:
        fit = fit_intrinsics(ResectionProblem(matched, camera.bTc), gTb, prior)
    except np.linalg.LinAlgError:
        return []
    # Rims that the fit has lost cost nothing there.
    return [fit] if _in_sight(rims, fit.gTb, camera, catalog).all() else []


def _in_sight(rims: RimSet, gTb: FloatArray, camera: Camera, catalog: Catalog) -> BoolArray:
    """Tell which rims a pose can see."""
    rows = rims.craters
    return np.asarray(project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[1])


def _sigmas(fit: IntrinsicsFit) -> FloatArray:
    return np.array([fit.focal_scale_sigma, *np.sqrt(np.diag(fit.principal_covariance_px2))])
