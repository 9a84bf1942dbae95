"""The result of a reconstruction: measurements, trajectories, residuals, innovations and warnings."""

import html
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from craternav_fg import frames
from craternav_fg.catalogs.common_shift import unknown_height_warnings
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.evaluation.innovations import Innovations, innovations
from craternav_fg.evaluation.residuals import outlier_share, rim_residuals
from craternav_fg.evaluation.sensor_consistency import (
    ResidualSummary,
    prior_sigmas,
    smoothed_residuals,
    summarise,
)
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline import catalog_warnings, input_warnings, warnings
from craternav_fg.pipeline.detected_intrinsics import DetectedIntrinsics
from craternav_fg.pipeline.displacement import displacement
from craternav_fg.pipeline.intrinsics_check import contradicted_intrinsics, contradicted_lens
from craternav_fg.pipeline.map_scale import Growth, growth_of_rims
from craternav_fg.pipeline.processed_images import ProcessedImages
from craternav_fg.pipeline.rim_mistakes import likely_rim_mistake
from craternav_fg.resection.estimated_errors import EstimatedErrors
from craternav_fg.resection.shifted_group import ShiftedGroup
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# The estimator whose innovations are evaluated: a filter, which predicts each frame before it measures it.
FILTER = "ekf"
# The estimator at whose trajectory residuals and the initial state are judged.
SMOOTHER = "smoother"


