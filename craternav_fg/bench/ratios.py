"""Ratios of cost, each from one run in which both sides alternate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import L, X

from craternav_fg.bench.problems import Bench
from craternav_fg.bench.sessions import Reference
from craternav_fg.bench.timing import cpu_and_wall_s, seconds_of
from craternav_fg.estimators.base import Estimator, Problem
from craternav_fg.estimators.batch import build_graph
from craternav_fg.estimators.batch_options import BatchOptions
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, add_frame, add_prior
from craternav_fg.estimators.incremental import FixedLagIsam, Isam
from craternav_fg.estimators.online_session import OnlineSession
from craternav_fg.estimators.optimise import LmOptions, levenberg_marquardt
from craternav_fg.simulation.scenes import FOCAL_PX
from factors.arrays import FloatArray

# GTSAM's default: both sides stop at the same relative decrease.
RELATIVE_TOLERANCE = 1e-5
# With and without variables for time-correlated errors of rims.
KNOWING, UNKNOWING = BatchOptions(), BatchOptions(rim_errors=None)
# How often factors and runs are timed, of each of two alternatives, and what is compared with nothing.
FACTOR_REPETITIONS, RUN_REPETITIONS, SECONDS_REPETITIONS = 101, 7, 3


@dataclass(frozen=True)
class Ratio:
    """Cost of ours over the reference's.

    Attributes
    ----------
    median, low, high : float
        Over the repetitions: median, 10 % and 90 % points.
    ours_us, reference_us : float
        Median processor time, microseconds.
    wall : float
        Median ratio of the times on the wall, which other programs disturb.
    """

    median: float
    low: float
    high: float
    ours_us: float
    reference_us: float
    wall: float


def interleaved(ours: Callable[[], object], reference: Callable[[], object], repetitions: int) -> Ratio:
    """Time two functions alternately; each pair of calls gives one ratio."""
    ours(), reference()
    pairs = [(cpu_and_wall_s(ours), cpu_and_wall_s(reference)) for _ in range(repetitions)]
    ours_s, reference_s = np.array(pairs).transpose(1, 0, 2)
    return summary(ours_s, reference_s)


def summary(ours_s: FloatArray, reference_s: FloatArray) -> Ratio:
    """Summarise the times of repetitions.

    Parameters
    ----------
    ours_s, reference_s : ndarray, shape (n, 2)
        Processor time and time on the wall of each repetition.

    Returns
    -------
    Ratio
    """
    cpu, wall = (ours_s / reference_s).T
    low, median, high = np.percentile(cpu, [10, 50, 90])
    return Ratio(
        median=float(median),
        low=float(low),
        high=float(high),
        ours_us=1e6 * float(np.median(ours_s[:, 0])),
        reference_us=1e6 * float(np.median(reference_s[:, 0])),
        wall=float(np.median(wall)),
    )


def factor_ratio(bench: Bench, *, landmarks: bool = False) -> Ratio:
    """Compare the time to linearise the craters of all frames, per frame.

    Parameters
    ----------
    bench : Bench
    landmarks : bool
        Whether the reference is `KnownLandmarkFactorPose3`, a point in b without a camera; else it is
        `GenericProjectionFactorCal3_S2` with a mounting, an image measurement like ours.

    Returns
    -------
    Ratio
    """
    values = bench.values(np.random.default_rng(1), scale=0.1)
    # The reference's have the landmarks as well.
    poses = gtsam.Values(values)
    ours = FactorGraph()
    problem = bench.problem
    for i, frame in enumerate(problem.frames):
        add_frame(ours, problem, GraphOptions(), X(i), frame)
    if landmarks:
        reference = gtsam.NonlinearFactorGraph()
        for i in range(len(problem.frames)):
            bench.landmark_factors(reference, i)
    else:
        reference = projection_factors(bench, values)
    ratio = interleaved(
        lambda: ours.linearize(poses), lambda: reference.linearize(values), FACTOR_REPETITIONS
    )
    frames = len(problem.frames)
    return replace(ratio, ours_us=ratio.ours_us / frames, reference_us=ratio.reference_us / frames)


def projection_factors(bench: Bench, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """Make a `GenericProjectionFactorCal3_S2` with a mounting for every crater, and insert their centres.

    Parameters
    ----------
    bench : Bench
    values : gtsam.Values
        Changed.

    Returns
    -------
    gtsam.NonlinearFactorGraph
    """
    graph = gtsam.NonlinearFactorGraph()
    model = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
    camera = bench.problem.camera
    calibration = gtsam.Cal3_S2(FOCAL_PX, FOCAL_PX, 0.0, camera.cx_px, camera.cy_px)
    mounting = gtsam.Pose3(camera.bTc)
    for i, frame in enumerate(bench.problem.frames):
        for row, chart in zip(frame.rims.craters.tolist(), frame.rims.chart, strict=True):
            values.insert(L(row), bench.problem.catalog.centres[row])
            pixel = camera.pixels(chart[:2])
            graph.push_back(
                gtsam.GenericProjectionFactorCal3_S2(pixel, model, X(i), L(row), calibration, mounting)
            )
    return graph


def batch_graphs(
    bench: Bench,
) -> tuple[FactorGraph, gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Make the graph of a descent with our factors, the one with GTSAM's own, and their initial values.

    Parameters
    ----------
    bench : Bench

    Returns
    -------
    ours : FactorGraph
    reference : gtsam.NonlinearFactorGraph
        With the same IMU factors.
    values : gtsam.Values
    """
    values = bench.values(np.random.default_rng(1))
    ours = build_graph(bench.problem, BatchOptions(), values)
    reference = gtsam.NonlinearFactorGraph()
    add_prior(reference, bench.problem.initial)
    for i in range(ours.size()):
        factor = ours.at(i)
        if isinstance(factor, gtsam.CombinedImuFactor):
            reference.push_back(factor)
    for i in range(len(bench.gTb)):
        bench.landmark_factors(reference, i)
    return ours, reference, values


