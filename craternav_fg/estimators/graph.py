"""The factor graph of a descent: priors, frames, IMU intervals."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.body import Body
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.correlated_errors import VARIANCE_INFLATION, RimErrorOptions, RimErrorStates
from craternav_fg.estimators.elimination import CholeskyOrder
from craternav_fg.estimators.rim_models import RIM_MODELS, RimModel, rim_factors
from craternav_fg.imu import ImuRows
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import InitialState
from factors.ahead import Ahead
from factors.arrays import FloatArray, IntArray
from factors.conic_shape import ChartError, conic_shape_factor, conic_shape_factors
from factors.custom import Loss
from factors.imu import INTEGRATION_VARIANCE, imu_factor, integrate, parameters
from factors.kernels import robust
from factors.rim_points import rim_points_factor
from factors.rims_with_errors import RimsWithErrors
from factors.sun_tilt import sun_tilt_factor

# On the root mean square of an arc's whitened distances, whose expectation is 1.
ARC_LOSS = Loss(robust.HUBER, 2.0)


@dataclass(frozen=True)
class GraphOptions:
    """What the graph consists of.

    Attributes
    ----------
    rims : {"chart", "eq19", "los", "los+shape", "points", "centre"}
        Measurement of a rim: its ellipse chart; the paper's eq. (19); its line of sight, eq. (11), alone or
        with what (19) says beside it; points of the ellipse; its centre only. See `rim_models.rim_factors`.
    loss : Loss
        On each crater's whitened norm. Huber at 3.3 sigma, about the 95 % point of 5 dimensions.
    keyframe_s : float
        Longest interval between two states: gravity is constant within one.
    rim_errors : RimErrorOptions or None
        How time-correlated errors of rims are modelled, where the measurements have any and `rims` is
        "chart". None treats them as white, as the other measurements do.
    variance_inflation : float
        Factor on the variance of time-correlated errors that are treated as white: 1 for a single image.
    """

    rims: RimModel = "chart"
    loss: Loss = Loss(robust.HUBER, 3.3)
    keyframe_s: float = 1.0
    rim_errors: RimErrorOptions | None = field(default_factory=RimErrorOptions)
    variance_inflation: float = VARIANCE_INFLATION

    def __post_init__(self) -> None:
        if self.rims not in RIM_MODELS:
            raise EstimationError(f"rims: expected one of {', '.join(RIM_MODELS)}, found {self.rims!r}")
        if self.rims != "chart" and self.rim_errors not in (None, RimErrorOptions()):
            raise EstimationError(f"rim_errors: variables for them need rims='chart', found {self.rims!r}")
        for name in ("keyframe_s", "variance_inflation"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise EstimationError(f"{name}: expected a positive number, found {value}")

    @property
    def rim_error_states(self) -> RimErrorOptions | None:
        """How the graph's variables for errors of rims behave; None without such variables."""
        return self.rim_errors if self.rims == "chart" else None


@dataclass(frozen=True)
class ImuInterval:
    """An IMU factor of a graph, from one state to the next.

    Attributes
    ----------
    index : int
        Index of the state at its beginning.
    midpoint : ndarray, shape (3,)
        Point in g, m, at which gravity is evaluated.
    pim : gtsam.PreintegratedCombinedMeasurements
    params : gtsam.PreintegrationCombinedParams
        The factor's own, gravity among them.
    slot : int
        Slot of the factor in a solver.
    """

    index: int
    midpoint: FloatArray
    pim: gtsam.PreintegratedCombinedMeasurements
    params: gtsam.PreintegrationCombinedParams
    slot: int = -1

    @property
    def stiffness(self) -> FloatArray:
        """Information (9,) of rotation, position, velocity at the end, given all else, rad^-2, m^-2, s^2/m^2.

        That of the stiffest axis, whatever the frame.
        """
        information = np.linalg.inv(self.pim.preintMeasCov()[:9, :9])
        return np.repeat([np.linalg.norm(information[i : i + 3, i : i + 3], 2) for i in (0, 3, 6)], 3)

    def with_gravity_at(self, body: Body, midpoint: FloatArray) -> "ImuInterval":
        """Evaluate the factor's gravity at another point; it must then be linearised again.

        Parameters
        ----------
        body : Body
        midpoint : ndarray, shape (3,)
            Position half-way through the interval, in g, m.

        Returns
        -------
        ImuInterval
        """
        self.params.n_gravity = body.gravity(midpoint)
        return replace(self, midpoint=midpoint)


