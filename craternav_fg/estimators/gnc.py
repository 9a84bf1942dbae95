"""The batch smoother for many wrong matches: graduated non-convexity (GNC) with truncated least squares.

Yang, Antonante, Tzoumas, Carlone, "Graduated non-convexity for robust spatial perception", RA-L 5 (2), 2020.
GTSAM's own GNC optimiser refuses custom factors. Here Levenberg-Marquardt runs on a graph whose rims are
reweighted in every round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X, Y
from scipy.special import chdtri

from craternav_fg.ellipse import relative_covariance
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch import build_graph, optimum, trajectory
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.calibration import Calibration, map_sigmas
from craternav_fg.estimators.consensus import Track, robust_track
from craternav_fg.estimators.filter_state import POSE
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, ImuInterval, add_frame
from craternav_fg.estimators.initial_values import initial_values
from craternav_fg.estimators.intrinsics import intrinsic_slopes
from craternav_fg.estimators.linearisation import linearise_arcs
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.motion import longest_interval_s
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from craternav_fg.estimators.rim_models import rim_factors
from craternav_fg.linalg import squared_distance
from craternav_fg.matching.rematch import NO_CRATER, rematched
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray
from factors.custom import Loss
from factors.kernels.validity import UNSEEN

# Within a round, whose weights are not final: few steps are enough.
COARSE_LM = LmOptions(max_iterations=2, relative_tolerance=1e-3)
# At a growth of 1.4 the control parameter grows by 6e8 in as many rounds.
MAX_ROUNDS = 60
# A rim of less weight is left out: its covariance would grow a thousandfold.
MIN_WEIGHT = 1e-3
# Number of components of a rim's residual, by the kind of measurement.
RESIDUAL_SIZE = {"chart": 5, "centre": 2}


@dataclass(frozen=True)
class GncOptions:
    """Graduated non-convexity.

    Attributes
    ----------
    inlier_probability : float
        Share of the right matches to be kept: a rim's limit is this quantile of chi-square, 4.5 sigma at
        0.999.
    growth_factor : float
        Factor by which the control parameter grows each round; Yang et al. use 1.4. A smaller one is slower
        and follows the optimum more closely.
    graph : GraphOptions
        Options of the last optimisation, on the inliers; its loss and time-correlated errors are not used
        before. Where errors of map or intrinsics are estimated, matches are judged with their prior
        covariance.
    """

    inlier_probability: float = 0.999
    growth_factor: float = 1.4
    graph: GraphOptions = field(default_factory=GraphOptions)

    def __post_init__(self) -> None:
        if self.graph.rims not in RESIDUAL_SIZE:
            raise EstimationError(f"graph.rims: expected chart or centre, found {self.graph.rims!r}")
        if not 0.0 < self.inlier_probability < 1.0:
            raise EstimationError(
                f"inlier_probability: expected a number between 0 and 1, found {self.inlier_probability}"
            )
        if not 1.0 < self.growth_factor < np.inf:
            raise EstimationError(f"growth_factor: expected a number above 1, found {self.growth_factor}")


@dataclass(frozen=True)
class _Decided:
    """Result of the rounds.

    Attributes
    ----------
    weights : list of ndarray
        Weights of each frame's matches: 1 inlier, 0 outlier.
    values : gtsam.Values
        Near the optimum with these weights.
    poses : list of ndarray, shape (4, 4)
        Poses of the body in g at each frame's exposure.
    intervals : list of ImuInterval
    """

    weights: list[FloatArray]
    values: gtsam.Values
    poses: list[FloatArray]
    intervals: list[ImuInterval]


class GncSmoother:
    """Batch smoother that decides for each rim whether its match is right.

    A rim with a wrong match is re-associated with the catalogue (`rematched`) and used for the crater it
    belongs to, or not at all. An arc that is an outlier is left out.

    Parameters
    ----------
    options : GncOptions
    """

    name = "gnc_smoother"

    def __init__(self, options: GncOptions = GncOptions()) -> None:
        self.options = options

    @property
    def estimates_map(self) -> bool:
        """Whether errors of the map are unknowns, see `BatchSmoother.estimates_map`."""
        return bool(BatchOptions.of(self.options.graph).calibration.map_sigmas.any())

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate the state at every frame from all data but outliers.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Trajectory
            With the weights of the matches, 1 inlier and 0 outlier, and the craters that rims are used for.

        Raises
        ------
        EstimationError
            When the optimisation does not converge.
        """
        options = BatchOptions.of(self.options.graph)
        judged = replace(
            problem, frames=[_with_prior_covariance(problem, f, options.calibration) for f in problem.frames]
        )
        track = robust_track(judged, self._limit2(RESIDUAL_SIZE["chart"]), options)
        longest_s = longest_interval_s(problem, options)
        values, numbers = initial_values(problem, track.start, track.states, longest_s)
        decided = self._decide(judged, track, values, numbers)
        frames, craters = [], []
        predicted = [track.states[0]] * track.start.frame + track.states
        for frame, wide, weights, gTb, state in zip(
            problem.frames, judged.frames, decided.weights, decided.poses, predicted, strict=True
        ):
            taken = rematched(
                wide.rims, weights > 0.0, gTb, problem.camera, problem.catalog,
                self._limit2(RESIDUAL_SIZE["chart"]),
            )  # fmt: skip
            craters.append(taken)
            rims = replace(frame.rims, craters=taken).take(taken != NO_CRATER)
            arcs = self._fitting(problem, frame.arcs, gTb, state.covariance[POSE, POSE])
            inliers = replace(frame, rims=rims, arcs=arcs)
            frames.append(with_predicted_covariances(inliers, gTb, problem.camera, problem.catalog))
        kept = replace(problem, frames=frames)
        graph, best = optimum(kept, options, decided.values, decided.intervals)
        return replace(
            trajectory(kept, options, graph, best.values, numbers, best.contraction),
            rim_weights=tuple(decided.weights), rim_craters=tuple(craters),
        )  # fmt: skip

    def _limit2(self, freedom: int) -> float:
        return float(chdtri(freedom, 1.0 - self.options.inlier_probability))

    def _fitting(self, problem: Problem, arcs: ArcSet, gTb: FloatArray, covariance: FloatArray) -> ArcSet:
        """Arcs that are inliers at a pose whose covariance (6, 6) is given."""
        fits = np.zeros(len(arcs), dtype=np.bool_)
        alone = arcs.inflate_correlated(1.0)
        for i in range(len(arcs)):
            for one in linearise_arcs(gTb, alone.take(np.array([i])), problem.camera, problem.catalog):
                S = one.A @ covariance @ one.A.T + np.eye(len(one.A))
                squared = float(squared_distance(one.residual, S))
                fits[i] = squared <= self._limit2(len(one.residual))
        return arcs.take(fits)

    def _decide(
        self, problem: Problem, track: Track, values: gtsam.Values, numbers: Sequence[int]
    ) -> _Decided:
        """Decide which matches are right."""
        # Outliers show without variables for the time-correlated errors.
        options = replace(BatchOptions.of(self.options.graph), loss=Loss(), rim_errors=None)
        limit2 = self._limit2(RESIDUAL_SIZE[options.rims])
        rims = _Rims(problem, options, numbers)
        # Wrong arcs could outweigh right rims.
        blind = [replace(f, rims=RimSet.empty(), arcs=ArcSet.empty()) for f in problem.frames]
        others = build_graph(replace(problem, frames=blind), options, values)
        squared = rims.squared(values)
        trusted = np.concatenate([np.zeros(0, dtype=np.bool_), *track.kept])
        # Infinite where the pose cannot see a rim.
        trusted &= np.isfinite(squared[len(squared) - len(trusted) :])
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
            values = levenberg_marquardt(graph, values, COARSE_LM).values
            squared, previous = rims.squared(values), weights
            mu *= self.options.growth_factor
        right = rims.split((squared <= limit2).astype(np.float64))
        return _Decided(right, values, rims.poses(values), others.intervals)


