"""Where the lander is when nothing predicts it: rims found blindly, identified, and a static pose of them.

From two such poses and the IMU between them follows the velocity, and so an initial state for a data set
that has none. Its standard deviations are made so much larger than the poses' that it is hardly a
measurement: the estimators measure the same images themselves.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset import Dataset, layout
from craternav_fg.ellipse import normalised_chart
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.frames import rotate_position_block
from craternav_fg.matching.gate import match_rims
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex, load_or_build
from craternav_fg.measurements import RimSet
from craternav_fg.resection.problem import MatchedRims, ResectionProblem, Status
from craternav_fg.resection.robust import solve_robustly
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.detect import FoundRims, find_rims
from craternav_fg.vision.grey import on_8_bit_scale, undistorted

FloatArray = npt.NDArray[np.float64]

# The initial state's standard deviations over those of the poses that it was made of.
_WIDER = 10.0
# Of what the poses do not tell: far above a navigation-grade IMU's, no more than a tactical one's (10 deg/h,
# 1 mg); the angular velocity is the gyro's.
_GYRO_BIAS_RAD_S = 4.8e-5
_ACCELEROMETER_BIAS_M_S2 = 1e-2
_ANGULAR_VELOCITY_RAD_S = 0.01
_ITERATIONS = 8
# Fewer matched rims may agree by chance.
_LEAST_RIMS = 3


@dataclass(frozen=True)
class PoseFix:
    """A pose found without a prediction, or with a poor one.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
    pose_covariance : ndarray, shape (6, 6)
        Attitude (rotation vector in b, rad), position in g, m.
    rims : int
        Matched rims that it rests on.
    """

    gTb: FloatArray
    pose_covariance: FloatArray
    rims: int


def index_path(catalog: Path) -> Path:
    """Where a catalogue's index is kept, if not elsewhere: beside it."""
    return catalog.with_name(f"{catalog.name}.index.npz")


