"""A start and first states that are robust against many wrong matches.

Two rims of an image determine the pose with four redundant measurements, so two wrong matches hardly ever
agree with each other and the prior. Pairs of the first frames are tried. Each pair that agrees gives a start;
a filter that uses, in every image, the rims that agree with one another tracks it through those frames. The
start that explains most of all rims wins: the consensus of minimal sets of Fischler and Bolles (1981), with
the truncated cost of Torr and Zisserman (2000).
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.correlated_errors import VARIANCE_INFLATION
from craternav_fg.estimators.ekf.fusion import fuse_updates
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.graph import GraphOptions
from craternav_fg.estimators.linearisation import LinearMeasurement, linearise_rims, linearise_sun
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.start import find_start
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import FrameMeasurement, RimSet
from factors.arrays import BoolArray, FloatArray

# Number of first frames with rims from which pairs are taken, and over which a start is judged.
WINDOW_FRAMES = 5
# Pairs are tried until the probability that none of them had right matches only is below this.
MISS_PROBABILITY = 1e-6
MAX_PAIRS = 100


@dataclass(frozen=True)
class Track:
    """States at the frames from the start on, by a filter that selects its rims.

    Attributes
    ----------
    start : Start
        Its first frame and the pose there.
    states : list of FilterState
        At the start's frame and those after it.
    kept : list of ndarray of bool, shape (n,)
        For each of these frames, the rims that were used.
    cost : float
        Squared distance of the start from the prior and of every rim from its prediction, truncated for a rim
        that is not used.
    """

    start: Start
    states: list[FilterState]
    kept: list[BoolArray]
    cost: float


def robust_track(problem: Problem, limit2: float, options: GraphOptions = GraphOptions()) -> Track:
    """Track a descent some of whose matches are wrong.

    Parameters
    ----------
    problem : Problem
        Its start is used only when no two rims of the first frames agree.
    limit2 : float
        Squared whitened norm, 5 degrees of freedom, beyond which a rim does not agree.
    options : GraphOptions
        Options of the start.

    Returns
    -------
    Track
    """
    seen = [k for k, frame in enumerate(problem.frames) if len(frame.rims)]
    if not seen:
        return _track(problem, problem.start, problem.frames, limit2)
    window = seen[:WINDOW_FRAMES]
    early = problem.frames[: window[-1] + 1]
    total = sum(len(frame.rims) for frame in early)
    best: Track | None = None
    best_cost = np.inf
    for tried, (k, pair) in enumerate(_minimal_sets(problem.frames, window), start=1):
        start = _start(problem, k, pair, limit2, options)
        if start is not None:
            track = _track(problem, start, early, limit2)
            # Rims of earlier frames count as unexplained.
            cost = track.cost + limit2 * sum(len(frame.rims) for frame in problem.frames[:k])
            if cost < best_cost:
                best, best_cost = track, cost
        share = 0.0 if best is None else sum(int(kept.sum()) for kept in best.kept) / total
        if tried >= MAX_PAIRS or (1.0 - share**2) ** tried < MISS_PROBABILITY:
            break
    return _track(problem, problem.start if best is None else best.start, problem.frames, limit2)


def _minimal_sets(
    frames: Sequence[FrameMeasurement], window: Sequence[int]
) -> Iterator[tuple[int, npt.NDArray[np.int64]]]:
    """Pairs of a frame's index and two of its rims; every rim twice before any comes a third time."""
    most = max(len(frames[k].rims) for k in window)
    for apart in range(1, most // 2 + 1):
        for k in window:
            n = len(frames[k].rims)
            for i in range(n if 2 * apart < n else n // 2 if 2 * apart == n else 0):
                yield k, np.array([i, (i + apart) % n])


def _start(
    problem: Problem, index: int, pair: npt.NDArray[np.int64], limit2: float, options: GraphOptions
) -> Start | None:
    """Start from two rims of a frame and those that agree with them; None when the two do not agree."""
    frame = problem.frames[index]
    before = [replace(f, rims=RimSet.empty()) for f in problem.frames[:index]]

    def start(rows: npt.NDArray[np.int64] | BoolArray) -> Start:
        return find_start(problem, [*before, replace(frame, rims=frame.rims.take(rows))], options)

    found = start(pair)
    A, residual, usable = _linearised(problem, frame, found.gTb)
    own = usable & (np.sum(residual**2, axis=1) <= limit2)
    if not own[pair].all():
        return None
    kept, _ = agreeing(A, residual, usable, found.pose_covariance, limit2)
    kept[pair] = True
    return start(kept) if kept.sum() > len(pair) else found


def _track(problem: Problem, start: Start, frames: Sequence[FrameMeasurement], limit2: float) -> Track:
    """Track a start through frames."""
    first = start.frame
    states = filter_state.states_to_start(replace(problem, start=start))
    prior = filter_state.propagated_prior(problem, frames[: first + 1])[-1]
    off = states[-1].minus(prior)[POSE]
    cost = float(squared_distance(off, prior.covariance[POSE, POSE]))
    _, residual, usable = _linearised(problem, frames[first], start.gTb)
    squared = np.where(usable, np.sum(residual**2, axis=1), np.inf)
    cost += float(np.minimum(squared, limit2).sum())
    kept = [squared <= limit2]
    states = states[-1:]
    for last, frame in itertools.pairwise(frames[first:]):
        state = filter_state.propagate(states[-1], problem, last.stamp_ns, frame.stamp_ns)
        A, residual, usable = _linearised(problem, frame, state.gTb)
        mask, more = agreeing(A, residual, usable, state.covariance[POSE, POSE], limit2)
        cost += more
        kept.append(mask)
        updates = [LinearMeasurement(A[i], residual[i]) for i in np.flatnonzero(mask)]
        sun = linearise_sun(state.gTb, frame.sun, problem.camera)
        if sun is not None:
            updates.append(sun)
        if updates:
            state = state.corrected(*fuse_updates(state.covariance, updates, "exact"))
        states.append(state)
    return Track(start, states, kept, cost)


def _linearised(
    descent: Descent, frame: FrameMeasurement, gTb: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Linearise a frame's rims at a pose, with time-correlated errors treated as white."""
    camera, catalog = descent.camera, descent.catalog
    rims = with_predicted_covariances(frame, gTb, camera, catalog).rims.inflate_correlated(VARIANCE_INFLATION)
    return linearise_rims(gTb, rims, camera, catalog, model="chart", noise="measured")


def agreeing(
    A: FloatArray, residual: FloatArray, usable: BoolArray, covariance: FloatArray, limit2: float
) -> tuple[BoolArray, float]:
    """Select the rims of a frame that agree with a predicted pose and with one another.

    Each rim that agrees with the prediction corrects it in turn. The corrected pose with the smallest
    truncated cost decides which rims agree.

    Parameters
    ----------
    A : ndarray, shape (n, m, 6)
        Whitened derivatives in the pose's error.
    residual : ndarray, shape (n, m)
        Whitened, measured minus predicted.
    usable : ndarray of bool, shape (n,)
        The others agree with nothing.
    covariance : ndarray, shape (6, 6)
        Covariance of the predicted pose.
    limit2 : float
        Squared norm beyond which a rim does not agree.

    Returns
    -------
    kept : ndarray of bool, shape (n,)
    cost : float
        Sum of squared norms, each truncated at the limit.
    """
    n, m = residual.shape
    predicted = A @ covariance @ np.swapaxes(A, 1, 2) + np.eye(m)
    solved = np.linalg.solve(predicted, np.concatenate([residual[:, :, None], A], axis=2))
    alone = np.where(usable, np.sum(residual * solved[:, :, 0], axis=1), np.inf)
    kept = np.zeros(n, dtype=np.bool_)
    cost = n * limit2
    for i in np.flatnonzero(alone <= limit2):
        # The pose corrected by rim i, and the residuals of all rims there.
        to_i = covariance @ A[i].T
        off = residual - A @ (to_i @ solved[i, :, 0])
        left = covariance - to_i @ solved[i, :, 1:] @ covariance
        spread = A @ left @ np.swapaxes(A, 1, 2) + np.eye(m)
        squared = np.where(usable, squared_distance(off, spread), np.inf)
        squared[i] = alone[i]
        total = float(np.minimum(squared, limit2).sum())
        if total < cost:
            kept, cost = squared <= limit2, total
    return kept, cost
