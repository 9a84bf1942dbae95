"""The front end over a descent: each image measured near a predicted pose, with relocalisation when lost."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Start
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.sensor_bank import SensorBank
from craternav_fg.estimators.start import find_start
from craternav_fg.linalg import squared_distance
from craternav_fg.matching.acquire.search import acquire, craters_in_reach, image_spread_px
from craternav_fg.matching.gate import match_rims
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.pipeline.images_ahead import ImagesAhead
from craternav_fg.pipeline.initial_state import initial_from_fix, propagated_back
from craternav_fg.pipeline.relocalisation import PoseFix, Relocaliser
from craternav_fg.sun_in_image import sun_angle_in_image
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.error_model.pooling import PooledErrors
from craternav_fg.vision.error_model.steady_roots import with_steady_roots
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.arrays import FloatArray, IntArray
from factors.kernels import strapdown

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
# Later frames that must agree with a track from identified craters before it replaces one that frames had
# supported: the first of them determines the velocity, the second tests it.
CONFIRMING_FRAMES = 2
# The new one's velocity is so uncertain that it follows the right images, too: the former track needs no more
# rims in them, only far more than by chance.
RESUMING_SHARE = 0.5


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
    disbelieved : mapping of int to FrameMeasurement
        Measurements that were left out, by frame: they contradict the IMU, and no later frame confirms them.
    """

    frames: tuple[FrameMeasurement, ...]
    segments: tuple[Segment, ...]
    guides: FloatArray
    disbelieved: Mapping[int, FrameMeasurement]


class _Guided(NamedTuple):
    """Measurements of an image, and the pose (4, 4) of the body near which they were searched."""

    frame: FrameMeasurement
    gTb: FloatArray


@dataclass
class _Track:
    """One account of where the lander has been: its smoother, and what was measured near its predictions."""

    session: OnlineSession
    pooled: PooledErrors
    segments: list[Segment]
    measured: list[_Guided]
    # Frames that agreed since its last segment began, and the identified pose that it began from.
    agreeing: int = 0
    fix: PoseFix | None = None

    @property
    def supported(self) -> list[int]:
        """Frames with enough rims to support the track."""
        return [k for k, one in enumerate(self.measured) if len(one.frame.rims) >= MIN_AGREEING_RIMS]


