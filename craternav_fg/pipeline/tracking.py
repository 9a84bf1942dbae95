"""The front end over a descent: each image measured where those before it predict; lost, and found again."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Start
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.online import OnlineSession
from craternav_fg.estimators.start import find_start
from craternav_fg.matching.acquire.search import acquire, image_spread_px
from craternav_fg.matching.gate import match_rims
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.pipeline.relocalisation import PoseFix, Relocaliser, earlier, initial_at
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.error_model.pooling import PooledErrors
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.kernels import strapdown

FloatArray = npt.NDArray[np.float64]

# So many rims, found without a pose that explains the image, agree by chance only once in very many images.
MIN_AGREEING_RIMS = 3
# The guided front end recovers a prediction that is wrong by so much all over the image.
GUIDED_REACH_PX = 30.0
# Fewer of the expected rims are a sign that the prediction is wrong.
LOST_SHARE = 0.25
# Squared distance, 6 degrees of freedom, from which a prediction is contradicted; the errors of rims found
# blindly have common parts, so their covariance counts as much more.
CONTRADICTION, COMMON = 60.0, 4.0


@dataclass(frozen=True)
class Tracked:
    """What the front end made of a descent.

    Attributes
    ----------
    frames : tuple of FrameMeasurement
    arcs : tuple of (int, InitialState)
        First frame and initial state of each part of the descent: one, unless the images contradicted what
        was predicted of them by those before.
    guides : ndarray, shape (k, 4, 4)
        Poses of the lander near which each image was measured.
    """

    frames: tuple[FrameMeasurement, ...]
    arcs: tuple[tuple[int, InitialState], ...]
    guides: FloatArray


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
        self._measured: list[FrameMeasurement] = []
        self._arcs = [(0, descent.initial)]
        self._poor = 0
        self._guide = descent.initial.gTb

    def run(self, report: Callable[[str, int, int], None]) -> Tracked:
        """Measure the images, first to last."""
        stamps = [int(stamp) for stamp in self.dataset.stamps_ns]
        report("frames", 0, len(stamps))
        guides = []
        for k, stamp in enumerate(stamps):
            predicted = filter_state.prior(self.descent) if k == 0 else self._session.predict(stamp)
            covariance = predicted.covariance[filter_state.POSE, filter_state.POSE]
            frame = self._measure(k, predicted.gTb, covariance)
            guide = self._guide
            found = self._searched(k, predicted, frame)
            if found is not None:
                fix, again = found
                guide = fix.gTb
                frame = self._resumed(k, predicted, fix, self._settled(again, guide))
            elif k == 0:
                frame, guide = self._begin(frame), self._guide
            else:
                frame = replace(frame, sun=repeated(frame.sun, len(stamps) - 1))
                frame = self._settled(frame, guide)
                self._session.update(frame)
            self._measured.append(frame)
            guides.append(guide)
            report("frames", k + 1, len(stamps))
        return Tracked(tuple(self._measured), tuple(self._arcs), np.array(guides))

    def _begin(self, frame: FrameMeasurement) -> FrameMeasurement:
        start = find_start(self.descent, [frame])
        if len(frame.rims):
            # Once more from the start: rims that only it predicts.
            frame = self._measure(0, start.gTb, start.pose_covariance)
            frame = self._settled(frame, self._guide)
            start = find_start(self.descent, [frame])
        self._session.begin(frame, start)
        return frame

    def _settled(self, frame: FrameMeasurement, gTb: FloatArray) -> FrameMeasurement:
        return replace(frame, rims=self._pooled.pool(frame.rims, gTb))

    def _measure(self, number: int, gTb: FloatArray, covariance: FloatArray) -> FrameMeasurement:
        """Measure an image from a predicted pose and its covariance.

        A prediction too poor for the guided front end is first searched for the pose that explains the image;
        what is found there guides, but is no measurement. When nothing is found, few rims can be a chance
        agreement, and the sense of the sun's tilt, which rims tell, is unknown: neither is believed.
        """
        data = self.dataset
        spread_px = image_spread_px(data.camera, data.body.radius_m, gTb, covariance)
        if 3.0 * spread_px <= GUIDED_REACH_PX:
            return self._guided(number, gTb, covariance)
        near = self.relocaliser.match(number, gTb, covariance)
        if near is not None:
            return self._guided(number, near.gTb, near.pose_covariance)
        sun = data.sun.at(int(data.stamps_ns[number]))
        found = acquire(data.image(number), data.camera, data.catalog, gTb, covariance, sun)
        if found is not None:
            return self._guided(number, found.gTb, found.pose_covariance)
        frame = self._guided(number, gTb, covariance)
        if len(frame.rims) < MIN_AGREEING_RIMS:
            return FrameMeasurement(frame.stamp_ns, RimSet.empty(), None)
        return frame

    def _guided(self, number: int, gTb: FloatArray, covariance: FloatArray) -> FrameMeasurement:
        """Measure an image near a pose, without the rims that are another crater's as well."""
        self._guide = gTb
        data = self.dataset
        stamp = int(data.stamps_ns[number])
        frame = self.front_end.measure(data.image(number), stamp, gTb, covariance, data.sun.at(stamp))
        rims = frame.rims
        found = match_rims(rims.chart, rims.covariance, data.camera.pinhole, data.catalog, gTb, covariance)
        other = (found.craters >= 0) & (found.craters != rims.craters)
        return replace(frame, rims=rims.take(~(other | found.ambiguous)))

    def _searched(
        self, number: int, predicted: FilterState, frame: FrameMeasurement
    ) -> tuple[PoseFix, FrameMeasurement] | None:
        """Look for the craters of an image among all when those before it lost them; None for nothing."""
        limits = self.front_end.options
        expected, _ = self.dataset.catalog.visible(
            self.dataset.camera, predicted.gTb, min_semi_minor_px=limits.min_semi_minor_px,
            margin_px=limits.margin_px,
        )  # fmt: skip
        if len(frame.rims) and len(frame.rims) >= LOST_SHARE * len(expected):
            self._poor = 0
            return None
        self._poor += 1
        # Ground without any known crater is no loss: looking for them is done less and less often.
        if self._poor < 2 or self._poor & (self._poor - 1):
            return None
        fix = self.relocaliser.locate(number)
        if fix is None:
            return None
        again = self._guided(number, fix.gTb, fix.pose_covariance)
        return (fix, again) if len(again.rims) >= max(MIN_AGREEING_RIMS, len(frame.rims) + 1) else None

    def _resumed(
        self, number: int, predicted: FilterState, fix: PoseFix, frame: FrameMeasurement
    ) -> FrameMeasurement:
        """Go on from a pose that was found: with another smoother when it contradicts the one there was."""
        self._poor = 0
        last = len(self.dataset.stamps_ns) - 1
        frame = replace(frame, sun=repeated(frame.sun, last))
        step = np.concatenate(
            [
                frames.rotation_log(predicted.gTb[:3, :3].T @ fix.gTb[:3, :3]),
                fix.gTb[:3, 3] - predicted.gTb[:3, 3],
            ]
        )
        spread = predicted.covariance[filter_state.POSE, filter_state.POSE] + COMMON * fix.pose_covariance
        scale = np.sqrt(np.diag(spread))
        whitened = np.linalg.solve(spread / np.outer(scale, scale), step / scale) @ (step / scale)
        if number > 0 and whitened < CONTRADICTION:
            self._session.update(frame)
            return frame
        stamps = self.dataset.stamps_ns
        tracked = [k for k, one in enumerate(self._measured) if len(one.rims) >= MIN_AGREEING_RIMS]
        since_s = 1e-9 * float(stamps[number] - stamps[tracked[-1] if tracked else 0])
        variance = np.diag(predicted.covariance)[strapdown.VELOCITY].max()
        slip_m_s = float(np.linalg.norm(step[3:])) / since_s if since_s > 0.0 and tracked else 0.0
        state = initial_at(frame.stamp_ns, fix, predicted.gV, float(np.hypot(np.sqrt(variance), slip_m_s)))
        begun = replace(self.descent, initial=state)
        if tracked:
            self._arcs.append((number, state))
        else:
            # Nothing bore the initial state out, and the images contradict it.
            self._arcs = [(0, earlier(begun, state, int(stamps[0])))]
            self._measured = [FrameMeasurement(one.stamp_ns, RimSet.empty(), None) for one in self._measured]
        self._session = OnlineSession(begun)
        self._session.begin(frame, Start(fix.gTb, fix.pose_covariance, 0))
        return frame


def repeated(sun: SunTilt | None, times: int) -> SunTilt | None:
    """Enlarge a tilt's noise for so many tilts that share one error.

    The error is that of the view and the ground's photometry, some degrees at an oblique view, and stays
    through a descent: taken as new in each frame, it would in the end outweigh the rims.
    """
    return None if sun is None else replace(sun, sigma_rad=np.sqrt(times) * sun.sigma_rad)
