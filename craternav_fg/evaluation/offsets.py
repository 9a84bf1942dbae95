"""Offsets of a trajectory from a-priori states, and of each frame from its prediction by the others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.start import find_start
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray

# Index of a frame; offset, sigmas and turn (3,) of its prediction.
_Left = tuple[int, FloatArray, FloatArray, FloatArray]

# Prior of a frame whose pose is estimated alone: so wide that its rims decide.
_WIDE_ATTITUDE_RAD, _WIDE_POSITION_M = 0.1, 2e4
# Fewer rims do not locate a frame by themselves.
_MIN_RIMS = 6


@dataclass(frozen=True)
class Offsets:
    """Differences of positions, east, north and up of the reference.

    Attributes
    ----------
    frames : ndarray of int, shape (k,)
        Indices of the frames.
    enu_m : ndarray, shape (k, 3)
        Difference of the positions, m, along east, north and up in g at the reference's position.
    sigma_m : ndarray, shape (k, 3)
        Standard deviations that are stated, m, along the same directions in g.
    attitude_rad : ndarray, shape (k, 3)
        Rotation vector in b from the reference's attitude.
    """

    frames: npt.NDArray[np.int64]
    enu_m: FloatArray
    sigma_m: FloatArray
    attitude_rad: FloatArray

    @property
    def scatter_m(self) -> FloatArray:
        """Standard deviations (3,) about the mean, m, along east, north, up in g."""
        return np.asarray(np.std(self.enu_m, axis=0, ddof=1))


def offsets(trajectory: Trajectory, reference: Trajectory) -> Offsets:
    """Compare a trajectory with another at the same stamps.

    Parameters
    ----------
    trajectory : Trajectory
        Its covariances give the sigmas.
    reference : Trajectory

    Returns
    -------
    Offsets

    Raises
    ------
    EstimationError
        When the stamps differ, or the trajectory has no covariances.
    """
    if not np.array_equal(trajectory.stamps_ns, reference.stamps_ns):
        raise EstimationError("expected two trajectories at the same stamps")
    if trajectory.pose_covariance is None:
        raise EstimationError("expected a trajectory with covariances")
    enu = frames.east_north_up(*frames.latitude_longitude(reference.gP))
    of_position = np.swapaxes(enu, 1, 2) @ trajectory.pose_covariance[:, 3:, 3:] @ enu
    return Offsets(
        np.arange(len(trajectory)),
        np.einsum("kij,ki->kj", enu, trajectory.gP - reference.gP),
        np.sqrt(np.diagonal(of_position, axis1=1, axis2=2)),
        frames.rotation_log(np.swapaxes(reference.gRb, 1, 2) @ trajectory.gRb),
    )


def leave_one_out(problems: Sequence[Problem], estimator: Estimator, stamps_ns: IntArray) -> Offsets:
    """Predict each frame from the others of its segment, and compare with where its own rims alone put it.

    Parameters
    ----------
    problems : sequence of Problem
        One for each segment of a descent, see `Reconstruction.problems`.
    estimator : Estimator
        That predicts.
    stamps_ns : ndarray of int, shape (n,)
        Stamps of the frames whose indices are returned. Problems have further ones where only sensors
        measured.

    Returns
    -------
    Offsets
        Prediction less the frame's own position, with the sigmas of both together. Frames with few rims are
        left out, and frames without another that shows rims in their segment.

    Raises
    ------
    EstimationError
        When no frame has enough rims, or a prediction has no covariance.
    """
    index_of = {int(stamp): k for k, stamp in enumerate(stamps_ns)}
    found: list[_Left] = []
    for problem in problems:
        with_rims = sum(len(frame.rims) > 0 for frame in problem.frames)
        for k, frame in enumerate(problem.frames):
            if len(frame.rims) >= _MIN_RIMS and with_rims > 1 and frame.stamp_ns in index_of:
                found.append((index_of[frame.stamp_ns], *_left_out(problem, estimator, k)))
    if not found:
        raise EstimationError(
            f"no frame has {_MIN_RIMS} rims, with which its own pose is compared, and another frame beside it"
        )
    columns = [np.array([one[i] for one in found]) for i in range(4)]
    return Offsets(columns[0].astype(np.int64), columns[1], columns[2], columns[3])


def _left_out(problem: Problem, estimator: Estimator, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offset (3,) of a frame's prediction by the others from its own pose, its sigmas, and the turn."""
    frame, others = problem.frames[k], list(problem.frames)
    others[k] = FrameMeasurement(frame.stamp_ns, RimSet.empty(), None)
    predicted = estimator.estimate(_without(problem, others))
    if predicted.pose_covariance is None:
        raise EstimationError(f"{estimator.name}: expected a trajectory with covariances")
    gTb, covariance = predicted.gTb[k], predicted.pose_covariance[k]
    own = _alone(problem, frame, gTb)
    enu = frames.east_north_up(*frames.latitude_longitude(own[0][None, :3, 3]))[0]
    both = enu.T @ (covariance + own[1])[3:, 3:] @ enu
    return (
        enu.T @ (gTb[:3, 3] - own[0][:3, 3]),
        np.sqrt(np.diag(both)),
        frames.rotation_log(own[0][:3, :3].T @ gTb[:3, :3]),
    )


def _without(problem: Problem, others: Sequence[FrameMeasurement]) -> Problem:
    """Return a problem with other frames, and the start that follows from them."""
    return replace(problem, frames=others, start=find_start(problem, others))


def _alone(problem: Problem, frame: FrameMeasurement, gTb: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pose (4, 4) and covariance (6, 6) of a frame from its own rims."""
    initial = replace(
        problem.initial,
        stamp_ns=frame.stamp_ns,
        gTb=gTb,
        attitude_sigma_rad=_WIDE_ATTITUDE_RAD,
        position_sigma_m=_WIDE_POSITION_M,
    )
    start = find_start(replace(problem, initial=initial), [frame], GraphOptions(variance_inflation=1.0))
    return start.gTb, start.pose_covariance