class FactorGraph(gtsam.NonlinearFactorGraph):
    """A graph that keeps the Python objects of its custom factors, its IMU intervals, and rims with errors.

    GTSAM hands a factor to its callback. Where nobody keeps the object, one is made for every call: a tenth
    of the time to linearise ten rims.

    Attributes
    ----------
    intervals : list of ImuInterval
    left_out : int
        Number of measured rows that its factors stand for beside their own, see `add_frame`.
    rims : RimsWithErrors
        Rims beside the factors. They count in `error` and `linearize`, but not where GTSAM's own optimisers
        evaluate the graph.
    ahead : Ahead
        Evaluates the factors of its frames' rims at once in `error` and `linearize`.
    """

    def __init__(self) -> None:
        super().__init__()
        self._kept: list[gtsam.CustomFactor] = []
        # With the numbers of factors and of rows of rims that it is for.
        self._order: tuple[tuple[int, int], CholeskyOrder] | None = None
        self.intervals: list[ImuInterval] = []
        self.left_out = 0
        self.rims = RimsWithErrors()
        self.ahead = Ahead()

    def error(self, values: gtsam.Values) -> float:
        """Half the sum of squares of all residuals, under their losses."""
        with self.ahead.at(values, linearise=False):
            return float(super().error(values)) + self.rims.error(values)

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """Linearise all factors and rims at values."""
        with self.ahead.at(values, linearise=True):
            linear = super().linearize(values)
        self.rims.linearise(values, linear)
        return linear

    def order(self, linear: gtsam.GaussianFactorGraph) -> CholeskyOrder:
        """Order to factorise what it is linearised to: all such graphs have the same factors."""
        of = self.size(), self.rims.rows
        if self._order is None or self._order[0] != of:
            self._order = of, CholeskyOrder(linear)
        return self._order[1]

    def push_back(self, factor: Any) -> None:
        """Add a factor, or all those of a graph."""
        if isinstance(factor, gtsam.CustomFactor):
            self._kept.append(factor)
        super().push_back(factor)


def cholesky_order(graph: gtsam.NonlinearFactorGraph, linear: gtsam.GaussianFactorGraph) -> CholeskyOrder:
    """Order to factorise what a graph is linearised to; a `FactorGraph` computes it once.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    linear : gtsam.GaussianFactorGraph

    Returns
    -------
    CholeskyOrder
    """
    return graph.order(linear) if isinstance(graph, FactorGraph) else CholeskyOrder(linear)


def add_prior(graph: gtsam.NonlinearFactorGraph, initial: InitialState) -> None:
    """Add the priors of the first state."""
    pose_sigmas = np.repeat([initial.attitude_sigma_rad, initial.position_sigma_m], 3)
    bias_sigmas = np.repeat(
        [initial.accelerometer_bias_sigma_m_s2, initial.gyro_bias_sigma_rad_s], 3
    )  # GTSAM's order
    diagonal = gtsam.noiseModel.Diagonal.Sigmas
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(initial.gTb), diagonal(pose_sigmas)))
    graph.push_back(
        gtsam.PriorFactorVector(V(0), initial.gV, diagonal(np.full(3, initial.velocity_sigma_m_s)))
    )
    graph.push_back(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), diagonal(bias_sigmas)))


@dataclass(frozen=True)
class RimVariables:
    """Variables of a frame's rims in a graph, beside the pose.

    Attributes
    ----------
    values : gtsam.Values
        Gets the variables that are new.
    states : RimErrorStates or None
        Time-correlated errors; None treats them as white.
    holds : callable or None
        See `RimErrorStates.enter`.
    map_errors : sequence of ChartError
        Errors of the rims' craters on the map, which the graph has already.
    together : bool
        Whether rims with errors go to `FactorGraph.rims`, where one call linearises all of them. iSAM2 wants
        a factor for each.
    """

    values: gtsam.Values
    states: RimErrorStates | None = None
    holds: Callable[[int], bool] | None = None
    map_errors: Sequence[ChartError] = ()
    together: bool = False