class Tracker:
    """Measures all images of a data set, each with the pose that the online smoother predicts.

    Parameters
    ----------
    dataset : Dataset
    descent : Descent
    front_end : GuidedFrontEnd
    relocaliser : Relocaliser
    repeated : collection of int
        Frames whose images are copies of earlier ones: no rims are measured in them.
    """

    def __init__(
        self,
        dataset: Dataset,
        descent: Descent,
        front_end: GuidedFrontEnd,
        relocaliser: Relocaliser,
        repeated: Collection[int] = (),
    ) -> None:
        self.dataset = dataset
        self.descent = descent
        self.front_end = front_end
        self.relocaliser = relocaliser
        self.repeated = repeated
        self._images = ImagesAhead(dataset)
        self._bank = SensorBank(descent.sensors)
        pooled = PooledErrors(dataset.camera, dataset.catalog)
        self._track = _Track(OnlineSession(descent), pooled, [Segment(0, descent.initial)], [])
        # The track that identified craters contradicted, until later frames decide.
        self._former: _Track | None = None
        self._disbelieved: dict[int, FrameMeasurement] = {}
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
        total = len(self.dataset.stamps_ns)
        report("frames", 0, total)
        for index in range(total):
            self._next(index, self._predicted_of(self._track, index))
            report("frames", index + 1, total)
        # An initial state that no frame supports counts less than identified craters.
        if self._former is not None and self._former.supported:
            self._resume(self._former)
        track = self._track
        measured, guides = zip(*track.measured, strict=True)
        data, options = self.dataset, self.front_end.options.correlated_errors
        frames = with_steady_roots(measured, np.array(guides), data.camera, data.catalog, options)
        return Tracked(frames, tuple(track.segments), np.array(guides), self._disbelieved)

    def _predicted_of(self, track: _Track, index: int) -> FilterState:
        """Predict a track's state at an image, after what sensors measured since the last one."""
        if index == 0:
            return filter_state.prior(self.descent)
        session, stamp_ns = track.session, int(self.dataset.stamps_ns[index])
        for sample_ns in self._bank.between(session.stamp_ns, stamp_ns):
            session.update(FrameMeasurement(sample_ns, RimSet.empty(), None))
        return session.predict(stamp_ns)

    def _next(self, index: int, predicted: FilterState) -> None:
        """Measure an image and update the smoother with it."""
        track, former = self._track, self._former
        if index in self.repeated:
            self._take(track, index, self._nothing(index, predicted.gTb))
            if former is not None:
                self._take(former, index, self._nothing(index, self._predicted_of(former, index).gTb))
            return
        guided = self._measure(index, predicted.gTb, predicted.covariance[POSE, POSE])
        if former is not None and self._resumed(former, index, len(guided.frame.rims)):
            return
        relocalised = self._relocalise(index, predicted, guided.frame)
        if relocalised is not None:
            fix, frame = relocalised
            self._poor_frames = 0
            guided = _Guided(frame, fix.gTb)
            if _contradicts(predicted, fix):
                self._begin_from(index, predicted, fix, frame)
                return
        self._take(track, index, guided)
        if former is not None and self._agrees(guided):
            track.agreeing += 1
            if track.agreeing == CONFIRMING_FRAMES:
                self._leave(former)

    def _take(self, track: _Track, index: int, guided: _Guided) -> None:
        """Update the smoother of a track with an image's measurements."""
        if index == 0:
            guided = self._begin(track, guided)
        else:
            guided = guided._replace(frame=self._shared_sun(_pool(track, guided)))
            track.session.update(guided.frame)
        track.measured.append(guided)

    def _begin(self, track: _Track, guided: _Guided) -> _Guided:
        """Find the start from the first image and begin the smoother."""
        start = find_start(self.descent, [guided.frame])
        if len(guided.frame.rims):
            # Measure again from the start: it predicts more rims than the prior does.
            guided = self._measure(0, start.gTb, start.pose_covariance)
            guided = guided._replace(frame=_pool(track, guided))
            start = find_start(self.descent, [guided.frame])
        track.session.begin(guided.frame, start)
        return guided

    def _resumed(self, former: _Track, index: int, rims: int) -> bool:
        """Whether an image agrees with the former track, though it may show `rims` near the present one."""
        predicted = self._predicted_of(former, index)
        guided = self._measure(index, predicted.gTb, predicted.covariance[POSE, POSE])
        agrees = len(guided.frame.rims) >= RESUMING_SHARE * rims and self._agrees(guided)
        self._take(former, index, guided if agrees else self._nothing(index, predicted.gTb))
        if agrees:
            self._resume(former)
        return agrees

    def _resume(self, former: _Track) -> None:
        """Continue the former track: what contradicted it was wrong."""
        self._disbelieve(former)
        self._track, self._former, self._poor_frames = former, None, 0

    def _leave(self, former: _Track) -> None:
        """Give up the former track, which later frames do not confirm.

        If it rests on one frame with few rims, which chance explains, that is left out, too.
        """
        self._former = None
        track, supported = self._track, former.supported
        rims = [len(former.measured[k].frame.rims) for k in supported]
        if len(former.segments) > 1 or len(rims) != 1 or rims[0] >= ENOUGH_RIMS or track.fix is None:
            return
        began = track.segments[-1]
        stamps = self.dataset.stamps_ns
        self._disbelieved[supported[0]] = former.measured[supported[0]].frame
        track.measured[: began.first] = [
            self._nothing(k, one.gTb) for k, one in enumerate(track.measured[: began.first])
        ]
        prior = filter_state.propagate(
            filter_state.prior(self.descent), self.descent, int(stamps[0]), int(stamps[began.first])
        )
        initial = self.descent.initial
        if _contradicts(prior, track.fix):
            initial = propagated_back(
                replace(self.descent, initial=began.initial), began.initial, int(stamps[0])
            )
        track.segments = [Segment(0, initial)]

    def _disbelieve(self, former: _Track) -> None:
        """Note the frames whose rims only the present track holds."""
        both = zip(self._track.measured, former.measured, strict=False)
        self._disbelieved |= {
            k: now.frame
            for k, (now, then) in enumerate(both)
            if len(now.frame.rims) and not len(then.frame.rims)
        }

    def _agrees(self, guided: _Guided) -> bool:
        """Whether an image shows the craters that are expected, and not by chance."""
        least = max(MIN_AGREEING_RIMS, MIN_FOUND_SHARE * self._expected(guided.gTb))
        return len(guided.frame.rims) >= least

    def _nothing(self, index: int, gTb: FloatArray) -> _Guided:
        """Image in which nothing was measured near a pose."""
        return _Guided(FrameMeasurement(int(self.dataset.stamps_ns[index]), RimSet.empty(), None), gTb)

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
        found = acquire(self._images.image(index), data.camera, data.catalog, gTb, covariance, sun)
        if found is not None:
            return self._guided(index, found.gTb, found.pose_covariance)
        guided = self._guided(index, gTb, covariance)
        # The more craters are searched, and the farther around them, the more rims chance puts near them.
        least: float = ENOUGH_RIMS
        if spread_px <= GUIDED_REACH_PX:
            least = min(max(MIN_AGREEING_RIMS, MIN_FOUND_SHARE * self._expected(gTb)), ENOUGH_RIMS)
        if len(guided.frame.rims) < least:
            return self._nothing(index, gTb)
        return guided

    def _guided(self, index: int, gTb: FloatArray, covariance: FloatArray) -> _Guided:
        """Measure an image near a pose, without the rims that fit another crater as well."""
        data = self.dataset
        stamp = int(data.stamps_ns[index])
        frame = self.front_end.measure(self._images.image(index), stamp, gTb, covariance, data.sun.at(stamp))
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
        among = None
        # Ground without any known crater is not a lost track: identification is tried at frames 2, 4, 8, ...,
        # and at the first if that is the descent's first.
        if self._poor_frames & (self._poor_frames - 1) or (self._poor_frames == 1 and index > 0):
            if self._guides(predicted):
                return None
            # Nothing else leads to rims, and a descent may show enough of them in a few images only. The map
            # near the prediction is searched in seconds, a large one in minutes.
            among = self._in_reach(index, predicted)
        fix = self.relocaliser.locate(index, self._sun_angle_rad(index, predicted), among)
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

    def _in_reach(self, index: int, predicted: FilterState) -> IntArray:
        """Rows of the craters that an image may show, by the prediction."""
        data, covariance = self.dataset, predicted.covariance[POSE, POSE]
        sun_g = data.sun.at(int(data.stamps_ns[index]))
        return craters_in_reach(data.camera, data.catalog, predicted.gTb, covariance, sun_g)

    def _sun_angle_rad(self, index: int, predicted: FilterState) -> float | None:
        """Direction towards the sun in an image; None where the predicted attitude does not tell it."""
        data = self.dataset
        if np.linalg.eigvalsh(predicted.covariance[:3, :3])[-1] > _MAX_SUN_SIGMA_RAD**2:
            return None
        sun_g = data.sun.at(int(data.stamps_ns[index]))
        return sun_angle_in_image(
            data.camera.pinhole, data.camera.gTc(predicted.gTb), sun_g, data.body.radius_m
        )

    def _begin_from(self, index: int, predicted: FilterState, fix: PoseFix, frame: FrameMeasurement) -> None:
        """Begin a track from an identified pose that contradicts the prediction, beside the former one.

        One image may be wrong: stale, or of another frame. The former track goes on without it until later
        frames agree with one of the two.
        """
        if self._former is None:
            former = self._track
            self._take(former, index, self._nothing(index, predicted.gTb))
        else:
            former, predicted = self._former, self._former.session.state
            self._disbelieve(former)
        supported, stamps = former.supported, self.dataset.stamps_ns
        since_s = 1e-9 * float(stamps[index] - stamps[supported[-1] if supported else 0])
        variance = np.diag(predicted.covariance)[strapdown.VELOCITY].max()
        slip_m = float(np.linalg.norm(_pose_step(predicted, fix)[3:]))
        slip_m_s = slip_m / since_s if since_s > 0.0 and supported else 0.0
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
        segments, earlier = [*former.segments, Segment(index, state)], former.measured[:index]
        if not supported:
            # No earlier frame supports the initial state, and this one contradicts it.
            segments = [Segment(0, propagated_back(descent, state, int(stamps[0])))]
            earlier = [self._nothing(k, one.gTb) for k, one in enumerate(earlier)]
        # What rims near a wrong pose have shown of their craters' errors goes with it.
        pooled = PooledErrors(self.dataset.camera, self.dataset.catalog)
        track = _Track(OnlineSession(descent), pooled, segments, earlier, fix=fix)
        frame = _pool(track, _Guided(frame, fix.gTb))
        if index > 0:
            frame = self._shared_sun(frame)
        track.session.begin(frame, Start(fix.gTb, fix.pose_covariance, 0))
        track.measured.append(_Guided(frame, fix.gTb))
        self._track = track
        self._former = former if supported or self._guides(predicted) else None


def _pool(track: _Track, guided: _Guided) -> FrameMeasurement:
    """Pool the covariances of a frame's rims with those of a track's earlier frames."""
    return replace(guided.frame, rims=track.pooled.pool(guided.frame.rims, guided.gTb))


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
