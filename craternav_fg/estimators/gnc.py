"""The batch smoother for many wrong matches: graduated non-convexity with truncated least squares.

Yang, Antonante, Tzoumas, Carlone, "Graduated non-convexity for robust spatial perception", RA-L 5 (2), 2020.
GTSAM's own optimiser for it refuses custom factors; here Levenberg-Marquardt runs on a graph whose rims are
weighted anew in every round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import X, Y
from scipy.stats import chi2

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import build_graph, optimum, trajectory
from craternav_fg.estimators.consensus import Track, robust_track
from craternav_fg.estimators.first_guess import initial_values
from craternav_fg.estimators.graph import GraphOptions, add_frame
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from craternav_fg.measurements import ArcSet, FrameMeasurement
from craternav_fg.trajectory import Trajectory
from factors.custom import Loss
from factors.kernels.validity import UNSEEN

FloatArray = npt.NDArray[np.float64]

# Within a round the weights are not final: few steps are enough.
COARSE = LmOptions(max_iterations=2, relative_tolerance=1e-3)
MAX_ROUNDS = 60
# A rim of less weight is left out.
LEAST_WEIGHT = 1e-3
# Components of a rim's residual, by the kind of measurement.
COMPONENTS = {"chart": 5, "centre": 2}


@dataclass(frozen=True)
class GncOptions:
    """Graduated non-convexity.

    Attributes
    ----------
    inlier_probability : float
        Share of the right matches to be kept: the limit is this quantile of chi-square, 4.5 sigma at 0.999.
    growth : float
        By which the control parameter grows each round: Yang et al. take 1.4. Nearer to 1 is slower and
        loses the way less.
    graph : GraphOptions
        Of the last optimisation, on the kept rims; its loss is not used before.
    """

    inlier_probability: float = 0.999
    growth: float = 1.4
    graph: GraphOptions = field(default_factory=GraphOptions)

    def __post_init__(self) -> None:
        if not 0.0 < self.inlier_probability < 1.0:
            raise EstimationError(
                f"inlier_probability: expected a number between 0 and 1, found {self.inlier_probability}"
            )
        if not 1.0 < self.growth < np.inf:
            raise EstimationError(f"growth: expected a number above 1, found {self.growth}")


class GncSmoother:
    """Batch smoother that decides of each rim whether it is used wholly or not at all.

    Parameters
    ----------
    options : GncOptions
    """

    name = "gnc_smoother"

    def __init__(self, options: GncOptions = GncOptions()) -> None:
        self.options = options

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate the state at every frame from all data that is not found wrong.

        Returns
        -------
        Trajectory
            With the weights of the rims: 1 kept, 0 rejected.

        Raises
        ------
        EstimationError
            When the optimisation does not converge.
        """
        graph_options = self.options.graph
        probability = self.options.inlier_probability
        track = robust_track(problem, float(chi2.ppf(probability, COMPONENTS["chart"])), graph_options)
        values, numbers = initial_values(problem, track.start, track.states, graph_options.keyframe_s)
        kept, values = self._decide(problem, track, values, numbers)
        graph, values = optimum(_with_weights(problem, kept), graph_options, values)
        return replace(trajectory(problem, graph_options, graph, values, numbers), rim_weights=tuple(kept))

    def _decide(
        self, problem: Problem, track: Track, values: gtsam.Values, numbers: Sequence[int]
    ) -> tuple[list[FloatArray], gtsam.Values]:
        """Find each rim's weight, 0 or 1, and values near the optimum with these weights."""
        options = replace(self.options.graph, loss=Loss())
        limit2 = float(chi2.ppf(self.options.inlier_probability, COMPONENTS[options.rims]))
        rims = _Rims(problem, options, numbers)
        others = build_graph(_with_weights(problem, rims.split(np.zeros(rims.count))), options, values)
        squared = rims.squared(values)
        trusted = np.concatenate([np.zeros(0, dtype=np.bool_), *track.kept])
        largest = float(squared[len(squared) - len(trusted) :][trusted].max(initial=limit2))
        # The surrogate is convex up to the largest residual of the rims that the start trusts.
        mu = limit2 / (2.0 * largest - limit2)
        previous = np.full(len(squared), np.nan)
        for _ in range(MAX_ROUNDS):
            weights = truncated_weights(squared, mu, limit2)
            if np.array_equal(weights, previous) and not (weights % 1.0).any():
                break
            graph = gtsam.NonlinearFactorGraph(others)
            rims.add(graph, weights)
            values = levenberg_marquardt(graph, values, COARSE).values
            squared, previous = rims.squared(values), weights
            mu *= self.options.growth
        return rims.split((squared <= limit2).astype(np.float64)), values


