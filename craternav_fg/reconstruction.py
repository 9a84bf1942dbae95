"""From a data set to trajectories: front end, start, and every estimator on the same measurements."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.online import OnlineSession
from craternav_fg.estimators.registry import ESTIMATORS, estimator
from craternav_fg.estimators.start import find_start
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.trajectory import Trajectory
from craternav_fg.vision.acquire import acquire, image_spread_px
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.errors import FactorError

FloatArray = npt.NDArray[np.float64]

# Called with what is being done, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]

# What numbers beyond all reason end in: a factor that is not finite, a system that GTSAM cannot solve.
NUMERICAL_ERRORS = (FactorError, RuntimeError, OverflowError, np.linalg.LinAlgError)
# So many rims, found without a pose that explains the image, agree by chance only once in very many images.
MIN_AGREEING_RIMS = 3
# The guided front end recovers a prediction that is wrong by so much all over the image.
GUIDED_REACH_PX = 30.0


@dataclass(frozen=True)
class Reconstruction:
    """What came out of a data set.

    Attributes
    ----------
    frames : tuple of FrameMeasurement
        The measurements that all estimators were given.
    start : Start
        Their common start.
    trajectories : mapping of str to Trajectory
        By the estimator's name, at the frames' stamps.
    times_s : mapping of str to float
        Wall time of the front end (`front_end`) and of each estimator.
    options : mapping of str to dict
        Options of the front end and of each estimator that has any, resolved.
    failures : mapping of str to str
        Estimators that gave no trajectory, and why.
    expected_rims : tuple of int, or None
        For each frame, how many catalogue craters should be seen whole and large enough from the first
        trajectory's poses; None when no images were looked at.
    """

    frames: tuple[FrameMeasurement, ...]
    start: Start
    trajectories: Mapping[str, Trajectory]
    times_s: Mapping[str, float]
    options: Mapping[str, dict[str, Any]]
    failures: Mapping[str, str]
    expected_rims: tuple[int, ...] | None


def reconstruct(
    dataset: Dataset,
    names: Sequence[str] = tuple(ESTIMATORS),
    *,
    progress: Progress | None = None,
) -> Reconstruction:
    """Measure the frames of a data set and run estimators on them.

    Parameters
    ----------
    dataset : Dataset
        Its ground truth, if it has one, is not looked at.
    names : sequence of str
        Estimators, see `craternav_fg.estimators.registry`.
    progress : callable, optional

    Returns
    -------
    Reconstruction

    Raises
    ------
    EstimationError
        When a name is unknown, or every estimator fails.
    InputError
        When an image cannot be read.
    """
    chosen = [estimator(name) for name in names]
    report = progress or _silent
    descent = Descent(
        dataset.body, dataset.camera, dataset.catalog, dataset.imu, dataset.imu_noise, dataset.initial
    )
    options = {one.name: asdict(one.options) for one in chosen if hasattr(one, "options")}
    began = time.perf_counter()
    if dataset.rims is None:
        front_end = GuidedFrontEnd(dataset.camera, dataset.catalog)
        options["front_end"] = asdict(front_end.options)
        try:
            frames = _measure(dataset, descent, front_end, report)
        except NUMERICAL_ERRORS as error:
            raise EstimationError(f"front end: {_one_line(error)}") from error
    else:
        frames = dataset.rims
    start = find_start(descent, frames)
    times_s = {"front_end": time.perf_counter() - began}
    problem = Problem(
        descent.body, descent.camera, descent.catalog, descent.imu, descent.imu_noise, descent.initial,
        start, frames,
    )  # fmt: skip
    trajectories: dict[str, Trajectory] = {}
    failures: dict[str, str] = {}
    for done, one in enumerate(chosen):
        report(f"estimator {one.name}", done, len(chosen))
        began = time.perf_counter()
        try:
            trajectories[one.name] = one.estimate(problem)
        except (EstimationError, *NUMERICAL_ERRORS) as error:
            failures[one.name] = f"{one.name}: {_one_line(error)}"
        times_s[one.name] = time.perf_counter() - began
    report("estimator", len(chosen), len(chosen))
    if not trajectories:
        raise EstimationError("; ".join(failures.values()))
    expected = None
    if dataset.rims is None:
        limits = front_end.options
        expected = tuple(
            len(
                dataset.catalog.visible(
                    dataset.camera,
                    gTb,
                    min_semi_minor_px=limits.min_semi_minor_px,
                    margin_px=limits.margin_px,
                )[0]
            )
            for gTb in next(iter(trajectories.values())).gTb
        )
    return Reconstruction(frames, start, trajectories, times_s, options, failures, expected)


def _measure(
    dataset: Dataset, descent: Descent, front_end: GuidedFrontEnd, report: Progress
) -> tuple[FrameMeasurement, ...]:
    """Measure all images, each with the pose that the online smoother predicts from those before it."""
    stamps = [int(stamp) for stamp in dataset.stamps_ns]
    report("frames", 0, len(stamps))
    session = OnlineSession(descent)
    measured: list[FrameMeasurement] = []
    for k in range(len(stamps)):
        predicted = filter_state.prior(descent) if k == 0 else session.predict(stamps[k])
        pose_covariance = predicted.covariance[filter_state.POSE, filter_state.POSE]
        frame = _measure_one(dataset, front_end, k, predicted.gTb, pose_covariance)
        if k == 0:
            start = find_start(descent, [frame])
            if len(frame.rims):
                # Once more from the start: rims that only it predicts.
                frame = _measure_one(dataset, front_end, k, start.gTb, start.pose_covariance)
                start = find_start(descent, [frame])
            session.begin(frame, start)
        else:
            frame = replace(frame, sun=_repeated(frame.sun, len(stamps) - 1))
            session.update(frame)
        measured.append(frame)
        report("frames", k + 1, len(stamps))
    return tuple(measured)


def _measure_one(
    dataset: Dataset, front_end: GuidedFrontEnd, number: int, gTb: FloatArray, covariance: FloatArray
) -> FrameMeasurement:
    """Measure an image from a predicted pose and its covariance.

    A prediction too poor for the guided front end is first searched for the pose that explains the image;
    what is found there guides, but is no measurement. When nothing is found, few rims can be a chance
    agreement, and the sense of the sun's tilt, which rims tell, is unknown: neither is believed.
    """
    stamp = int(dataset.stamps_ns[number])
    image, sun = dataset.image(number), dataset.sun.at(stamp)
    spread_px = image_spread_px(dataset.camera, dataset.body.radius_m, gTb, covariance)
    if 3.0 * spread_px <= GUIDED_REACH_PX:
        return front_end.measure(image, stamp, gTb, covariance, sun)
    found = acquire(image, dataset.camera, dataset.catalog, gTb, covariance, sun)
    if found is not None:
        return front_end.measure(image, stamp, found.gTb, found.pose_covariance, sun)
    frame = front_end.measure(image, stamp, gTb, covariance, sun)
    if len(frame.rims) < MIN_AGREEING_RIMS:
        return FrameMeasurement(stamp, RimSet.empty(), None)
    return frame


def _repeated(sun: SunTilt | None, times: int) -> SunTilt | None:
    """Enlarge a tilt's noise for so many tilts that share one error.

    The error is that of the view and the ground's photometry, some degrees at an oblique view, and stays
    through a descent: taken as new in each frame, it would in the end outweigh the rims.
    """
    return None if sun is None else replace(sun, sigma_rad=np.sqrt(times) * sun.sigma_rad)


def _one_line(error: Exception) -> str:
    """Give the first sentence of an error's text: GTSAM's go on for a page."""
    return " ".join(str(error).split()).split(". ")[0].removesuffix(".")


def _silent(what: str, done: int, total: int) -> None:
    del what, done, total