def _with_prior_covariance(
    problem: Problem, frame: FrameMeasurement, options: Calibration
) -> FrameMeasurement:
    """Add to rims what the errors of map and intrinsics that are estimated may amount to, at any pose."""
    rims = frame.rims
    added = np.zeros_like(rims.covariance)
    if options.map_sigmas.any():
        shares2 = map_sigmas(problem.catalog, rims.craters, options).max(axis=1, initial=0.0) ** 2
        added += shares2[:, None, None] * relative_covariance(rims.chart, 1.0)
    if options.intrinsic_sigmas.any() and len(rims):
        root = intrinsic_slopes(rims.chart, problem.camera) * options.intrinsic_sigmas
        added += root @ np.swapaxes(root, 1, 2)
    fused = None if rims.fused_white is None else rims.fused_white + added
    return replace(frame, rims=replace(rims, covariance=rims.covariance + added, fused_white=fused))


def truncated_weights(squared: FloatArray, mu: float, limit2: float) -> FloatArray:
    """Weights of the truncated loss's surrogate: Yang et al., section IV.

    1 up to mu/(mu + 1) limit2, 0 from (mu + 1)/mu limit2 on, between them sqrt(limit2 mu (mu + 1)/d2) - mu:
    for mu -> 0 the loss is quadratic, for mu -> infinity truncated.

    Parameters
    ----------
    squared : ndarray, shape (n,)
        Squared whitened norms d2 of residuals.
    mu : float
        Control parameter.
    limit2 : float
        Squared norm at which the loss is truncated.

    Returns
    -------
    ndarray, shape (n,)
        Weights from 0 to 1.
    """
    between = np.sqrt(limit2 * mu * (mu + 1.0) / np.maximum(squared, np.finfo(np.float64).tiny)) - mu
    return np.asarray(np.clip(between, 0.0, 1.0))


