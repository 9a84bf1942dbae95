"""The front end over a descent: each image measured near a predicted pose, with relocalisation when lost."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Start
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.sensor_bank import SensorBank
from craternav_fg.estimators.start import find_start
from craternav_fg.linalg import squared_distance
from craternav_fg.matching.acquire.search import acquire, image_spread_px
from craternav_fg.matching.gate import match_rims
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.pipeline.initial_state import initial_from_fix, propagated_back
from craternav_fg.pipeline.relocalisation import PoseFix, Relocaliser
from craternav_fg.sun_in_image import sun_angle_in_image
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.error_model.pooling import PooledErrors
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.kernels import strapdown

FloatArray = npt.NDArray[np.float64]

# Number of rims that agree with a pose by chance only once in very many images.
MIN_AGREEING_RIMS = 3
# After a poor prediction, so many are enough whatever the number expected. Measured in 85 images of the
# rendered southern highlands from 30 to 100 km, with sigmas of 4 km and 1 deg and 20 to 100 craters expected:
# 7 rims or more were right 24 times of 24, 3 to 6 were wrong 17 times of 20. Where few craters are expected,
# fewer are not enough either: of six, four were found by chance, and put a descent 11 km off.
ENOUGH_RIMS = 7
# Largest error of a prediction, over the whole image, from which the guided front end converges.
GUIDED_REACH_PX = 30.0
# Largest standard deviation of a predicted attitude that tells the direction towards the sun in an image: a
# third of half the quarter of the image that the crater network asks for it.
_MAX_SUN_SIGMA_RAD = float(np.deg2rad(15.0))
# Share of the expected rims below which the prediction is suspected to be wrong.
MIN_FOUND_SHARE = 0.25
# Squared Mahalanobis distance (6 degrees of freedom) between a prediction and an identified pose above which
# the two contradict each other: chance exceeds it once in 1e10. The errors of rims detected blindly are
# correlated, so the covariance of the identified pose is inflated.
CONTRADICTION_CHI2 = 60.0
FIX_VARIANCE_INFLATION = 4.0


class Segment(NamedTuple):
    """A part of a descent that is estimated on its own.

    Attributes
    ----------
    first : int
        Index of its first frame.
    initial : InitialState
        Its own prior.
    """

    first: int
    initial: InitialState


@dataclass(frozen=True)
class Tracked:
    """Measurements of a descent's images.

    Attributes
    ----------
    frames : tuple of FrameMeasurement
    segments : tuple of Segment
        One, unless identified craters contradicted the prediction: then a new one begins.
    guides : ndarray, shape (k, 4, 4)
        Pose of the body in g near which each image was measured.
    """

    frames: tuple[FrameMeasurement, ...]
    segments: tuple[Segment, ...]
    guides: FloatArray


class _Guided(NamedTuple):
    """Measurements of an image, and the pose (4, 4) of the body near which they were searched."""

    frame: FrameMeasurement
    gTb: FloatArray


class Tracker:
    """Measures all images of a data set, each with the pose that the online smoother predicts.

    Parameters
    ----------
    dataset : Dataset
    descent : Descent
    front_end : GuidedFrontEnd
    relocaliser : Relocaliser
    """

    def __init__(
        self, dataset: Dataset, descent: Descent, front_end: GuidedFrontEnd, relocaliser: Relocaliser
    ) -> None:
        self.dataset = dataset
        self.descent = descent
        self.front_end = front_end
        self.relocaliser = relocaliser
        self._pooled = PooledErrors(dataset.camera, dataset.catalog)
        self._session = OnlineSession(descent)
        self._bank = SensorBank(descent.sensors)
        self._measured: list[FrameMeasurement] = []
        self._segments = [Segment(0, descent.initial)]
        # Successive frames with far fewer rims than expected.
        self._poor_frames = 0

    def run(self, report: Callable[[str, int, int], None]) -> Tracked:
        """Measure the images, first to last.

        Parameters
        ----------
        report : callable
            Called with "frames", how many are done, and how many there are.

        Returns
        -------
        Tracked
        """
        stamps = [int(stamp) for stamp in self.dataset.stamps_ns]
        report("frames", 0, len(stamps))
        guides = []
        for index, stamp in enumerate(stamps):
            predicted = filter_state.prior(self.descent) if index == 0 else self._predict(stamp)
            frame, guide = self._next(index, predicted)
            self._measured.append(frame)
            guides.append(guide)
            report("frames", index + 1, len(stamps))
        return Tracked(tuple(self._measured), tuple(self._segments), np.array(guides))

    def _predict(self, stamp_ns: int) -> FilterState:
        """Predict the state at an image, after what sensors measured since the last one."""
        for sample_ns in self._bank.between(self._session.stamp_ns, stamp_ns):
            self._session.update(FrameMeasurement(sample_ns, RimSet.empty(), None))
        return self._session.predict(stamp_ns)

    def _next(self, index: int, predicted: FilterState) -> _Guided:
        """Measure an image and update the smoother with it."""
        guided = self._measure(index, predicted.gTb, predicted.covariance[POSE, POSE])
        relocalised = self._relocalise(index, predicted, guided.frame)
        if relocalised is not None:
            fix, frame = relocalised
            if index == 0 and not _contradicts(predicted, fix):
                return self._begin(_Guided(frame, fix.gTb))
            frame = self._shared_sun(self._pool(frame, fix.gTb))
            self._continue_from(index, predicted, fix, frame)
            return _Guided(frame, fix.gTb)
        if index == 0:
            return self._begin(guided)
        frame = self._pool(self._shared_sun(guided.frame), guided.gTb)
        self._session.update(frame)
        return _Guided(frame, guided.gTb)

    def _begin(self, guided: _Guided) -> _Guided:
        """Find the start from the first image and begin the smoother."""
        start = find_start(self.descent, [guided.frame])
        if len(guided.frame.rims):
            # Measure again from the start: it predicts more rims than the prior does.
            frame, gTb = self._measure(0, start.gTb, start.pose_covariance)
            guided = _Guided(self._pool(frame, gTb), gTb)
            start = find_start(self.descent, [guided.frame])
        self._session.begin(guided.frame, start)
        return guided

    def _pool(self, frame: FrameMeasurement, gTb: FloatArray) -> FrameMeasurement:
        """Pool the covariances of a frame's rims with those of earlier frames."""
        return replace(frame, rims=self._pooled.pool(frame.rims, gTb))

    def _shared_sun(self, frame: FrameMeasurement) -> FrameMeasurement:
        """Inflate the noise of a frame's sun tilt, as all frames but the first share its error."""
        return replace(frame, sun=shared_error(frame.sun, len(self.dataset.stamps_ns) - 1))

    def _measure(self, index: int, gTb: FloatArray, covariance: FloatArray) -> _Guided:
        """Measure an image from a predicted pose and its covariance.

        When the prediction is too poor for the guided front end, the pose that explains the image is searched
        first; it guides the front end but is no measurement. When none is found, few rims of those expected
        can be a chance agreement, and the sense of the sun's tilt, which needs rims, is unknown: both are
        discarded.
        """
        data = self.dataset
        spread_px = image_spread_px(data.camera, data.body.radius_m, gTb, covariance)
        if 3.0 * spread_px <= GUIDED_REACH_PX:
            return self._guided(index, gTb, covariance)
        near = self.relocaliser.match(index, gTb, covariance)
        if near is not None:
            return self._guided(index, near.gTb, near.pose_covariance)
        sun = data.sun.at(int(data.stamps_ns[index]))
        found = acquire(data.image(index), data.camera, data.catalog, gTb, covariance, sun)
        if found is not None:
            return self._guided(index, found.gTb, found.pose_covariance)
        guided = self._guided(index, gTb, covariance)
        # The more craters are searched, and the farther around them, the more rims chance puts near them.
        least: float = ENOUGH_RIMS
        if spread_px <= GUIDED_REACH_PX:
            least = min(max(MIN_AGREEING_RIMS, MIN_FOUND_SHARE * self._expected(gTb)), ENOUGH_RIMS)
        if len(guided.frame.rims) < least:
            return _Guided(FrameMeasurement(guided.frame.stamp_ns, RimSet.empty(), None), gTb)
        return guided

    def _guided(self, index: int, gTb: FloatArray, covariance: FloatArray) -> _Guided:
        """Measure an image near a pose, without the rims that fit another crater as well."""
        data = self.dataset
        stamp = int(data.stamps_ns[index])
        frame = self.front_end.measure(data.image(index), stamp, gTb, covariance, data.sun.at(stamp))
        rims = frame.rims
        found = match_rims(rims.chart, rims.covariance, data.camera.pinhole, data.catalog, gTb, covariance)
        other = (found.craters >= 0) & (found.craters != rims.craters)
        return _Guided(replace(frame, rims=rims.take(~(other | found.ambiguous))), gTb)

    def _expected(self, gTb: FloatArray) -> int:
        """Count the craters of the catalogue that an image from a pose (4, 4) should show."""
        limits = self.front_end.options
        expected, _ = self.dataset.catalog.visible(
            self.dataset.camera, gTb, min_semi_minor_px=limits.min_semi_minor_px, margin_px=limits.margin_px
        )
        return len(expected)

    def _relocalise(
        self, index: int, predicted: FilterState, frame: FrameMeasurement
    ) -> tuple[PoseFix, FrameMeasurement] | None:
        """Identify the craters of an image that the prediction lost; None when not needed or not found."""
        if len(frame.rims) and len(frame.rims) >= MIN_FOUND_SHARE * self._expected(predicted.gTb):
            self._poor_frames = 0
            return None
        self._poor_frames += 1
        # Ground without any known crater is not a lost track: identification is tried at frames 2, 4, 8, ...,
        # and at the first if that is the descent's first.
        if self._poor_frames & (self._poor_frames - 1) or (self._poor_frames == 1 and index > 0):
            return None
        fix = self.relocaliser.locate(index, self._sun_angle_rad(index, predicted))
        # An identified pose that agrees with a good prediction confirms it, and is coarser.
        if fix is None or (self._guides(predicted) and not _contradicts(predicted, fix)):
            return None
        found = self._guided(index, fix.gTb, fix.pose_covariance).frame
        return (fix, found) if len(found.rims) >= max(MIN_AGREEING_RIMS, len(frame.rims) + 1) else None

    def _guides(self, predicted: FilterState) -> bool:
        """Whether the guided front end converges from a predicted pose."""
        data, covariance = self.dataset, predicted.covariance[POSE, POSE]
        spread_px = image_spread_px(data.camera, data.body.radius_m, predicted.gTb, covariance)
        return 3.0 * spread_px <= GUIDED_REACH_PX

    def _sun_angle_rad(self, index: int, predicted: FilterState) -> float | None:
        """Direction towards the sun in an image; None where the predicted attitude does not tell it."""
        data = self.dataset
        if np.linalg.eigvalsh(predicted.covariance[:3, :3])[-1] > _MAX_SUN_SIGMA_RAD**2:
            return None
        sun_g = data.sun.at(int(data.stamps_ns[index]))
        return sun_angle_in_image(
            data.camera.pinhole, data.camera.gTc(predicted.gTb), sun_g, data.body.radius_m
        )

    def _continue_from(
        self, index: int, predicted: FilterState, fix: PoseFix, frame: FrameMeasurement
    ) -> None:
        """Continue from an identified pose, with a new smoother when it contradicts the prediction."""
        self._poor_frames = 0
        if not _contradicts(predicted, fix):
            self._session.update(frame)
            return
        tracked = [k for k, one in enumerate(self._measured) if len(one.rims) >= MIN_AGREEING_RIMS]
        stamps = self.dataset.stamps_ns
        since_s = 1e-9 * float(stamps[index] - stamps[tracked[-1] if tracked else 0])
        variance = np.diag(predicted.covariance)[strapdown.VELOCITY].max()
        slip_m = float(np.linalg.norm(_pose_step(predicted, fix)[3:]))
        slip_m_s = slip_m / since_s if since_s > 0.0 and tracked else 0.0
        sigma_m_s = float(np.hypot(np.sqrt(variance), slip_m_s))
        state = initial_from_fix(frame.stamp_ns, fix, predicted.gV, sigma_m_s)
        if self.dataset.motion is not None:
            before = self.descent.initial
            state = replace(
                state,
                angular_velocity_sigma_rad_s=before.angular_velocity_sigma_rad_s,
                gyro_bias_sigma_rad_s=before.gyro_bias_sigma_rad_s,
                accelerometer_bias_sigma_m_s2=before.accelerometer_bias_sigma_m_s2,
                angular_velocity_rad_s=before.angular_velocity_rad_s,
            )
        descent = replace(self.descent, initial=state)
        if tracked:
            self._segments.append(Segment(index, state))
        else:
            # No earlier frame supports the initial state, and this one contradicts it.
            self._segments = [Segment(0, propagated_back(descent, state, int(stamps[0])))]
            self._measured = [FrameMeasurement(one.stamp_ns, RimSet.empty(), None) for one in self._measured]
        # What rims near a wrong pose have shown of their craters' errors goes with it.
        self._pooled = PooledErrors(self.dataset.camera, self.dataset.catalog)
        self._session = OnlineSession(descent)
        self._session.begin(frame, Start(fix.gTb, fix.pose_covariance, 0))


