"""Whether the initial state is as good as it states, by the poses that single frames have of their own.

With standard deviations that are too small the initial state outweighs the rims of the first minutes, and all
estimates are wrong without a sign of it in their covariances.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craternav_fg import frames as rotations
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Descent
from craternav_fg.estimators.filter_state import POSE
from craternav_fg.frames import rotate_position_block
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.tracking import CONTRADICTION_CHI2, FIX_VARIANCE_INFLATION
from craternav_fg.resection.efficient import solve
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from craternav_fg.trajectory import InitialState
from factors.arrays import FloatArray

# Rims that determine a pose and check it, frames that are asked, and those of them that must tell.
_POSE_RIMS, _ASKED, _LEAST_FRAMES = 3, 5, 3


def sigma_factor(descent: Descent, frames: Sequence[FrameMeasurement]) -> float:
    """Compute by how much the standard deviations of the initial pose and velocity are too small.

    Parameters
    ----------
    descent : Descent
    frames : sequence of FrameMeasurement
        With rims whose craters are known.

    Returns
    -------
    float
        1 where the first frames that have a pose of their own do not contradict the initial state, or where
        fewer than three have one.
    """
    enough = (k for k, frame in enumerate(frames) if len(frame.rims.matched_once()) >= _POSE_RIMS)
    asked = list(itertools.islice(enough, _ASKED))
    if len(asked) < _LEAST_FRAMES:
        return 1.0
    states = filter_state.propagated_prior(descent, frames[: asked[-1] + 1])
    distances2: list[float] = []
    for k in asked:
        frame = replace(frames[k], rims=frames[k].rims.matched_once())
        expected = states[k].covariance[POSE, POSE] + _of_attitude(descent, frame.stamp_ns)
        nearest2 = _nearest2(descent, frame, states[k].gTb, expected)
        distances2 += [] if nearest2 is None else [nearest2]
    if len(distances2) < _LEAST_FRAMES or np.median(distances2) < CONTRADICTION_CHI2:
        return 1.0
    return float(np.sqrt(np.median(distances2) / 6.0))


def widened(initial: InitialState, factor: float) -> InitialState:
    """Multiply the standard deviations of pose and velocity.

    Parameters
    ----------
    initial : InitialState
    factor : float

    Returns
    -------
    InitialState
    """
    return replace(
        initial,
        attitude_sigma_rad=factor * initial.attitude_sigma_rad,
        position_sigma_m=factor * initial.position_sigma_m,
        velocity_sigma_m_s=factor * initial.velocity_sigma_m_s,
    )


def _of_attitude(descent: Descent, stamp_ns: int) -> FloatArray:
    """Covariance (6, 6) of what an initial attitude that is off moves the position in the second order.

    A thrust that points elsewhere by an angle is shorter along where it should point by half of its square.
    """
    out = np.zeros((6, 6))
    initial = descent.initial
    if descent.motion is not None or stamp_ns == initial.stamp_ns:
        return out
    dt_s, _, force = descent.imu.between(initial.stamp_ns, stamp_ns)
    path_m = 0.5 * float(dt_s @ np.linalg.norm(force, axis=1)) * float(dt_s.sum())
    out[3:, 3:] = (path_m * initial.attitude_sigma_rad**2) ** 2 * np.eye(3)
    return out


def _nearest2(
    descent: Descent, frame: FrameMeasurement, gTb: FloatArray, expected: FloatArray
) -> float | None:
    """Squared distance of a pose (4, 4) from the nearest one of a frame's rims alone; None without any.

    What the map's craters have in common moves all of these poses, so it is part of the `expected` (6, 6).
    """
    rims = MatchedRims.of(frame.rims, descent.catalog)
    weights = np.zeros(len(descent.catalog))
    weights[frame.rims.craters] = 1.0
    expected = expected + descent.catalog.shift_covariance(gTb[None], weights)[0]
    try:
        found = solve(ResectionProblem(rims, descent.camera.bTc, sun=frame.sun)).poses
    except (EstimationError, *NUMERICAL_ERRORS):
        return None
    of_poses = []
    for pose in found:
        R = pose.gTb[:3, :3]
        turn = rotations.rotation_log(gTb[:3, :3].T @ R)
        step = np.concatenate([turn, pose.gTb[:3, 3] - gTb[:3, 3]])
        own = FIX_VARIANCE_INFLATION * rotate_position_block(pose.covariance, R)
        if np.isfinite(own).all():
            of_poses.append(float(squared_distance(step, expected + own)))
    return min(of_poses, default=None)
