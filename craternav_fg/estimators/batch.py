"""The batch smoother: all states from all data."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X, Y

from craternav_fg.body import Body
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.calibration import (
    add_calibration,
    add_exposure,
    calibrated,
    map_errors,
)
from craternav_fg.estimators.correlated_errors import RimErrorStates
from craternav_fg.estimators.crater_scatter import variance_factors, with_variance_factors
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.graph import (
    FactorGraph,
    GraphOptions,
    ImuInterval,
    RimVariables,
    add_frame,
    add_imu,
    add_prior,
    bias_covariance_ours,
    bias_vector,
    push_interval,
    state_at,
    state_stamps,
)
from craternav_fg.estimators.initial_values import initial_values
from craternav_fg.estimators.intrinsics import intrinsic_error
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.motion import add_motion, longest_interval_s
from craternav_fg.estimators.online import OnlineSmoother
from craternav_fg.estimators.online_session import MIDPOINT_TOLERANCE_M
from craternav_fg.estimators.optimise import (
    MAX_PREDICTED_DECREASE,
    LmOptions,
    LmResult,
    levenberg_marquardt,
)
from craternav_fg.estimators.point_features import FeatureStates
from craternav_fg.estimators.sensor_bank import SensorBank, add_sensors
from craternav_fg.frames import rotate_position_block
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimSet
from craternav_fg.trajectory import Trajectory
from factors.conic_shape import ChartError
from factors.kernels.conic import project_rims

# Returns custom factors from the problem and the indices of the frames' states, on X, V and B of those.
OwnFactors = Callable[[Problem, Sequence[int]], Iterable[gtsam.NonlinearFactor]]

# Of a descent, with gravity re-evaluated after each; two are enough unless the start is far off.
MAX_OPTIMISATIONS = 5
# Of the first optimisation, which ends within a few hundredths of a sigma of the optimum.
ROUGH_LM = LmOptions(relative_tolerance=1e-4)
# On real ground many rims fit badly; on the robust loss's flat part the optimum is reached slowly.
FINAL_LM = LmOptions(max_iterations=200)
# In graphs solved by Cholesky factorisation, as the steps of the covariances follow: usually one or two.
CHOLESKY_TOLERANCE = 1e-5
MAX_LAST_STEPS = 3
# Largest decrease of the error, half a sum of squares, that the last of them leaves: 0.006 sigma.
MAX_LEFT_DECREASE = 2e-5
# Relative error of variances by Cholesky factorisation, an order of magnitude estimated at some poses: above,
# they are computed by QR. Along a descent errors add up to 2 to 20 times as much.
MAX_ROUNDING = 1e-5
CHECKED_POSES = 8
# An optimum is suspect when its chi-square exceeds this many times its degrees of freedom, and these standard
# deviations more.
SUSPECT_CHI2_RATIO, SUSPECT_SIGMAS = 1.3, 6.0


@dataclass(frozen=True)
class _Start:
    """Where the last optimisation starts, and what it is judged by.

    Attributes
    ----------
    problem : Problem
        With the covariances of that optimisation.
    values : gtsam.Values
    state_indices : sequence of int
        States of the frames.
    intervals : sequence of ImuInterval
        See `build_graph`.
    stated_error : float
        Half the sum of squares where all covariances are as stated, at the optimum of these: in the graph,
        craters that an optimum contradicts have larger ones, the larger the worse it is.
    suspect : bool
        Whether this error is so large that the optimum may be a local one.
    """

    problem: Problem
    values: gtsam.Values
    state_indices: Sequence[int]
    intervals: Sequence[ImuInterval] = ()
    stated_error: float = 0.0
    suspect: bool = False


class BatchSmoother:
    """Levenberg-Marquardt over the whole descent, started from the EKF's result.

    The centre-based baseline also starts from the EKF on ellipse charts, so that its result is its own
    optimum and not an effect of its start. An optimum whose chi-square is far too large may be local. The
    online smoother, which costs more but depends less on the first frames, then provides a second start,
    and the better optimum is taken.

    Parameters
    ----------
    options : BatchOptions, or GraphOptions, to which the defaults of the rest are added
        `rims="centre"` makes the centre-based baseline.
    name : str
        Name under which its results are stored.
    own_factors : callable, optional
        Called with the problem and the indices of the frames' states; returns further factors of the graph,
        on pose `X(k)`, velocity `V(k)` and biases `B(k)` of a state k, with standard deviations above zero.
    """

    def __init__(
        self,
        options: GraphOptions = BatchOptions(),
        name: str = "smoother",
        own_factors: OwnFactors | None = None,
    ) -> None:
        self.options = BatchOptions.of(options)
        self.name = name
        self.own_factors = own_factors

    @property
    def estimates_map(self) -> bool:
        """Whether errors of the map are unknowns, which then must not be in the rims' covariances as well."""
        return bool(self.options.calibration.map_sigmas.any())

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate the state at every frame from all data, with marginal covariances.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Trajectory

        Raises
        ------
        EstimationError
            When the optimisation does not converge, or an own factor has a constrained noise model.
        """
        found = []
        with suppress(EstimationError, np.linalg.LinAlgError):
            states = ekf().states(problem)[problem.start.frame :]
            longest_s = longest_interval_s(problem, self.options)
            start = self._start(problem, *initial_values(problem, problem.start, states, longest_s))
            if not start.suspect:
                return self._finished(problem, start)
            found.append(start)
        session = OnlineSmoother(self.options).run(problem)
        try:
            found.append(self._start(problem, session.smoothed_values(), session.frame_state_indices))
        except EstimationError:
            if not found:
                raise
        # The last optimisation takes long where the data contradict each other: only the better one is made.
        better, *other = sorted(found, key=lambda one: one.stated_error)
        try:
            return self._finished(problem, better)
        except EstimationError:
            if not other:
                raise
        return self._finished(problem, other[0])

    def _start(self, problem: Problem, values: gtsam.Values, state_indices: Sequence[int]) -> _Start:
        """Optimise roughly, and evaluate the covariances at the rims that the result predicts.

        Craters that the result contradicts get larger ones.
        """
        if self.options.rims == "centre":
            return _Start(problem, values, state_indices)
        graph = build_graph(problem, self.options, values, own_factors=self.own_factors)
        rough = levenberg_marquardt(graph, values, _solved_for(ROUGH_LM, problem, self.options))
        values, suspect = rough.values, _suspect(graph, rough)
        letter = Y if self.options.calibration.of_exposure else X
        poses = [values.atPose3(letter(index)).matrix() for index in state_indices]
        frames = [
            with_predicted_covariances(f, gTb, problem.camera, problem.catalog)
            for f, gTb in zip(problem.frames, poses, strict=True)
        ]
        freedom = self.options.crater_freedom if self.options.rim_error_states is not None else None
        # Variables of the map and of the lens take up what craters seem to err by.
        if freedom is not None and not self.options.calibration.of_charts:
            factors = variance_factors(frames, poses, problem.camera, problem.catalog, freedom)
            frames = [with_variance_factors(frame, factors) for frame in frames]
        weighted = replace(problem, frames=frames)
        return _Start(weighted, values, state_indices, graph.intervals, rough.error, suspect)

    def _finished(self, problem: Problem, start: _Start) -> Trajectory:
        """Optimise with the covariances of a start."""
        graph, best = optimum(start.problem, self.options, start.values, start.intervals, self.own_factors)
        return trajectory(problem, self.options, graph, best.values, start.state_indices, best.contraction)


def _solved_for(lm: LmOptions, problem: Problem, options: BatchOptions) -> LmOptions:
    """Use Cholesky factorisation for graphs with variables for the errors of rims, in which QR is slow."""
    if options.rim_error_states is None or not any(_has_variables(f.rims) for f in problem.frames):
        return lm
    return replace(lm, cholesky=True, relative_tolerance=max(lm.relative_tolerance, CHOLESKY_TOLERANCE))


def _has_variables(rims: RimSet) -> bool:
    """Whether a variable of its own belongs to the errors of each crater."""
    return rims.correlated is not None or rims.of_map is not None


def _suspect(graph: FactorGraph, found: LmResult) -> bool:
    """Whether an optimum's chi-square is so large that it may be a local one."""
    rows = graph.left_out + graph.rims.rows + sum(graph.at(i).dim() for i in range(graph.size()))
    freedom = max(rows - found.values.dim(), 1)
    return 2.0 * found.error > SUSPECT_CHI2_RATIO * freedom + SUSPECT_SIGMAS * np.sqrt(2.0 * freedom)