def _contradicts(predicted: FilterState, fix: PoseFix) -> bool:
    """Whether an identified pose contradicts a predicted one."""
    spread = predicted.covariance[POSE, POSE] + FIX_VARIANCE_INFLATION * fix.pose_covariance
    return bool(squared_distance(_pose_step(predicted, fix), spread) >= CONTRADICTION_CHI2)


def _pose_step(predicted: FilterState, fix: PoseFix) -> FloatArray:
    """Error (6,) of a predicted pose against an identified one: attitude in b, position in g."""
    turn = frames.rotation_log(predicted.gTb[:3, :3].T @ fix.gTb[:3, :3])
    return np.concatenate([turn, fix.gTb[:3, 3] - predicted.gTb[:3, 3]])


def shared_error(sun: SunTilt | None, count: int) -> SunTilt | None:
    """Inflate a sun tilt's noise for tilts that share one error.

    The error comes from the view and the ground's photometry. It is some degrees at an oblique view and stays
    through a descent: treated as white, it would in the end outweigh the rims.

    Parameters
    ----------
    sun : SunTilt or None
    count : int
        Number of tilts that share the error.

    Returns
    -------
    SunTilt or None
        `count` of these have together the weight of the given tilt.
    """
    return None if sun is None else replace(sun, sigma_rad=np.sqrt(count) * sun.sigma_rad)