def truncated_weights(squared: FloatArray, mu: float, limit2: float) -> FloatArray:
    """Weights (n,) of the truncated loss's surrogate at squared norms (n,): Yang et al., section IV.

    1 up to mu/(mu + 1) limit2, 0 from (mu + 1)/mu limit2 on, between them sqrt(limit2 mu (mu + 1)/d2) - mu:
    for mu -> 0 the loss is quadratic, for mu -> infinity truncated.
    """
    between = np.sqrt(limit2 * mu * (mu + 1.0) / np.maximum(squared, np.finfo(np.float64).tiny)) - mu
    return np.asarray(np.clip(between, 0.0, 1.0))


def _with_weights(problem: Problem, weights: Sequence[FloatArray]) -> Problem:
    """Divide every rim's covariance by its weight, which scales its whitening by the root."""
    frames = [_weighted(frame, w) for frame, w in zip(problem.frames, weights, strict=True)]
    return replace(problem, frames=frames)


def _weighted(frame: FrameMeasurement, weights: FloatArray) -> FrameMeasurement:
    kept = weights > LEAST_WEIGHT
    rims = frame.rims.take(kept)
    return replace(frame, rims=replace(rims, covariance=rims.covariance / weights[kept, None, None]))


class _Rims:
    """All rims of a descent in the order of its frames: their residuals, and their factors by weight."""

    def __init__(self, problem: Problem, options: GraphOptions, numbers: Sequence[int]) -> None:
        self._problem = problem
        self._options = options
        # Image factors hold on to the exposure, where that is not the state itself.
        letter = Y if options.calibration.of_exposure else X
        self._keys = [letter(number) for number in numbers]
        self._frames = [replace(frame, sun=None, arcs=ArcSet.empty()) for frame in problem.frames]
        self._ends = np.cumsum([len(frame.rims) for frame in self._frames])
        self.count = int(self._ends[-1])
        self._graph = gtsam.NonlinearFactorGraph()
        self.add(self._graph, np.ones(self.count))

    def split(self, weights: FloatArray) -> list[FloatArray]:
        """Weights of all rims, frame by frame."""
        return np.split(weights, self._ends[:-1])

    def add(self, graph: gtsam.NonlinearFactorGraph, weights: FloatArray) -> None:
        """Add the factors of all rims, weighted."""
        for key, frame, w in zip(self._keys, self._frames, self.split(weights), strict=True):
            add_frame(graph, self._problem, self._options, key, _weighted(frame, w))

    def squared(self, values: gtsam.Values) -> FloatArray:
        """Squared whitened norms of all rims; infinite where the pose cannot see the crater."""
        rows = COMPONENTS[self._options.rims]
        residuals = [np.empty(0)]
        for i in range(self._graph.size()):
            factor = self._graph.at(i)
            assert isinstance(factor, gtsam.CustomFactor)
            residuals.append(factor.unwhitenedError(values))
        e = np.concatenate(residuals).reshape(-1, rows)
        # What is out of sight has no pull, only a step in the error that would stop the optimiser.
        seen = (e != UNSEEN).any(axis=1)
        return np.where(seen, np.sum(e**2, axis=1), np.inf)
