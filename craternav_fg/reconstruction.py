"""From a data set to trajectories: front end, start, and every estimator on the same measurements."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.online import OnlineSession
from craternav_fg.estimators.registry import ESTIMATORS, estimator
from craternav_fg.estimators.start import first_frame_map
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory
from craternav_fg.vision.acquire import acquire, image_spread_px
from craternav_fg.vision.guided import GuidedFrontEnd

# Called with what is being done, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]

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
    """

    frames: tuple[FrameMeasurement, ...]
    start: Start
    trajectories: Mapping[str, Trajectory]
    times_s: Mapping[str, float]
    options: Mapping[str, dict[str, Any]]


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
        When a name is unknown or an estimator fails.
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
        frames, start = _measure(dataset, descent, front_end, report)
    else:
        frames = dataset.rims
        start = first_frame_map(descent, frames[0])
    times_s = {"front_end": time.perf_counter() - began}
    problem = Problem(
        descent.body, descent.camera, descent.catalog, descent.imu, descent.imu_noise, descent.initial,
        start, frames,
    )  # fmt: skip
    trajectories = {}
    for done, one in enumerate(chosen):
        report(f"estimator {one.name}", done, len(chosen))
        began = time.perf_counter()
        trajectories[one.name] = one.estimate(problem)
        times_s[one.name] = time.perf_counter() - began
    report("estimator", len(chosen), len(chosen))
    return Reconstruction(frames, start, trajectories, times_s, options)


def _measure(
    dataset: Dataset, descent: Descent, front_end: GuidedFrontEnd, report: Progress
) -> tuple[tuple[FrameMeasurement, ...], Start]:
    """Measure all images, each with the pose that the online smoother predicts from those before it."""
    stamps = [int(stamp) for stamp in dataset.stamps_ns]
    report("frames", 0, len(stamps))
    first, start = _measure_first(dataset, descent, front_end)
    session = OnlineSession(descent)
    session.begin(first, start)
    measured = [first]
    for k, stamp in enumerate(stamps[1:], start=1):
        predicted = session.predict(stamp)
        frame = front_end.measure(
            dataset.image(k), stamp, predicted.gTb, predicted.covariance[:6, :6], dataset.sun.at(stamp)
        )
        session.update(frame)
        measured.append(frame)
        report("frames", k + 1, len(stamps))
    return tuple(measured), start


def _measure_first(
    dataset: Dataset, descent: Descent, front_end: GuidedFrontEnd
) -> tuple[FrameMeasurement, Start]:
    """Measure the first image from the prior, and once more from the start that this gives.

    A prior too poor for the guided front end is first searched through for the pose that explains the
    image; what is found there guides, but is no measurement.
    """
    initial = dataset.initial
    stamp = initial.stamp_ns
    image, sun = dataset.image(0), dataset.sun.at(stamp)
    gTb = initial.gTb
    covariance = np.diag(np.repeat([initial.attitude_sigma_rad**2, initial.position_sigma_m**2], 3))
    spread_px = image_spread_px(dataset.camera, dataset.body.radius_m, gTb, covariance)
    if 3.0 * spread_px > GUIDED_REACH_PX:
        found = acquire(image, dataset.camera, dataset.catalog, gTb, covariance, sun)
        if found is not None:
            gTb, covariance = found.gTb, found.pose_covariance
    frame = front_end.measure(image, stamp, gTb, covariance, sun)
    start = first_frame_map(descent, frame)
    frame = front_end.measure(image, stamp, start.gTb, start.pose_covariance, sun)
    return frame, first_frame_map(descent, frame)


def _silent(what: str, done: int, total: int) -> None:
    del what, done, total
