"""From a data set to trajectories: front end, start, and every estimator on the same measurements."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.registry import DEFAULT, estimator
from craternav_fg.estimators.start import make_problem
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.relocalisation import Relocaliser, find_initial
from craternav_fg.pipeline.tracking import Tracker
from craternav_fg.trajectory import InitialState, Trajectory
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.errors import FactorError

FloatArray = npt.NDArray[np.float64]

# Called with what is being done, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]

# What numbers beyond all reason end in: a factor that is not finite, a system that GTSAM cannot solve.
NUMERICAL_ERRORS = (FactorError, RuntimeError, OverflowError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Reconstruction:
    """What came out of a data set.

    Attributes
    ----------
    frames : tuple of FrameMeasurement
        The measurements that all estimators were given.
    problems : tuple of Problem
        What the estimators were given: one, or one for each part of a descent that began anew. Each has its
        start.
    origin : {"given", "found", "replaced"}
        Where the initial state is from: the data set, the images as the data set has none, or the images as
        they contradict the data set's.
    resumed : tuple of int
        Frames from which everything began anew, as the images contradicted what was predicted of them.
    trajectories : mapping of str to Trajectory
        By the estimator's name, at the frames' stamps.
    times_s : mapping of str to float
        Wall time of the front end (`front_end`) and of each estimator.
    options : mapping of str to dict
        Options of the front end and of each estimator that has any, resolved.
    failures : mapping of str to str
        Estimators that gave no trajectory, and why.
    index_said : str
        Why the catalogue's index for identification was built although one could be stored; empty otherwise.
    expected_rims : tuple of int, or None
        For each frame, how many catalogue craters should be seen whole and large enough from the first
        trajectory's poses; None when no images were looked at.
    predicted : ndarray, shape (k, 4, 4), or None
        Poses of the lander that guided the front end in each frame; None when no images were looked at.
    """

    frames: tuple[FrameMeasurement, ...]
    problems: tuple[Problem, ...]
    origin: str
    resumed: tuple[int, ...]
    trajectories: Mapping[str, Trajectory]
    times_s: Mapping[str, float]
    options: Mapping[str, dict[str, Any]]
    failures: Mapping[str, str]
    index_said: str
    expected_rims: tuple[int, ...] | None
    predicted: FloatArray | None


def reconstruct(
    dataset: Dataset,
    names: Sequence[str] = DEFAULT,
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
    options = {one.name: asdict(one.options) for one in chosen if hasattr(one, "options")}
    began = time.perf_counter()
    relocaliser = Relocaliser(dataset)
    initial = dataset.initial
    if initial is None:
        report("index of the catalogue", 0, 1)
        relocaliser.prepare()
        report("index of the catalogue", 1, 1)
        initial = find_initial(
            dataset, relocaliser, lambda done: report("identified frames", done, len(dataset))
        )
    descent = Descent.of(dataset, initial)
    predicted: FloatArray | None = None
    if dataset.measurements is None:
        front_end = GuidedFrontEnd(dataset.camera, dataset.catalog)
        options["front_end"] = asdict(front_end.options)
        try:
            tracked = Tracker(dataset, descent, front_end, relocaliser).run(report)
        except NUMERICAL_ERRORS as error:
            raise EstimationError(f"front end: {_one_line(error)}") from error
        frames, arcs, predicted = tracked.frames, tracked.arcs, tracked.guides
    else:
        frames, arcs = dataset.measurements, ((0, initial),)
    problems = _problems(descent, frames, arcs)
    times_s = {"front_end": time.perf_counter() - began}
    trajectories: dict[str, Trajectory] = {}
    failures: dict[str, str] = {}
    for done, one in enumerate(chosen):
        report(f"estimator {one.name}", done, len(chosen))
        began = time.perf_counter()
        try:
            trajectories[one.name] = _sound(_joined([one.estimate(problem) for problem in problems]))
        except (EstimationError, *NUMERICAL_ERRORS) as error:
            failures[one.name] = f"{one.name}: {_one_line(error)}"
        times_s[one.name] = time.perf_counter() - began
    report("estimator", len(chosen), len(chosen))
    if not trajectories:
        raise EstimationError("; ".join(failures.values()))
    expected = None
    if dataset.measurements is None:
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
    origin = "found" if dataset.initial is None else "given"
    if origin == "given" and arcs[0][1] is not initial:
        origin = "replaced"
    return Reconstruction(
        frames, tuple(problems), origin, tuple(first for first, _ in arcs[1:]), trajectories, times_s,
        options, failures, relocaliser.index_said, expected, predicted,
    )  # fmt: skip


def _problems(
    descent: Descent, frames: Sequence[FrameMeasurement], arcs: Sequence[tuple[int, InitialState]]
) -> list[Problem]:
    """Make a problem of each part of a descent, from its first frame to the next part's."""
    out = []
    ends = [first for first, _ in arcs[1:]] + [len(frames)]
    for (first, initial), end in zip(arcs, ends, strict=True):
        part = replace(descent, initial=initial)
        out.append(make_problem(part, frames[first:end]))
    return out


def _joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Put the parts of a trajectory one behind the other."""
    if len(parts) == 1:
        return parts[0]
    values: dict[str, Any] = {}
    for one in fields(Trajectory):
        every = [getattr(part, one.name) for part in parts]
        if any(value is None for value in every):
            values[one.name] = None
        elif one.name in ("rim_weights", "rim_craters"):
            values[one.name] = tuple(of_frame for value in every for of_frame in value)
        elif one.name == "calibrated":
            values[one.name] = every[-1]
        else:
            values[one.name] = np.concatenate(every)
    return Trajectory(**values)


def _sound(trajectory: Trajectory) -> Trajectory:
    """Return a trajectory that is one.

    Raises
    ------
    EstimationError
        When a state is not finite or a variance not positive: such an estimator has failed, whatever it says.
    """
    for name in ("gTb", "gV", "bias", "pose_covariance", "velocity_covariance", "bias_covariance"):
        values = getattr(trajectory, name)
        if values is None:
            continue
        good, what = np.isfinite(values).reshape(len(values), -1).all(axis=1), "finite numbers"
        if good.all() and name.endswith("covariance"):
            good, what = (np.diagonal(values, axis1=1, axis2=2) > 0.0).all(axis=1), "positive variances"
        if not good.all():
            frame = int(np.argmin(good))
            raise EstimationError(f"{name.replace('_', ' ')} of frame {frame}: expected {what}")
    return trajectory


def _one_line(error: Exception) -> str:
    """Give the first sentence of an error's text: GTSAM's go on for a page."""
    return " ".join(str(error).split()).split(". ")[0].removesuffix(".")


def _silent(what: str, done: int, total: int) -> None:
    del what, done, total
