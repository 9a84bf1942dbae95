"""From a data set to trajectories: front end, start, and every estimator on the same measurements."""

import time
from collections.abc import Collection, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError, one_sentence
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Descent, Estimator, Problem
from craternav_fg.estimators.dead_reckoning import DeadReckoning
from craternav_fg.estimators.instruments import IMU, RIMS, SUN
from craternav_fg.estimators.registry import DEFAULT, estimator
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.detected_intrinsics import detected_intrinsics
from craternav_fg.pipeline.displacement import displacement
from craternav_fg.pipeline.initial_state import find_initial
from craternav_fg.pipeline.intrinsics_error import with_intrinsics_error
from craternav_fg.pipeline.lever_arm import with_lever_arm_error, with_mounting_error
from craternav_fg.pipeline.map_shift import with_common_shift
from craternav_fg.pipeline.measuring import Measured, Measuring, Progress, expected_rims
from craternav_fg.pipeline.mistakes import likely_mistake, turned_about_axis
from craternav_fg.pipeline.processed_images import processed_images
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.pipeline.repeated_images import repeated_images
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.pipeline.tracking import Segment
from craternav_fg.pipeline.unstated_map import with_aligned_group, with_unstated_errors
from craternav_fg.pipeline.warnings import MAX_POSITION_SIGMAS
from craternav_fg.sensors.point_features import NAME as FEATURES
from craternav_fg.sensors.protocol import Sensor
from craternav_fg.trajectory import InitialState, Trajectory
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import BoolArray, FloatArray, IntArray

# Of eigenvalues of correlations, which may be negative by so much.
_MAX_ROUNDING = 1e-9


