"""Focal length and principal point by rims that are detected and identified without any prediction.

Rims that are searched near a prediction agree with the camera that predicted them, or are not found. Those of
a whole image, identified by themselves, show by how much focal length and principal point are off.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.intrinsics_check import pooled
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.resection.intrinsics import IntrinsicsFit, IntrinsicsPrior, fit_intrinsics
from craternav_fg.resection.problem import ResectionProblem
from factors.arrays import FloatArray

# Images that are asked: their rims take a second.
_IMAGES = 5
# Share of the frames that should show craters and do not, from which they are asked.
_MISSED_SHARE = 0.1
# Rims of an image beside its six coordinates of the pose and three of the intrinsics.
_MIN_RIMS = 6
# Deviation that is told: in standard deviations, and as relative focal length and px.
_MIN_SIGMAS, _MIN_FOCAL_SHARE, _MIN_SHIFT_PX = 5.0, 0.003, 1.5


@dataclass(frozen=True)
class DetectedIntrinsics:
    """Deviation of a camera's intrinsics from those that its images show.

    Attributes
    ----------
    images : int
        Number of images that tell.
    focal_share : float
        Relative deviation of the true focal length from the camera's.
    focal_sigma_share : float
        Its standard deviation.
    shift_px : ndarray, shape (2,)
        True less the camera's principal point.
    shift_sigma_px : ndarray, shape (2,)
        Standard deviations.
    """

    images: int
    focal_share: float
    focal_sigma_share: float
    shift_px: FloatArray
    shift_sigma_px: FloatArray

    @property
    def focal_is_off(self) -> bool:
        """Whether the focal length clearly deviates."""
        least = max(_MIN_SIGMAS * self.focal_sigma_share, _MIN_FOCAL_SHARE)
        return abs(self.focal_share) > least

    @property
    def principal_point_is_off(self) -> bool:
        """Whether the principal point clearly deviates."""
        least = np.maximum(_MIN_SIGMAS * self.shift_sigma_px, _MIN_SHIFT_PX)
        return bool((np.abs(self.shift_px) > least).any())


def detected_intrinsics(
    dataset: Dataset,
    relocaliser: Relocaliser,
    frames: Sequence[FrameMeasurement],
    expected: Sequence[int] | None,
    gTb: FloatArray,
) -> DetectedIntrinsics | None:
    """Estimate the intrinsics by detected rims, where frames show fewer rims than they should.

    Parameters
    ----------
    dataset : Dataset
        With images.
    relocaliser : Relocaliser
    frames : sequence of FrameMeasurement
    expected : sequence of int or None
        Catalogue craters that each frame should show; None when none were searched in images.
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m: they tell which craters an image may show.

    Returns
    -------
    DetectedIntrinsics or None
        None where nothing is amiss, where the heights of the map are unknown, and with fewer than two images
        that tell.
    """
    prior = IntrinsicsPrior.of(dataset.camera)
    if expected is None or not dataset.catalog.has_heights or not all(prior.sigmas):
        return None
    counts = np.array(expected)
    missed = (counts > 0) & (np.array([len(frame.rims) for frame in frames]) == 0)
    if not missed.any() or missed.sum() < _MISSED_SHARE * np.count_nonzero(counts):
        return None
    # The image with the most craters of each part of the descent.
    parts = np.array_split(np.arange(len(counts)), min(_IMAGES, len(counts)))
    some = [int(part[np.argmax(counts[part])]) for part in parts]
    fits = [_fit(relocaliser, k, gTb[k], prior) for k in some if counts[k] >= _MIN_RIMS]
    return _mean([one for one in fits if one is not None])


def _fit(relocaliser: Relocaliser, index: int, gTb: FloatArray, prior: IntrinsicsPrior) -> FloatArray | None:
    """Deviations of focal length (logarithm) and principal point, px, and their sigmas: (2, 3)."""
    found = relocaliser.identified_near(index, gTb)
    if found is None or len(found[0]) < _MIN_RIMS:
        return None
    rims, pose = found
    problem = ResectionProblem(rims, relocaliser.camera.bTc)
    try:
        fit = fit_intrinsics(problem, pose, prior)
    except np.linalg.LinAlgError:
        return None
    return _told(fit, 5 * len(rims) - 6)


def _told(fit: IntrinsicsFit, freedom: int) -> FloatArray | None:
    """Return what a fit tells, with sigmas as large as its rims scatter."""
    sigmas = np.array([fit.focal_scale_sigma, *np.sqrt(np.diag(fit.principal_covariance_px2))])
    if not fit.converged or not np.isfinite(sigmas).all():
        return None
    scatter = np.sqrt(max(fit.cost / freedom, 1.0))
    return np.array([[np.log(fit.focal_scale), *fit.principal_shift_px], scatter * sigmas])


def _mean(told: Sequence[FloatArray]) -> DetectedIntrinsics | None:
    if len(told) < 2:
        return None
    values, sigmas = np.array(told).transpose(1, 0, 2)
    mean, sigma = pooled(values, sigmas)
    return DetectedIntrinsics(len(values), float(np.expm1(mean[0])), float(sigma[0]), mean[1:], sigma[1:])