class Relocaliser:
    """Finds poses in the images of a data set; its catalogue is indexed when that is first needed.

    The index of a large catalogue, `craters.parquet`, takes long: it is kept beside it.

    Parameters
    ----------
    dataset : Dataset

    Attributes
    ----------
    index_said : str
        Why an index was built although one could be stored, and what became of it; empty otherwise.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self.index_said = ""
        self._found: tuple[int, FoundRims] | None = None

    def prepare(self) -> None:
        """Index the catalogue now, which may take half a minute, if images are to be looked at."""
        if self._dataset.measurements is None:
            _ = self._index

    @cached_property
    def _index(self) -> TripleIndex:
        large = self._dataset.path / layout.LARGE_CRATERS
        if large.is_file():
            index, self.index_said = load_or_build(index_path(large), self._dataset.catalog)
            return index
        return TripleIndex.build(self._dataset.catalog)

    def locate(self, number: int) -> PoseFix | None:
        """Give the pose of a frame from its image, or from its rims when they are measured; None for none."""
        data = self._dataset
        if data.measurements is not None:
            return self._static(data.measurements[number].rims)
        found = self._rims(number)
        answer = identify(found.ellipses_px, data.camera.pinhole, self._index)
        if not answer.identified:
            return None
        charts, covariances = self._normalised(found)
        matched = np.flatnonzero(answer.rows >= 0)
        fix = self._static(RimSet(answer.rows[matched], charts[matched], covariances[matched]))
        if fix is not None:
            return fix
        return PoseFix(answer.gTb, rotate_position_block(answer.covariance, answer.gTb[:3, :3]), len(matched))

    def match(self, number: int, gTb: FloatArray, pose_covariance: FloatArray) -> PoseFix | None:
        """Give the pose of a frame from its image and a poor prediction; None when too few rims agree."""
        data = self._dataset
        charts, covariances = self._normalised(self._rims(number))
        answer = match_rims(charts, covariances, data.camera.pinhole, data.catalog, gTb, pose_covariance)
        count = int(np.count_nonzero(answer.craters >= 0))
        return PoseFix(answer.gTb, answer.pose_covariance, count) if count >= _LEAST_RIMS else None

    def _static(self, rims: RimSet) -> PoseFix | None:
        if len(rims) < _LEAST_RIMS:
            return None
        data = self._dataset
        result = solve_robustly(ResectionProblem(MatchedRims.of(rims, data.catalog), data.camera.bTc))
        if result.status is not Status.SOLVED:
            return None
        pose = result.poses[0]
        return PoseFix(
            pose.gTb, rotate_position_block(pose.covariance, pose.gTb[:3, :3]), len(rims) - len(result.wrong)
        )

    def _rims(self, number: int) -> FoundRims:
        if self._found is None or self._found[0] != number:
            camera = self._dataset.camera
            # Rims found here only guide: an interpolated image will do, and all that follows is a pinhole's.
            image = undistorted(on_8_bit_scale(self._dataset.image(number), camera), camera)
            self._found = number, find_rims(image)
        return self._found[1]

    def _normalised(self, found: FoundRims) -> tuple[FloatArray, FloatArray]:
        charts, scale = normalised_chart(found.charts_px, self._dataset.camera.pinhole)
        return charts, found.covariance_px * np.outer(scale, scale)


def find_initial(dataset: Dataset, relocaliser: Relocaliser, report: Callable[[int], None]) -> InitialState:
    """Find an initial state of a data set that has none.

    Parameters
    ----------
    dataset : Dataset
    relocaliser : Relocaliser
    report : callable
        Called with the number of frames that were looked at.

    Returns
    -------
    InitialState
        At the first frame's stamp, from the first two frames whose place was found.

    Raises
    ------
    EstimationError
        When there are no two such frames.
    """
    stamps = [int(stamp) for stamp in dataset.stamps_ns]
    seen: list[tuple[int, PoseFix]] = []
    for number, stamp in enumerate(stamps):
        fix = relocaliser.locate(number)
        report(number + 1)
        if fix is not None:
            seen.append((stamp, fix))
        if len(seen) == 2:
            break
    if len(seen) < 2:
        raise EstimationError(
            f"dataset.toml has no initial state, and of {len(stamps)} frames the craters of {len(seen)} were "
            "identified, expected two"
        )
    (first_ns, first), (second_ns, second) = seen
    interval_s = 1e-9 * (second_ns - first_ns)
    spread_m2 = first.pose_covariance[3:, 3:] + second.pose_covariance[3:, 3:]
    velocity_m_s = float(np.sqrt(np.trace(spread_m2) / 3.0)) / interval_s
    state = initial_at(first_ns, first, np.zeros(3), velocity_m_s)
    descent = Descent.of(dataset, state)
    gV = np.zeros(3)
    for _ in range(_ITERATIONS):
        ahead = filter_state.propagate(_moving(descent, first.gTb, gV), descent, first_ns, second_ns)
        gV = gV + (second.gTb[:3, 3] - ahead.gTb[:3, 3]) / interval_s
    if first_ns == stamps[0]:
        return replace(state, gV=gV)
    return earlier(descent, replace(state, gV=gV), stamps[0])


def initial_at(stamp_ns: int, fix: PoseFix, gV: FloatArray, velocity_sigma_m_s: float) -> InitialState:
    """Make an initial state of a pose and a velocity, wide enough to be hardly a measurement."""
    attitude_rad2, position_m2 = np.split(np.diag(fix.pose_covariance), 2)
    return InitialState(
        stamp_ns=stamp_ns,
        gTb=fix.gTb,
        gV=gV,
        attitude_sigma_rad=_WIDER * float(np.sqrt(attitude_rad2.max())),
        position_sigma_m=_WIDER * float(np.sqrt(position_m2.max())),
        velocity_sigma_m_s=_WIDER * velocity_sigma_m_s,
        angular_velocity_sigma_rad_s=_ANGULAR_VELOCITY_RAD_S,
        gyro_bias_sigma_rad_s=_GYRO_BIAS_RAD_S,
        accelerometer_bias_sigma_m_s2=_ACCELEROMETER_BIAS_M_S2,
    )


def _moving(descent: Descent, gTb: FloatArray, gV: FloatArray) -> FilterState:
    return replace(filter_state.prior(descent), gTb=gTb, gV=gV)


def earlier(descent: Descent, state: InitialState, stamp_ns: int) -> InitialState:
    """State at an earlier stamp from which the IMU leads to a given one."""
    interval_s = 1e-9 * (state.stamp_ns - stamp_ns)
    gTb, gV = state.gTb.copy(), state.gV
    gTb[:3, 3] -= interval_s * gV
    for _ in range(_ITERATIONS):
        ahead = filter_state.propagate(_moving(descent, gTb, gV), descent, stamp_ns, state.stamp_ns)
        step_m_s = state.gV - ahead.gV
        gTb = gTb.copy()
        gTb[:3, :3] = state.gTb[:3, :3] @ ahead.gTb[:3, :3].T @ gTb[:3, :3]
        gTb[:3, 3] += state.gTb[:3, 3] - ahead.gTb[:3, 3] - interval_s * step_m_s
        gV = gV + step_m_s
    return replace(
        state,
        stamp_ns=stamp_ns,
        gTb=gTb,
        gV=gV,
        position_sigma_m=float(np.hypot(state.position_sigma_m, interval_s * state.velocity_sigma_m_s)),
    )
