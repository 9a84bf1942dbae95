"""What estimators are given: the measurements of a data set, checked, with the errors of the map."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import EstimationError, one_sentence
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Descent, Problem
from craternav_fg.estimators.instruments import CAMERA_AND_IMU
from craternav_fg.estimators.sensor_bank import SensorBank
from craternav_fg.estimators.start import make_problem
from craternav_fg.evaluation.residuals import frame_residuals, outlying_craters
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.map_errors import (
    filtered_poses,
    lack_map_errors,
    with_map_errors,
    with_white_map_errors,
)
from craternav_fg.pipeline.prior_check import sigma_factor, widened
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.pipeline.rim_planes import heights_of_points, lowered_to_planes
from craternav_fg.pipeline.sensor_checks import check_imu, check_logs
from craternav_fg.pipeline.tracking import Segment, Tracker
from craternav_fg.sensors.point_features import FeatureTracks
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.point_tracks import GroundMotion, track_points
from factors.arrays import FloatArray

# Called with the name of a step, its finished amount and its total.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Measured:
    """Measurements of a descent.

    Attributes
    ----------
    frames : tuple of FrameMeasurement
    segments : tuple of Segment
    guides : ndarray, shape (k, 4, 4), or None
        Poses gTb of the body that guided the front end, m; None when the data set holds the measurements.
    limits : GuidedOptions or None
        Options of the front end, if there was one.
    disbelieved : mapping of int to FrameMeasurement
        See `Tracked`.
    sigma_factor : float
        By which the standard deviations of the initial state were multiplied, as the rims contradict it.
    """

    frames: tuple[FrameMeasurement, ...]
    segments: tuple[Segment, ...]
    guides: FloatArray | None = None
    limits: GuidedOptions | None = None
    disbelieved: Mapping[int, FrameMeasurement] = field(default_factory=dict)
    sigma_factor: float = 1.0

    @property
    def every(self) -> "Measured":
        """The same with what was left out."""
        return replace(
            self, frames=tuple(self.disbelieved.get(k, frame) for k, frame in enumerate(self.frames))
        )

    def problems(self, descent: Descent) -> tuple[Problem, ...]:
        """Make a problem of each segment, from its first frame to the next segment's.

        Parameters
        ----------
        descent : Descent

        Returns
        -------
        tuple of Problem
        """
        ends = [segment.first for segment in self.segments[1:]] + [len(self.frames)]
        bank = SensorBank(descent.sensors)
        return tuple(
            make_problem(replace(descent, initial=initial), bank.epochs(self.frames[first:end]))
            for (first, initial), end in zip(self.segments, ends, strict=True)
        )


@dataclass(frozen=True)
class Prepared:
    """What estimators are given.

    Attributes
    ----------
    dataset : Dataset
    relocaliser : Relocaliser
    descent : Descent
        With the catalogue that the problems have.
    measured : Measured
        With the errors of the map.
    read : tuple of FrameMeasurement
        The frames as they were measured: without errors of the map that were added.
    problems : tuple of Problem
        One for each segment.
    lowered : bool
        See `Reconstruction`.
    wrong_craters : mapping of int to int
        Craters of measured rims that the others contradict, and in how many frames: they are left out.
    """

    dataset: Dataset
    relocaliser: Relocaliser
    descent: Descent
    measured: Measured
    read: tuple[FrameMeasurement, ...]
    problems: tuple[Problem, ...]
    lowered: bool
    wrong_craters: Mapping[int, int] = field(default_factory=dict)

    def without_map_errors(self) -> tuple[FrameMeasurement, ...]:
        """Take the errors of the map out of the rims, for what estimates them.

        Returns
        -------
        tuple of FrameMeasurement
        """
        # Rims to which errors of the map were added as white ones do not say what to take out.
        return tuple(
            replace(frame, rims=(read if frame.rims.of_map is None else frame).rims.with_exact_map())
            for frame, read in zip(self.measured.frames, self.read, strict=True)
        )


@dataclass(frozen=True)
class Measuring:
    """How the frames of a data set are measured.

    Attributes
    ----------
    initial : InitialState
    options : GuidedOptions
    without : sequence of str
        Names of what is left out of the estimation.
    repeated : collection of int
        Frames whose images are copies of earlier ones.
    report : callable
        Called with the name of a step, its finished amount and its total.
    tilt_rad : float
        Standard deviation of slopes of rims' planes that is added to measured rims of a file with the errors
        of the map; the options have that of images.
    """

    initial: InitialState
    options: GuidedOptions
    without: Sequence[str]
    repeated: Collection[int]
    report: Progress
    tilt_rad: float = 0.0

    def prepared(
        self, dataset: Dataset, relocaliser: Relocaliser, *, lowered: bool | None = None
    ) -> Prepared:
        """Measure the frames of a data set, check its logs, and make problems for the estimators.

        Parameters
        ----------
        dataset : Dataset
        relocaliser : Relocaliser
            With the same data set.
        lowered : bool, optional
            Whether the catalogue's heights are those of the rims' points; the rims decide if not given.

        Returns
        -------
        Prepared

        Raises
        ------
        EstimationError
            When the front end fails, or no start is found.
        InputError
            When a log is in a wrong unit or order, or an image cannot be read.
        """
        measured = self._measured(dataset, relocaliser)
        measured = replace(
            measured,
            frames=tuple(self._left_out(frame) for frame in measured.frames),
            disbelieved={k: self._left_out(frame) for k, frame in measured.disbelieved.items()},
        )
        descent = Descent.of(dataset, self.initial)
        if dataset.features is None and measured.limits is not None and measured.limits.points.count:
            descent = replace(descent, features=self._tracks(dataset, measured, measured.limits))
        read = measured.frames
        lacking = dataset.measurements is not None and lack_map_errors(read, descent.catalog)
        if lacking:
            measured = replace(measured, frames=with_white_map_errors(read, descent.catalog, self.tilt_rad))
        try:
            problems = measured.problems(descent)
            # Where a wrong IMU led, the rims of its frames are those that were left out.
            check_imu(measured.every.problems(descent), dataset.path)
            check_logs(problems, dataset.path)
            if dataset.measurements is not None and dataset.initial is not None:
                measured = self._with_prior(measured, descent)
                problems = measured.problems(descent)
            wrong = {} if dataset.measurements is None else _wrong_craters(problems)
            if wrong:
                read = tuple(_without(frame, wrong) for frame in read)
                measured = replace(
                    measured, frames=tuple(_without(frame, wrong) for frame in measured.frames)
                )
                problems = measured.problems(descent)
            if lacking:
                measured = replace(measured, frames=with_map_errors(read, problems, self.tilt_rad))
                problems = measured.problems(descent)
        except NUMERICAL_ERRORS as error:
            raise EstimationError(f"start: {one_sentence(error)}") from error
        if lowered is None:
            lowered = heights_of_points(problems)
        if lowered:
            descent = replace(descent, catalog=lowered_to_planes(descent.catalog))
            problems = measured.problems(descent)
        return Prepared(dataset, relocaliser, descent, measured, read, problems, lowered, wrong)

    def _measured(self, dataset: Dataset, relocaliser: Relocaliser) -> Measured:
        """Take the data set's measurements, or measure its images."""
        if dataset.measurements is not None:
            return Measured(dataset.measurements, (Segment(0, self.initial),))
        front_end = GuidedFrontEnd(dataset.camera, dataset.catalog, self.options)
        try:
            descent = Descent.of(dataset, self.initial)
            tracked = Tracker(dataset, descent, front_end, relocaliser, self.repeated).run(self.report)
        except NUMERICAL_ERRORS as error:
            hint = "the prediction has diverged: check the IMU's units and axes, and the initial state"
            raise EstimationError(f"front end: {one_sentence(error)}; {hint}") from error
        return Measured(
            tracked.frames, tracked.segments, tracked.guides, front_end.options, tracked.disbelieved
        )

    def _with_prior(self, measured: Measured, descent: Descent) -> Measured:
        """Widen the initial state where the rims contradict it; images are tracked without it then."""
        factor = sigma_factor(descent, measured.frames)
        if factor == 1.0:
            return measured
        return replace(measured, segments=(Segment(0, widened(self.initial, factor)),), sigma_factor=factor)

    def _left_out(self, frame: FrameMeasurement) -> FrameMeasurement:
        """Take what is left out of a frame."""
        for one in CAMERA_AND_IMU:
            if one.name in self.without:
                frame = one.left_out(frame)
        return frame

    def _tracks(self, dataset: Dataset, measured: Measured, limits: GuidedOptions) -> FeatureTracks:
        """Track points through the images."""

        def images() -> Iterator[ImageArray]:
            for k in range(len(dataset)):
                self.report("tracked points", k, len(dataset))
                yield dataset.image(k)
            self.report("tracked points", len(dataset), len(dataset))

        guides = measured.guides
        motion = None if guides is None else GroundMotion(guides, dataset.body.radius_m)
        return track_points(images(), measured.frames, dataset.camera, limits.points, motion)