def reconstruct(
    data: Dataset | Path | str,
    estimators: Sequence[str | Estimator] = DEFAULT,
    *,
    sensors: Sequence[str | Sensor] | None = None,
    without: Sequence[str] = (),
    front_end: GuidedOptions | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Measure the frames of a data set and run estimators on them.

    Parameters
    ----------
    data : Dataset, Path or str
        A data set or its folder. Its ground truth, if it has one, is not used.
    estimators : sequence of str or Estimator
        Names, see `craternav_fg.estimators.registry`, or objects with `name` and `estimate(problem)`.
    sensors : sequence of str or Sensor, optional
        Sensors to use besides camera and IMU: names of the data set's sensors, or objects of your own. All
        of the data set's by default. "features" are its tracked points.
    without : sequence of str, optional
        Names of sensors to exclude from estimation, also "rims", "sun" or "features"; the front end still
        tracks with the camera.
    front_end : GuidedOptions, optional
        How rims are measured in images.
    progress : callable, optional
        Called with the name of a step, its finished amount and its total.

    Returns
    -------
    Reconstruction

    Raises
    ------
    EstimationError
        When a name is unknown, or every estimator fails.
    InputError
        When the data set is wrong, a sensor's log in a wrong unit, or an image cannot be read.
    """
    chosen = [estimator(one) if isinstance(one, str) else one for one in estimators]
    dataset = _with_sensors(data if isinstance(data, Dataset) else Dataset.open(data), sensors, without)
    report = progress or _silent
    began = time.perf_counter()
    relocaliser = Relocaliser(dataset)
    repeated = {} if dataset.measurements is not None else repeated_images(dataset.image_paths)
    initial = _initial_state(dataset, relocaliser, report, repeated)
    measuring = Measuring(initial, front_end or GuidedOptions(), without, repeated, report)
    prepared, map_errors = with_unstated_errors(measuring.prepared(dataset, relocaliser), measuring)
    prepared, map_errors, shifted = with_aligned_group(prepared, map_errors, measuring, dataset)
    times_s = {"front_end": time.perf_counter() - began}
    dataset, measured, problems = prepared.dataset, prepared.measured, prepared.problems
    bare = problems
    if any(getattr(one, "estimates_map", False) for one in chosen):
        bare = replace(measured, frames=prepared.without_map_errors()).problems(prepared.descent)
    trajectories, failures, estimation_s = _run(chosen, problems, bare, measured.frames, report)
    first = next(iter(trajectories.values()))
    searched = None if RIMS in without else measured.limits
    expected = expected_rims(dataset, first.gTb, searched)
    return Reconstruction(
        frames=measured.frames,
        problems=problems,
        origin=_origin(dataset, measured),
        reinitialised_at=tuple(segment.first for segment in measured.segments[1:]),
        trajectories=trajectories,
        times_s=times_s | estimation_s,
        options=_options(chosen, measured.limits),
        failures=failures,
        index_note=prepared.relocaliser.index_note,
        expected_rims=expected,
        detected_intrinsics=detected_intrinsics(
            dataset, prepared.relocaliser, measured.frames, expected, first.gTb
        ),
        predicted=measured.guides,
        ignored=dataset.ignored,
        in_colour=dataset.in_colour,
        repeated_craters=dataset.repeated_craters,
        sun_departure_rad=dataset.sun_departure_rad,
        repeated={_name(dataset, k): _name(dataset, first) for k, first in repeated.items()},
        processed=processed_images(dataset),
        disbelieved={k: _name(dataset, k) for k in measured.disbelieved},
        displaced=_displaced(dataset, measured.segments),
        sigma_factor=measured.sigma_factor,
        lowered=prepared.lowered,
        wrong_craters={
            dataset.catalog.identifiers[row]: count for row, count in prepared.wrong_craters.items()
        },
        map_errors=map_errors,
        shifted_group=shifted,
        mistake="" if searched is None else _mistake(dataset, Descent.of(dataset, initial), measured, report),
    )


def _run(
    chosen: Sequence[Estimator],
    problems: Sequence[Problem],
    bare: Sequence[Problem],
    frames: Sequence[FrameMeasurement],
    report: Progress,
) -> tuple[dict[str, Trajectory], dict[str, str], dict[str, float]]:
    """Run estimators: trajectories, why others failed, and how long each took, s.

    Those that estimate the errors of the map get the problems whose rims do not contain them.

    Raises
    ------
    EstimationError
        When every estimator fails.
    """
    stamps_ns = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    catalog = problems[0].catalog
    seen = any(len(frame.rims) or len(frame.arcs) for frame in frames)
    trajectories: dict[str, Trajectory] = {}
    failures: dict[str, str] = {}
    times_s: dict[str, float] = {}
    for done, one in enumerate(chosen):
        report(f"estimator {one.name}", done, len(chosen))
        began = time.perf_counter()
        try:
            estimated = _estimate(one, bare if getattr(one, "estimates_map", False) else problems, stamps_ns)
            found = with_common_shift(one.name, estimated, catalog, frames)
            if seen and one.name != DeadReckoning.name:
                found = with_lever_arm_error(found, problems[0])
                found = with_mounting_error(found, problems[0])
                found = with_intrinsics_error(found, problems[0])
            trajectories[one.name] = found
        except (EstimationError, *NUMERICAL_ERRORS) as error:
            failures[one.name] = f"{one.name}: {one_sentence(error)}"
        times_s[one.name] = time.perf_counter() - began
    report("estimator", len(chosen), len(chosen))
    if not trajectories:
        raise EstimationError("; ".join(failures.values()))
    return trajectories, failures, times_s


def _with_sensors(dataset: Dataset, chosen: Sequence[str | Sensor] | None, without: Sequence[str]) -> Dataset:
    """Keep the chosen sensors of a data set, add custom ones, and leave out others.

    Raises
    ------
    EstimationError
        When the data set has no sensor of a name.
    """
    if chosen is not None:
        dataset = _with_chosen(dataset, chosen)
    names = [sensor.name for sensor in dataset.sensors]
    names += [] if dataset.features is None else [FEATURES]
    for name in without:
        if name == IMU:
            raise EstimationError(
                "without: the states follow each other by the IMU; a data set without one says in [motion] "
                "how the lander moves"
            )
        if name not in (*names, RIMS, SUN):
            has = ", ".join((*names, RIMS, SUN))
            raise EstimationError(f"without: the data set has no sensor {name!r}; it has {has}")
    kept = tuple(sensor for sensor in dataset.sensors if sensor.name not in without)
    return replace(dataset, sensors=kept, features=None if FEATURES in without else dataset.features)


def _with_chosen(dataset: Dataset, chosen: Sequence[str | Sensor]) -> Dataset:
    """Keep the chosen sensors, and add custom ones."""
    there: dict[str, Sensor] = {sensor.name: sensor for sensor in dataset.sensors}
    names = [*there, *([] if dataset.features is None else [FEATURES])]
    for one in chosen:
        if isinstance(one, str) and one not in names:
            has = ", ".join(names) if names else "none beside camera and IMU"
            raise EstimationError(f"sensor {one!r}: the data set has {has}")
    kept = tuple(there[one] if isinstance(one, str) else one for one in chosen if one != FEATURES)
    return replace(dataset, sensors=kept, features=dataset.features if FEATURES in chosen else None)


def _initial_state(
    dataset: Dataset, relocaliser: Relocaliser, report: Progress, repeated: Collection[int]
) -> InitialState:
    """Take the data set's initial state, or find one in its images."""
    if dataset.initial is not None:
        return dataset.initial
    report("index of the catalogue", 0, 1)
    relocaliser.prepare()
    report("index of the catalogue", 1, 1)
    return find_initial(
        dataset, relocaliser, lambda done: report("identified frames", done, len(dataset)), repeated
    )


def _estimate(one: Estimator, problems: Sequence[Problem], stamps_ns: IntArray) -> Trajectory:
    """Estimate all segments, and keep the states at the frames."""
    whole = _joined([one.estimate(problem) for problem in problems])
    at_frames = np.isin(whole.stamps_ns, stamps_ns)
    return _checked(whole if at_frames.all() else whole.take(np.flatnonzero(at_frames)))


def _joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Join the trajectories of segments to one."""
    if len(parts) == 1:
        return parts[0]
    values: dict[str, Any] = {}
    for one in fields(Trajectory):
        if one.name == "calibrated_at":
            continue
        every = [getattr(part, one.name) for part in parts]
        if any(value is None for value in every):
            values[one.name] = None
        elif one.name in ("rim_weights", "rim_craters"):
            values[one.name] = tuple(of_frame for value in every for of_frame in value)
        elif one.name == "calibrated":
            values[one.name] = every[-1]
            values["calibrated_at"] = tuple(part.calibrated for part in parts for _ in range(len(part)))
        else:
            values[one.name] = np.concatenate(every)
    return Trajectory(**values)


def _checked(trajectory: Trajectory) -> Trajectory:
    """Return a trajectory whose numbers are sound.

    Raises
    ------
    EstimationError
        When a state is not finite or a covariance not positive definite: the estimator has failed, whatever
        it reports.
    """
    for name in ("gTb", "gV", "bias", "pose_covariance", "velocity_covariance", "bias_covariance"):
        values = getattr(trajectory, name)
        if values is None:
            continue
        good, what = np.isfinite(values).reshape(len(values), -1).all(axis=1), "finite numbers"
        if good.all() and name.endswith("covariance"):
            good, what = (np.diagonal(values, axis1=1, axis2=2) > 0.0).all(axis=1), "positive variances"
            if good.all():
                good, what = _definite(values), "a positive definite matrix"
        if not good.all():
            frame = int(np.argmin(good))
            raise EstimationError(f"{name.replace('_', ' ')} of frame {frame}: expected {what}")
    return trajectory


def _definite(covariances: FloatArray) -> BoolArray:
    """Whether covariances (n, m, m) have no negative variance in any direction, but for rounding."""
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    correlations = covariances / (sigmas[:, :, None] * sigmas[:, None, :])
    return np.asarray(np.linalg.eigvalsh(correlations)[:, 0] > -_MAX_ROUNDING)


def _origin(dataset: Dataset, measured: Measured) -> Literal["given", "found", "replaced"]:
    """Determine where the initial state is from, see `Reconstruction.origin`."""
    if dataset.initial is None:
        return "found"
    kept = measured.sigma_factor > 1.0 or measured.segments[0].initial is dataset.initial
    return "given" if kept else "replaced"


def _displaced(dataset: Dataset, segments: Sequence[Segment]) -> str:
    """Tell where the first position is from the data set's, if they contradict each other."""
    given, first = dataset.initial, segments[0].initial
    if given is None or given.stamp_ns != first.stamp_ns:
        return ""
    before, after = given.gTb[:3, 3], first.gTb[:3, 3]
    apart = np.linalg.norm(after - before) > MAX_POSITION_SIGMAS * given.position_sigma_m
    return displacement(before, after) if apart else ""


def _options(chosen: Sequence[Estimator], limits: GuidedOptions | None) -> dict[str, dict[str, Any]]:
    """Return the options of the estimators that have any and, if it ran, of the front end."""
    options = {one.name: asdict(one.options) for one in chosen if hasattr(one, "options")}
    return options if limits is None else options | {"front_end": asdict(limits)}


def _mistake(dataset: Dataset, descent: Descent, measured: Measured, report: Progress) -> str:
    """Explain why no rim was found in any image, or only from a turned camera; empty if nothing does."""
    first = measured.segments[0].initial
    turned = turned_about_axis(dataset.camera, descent.initial.gTb, first.gTb)
    if any(len(frame.rims) for frame in measured.frames) and not turned:
        return ""
    return likely_mistake(
        dataset, descent, lambda done, total: report("usual mistakes that were tried", done, total)
    )


def _name(dataset: Dataset, frame: int) -> str:
    """Name the file of a frame's image."""
    return dataset.image_paths[frame].name


def _silent(what: str, done: int, total: int) -> None:
    del what, done, total