def optimum(
    problem: Problem,
    options: BatchOptions,
    values: gtsam.Values,
    intervals: Sequence[ImuInterval] = (),
    own_factors: OwnFactors | None = None,
) -> tuple[FactorGraph, LmResult]:
    """Optimise a whole descent, and repeat it until the points at which gravity is evaluated no longer move.

    Parameters
    ----------
    problem : Problem
    options : BatchOptions
    values : gtsam.Values
        Initial values of all states: those of the frames, and those between.
    intervals : sequence of ImuInterval
        Intervals of an earlier graph of these states, which is then no longer used.
    own_factors : callable, optional
        See `BatchSmoother`.

    Returns
    -------
    graph : FactorGraph
    best : LmResult
        Its optimum.

    Raises
    ------
    EstimationError
        When the optimisation does not converge.
    """
    graph = build_graph(problem, options, values, intervals, own_factors)
    final = _solved_for(FINAL_LM, problem, options)
    for last in range(MAX_OPTIMISATIONS - 1, -1, -1):
        best = _converged(levenberg_marquardt(graph, values, final))
        values = best.values
        if not last or not _update_gravity(graph, problem.body, values):
            break
    lost, count = _out_of_sight(problem, options, values)
    if 2 * lost > count:
        raise EstimationError(f"no convergence: {lost} of {count} rims are out of sight of the poses reached")
    return graph, best