def _wrong_craters(problems: Sequence[Problem]) -> dict[int, int]:
    """Craters that contradict the filter, which single rims do not lead astray, in how many frames each."""
    try:
        poses = filtered_poses(problems)
    except (EstimationError, *NUMERICAL_ERRORS):
        return {}
    descent, frames = problems[0], [frame for problem in problems for frame in problem.frames]
    residuals = [
        frame_residuals(frame, poses[frame.stamp_ns], descent.camera, descent.catalog) for frame in frames
    ]
    return outlying_craters(np.concatenate(residuals), frames)


def _without(frame: FrameMeasurement, craters: Collection[int]) -> FrameMeasurement:
    """Leave the rims of some craters out of a frame."""
    kept = ~np.isin(frame.rims.craters, list(craters))
    return frame if kept.all() else replace(frame, rims=frame.rims.take(kept))


def expected_rims(dataset: Dataset, gTb: FloatArray, limits: GuidedOptions | None) -> tuple[int, ...] | None:
    """Count the catalogue craters that each frame should show.

    Parameters
    ----------
    dataset : Dataset
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m.
    limits : GuidedOptions or None
        With which rims were searched.

    Returns
    -------
    tuple of int, length k, or None
        None when no rims were searched.
    """
    if limits is None:
        return None
    least_px, margin_px = limits.min_semi_minor_px, limits.margin_px
    return tuple(
        len(dataset.catalog.visible(dataset.camera, T, min_semi_minor_px=least_px, margin_px=margin_px)[0])
        for T in gTb
    )
