"""The online smoother: iSAM2, frame by frame."""

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import (
    GraphOptions,
    add_frame,
    add_imu,
    add_prior,
    bias_vector,
    insert_state,
    state_stamps,
)
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory
from factors.kernels import strapdown

FloatArray = npt.NDArray[np.float64]

# Relinearise a variable that moved by more: pose (rad, m), velocity (m/s), bias (m/s^2, rad/s).
RELINEARISE = {
    "x": np.array([1e-4, 1e-4, 1e-4, 1.0, 1.0, 1.0]),
    "v": np.full(3, 0.05),
    "b": np.array([1e-4, 1e-4, 1e-4, 1e-7, 1e-7, 1e-7]),
}
# A wide prior makes the first frames nonlinear: iterate until the newest position moves by less.
SETTLED_M = 0.1
MAX_EXTRA_UPDATES = 5


class OnlineSession:
    """An iSAM2 smoother that takes one frame after the other.

    Call `begin` with the first frame, then `predict` and `update` for each later one. QR throughout; the
    linearisation point is held so that callbacks get it and not a copy of all values.

    Parameters
    ----------
    descent : Descent
    options : GraphOptions
    """

    def __init__(self, descent: Descent, options: GraphOptions = GraphOptions()) -> None:
        self._descent = descent
        self._options = options
        params = gtsam.ISAM2Params()
        params.setFactorization("QR")
        params.relinearizeSkip = 1
        params.enablePartialRelinearizationCheck = True
        thresholds = gtsam.ISAM2ThresholdMap()
        for letter, steps in RELINEARISE.items():
            thresholds.insert((letter, steps))
        params.setRelinearizeThreshold(thresholds)
        self._isam = gtsam.ISAM2(params)
        self._hold: gtsam.Values | None = None
        self._last = 0
        self._frame_numbers: list[int] = []
        self._stamps_ns: list[int] = []
        self._states: list[FilterState] = []

    @property
    def frame_numbers(self) -> list[int]:
        """Numbers of the graph's states that belong to frames."""
        return list(self._frame_numbers)

    @property
    def state(self) -> FilterState:
        """Estimate at the newest frame, from all data up to it.

        Its covariance refers to the error state of `factors.kernels.strapdown`.
        """
        return self._states[-1]

    def begin(self, frame: FrameMeasurement, start: Start) -> None:
        """Take the first frame; a start at it is where it is linearised, not another measurement.

        Parameters
        ----------
        frame : FrameMeasurement
            At the initial state's stamp.
        start : Start
        """
        graph = gtsam.NonlinearFactorGraph()
        values = gtsam.Values()
        initial = self._descent.initial
        add_prior(graph, initial)
        add_frame(graph, self._descent, self._options, X(0), frame)
        gTb = start.gTb if start.frame == 0 else initial.gTb
        insert_state(values, 0, gtsam.NavState(gtsam.Pose3(gTb), initial.gV), np.zeros(6))
        self._stamps_ns.append(frame.stamp_ns)
        self._frame_numbers.append(0)
        self._update(graph, values)

    def predict(self, stamp_ns: int) -> FilterState:
        """Predict the state at a later stamp by the IMU; nothing is changed.

        Raises
        ------
        ValueError
            When the IMU log does not reach so far.
        """
        return filter_state.propagate(self.state, self._descent, self._stamps_ns[-1], stamp_ns)

    def update(self, frame: FrameMeasurement) -> None:
        """Take the next frame: new states up to it, its measurements, one iSAM2 update.

        Raises
        ------
        EstimationError
            When the frame is not later than the last one.
        """
        begin_ns = self._stamps_ns[-1]
        if frame.stamp_ns <= begin_ns:
            raise EstimationError(f"frame at {frame.stamp_ns} ns is not later than {begin_ns} ns")
        graph = gtsam.NonlinearFactorGraph()
        values = gtsam.Values()
        state = self.state
        for end_ns in state_stamps(begin_ns, frame.stamp_ns, self._options.keyframe_s):
            ahead = filter_state.propagate(state, self._descent, begin_ns, int(end_ns))
            midpoint = 0.5 * (state.gTb[:3, 3] + ahead.gTb[:3, 3])
            add_imu(graph, self._descent, self._last, begin_ns, int(end_ns), midpoint, state.bias)
            self._last += 1
            insert_state(values, self._last, gtsam.NavState(gtsam.Pose3(ahead.gTb), ahead.gV), ahead.bias)
            state, begin_ns = ahead, int(end_ns)
        add_frame(graph, self._descent, self._options, X(self._last), frame)
        self._stamps_ns.append(frame.stamp_ns)
        self._frame_numbers.append(self._last)
        self._update(graph, values)

    def _update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        key = X(self._last)
        self._isam.update(graph, values)
        if self._hold is None:
            self._hold = self._isam.getLinearizationPoint()
        position = self._isam.calculateEstimatePose3(key).translation()
        for _ in range(MAX_EXTRA_UPDATES):
            self._isam.update()
            moved = self._isam.calculateEstimatePose3(key).translation()
            if np.linalg.norm(moved - position) < SETTLED_M:
                break
            position = moved
        self._states.append(self._newest())

    def _newest(self) -> FilterState:
        n = self._last
        gTb = np.ascontiguousarray(self._isam.calculateEstimatePose3(X(n)).matrix())
        bias = bias_vector(self._isam.calculateEstimateConstantBias(B(n)))
        joint = self._isam.jointMarginalCovariance([X(n), V(n), B(n)]).fullMatrix()
        # GTSAM: rotation, translation in b, velocity, accelerometer bias, gyro bias.
        T = np.zeros((strapdown.SIZE, 15))
        T[strapdown.ATTITUDE, 0:3] = np.eye(3)
        T[strapdown.POSITION, 3:6] = gTb[:3, :3]
        T[strapdown.VELOCITY, 6:9] = np.eye(3)
        T[strapdown.ACCELEROMETER_BIAS, 9:12] = np.eye(3)
        T[strapdown.GYRO_BIAS, 12:15] = np.eye(3)
        T[strapdown.RATE, 12:15] = -np.eye(3)
        row = int(np.searchsorted(self._descent.imu.stamps_ns, self._stamps_ns[-1]))
        rate = self._descent.imu.gyro[min(row, len(self._descent.imu.gyro) - 1)] - bias[:3]
        gV = self._isam.calculateEstimateVector(V(n))
        return FilterState(gTb, gV, rate, bias, T @ joint @ T.T)

    def filtered(self) -> Trajectory:
        """Estimates at every frame so far, each from the data up to its frame."""
        return filter_state.trajectory(self._stamps_ns, self._states)

    def smoothed_values(self) -> gtsam.Values:
        """Estimates of all states from all data so far."""
        return self._isam.calculateEstimate()


class OnlineSmoother:
    """iSAM2 over a whole descent; the estimate at a frame uses the data up to it.

    Parameters
    ----------
    options : GraphOptions
    """

    name = "online"

    def __init__(self, options: GraphOptions = GraphOptions()) -> None:
        self.options = options

    def run(self, problem: Problem) -> OnlineSession:
        """Feed all frames to a session."""
        session = OnlineSession(problem, self.options)
        session.begin(problem.frames[0], problem.start)
        for frame in problem.frames[1:]:
            session.update(frame)
        return session

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate the state at every frame from the data up to it."""
        return self.run(problem).filtered()