def _settled(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, marginals: Marginals, contraction: float
) -> tuple[gtsam.Values, Marginals]:
    """Take the steps that eliminations for covariances give while they are long, then optimise if need be.

    They converge where each predicts less than the last one did; a long one must lower the error, too. One
    leaves that times the root of the last contraction: where losses weigh rims, quadratic steps become linear
    ones (on real ground 5 % were left after a contraction of 1e-4).
    """
    for _ in range(MAX_LAST_STEPS):
        nearer, predicted = values.retract(marginals.step), marginals.predicted_decrease
        if np.sqrt(contraction) * predicted <= MAX_LEFT_DECREASE:
            return nearer, marginals
        if predicted > MAX_PREDICTED_DECREASE and not graph.error(nearer) <= graph.error(values):
            break
        values, marginals = nearer, Marginals(graph, nearer, cholesky=marginals.cholesky)
        if not marginals.predicted_decrease < predicted:
            break
        contraction = max(marginals.predicted_decrease / predicted, 0.0)
    values = _converged(levenberg_marquardt(graph, values, FINAL_LM)).values
    return values, Marginals(graph, values)


def _converged(result: LmResult) -> LmResult:
    """Return an optimum."""
    if not result.converged:
        raise EstimationError(
            f"no convergence in {result.iterations} iterations: measurements, IMU and "
            "initial state contradict each other (check frames, units and mounting)"
        )
    return result


def _out_of_sight(problem: Problem, options: BatchOptions, values: gtsam.Values) -> tuple[int, int]:
    """Count the rims that their frame's pose cannot see, which do not constrain it, and all rims."""
    lost = count = index = 0
    stamp_ns = problem.frames[0].stamp_ns
    for frame in problem.frames:
        if frame.stamp_ns > stamp_ns:
            longest_s = longest_interval_s(problem, options)
            index += len(state_stamps(stamp_ns, frame.stamp_ns, longest_s))
            stamp_ns = frame.stamp_ns
        rows = frame.rims.craters
        centres, axes = problem.catalog.centres[rows], problem.catalog.axes[rows]
        gTb = np.ascontiguousarray(values.atPose3(X(index)).matrix())
        lost += int(np.count_nonzero(~project_rims(gTb, problem.camera.bTc, centres, axes)[1]))
        count += len(rows)
    return lost, count