class _Rims:
    """All rims of a descent in the order of its frames: their residuals, and their factors by weight."""

    def __init__(self, problem: Problem, options: BatchOptions, numbers: Sequence[int]) -> None:
        self._problem = problem
        self._options = options
        letter = Y if options.calibration.of_exposure else X
        self._keys = [letter(number) for number in numbers]
        self._frames = [replace(frame, sun=None, arcs=ArcSet.empty()) for frame in problem.frames]
        self._ends = np.cumsum([len(frame.rims) for frame in self._frames])
        self.count = int(self._ends[-1])
        # Most weights do not change from round to round.
        self._made: list[tuple[FloatArray, FactorGraph]] = [
            (ones, self._factors(k, ones)) for k, ones in enumerate(self.split(np.ones(self.count)))
        ]
        self._unreduced = [factor for k in range(len(numbers)) for factor in self._residuals(k)]

    def split(self, weights: FloatArray) -> list[FloatArray]:
        """Weights of all rims, frame by frame."""
        return np.split(weights, self._ends[:-1])

    def poses(self, values: gtsam.Values) -> list[FloatArray]:
        """Poses (4, 4) of the body in g at the exposures."""
        return [np.ascontiguousarray(values.atPose3(key).matrix()) for key in self._keys]

    def add(self, graph: gtsam.NonlinearFactorGraph, weights: FloatArray) -> None:
        """Add the weighted factors of all rims; they are kept until their weights change."""
        for k, w in enumerate(self.split(weights)):
            if not np.array_equal(w, self._made[k][0]):
                self._made[k] = (w, self._factors(k, w))
            graph.push_back(self._made[k][1])

    def _factors(self, k: int, weights: FloatArray) -> FactorGraph:
        """Factors of a frame's rims, their covariances divided by their weights."""
        part = FactorGraph()
        kept = weights > MIN_WEIGHT
        rims = self._frames[k].rims.inflate_correlated(self._options.variance_inflation).take(kept)
        rims = replace(rims, covariance=rims.covariance / weights[kept, None, None])
        add_frame(part, self._problem, self._options, self._keys[k], replace(self._frames[k], rims=rims))
        return part

    def _residuals(self, k: int) -> list[gtsam.CustomFactor]:
        """Factors of a frame's rims of which each rim's residual can be read."""
        rims = self._frames[k].rims.inflate_correlated(self._options.variance_inflation)
        of = self._problem.camera, self._problem.catalog, rims, self._problem.initial.gTb
        return rim_factors(self._options.rims, self._keys[k], *of, Loss()) if len(rims) else []

    def squared(self, values: gtsam.Values) -> FloatArray:
        """Squared whitened norms of all rims; infinite where the pose cannot see the crater."""
        rows = RESIDUAL_SIZE[self._options.rims]
        residuals = [factor.unwhitenedError(values) for factor in self._unreduced]
        e = np.concatenate([np.empty(0), *residuals]).reshape(-1, rows)
        # A rim out of sight has no slope, only a step in the error that would stop the optimiser.
        seen = (e != UNSEEN).any(axis=1)
        return np.where(seen, np.sum(e**2, axis=1), np.inf)