def add_frame(
    graph: FactorGraph,
    descent: Descent,
    options: GraphOptions,
    key: int,
    frame: FrameMeasurement,
    *,
    noise_scale: float = 1.0,
    variables: RimVariables | None = None,
    near: FloatArray | None = None,
) -> int:
    """Add the factors of one image: rims, arcs and sun tilt.

    Parameters
    ----------
    graph : FactorGraph
    descent : Descent
    options : GraphOptions
    key : int
        Key of the pose at the exposure.
    frame : FrameMeasurement
    noise_scale : float
        Factor on all standard deviations.
    variables : RimVariables, optional
        Without them all errors of rims are treated as white.
    near : ndarray, shape (4, 4), optional
        Pose gTb, m, at whose attitude lines of sight are evaluated; the initial state's if not given.

    Returns
    -------
    int
        Number of measured rows that were reduced away: the factors have so many fewer.
    """
    left_out = 0
    states = None if variables is None or options.rim_error_states is None else variables.states
    rims = frame.rims if states is not None else frame.rims.inflate_correlated(options.variance_inflation)
    bTc = descent.camera.bTc
    if len(rims):
        if options.rims == "chart":
            errors: list[ChartError] = []
            if variables is not None and states is not None:
                errors = states.enter(rims, graph, variables.values, variables.holds)
            S = noise_scale**2 * (rims.covariance if states is None else rims.fused_white_covariance)
            errors.extend(() if variables is None else variables.map_errors)
            centres, axes = descent.catalog.centres[rims.craters], descent.catalog.axes[rims.craters]
            if errors and variables is not None and variables.together:
                graph.rims.add(key, bTc, centres, axes, rims.chart, S, errors, options.loss)
            elif errors:
                for factor in conic_shape_factors(
                    key, bTc, centres, axes, rims.chart, S, errors, options.loss
                ):
                    graph.push_back(factor)
            else:
                factor = conic_shape_factor(
                    key, bTc, centres, axes, rims.chart, S, options.loss, reduced=True, ahead=graph.ahead
                )
                graph.push_back(factor)
                left_out = rims.chart.size - factor.dim()
        else:
            scaled = replace(rims, covariance=noise_scale**2 * rims.covariance)
            gTb = descent.initial.gTb if near is None else near
            for factor in rim_factors(
                options.rims, key, descent.camera, descent.catalog, scaled, gTb, options.loss
            ):
                graph.push_back(factor)
    arcs = frame.arcs.inflate_correlated(options.variance_inflation)
    if len(arcs) and options.rims in ("chart", "points"):
        centres, axes = descent.catalog.centres[arcs.craters], descent.catalog.axes[arcs.craters]
        sigmas = [noise_scale * sigma for sigma in arcs.sigmas]
        shared = None
        if variables is not None and states is not None and options.rims == "chart":
            shared = states.enter_arcs(frame, graph, variables.values, variables.holds)
        factor = rim_points_factor(key, bTc, centres, axes, arcs.points, sigmas, ARC_LOSS, error=shared)
        graph.push_back(factor)
    if frame.sun is not None:
        sun = frame.sun
        sigma_rad = noise_scale * sun.sigma_rad
        graph.push_back(sun_tilt_factor(key, bTc, sun.direction, sun.tilt_rad, sigma_rad, sun.point))
    return left_out