def build_graph(
    problem: Problem,
    options: BatchOptions,
    values: gtsam.Values,
    intervals: Sequence[ImuInterval] = (),
    own_factors: OwnFactors | None = None,
) -> FactorGraph:
    """Build the graph of a whole descent, gravity and biases linearised at given values.

    Parameters
    ----------
    problem : Problem
    options : BatchOptions
    values : gtsam.Values
        Values of all states: those of the frames, and those between. Further variables that are missing are
        added: errors of rims as zero.
    intervals : sequence of ImuInterval
        Intervals of an earlier graph of these states, which is then no longer used. They need no
        preintegration.
    own_factors : callable, optional
        See `BatchSmoother`.

    Returns
    -------
    FactorGraph

    Raises
    ------
    EstimationError
        When an own factor has a constrained noise model.
    """
    graph = FactorGraph()
    add_prior(graph, problem.initial)
    states = None if options.rim_error_states is None else RimErrorStates(options.rim_error_states)
    added = gtsam.Values()
    bank = SensorBank(problem.sensors)
    # Points of arcs and tracks are normalised by the stated intrinsics; only rims have a variable for others.
    lens_known = not options.calibration.intrinsic_sigmas.any()
    tracks = problem.features if lens_known else None
    features = None if tracks is None else FeatureStates(tracks, problem.camera)
    known: set[int] = set()
    add_calibration(graph, values, options.calibration)

    def add_image(index: int, frame: FrameMeasurement) -> None:
        key = int(X(index))
        if options.calibration.of_exposure:
            state = values.atPose3(key), values.atVector(V(index)), values.atConstantBias(B(index))
            key = add_exposure(graph, values, problem, options.calibration, index, frame.stamp_ns, state)
        errors: list[ChartError] = []
        if options.rims == "chart":
            exposed = values.atPose3(key).matrix()
            errors = map_errors(graph, values, problem, options.calibration, frame.rims, exposed, known)
            intrinsic_sigmas = options.calibration.intrinsic_sigmas
            if not lens_known and len(frame.rims):
                errors.append(intrinsic_error(frame.rims, problem.camera, intrinsic_sigmas))
        frame = frame if lens_known else replace(frame, arcs=ArcSet.empty())
        variables = RimVariables(added, states, map_errors=errors, together=True)
        near = values.atPose3(key).matrix()
        graph.left_out += add_frame(graph, problem, options, key, frame, variables=variables, near=near)
        add_sensors(graph, added, problem, bank.at(frame.stamp_ns), index, frame.stamp_ns)
        if features is not None:
            features.enter(
                graph, added, key, frame.stamp_ns, lambda key: values.atPose3(key).matrix(),
                lambda key: values.atPoint3(key) if values.exists(key) else None,
            )  # fmt: skip

    add_image(0, problem.frames[0])
    index, of_frames = 0, [0]
    longest_s = longest_interval_s(problem, options)
    for before, frame in itertools.pairwise(problem.frames):
        stamps = [before.stamp_ns, *state_stamps(before.stamp_ns, frame.stamp_ns, longest_s)]
        for begin_ns, end_ns in itertools.pairwise(stamps):
            ends = [values.atPose3(X(i)).translation() for i in (index, index + 1)]
            midpoint = 0.5 * (ends[0] + ends[1])
            if problem.motion is not None:
                add_motion(graph, problem, index, int(begin_ns), int(end_ns), state_at(values, index))
            elif intervals:
                push_interval(graph, intervals[index].with_gravity_at(problem.body, midpoint))
            else:
                bias = bias_vector(values.atConstantBias(B(index)))
                add_imu(graph, problem, index, int(begin_ns), int(end_ns), midpoint, bias)
            index += 1
        add_image(index, frame)
        of_frames.append(index)
    for factor in () if own_factors is None else own_factors(problem, of_frames):
        if isinstance(factor, gtsam.NoiseModelFactor) and factor.noiseModel().isConstrained():
            keys = ", ".join(map(gtsam.DefaultKeyFormatter, factor.keys()))
            raise EstimationError(f"own factor on {keys}: expected standard deviations above zero, found 0")
        graph.push_back(factor)
    _add_missing(values, added)
    return graph


