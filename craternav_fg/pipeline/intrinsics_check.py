"""Whether the rims of all frames, each frame's by themselves, contradict the camera's intrinsics or lens."""

from collections.abc import Iterator, Sequence

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.intrinsics import RADIAL, intrinsic_slopes
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.resection.intrinsics import IntrinsicsFit, IntrinsicsPrior, fit_intrinsics, further_error
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from factors.arrays import BoolArray, FloatArray
from factors.kernels.conic import project_rims

# Fewer rims leave no redundancy; fewer frames do not show how far their estimates scatter.
_MIN_RIMS, _MIN_FRAMES = 6, 4
# Deviation of a pooled intrinsic, in standard deviations. Neither the scatter between frames nor their
# covariances show errors that their rims share unstated.
_MAX_SIGMAS = 6.0
# Frames, evenly spaced, that are asked at most, for the intrinsics and for the lens: neighbours see the same
# craters, and err alike.
_FRAMES, _LENS_FRAMES = 120, 40


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
    some = _spread(len(frames), _FRAMES)
    return contradicted_by([fit for _, fit in _fits(frames[some], gTb[some], camera, catalog, prior)])


def contradicted_lens(
    frames: Sequence[FrameMeasurement], gTb: FloatArray, camera: Camera, catalog: Catalog
) -> bool:
    """Whether the rims contradict the radial distortion that the camera states.

    A trajectory hides such an error as it hides one of the focal length: the altitude follows the rims near
    the centre, and those near the corners are not found.

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
    some = _spread(len(frames), _LENS_FRAMES)
    found = [
        further_error(problem, fit, prior, intrinsic_slopes(problem.rims.chart, camera)[..., RADIAL])
        for problem, fit in _fits(frames[some], gTb[some], camera, catalog, prior)
        if fit.converged
    ]
    told = np.array([one for one in found if np.isfinite(one).all()]).reshape(-1, 2)
    return _is_off(told[:, :1], told[:, 1:])


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
    values = [[np.log(fit.focal_scale), *fit.principal_shift_px] for fit in told]
    return _is_off(np.array(values), np.array([_sigmas(fit) for fit in told]))


def _is_off(values: FloatArray, sigmas: FloatArray) -> bool:
    """Whether the mean of one of k numbers that n frames tell, both (n, k), is not zero."""
    if len(values) < _MIN_FRAMES:
        return False
    mean, sigma = pooled(values, sigmas)
    return bool((np.abs(mean) > _MAX_SIGMAS * sigma).any())


def pooled(values: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Average what frames tell, with standard deviations as large as the frames scatter.

    Parameters
    ----------
    values, sigmas : ndarray, shape (n, k)
        Of at least two frames, k numbers of any unit each, and their standard deviations.

    Returns
    -------
    mean, sigma : ndarray, shape (k,)
    """
    weights = sigmas**-2.0
    mean = np.sum(weights * values, axis=0) / weights.sum(axis=0)
    scatter = np.sum(weights * (values - mean) ** 2, axis=0) / (len(values) - 1)
    return mean, np.sqrt(np.maximum(scatter, 1.0) / weights.sum(axis=0))


def to_be_averaged(rims: Sequence[RimSet], catalog: Catalog) -> list[RimSet]:
    """Inflate the errors of frames' rims of which a mean is taken.

    What a crater keeps, as errors of the map, is the same in all frames that show it, and what all rims share
    in all frames: a mean does not average it out.

    Parameters
    ----------
    rims : sequence of RimSet
        Of each frame.
    catalog : Catalog

    Returns
    -------
    list of RimSet
        Without correlated parts.
    """
    every = [one.craters for one in rims]
    shown = np.bincount(np.concatenate([*every, np.empty(0, np.int64)]), minlength=len(catalog))
    return [
        one.inflate_correlated(shown[one.craters].astype(np.float64), of_shared=len(rims)) for one in rims
    ]


def _spread(count: int, most: int) -> slice:
    """Select frames, evenly spaced."""
    return slice(None, None, 1 + count // most)


def _fits(
    frames: Sequence[FrameMeasurement],
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    prior: IntrinsicsPrior,
) -> Iterator[tuple[ResectionProblem, IntrinsicsFit]]:
    """Fit pose and intrinsics to each frame by itself; those whose rims do not tell them are left out."""
    each = zip((frame.rims for frame in frames), np.ascontiguousarray(gTb), strict=True)
    # A wrong match may be with a crater beyond the horizon, or with that of another rim.
    seen = [(rims.take(_in_sight(rims, pose, camera, catalog) & _alone(rims)), pose) for rims, pose in each]
    seen = [(rims, pose) for rims, pose in seen if len(rims) >= _MIN_RIMS]
    alike = to_be_averaged([rims for rims, _ in seen], catalog)
    for (rims, pose), inflated in zip(seen, alike, strict=True):
        matched = MatchedRims.of(inflated, catalog)
        problem = ResectionProblem(matched, camera.bTc)
        try:
            fit = fit_intrinsics(problem, pose, prior)
        except np.linalg.LinAlgError:
            continue
        # Rims that the fit has lost cost nothing there.
        if _in_sight(rims, fit.gTb, camera, catalog).all():
            yield problem, fit


def _in_sight(rims: RimSet, gTb: FloatArray, camera: Camera, catalog: Catalog) -> BoolArray:
    """Tell which rims a pose can see."""
    rows = rims.craters
    return np.asarray(project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[1])


def _alone(rims: RimSet) -> BoolArray:
    """Tell which rims are matched with a crater that no other rim is matched with."""
    _, inverse, counts = np.unique(rims.craters, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse] == 1)


def _sigmas(fit: IntrinsicsFit) -> FloatArray:
    return np.array([fit.focal_scale_sigma, *np.sqrt(np.diag(fit.principal_covariance_px2))])