def add_imu(
    graph: FactorGraph,
    descent: Descent,
    index: int,
    begin_ns: int,
    end_ns: int,
    midpoint: FloatArray,
    bias: FloatArray,
    rows: ImuRows | None = None,
    integration_variance: float = INTEGRATION_VARIANCE,
) -> ImuInterval:
    """Add the IMU factor from one state to the next.

    Parameters
    ----------
    graph : FactorGraph
    descent : Descent
    index : int
        Index of the state at the beginning.
    begin_ns, end_ns : int
        The interval.
    midpoint : ndarray, shape (3,)
        Predicted position half-way, in g, m, at which gravity is evaluated.
    bias : ndarray, shape (6,)
        Gyro (rad/s), then accelerometer (m/s^2), in b: where the preintegration is linearised.
    rows : (ndarray, ndarray, ndarray), optional
        What `ImuLog.between` gives for the interval, where it is known already.
    integration_variance : float
        See `factors.imu.parameters`.

    Returns
    -------
    ImuInterval
    """
    gravity = descent.body.gravity(midpoint)
    params = parameters(descent.imu_noise, descent.body.spin_rad_s, gravity, integration_variance)
    pim = integrate(params, *(rows or descent.imu.between(begin_ns, end_ns)), bias)
    interval = ImuInterval(index, midpoint, pim, params)
    push_interval(graph, interval)
    return interval


def push_interval(graph: FactorGraph, interval: ImuInterval) -> None:
    """Add the IMU factor of an interval, which may come from another graph of the same states."""
    i, j = interval.index, interval.index + 1
    graph.push_back(imu_factor([X(i), V(i), X(j), V(j), B(i), B(j)], interval.pim))
    graph.intervals.append(interval)


def state_stamps(begin_ns: int, end_ns: int, longest_s: float) -> IntArray:
    """Stamps of the states after a stamp up to another, evenly spaced.

    Parameters
    ----------
    begin_ns, end_ns : int
    longest_s : float
        Largest distance of two stamps.

    Returns
    -------
    ndarray of int, shape (n,)
        Stamps, ns; the last is `end_ns`.
    """
    n = max(1, math.ceil((end_ns - begin_ns) * 1e-9 / longest_s - 1e-9))
    if n == 1:
        return np.array([end_ns], dtype=np.int64)
    return begin_ns + np.round(np.arange(1, n + 1) * ((end_ns - begin_ns) / n)).astype(np.int64)


def insert_state(values: gtsam.Values, index: int, state: gtsam.NavState, bias: FloatArray) -> None:
    """Insert pose, velocity and bias of a state.

    Parameters
    ----------
    values : gtsam.Values
    index : int
        Index of the state.
    state : gtsam.NavState
    bias : ndarray, shape (6,)
        Gyro (rad/s), then accelerometer (m/s^2), in b.
    """
    values.insert(X(index), state.pose())
    values.insert(V(index), state.velocity())
    values.insert(B(index), gtsam.imuBias.ConstantBias(bias[3:], bias[:3]))


def state_at(values: gtsam.Values, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Read a state.

    Parameters
    ----------
    values : gtsam.Values
    index : int
        Index of the state.

    Returns
    -------
    gTb : ndarray, shape (4, 4)
        In g, m.
    gV : ndarray, shape (3,)
        In g, m/s.
    bias : ndarray, shape (6,)
        Gyro (rad/s), then accelerometer (m/s^2), in b.
    """
    bias = bias_vector(values.atConstantBias(B(index)))
    return values.atPose3(X(index)).matrix(), values.atVector(V(index)), bias


def bias_vector(bias: gtsam.imuBias.ConstantBias) -> FloatArray:
    """Return a bias in our order, which is not GTSAM's.

    Parameters
    ----------
    bias : gtsam.imuBias.ConstantBias

    Returns
    -------
    ndarray, shape (6,)
        Gyro (rad/s), then accelerometer (m/s^2), in b.
    """
    return np.concatenate([bias.gyroscope(), bias.accelerometer()])


def bias_covariance_ours(covariance: FloatArray) -> FloatArray:
    """Return the covariance of a bias in our order.

    Parameters
    ----------
    covariance : ndarray, shape (6, 6)
        In GTSAM's order: accelerometer, gyro.

    Returns
    -------
    ndarray, shape (6, 6)
        Covariance, gyro first.
    """
    order = [3, 4, 5, 0, 1, 2]
    return covariance[np.ix_(order, order)]