def _add_missing(values: gtsam.Values, added: gtsam.Values) -> None:
    """Insert the vectors that values lack."""
    for key in added.keys():  # noqa: SIM118 (Values is no mapping)
        if not values.exists(key):
            values.insert(key, added.atVector(key))


def _update_gravity(graph: FactorGraph, body: Body, values: gtsam.Values) -> bool:
    """Evaluate gravity where the states now are; False when that is where it was evaluated."""
    before = graph.intervals
    states = [one.index for one in before] + [before[-1].index + 1] if before else []
    positions = np.array([values.atPose3(X(i)).translation() for i in states]).reshape(-1, 3)
    midpoints = 0.5 * (positions[1:] + positions[:-1])
    graph.intervals = [
        one.with_gravity_at(body, midpoint) for one, midpoint in zip(before, midpoints, strict=True)
    ]
    steps = [float(np.linalg.norm(one.midpoint - m)) for one, m in zip(before, midpoints, strict=True)]
    return max(steps, default=0.0) >= MIDPOINT_TOLERANCE_M


def trajectory(
    problem: Problem,
    options: BatchOptions,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    state_indices: Sequence[int],
    contraction: float = 1.0,
) -> Trajectory:
    """Read the states of the frames and their marginal covariances from an optimum.

    Where steps by Cholesky factorisation lead to it, the eliminations for the covariances give further ones.

    Parameters
    ----------
    problem : Problem
    options : BatchOptions
    graph : gtsam.NonlinearFactorGraph
        Graph of the whole descent.
    values : gtsam.Values
        Its optimum.
    state_indices : sequence of int
        Indices of the frames' states.
    contraction : float
        That of the steps to the optimum, see `LmResult`.

    Returns
    -------
    Trajectory

    Raises
    ------
    EstimationError
        When further steps do not converge.
    """
    keys = [int(key(n)) for n in state_indices for key in (X, V, B)]
    cholesky = _solved_for(FINAL_LM, problem, options).cholesky
    marginals = Marginals(graph, values, cholesky=cholesky)
    if cholesky:
        values, marginals = _settled(graph, values, marginals, contraction)
    covariances = marginals.covariances(keys)
    # The poses lose most, and those of neighbouring states alike.
    some = map(X, state_indices[:: 1 + len(state_indices) // CHECKED_POSES])
    if marginals.rounding({key: covariances[key] for key in some}) > MAX_ROUNDING:
        values, marginals = _settled(graph, values, Marginals(graph, values), 1.0)
        covariances = marginals.covariances(keys)
    gTb = np.array([values.atPose3(X(n)).matrix() for n in state_indices])
    return Trajectory(
        stamps_ns=np.array([frame.stamp_ns for frame in problem.frames], dtype=np.int64),
        gTb=gTb,
        gV=np.array([values.atVector(V(n)) for n in state_indices]),
        bias=np.array([bias_vector(values.atConstantBias(B(n))) for n in state_indices]),
        pose_covariance=np.array(
            [
                rotate_position_block(covariances[X(n)], T[:3, :3])
                for n, T in zip(state_indices, gTb, strict=True)
            ]
        ),
        velocity_covariance=np.array([covariances[V(n)] for n in state_indices]),
        bias_covariance=np.array([bias_covariance_ours(covariances[B(n)]) for n in state_indices]),
        calibrated=calibrated(marginals, values, options.calibration, problem),
    )