def batch_ratio(bench: Bench) -> Ratio:
    """Compare the optimisation of the whole descent: ours against GTSAM's LM with QR on its own factors.

    GTSAM's Cholesky, its default, needs ten times as long here: it fails on realistic IMU information.
    """
    ours, reference, values = batch_graphs(bench)
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(RELATIVE_TOLERANCE)
    options = LmOptions(relative_tolerance=RELATIVE_TOLERANCE)
    return interleaved(
        lambda: levenberg_marquardt(ours, values, options),
        lambda: gtsam.LevenbergMarquardtOptimizer(reference, values, params).optimize(),
        RUN_REPETITIONS,
    )


def errors_ratio(estimator: Callable[[BatchOptions], Estimator], problem: Problem) -> Ratio:
    """Compare an estimator with variables for the time-correlated errors of rims with one that has none.

    Parameters
    ----------
    estimator : callable
        Makes it from the options of its graph.
    problem : Problem
        With such errors, see `problems.tracked`.

    Returns
    -------
    Ratio
    """
    ours, reference = estimator(KNOWING), estimator(UNKNOWING)
    return interleaved(lambda: ours.estimate(problem), lambda: reference.estimate(problem), RUN_REPETITIONS)


@dataclass(frozen=True)
class Online:
    """Cost of every frame of one online run.

    Attributes
    ----------
    ours_s, reference_s : ndarray, shape (frames - 1, 2)
        From the frame's measurement to the newest state and its covariance: processor time, time on the wall.
    """

    ours_s: FloatArray
    reference_s: FloatArray

    @property
    def flatness(self) -> float:
        """Mean cost of the last tenth of the frames over that of the first."""
        tenth = max(1, len(self.ours_s) // 10)
        return float(self.ours_s[-tenth:, 0].mean() / self.ours_s[:tenth, 0].mean())


def online(bench: Bench, lag_s: float | None = None) -> Online:
    """Run our session and the reference side by side, with a fixed lag when one is given."""
    solvers = [Isam() if lag_s is None else FixedLagIsam(lag_s) for _ in range(2)]
    session = OnlineSession(bench.problem, solver=solvers[0])
    session.begin(bench.problem.frames[0], bench.problem.start)
    reference = Reference(bench, solvers[1])
    seconds = []
    for frame in bench.problem.frames[1:]:
        seconds.append((cpu_and_wall_s(partial(session.update, frame)), cpu_and_wall_s(reference.update)))
    ours_s, reference_s = np.array(seconds).transpose(1, 0, 2)
    return Online(ours_s, reference_s)


def ekf_step_us(bench: Bench) -> float:
    """Cost of one frame of the distributed EKF, microseconds."""
    ekf().estimate(bench.problem)
    seconds = [seconds_of(lambda: ekf().estimate(bench.problem)) for _ in range(SECONDS_REPETITIONS)]
    return 1e6 * float(np.median(seconds)) / (len(bench.gTb) - 1)


def batch_seconds(benches: Sequence[Bench]) -> FloatArray:
    """Measure the durations of our batch optimisation.

    Each repetition runs all sizes in turn: the speed of the machine may change between sizes.

    Parameters
    ----------
    benches : sequence of Bench

    Returns
    -------
    ndarray, shape (repetitions, benches)
        Seconds.
    """
    options = LmOptions(relative_tolerance=RELATIVE_TOLERANCE)
    problems = []
    for bench in benches:
        values = bench.values(np.random.default_rng(1))
        problems.append((build_graph(bench.problem, BatchOptions(), values), values))
    seconds = np.empty((SECONDS_REPETITIONS, len(problems)))
    for turn in seconds:
        for k, (graph, values) in enumerate(problems):
            turn[k] = seconds_of(partial(levenberg_marquardt, graph, values, options))
    return seconds


def exponent(sizes: npt.ArrayLike, seconds: npt.ArrayLike) -> float:
    """Slope of log cost over log size, by least squares.

    Parameters
    ----------
    sizes : array_like, shape (n,)
        Numbers of frames.
    seconds : array_like, shape (n,)
        Durations, s.

    Returns
    -------
    float
    """
    return float(np.polyfit(np.log(np.asarray(sizes)), np.log(np.asarray(seconds)), 1)[0])