@dataclass(frozen=True)
class Reconstruction:
    """What was reconstructed from a data set.

    Attributes
    ----------
    frames : tuple of FrameMeasurement
        The measurements that all estimators were given.
    problems : tuple of Problem
        What the estimators were given: one problem, or one for each segment of a descent that was
        re-initialised. Each has its start.
    origin : {"given", "found", "replaced"}
        Where the initial state is from: the data set; the images, as the data set has none; or the images, as
        they contradict the data set's.
    reinitialised_at : tuple of int
        Indices of the frames at which a new segment begins, as identified craters contradict the prediction.
    trajectories : mapping of str to Trajectory
        By the estimator's name, at the frames' stamps.
    times_s : mapping of str to float
        Wall time of the front end (`front_end`) and of each estimator.
    options : mapping of str to dict
        Options of the front end and of each estimator that has any, resolved.
    failures : mapping of str to str
        Estimators that produced no trajectory, and why.
    index_note : str
        Why the catalogue's index for identification was built although one could be stored; empty otherwise.
    expected_rims : tuple of int, or None
        For each frame, how many catalogue craters should be seen whole and large enough from the first
        trajectory's poses; None when no images were processed, or their rims are excluded.
    predicted : ndarray, shape (k, 4, 4), or None
        Poses gTb of the body that guided the front end in each frame; None when no images were processed.
    ignored : tuple of str
        Folders below `mav0` of the data set that no sensor known here reads.
    in_colour : int
        Images of the data set that are in colour.
    repeated_craters : tuple of str
        See `Dataset.repeated_craters`.
    detected_intrinsics : DetectedIntrinsics or None
        Deviation of the camera's intrinsics from those by rims detected without a prediction; None where the
        images were not asked, or do not tell.
    sun_departure_rad : float
        See `Dataset.sun_departure_rad`.
    repeated : mapping of str to str
        Images whose files are copies of an earlier one, and the earlier one.
    processed : ProcessedImages
        Traces of processing in the images: equalised grey levels, repeated rows or columns, blur.
    disbelieved : mapping of int to str
        Frames whose rims were left out, as they contradict the IMU and no later frame confirms them, and the
        files of their images.
    mistake : str
        Where no rim was found in any image, or only from a camera that is turned: the mistake that would
        explain it, see `pipeline.mistakes`.
    displaced : str
        Where the initial position was replaced by one that contradicts it: where it is from it.
    sigma_factor : float
        By which the standard deviations of the initial pose and velocity were multiplied, as measured rims
        contradict them.
    lowered : bool
        Whether the catalogue's heights were taken for those of the rims' points, see `pipeline.rim_planes`.
    wrong_craters : mapping of str to int
        Craters whose measured rims were left out, as the others contradict them, and in how many frames.
    map_errors : EstimatedErrors or None
        Errors that were assumed of a catalogue that states none, as the rims show them; None where it states
        its errors, or the rims agree with it.
    shifted_group : ShiftedGroup or None
        Craters of the catalogue that were displaced alike against the others; they were aligned.
    """

    frames: tuple[FrameMeasurement, ...]
    problems: tuple[Problem, ...]
    origin: Literal["given", "found", "replaced"]
    reinitialised_at: tuple[int, ...]
    trajectories: Mapping[str, Trajectory]
    times_s: Mapping[str, float]
    options: Mapping[str, dict[str, Any]]
    failures: Mapping[str, str]
    index_note: str
    expected_rims: tuple[int, ...] | None
    predicted: FloatArray | None
    ignored: tuple[str, ...] = ()
    in_colour: int = 0
    repeated_craters: tuple[str, ...] = ()
    detected_intrinsics: DetectedIntrinsics | None = None
    sun_departure_rad: float = 0.0
    repeated: Mapping[str, str] = field(default_factory=dict)
    processed: ProcessedImages = field(default_factory=ProcessedImages)
    disbelieved: Mapping[int, str] = field(default_factory=dict)
    mistake: str = ""
    displaced: str = ""
    sigma_factor: float = 1.0
    lowered: bool = False
    wrong_craters: Mapping[str, int] = field(default_factory=dict)
    map_errors: EstimatedErrors | None = None
    shifted_group: ShiftedGroup | None = None

    @cached_property
    def innovations(self) -> Innovations | None:
        """Innovations of the filter `FILTER`; None when it did not run or no later frame measured anything.

        They need no ground truth.
        """
        return self._innovations() if FILTER in self.trajectories else None

    def _innovations(self) -> Innovations | None:
        runs = [(problem, ekf().run(problem)) for problem in self.problems]
        found = Innovations.joined(innovations(p, run.states, run.predictions) for p, run in runs)
        return found if found.sensor else None

    def _without_rims(self) -> Innovations | None:
        """Innovations where no rim was measured, even if the filter was not asked for; None with rims."""
        if any(len(frame.rims) for frame in self.frames) or not self.problems[0].sensors:
            return None
        try:
            return self.innovations or self._innovations()
        except (EstimationError, *NUMERICAL_ERRORS):
            return None

    @cached_property
    def residuals(self) -> Mapping[str, FloatArray]:
        """Whitened residuals (n, 5) of all rims at each estimator's poses, see `rim_residuals`."""
        descent = self.problems[0]
        return {
            name: rim_residuals(trajectory, self.frames, descent.camera, descent.catalog)
            for name, trajectory in self.trajectories.items()
        }

    @cached_property
    def consistency(self) -> Mapping[str, ResidualSummary]:
        """Each sensor's residuals at the smoother's trajectory; empty when `SMOOTHER` did not run."""
        if SMOOTHER not in self.trajectories:
            return {}
        return summarise(smoothed_residuals(self.problems, self.trajectories[SMOOTHER]))

    def _prior(self) -> tuple[dict[str, float], float]:
        """Distance of the smoothed first state from its prior, and the attitude's, read as x, y, z, w."""
        initial, smoothed = self.problems[0].initial, self.trajectories.get(SMOOTHER)
        if smoothed is None or int(smoothed.stamps_ns[0]) != initial.stamp_ns:
            return {}, np.inf
        gTb = initial.gTb.copy()
        gTb[:3, :3] = frames.from_quaternion_wxyz(np.roll(frames.to_quaternion_wxyz(gTb[:3, :3]), 1))
        reordered = prior_sigmas(replace(initial, gTb=gTb), smoothed)
        found = prior_sigmas(initial, smoothed)
        if self.problems[0].motion is not None:
            # There the biases stand for the motion.
            found = {name: value for name, value in found.items() if "bias" not in name}
        return found, reordered["attitude"]

    def _displaced(self) -> str:
        """Where the smoothed first position is from the initial one; empty without a smoother."""
        smoothed = self.trajectories.get(SMOOTHER)
        return "" if smoothed is None else displacement(self.problems[0].initial.gTb[:3, 3], smoothed.gP[0])

    @property
    def initial_position(self) -> dict[str, Any] | None:
        """Where the smoothed first position is from the initial one, and how many sigmas of it.

        What moves the whole catalogue, such as another prime meridian, moves the trajectory along, and shows
        here alone. None without a smoother, or where the images gave the initial state.
        """
        sigmas = self._prior()[0].get("position")
        if sigmas is None or self.origin != "given":
            return None
        return {"sigmas": sigmas, "smoothed": self._displaced()}

    def _least_position_sigma_m(self) -> float:
        """Smallest standard deviation of a position of the first trajectory; infinite without covariances."""
        covariances = next(iter(self.trajectories.values())).pose_covariance
        if covariances is None:
            return np.inf
        return float(np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2).min()))

    def _contradicted(self, check: Callable[..., bool]) -> bool:
        """Whether rims contradict the camera, each frame's by themselves, near the first trajectory."""
        descent, near = self.problems[0], next(iter(self.trajectories.values()))
        return check(self.frames, near.gTb, descent.camera, descent.catalog)

    def _growth_of_rims(self) -> Growth | None:
        """How much larger rims are than their craters; None without a smoother."""
        descent, smoothed = self.problems[0], self.trajectories.get(SMOOTHER)
        if smoothed is None:
            return None
        return growth_of_rims(
            self.frames, smoothed.gTb, descent.camera, descent.catalog, stated_errors=self.map_errors is None
        )

    def _rim_mistake(self) -> str:
        """Name what explains rims that contradict each other; empty for those measured in images."""
        return likely_rim_mistake(self.problems[0]) if self.predicted is None else ""

    def _contradicts_the_map(self) -> bool:
        """Whether rims are missing, left out, or contradict other sensors."""
        # Before the first rims, a wrong initial state is to blame.
        first = next((k for k, frame in enumerate(self.frames) if len(frame.rims)), 0)
        began = first if self.origin == "replaced" else 0
        missed = self.expected_rims is not None and any(
            expected and not len(frame.rims)
            for expected, frame in list(zip(self.expected_rims, self.frames, strict=True))[began:]
        )
        disbelieved = any(k >= began for k in self.disbelieved)
        outliers = warnings.inconsistent_trajectories(self.outlier_shares)
        too_large = self.innovations is not None and any(
            warnings.too_large(part.mean, int(part.dimension.sum()), images=self.predicted is not None)
            for part in map(self.innovations.of, {"imu", "rims"} & set(self.innovations.sensor))
        )
        return bool(missed or disbelieved or outliers or too_large)

    def _tenth_px_m(self) -> float:
        """Return a tenth of a pixel on the ground below the middle of the first trajectory, m."""
        descent, gP = self.problems[0], next(iter(self.trajectories.values())).gP
        altitude_m = float(np.median(descent.body.altitude_m(gP)))
        return 0.1 * max(altitude_m, 0.0) / descent.camera.focal_px

    @cached_property
    def outlier_shares(self) -> Mapping[str, float | None]:
        """Share of outliers among all rims, by estimator; None without rims."""
        return {name: outlier_share(residuals) for name, residuals in self.residuals.items()}

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting the trajectories, one sentence each."""
        descent = self.problems[0]
        of_sensors = warnings.inconsistent_sensors(
            FILTER,
            self.innovations,
            self.consistency,
            images=self.predicted is not None,
            motion=descent.motion is not None,
        )
        of_camera = (
            *warnings.contradicted_intrinsics(self._contradicted(contradicted_intrinsics)),
            *input_warnings.deviating_intrinsics(self.detected_intrinsics),
            *warnings.contradicted_lens(self._contradicted(contradicted_lens)),
        )
        of_scale = catalog_warnings.scaled_map(self._growth_of_rims())
        # What has a cause of its own does not speak against the map.
        explained = bool(of_camera or of_scale or self.mistake)
        return (
            *warnings.failed_estimators(self.failures),
            *warnings.contradicted_without_rims(FILTER, self._without_rims()),
            *warnings.singular_covariances(
                {name: t.pose_covariance for name, t in self.trajectories.items()}
            ),
            *warnings.inconsistent_trajectories(self.outlier_shares, self._rim_mistake),
            *warnings.contradicted_prior(*self._prior(), self._displaced()),
            *of_sensors,
            *of_camera,
            *input_warnings.long_lever_arms(
                {"camera": descent.camera.bTc, **{one.name: one.bTs for one in descent.sensors}}
            ),
            *input_warnings.missing_lever_arm(descent.camera, self._least_position_sigma_m()),
            *catalog_warnings.unusual_body(descent.catalog),
            *catalog_warnings.heights_in_km(descent.catalog),
            *catalog_warnings.angles_in_radians(descent.catalog),
            *of_scale,
            *input_warnings.unknown_sensors(self.ignored),
            *input_warnings.dead_imu(None if descent.motion is not None else descent.imu),
            *input_warnings.saturated_imu(None if descent.motion is not None else descent.imu),
            *input_warnings.empty_logs({one.name: len(one) for one in descent.sensors}),
            *input_warnings.colour_images(self.in_colour),
            *catalog_warnings.repeated_craters(self.repeated_craters),
            *catalog_warnings.wrong_craters(self.wrong_craters),
            *input_warnings.departing_sun(self.sun_departure_rad),
            *input_warnings.repeated_images(self.repeated),
            *input_warnings.equalised_images(self.processed),
            *input_warnings.repeated_lines(self.processed),
            *input_warnings.blurred_images(self.processed, descent.camera.psf_sigma_px),
            *input_warnings.disbelieved_frames(self.disbelieved),
            # A catalogue without heights says itself that its rims lie on the sphere.
            *warnings.lowered_rims(self.lowered and descent.catalog.has_heights),
            *unknown_height_warnings(descent.catalog.unknown_height_sigma_m),
            *input_warnings.widened_prior(self.sigma_factor),
            *warnings.replaced_states(self.origin, self.reinitialised_at, self.mistake, self.displaced),
            *warnings.frames_without_rims(
                [len(frame.rims) for frame in self.frames],
                self.expected_rims,
                self.mistake,
                [sensor.name for sensor in descent.sensors],
            ),
            *catalog_warnings.shifted_craters(self.shifted_group, descent.catalog),
            *catalog_warnings.assumed_map_errors(self.map_errors, descent.catalog),
            *catalog_warnings.unstated_map_errors(
                descent.catalog, self._contradicts_the_map() and not explained, self._tenth_px_m()
            ),
        )

    def _repr_html_(self) -> str:
        """Show in a notebook what was reconstructed, and the warnings."""
        rims = sum(len(frame.rims) for frame in self.frames)
        names = ", ".join(self.trajectories)
        lines = [f"{len(self.frames)} frames with {rims} rims; trajectories: {names}"]
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "".join(f"<p>{html.escape(line)}</p>" for line in lines)
