"""A session of the online smoother: iSAM2, frame by frame."""

import math
from array import array
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.correlated_errors import SHARED_LETTER, RimErrorStates
from craternav_fg.estimators.elimination import APART_LETTER, INDEX_BITS, INDEX_MASK
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.graph import (
    FactorGraph,
    GraphOptions,
    ImuInterval,
    RimVariables,
    add_frame,
    add_imu,
    add_prior,
    insert_state,
    state_stamps,
)
from craternav_fg.estimators.incremental import RELINEARISE_M, FixedLagIsam, Isam
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.motion import add_motion, longest_interval_s
from craternav_fg.estimators.newest_state import newest_state
from craternav_fg.estimators.point_features import SETTLED_ATTITUDE_RAD, FeatureStates
from craternav_fg.estimators.sensor_bank import (
    SensorBank,
    add_sensors,
    innovation_weights,
)
from craternav_fg.estimators.state_log import StateLog
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray
from factors.imu import INTEGRATION_VARIANCE
from factors.kernels import strapdown

# Shift of a midpoint below which gravity is not re-evaluated: on the Moon it changes by 1e-6 m/s^2 a metre.
MIDPOINT_TOLERANCE_M = 10.0
# Nor is it while the corrections since the last time are below this share of the position's sigma: a shift of
# 100 m is 1e-4 m/s^2, half a metre in 100 s. Linearising all IMU factors again costs more than all else.
GRAVITY_SHIFT_SIGMAS = 0.3
# A wide prior makes the first frames nonlinear: iterate until the newest position moves by less than this, or
# than this share of the altitude. The remaining error is smaller by that share again.
SETTLED_POSITION_M = 5.0
SETTLED_ALTITUDE_SHARE = 1e-3
# Shift, as a share of the altitude, at which a pose is relinearised; smaller, as the altitude falls while a
# tree lives.
RELINEARISE_ALTITUDE_SHARE = 3e-4
# Share of the position's sigma by which integration is uncertain after a second, at least, growing with the
# square root of the time: 1e-5 of that sigma in minutes. Stiffer IMU factors cost the covariances digits by
# Cholesky factorisation: with a position known to 400 m, all but two.
INTEGRATION_SHARE = 3e-6
# iSAM2 iterations at a frame after the first.
MAX_EXTRA_UPDATES = 5


class OnlineSession:
    """An iSAM2 smoother that takes one frame after the other.

    Call `begin` with the first frame, then `predict` and `update` for each later one; or `run`.

    Parameters
    ----------
    descent : Descent
    options : GraphOptions
    solver : Isam, optional
        Over all states when it is not given.
    keep_past : bool
        Whether a solver that is not given keeps all states for `smoothed_values`: memory then grows.
    """

    def __init__(
        self,
        descent: Descent,
        options: GraphOptions = GraphOptions(),
        solver: Isam | None = None,
        *,
        keep_past: bool = False,
    ) -> None:
        self._descent = descent
        self._bank = SensorBank(descent.sensors)
        tracks = descent.features
        self._features = None if tracks is None else FeatureStates(tracks, descent.camera)
        self._options = options
        if solver is None:
            # Without an IMU nobody knows the stiffness of what ties states, and so the digits that are lost.
            solver = Isam(
                self._relinearise_m(descent.initial.gTb),
                keep_past=keep_past,
                qr_alone=descent.motion is not None,
            )
        self._solver = solver
        self._last = 0
        self._errors = None
        if options.rim_error_states is not None:
            # A lag bounds the tree by itself.
            self._errors = RimErrorStates(
                options.rim_error_states, renewed=not isinstance(solver, FixedLagIsam)
            )
        self._frame_states = array("q")
        self._stamp_ns = descent.initial.stamp_ns
        self._newest: FilterState | None = None
        self._ended = ""
        self._log = StateLog(len(self._bank.sigmas))
        # With slots of this one of the solver's trees.
        self._intervals: list[ImuInterval] = []
        self._tree_of_slots = self._solver.trees
        self._corrected = np.zeros(3)

    @property
    def frame_state_indices(self) -> list[int]:
        """Indices of the graph's states that belong to frames."""
        return list(self._frame_states)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest frame, ns."""
        return self._stamp_ns

    @property
    def state(self) -> FilterState:
        """Estimate at the newest frame, from all data up to it.

        Its covariance refers to the error state of `factors.kernels.strapdown`.

        Raises
        ------
        EstimationError
            Before `begin`, and when the session has ended, see `update`.
        """
        if self._ended:
            raise EstimationError(self._ended)
        if self._newest is None:
            raise EstimationError("the session has no frame yet: call begin")
        return self._newest

    @property
    def states(self) -> list[FilterState]:
        """Estimates at every frame so far, each from the data up to its frame."""
        return self._log.states()

    def begin(self, frame: FrameMeasurement, start: Start) -> None:
        """Take the first frame.

        Parameters
        ----------
        frame : FrameMeasurement
            At the initial state's stamp.
        start : Start
            Linearisation point when it is at this frame; no further measurement.
        """
        graph = FactorGraph()
        values = gtsam.Values()
        initial = self._descent.initial
        add_prior(graph, initial)
        gTb = start.gTb if start.frame == 0 else initial.gTb
        variables = RimVariables(values, self._errors)
        add_frame(graph, self._descent, self._options, X(0), frame, variables=variables, near=gTb)
        samples = self._bank.at(frame.stamp_ns)
        weights = innovation_weights(samples, filter_state.prior(self._descent), frame.stamp_ns)
        add_sensors(graph, values, self._descent, samples, 0, frame.stamp_ns, weights=weights)
        insert_state(values, 0, gtsam.NavState(gtsam.Pose3(gTb), initial.gV), np.zeros(6))
        self._update(graph, values, 0, frame.stamp_ns)

    def begin_late(self, problem: Problem) -> None:
        """Take the frames up to the start's, the first with rims, at once.

        Frame by frame the IMU would lead a poor prior so far from that frame that no step from there finds
        back. Here all is linearised about the trajectory that leads to the start.

        Parameters
        ----------
        problem : Problem
            Its start is at a later frame than the first.
        """
        frames = problem.frames[: problem.start.frame + 1]
        states = filter_state.states_through_start(problem)
        graph, values = FactorGraph(), gtsam.Values()
        add_prior(graph, self._descent.initial)
        variables, near = RimVariables(values, self._errors), states[0].gTb
        add_frame(graph, self._descent, self._options, X(0), frames[0], variables=variables, near=near)
        begin = gtsam.NavState(gtsam.Pose3(states[0].gTb), states[0].gV)
        insert_state(values, 0, begin, states[0].bias)
        samples = self._bank.at(frames[0].stamp_ns)
        weights = innovation_weights(samples, states[0], frames[0].stamp_ns)
        add_sensors(graph, values, self._descent, samples, 0, frames[0].stamp_ns, weights=weights)
        last = 0
        for k, before in enumerate(self._states_without_rims(problem, frames[:-1])):
            begin_ns = frames[k].stamp_ns
            self._log.append(begin_ns, before)
            self._frame_states.append(last)
            last = self._extend(graph, values, states[k], last, begin_ns, frames[k + 1], states[k + 1])
        self._update(graph, values, last, frames[-1].stamp_ns)

    def run(self, problem: Problem) -> None:
        """Take all frames of a problem.

        Parameters
        ----------
        problem : Problem
            Of the session's descent.
        """
        first = problem.start.frame
        if first:
            self.begin_late(problem)
        else:
            self.begin(problem.frames[0], problem.start)
        for frame in problem.frames[first + 1 :]:
            self.update(frame)

    def _states_without_rims(
        self, problem: Problem, frames: Sequence[FrameMeasurement]
    ) -> Sequence[FilterState]:
        """Give the estimates at frames before the start, each from the data up to it."""
        if not self._descent.sensors:
            return filter_state.propagated_prior(self._descent, frames)
        session = OnlineSession(self._descent, self._options)
        session.begin(frames[0], problem.start)
        for frame in frames[1:]:
            session.update(frame)
        return session.states

    def predict(self, stamp_ns: int) -> FilterState:
        """Predict the state at a later stamp by the IMU; the session does not change.

        Parameters
        ----------
        stamp_ns : int

        Returns
        -------
        FilterState

        Raises
        ------
        ValueError
            When the IMU log does not cover the interval.
        """
        return filter_state.propagate(self.state, self._descent, self._stamp_ns, stamp_ns)

    def update(self, frame: FrameMeasurement) -> None:
        """Take the next frame: new states up to it, its measurements, one iSAM2 update.

        Parameters
        ----------
        frame : FrameMeasurement

        Raises
        ------
        EstimationError
            When the frame is not later than the last one, or its factors cannot be evaluated. The session
            then continues without the frame. When the frame is taken and its state cannot be computed, the
            session has ended: it refuses all later frames by the same error.
        """
        self._solver.relinearise_m = self._relinearise_m(self.state.gTb)
        begin_ns = self._stamp_ns
        if frame.stamp_ns <= begin_ns:
            raise EstimationError(f"frame at {frame.stamp_ns} ns is not later than {begin_ns} ns")
        graph = FactorGraph()
        values = gtsam.Values()
        # The next frame takes the index of one that fails: no variable or observation of it may be left.
        features = self._features and self._features.copy()
        if self._errors is not None:
            self._errors.mark()
        try:
            last = self._extend(graph, values, self.state, self._last, begin_ns, frame)
            self._add_features(graph, values, last, frame.stamp_ns)
            self._update(graph, values, last, frame.stamp_ns)
        except Exception:
            if self._errors is not None:
                self._errors.take_back()
            self._features = features
            raise

    def _extend(
        self, graph: FactorGraph, values: gtsam.Values, state: FilterState, last: int, begin_ns: int,
        frame: FrameMeasurement, reached: FilterState | None = None,
    ) -> int:  # fmt: skip
        """Add the states from one frame to the next, the next one's measurements, and give its index.

        The values are predicted by the IMU; at the next frame they are those of `reached`, if it is given.
        """
        longest_s = longest_interval_s(self._descent, self._options)
        for end_ns in state_stamps(begin_ns, frame.stamp_ns, longest_s):
            rows = self._descent.imu.between(begin_ns, int(end_ns))
            ahead = filter_state.propagate_through(state, self._descent, rows, int(end_ns))
            if self._descent.motion is not None:
                here = state.gTb, state.gV, state.bias
                add_motion(graph, self._descent, last, begin_ns, int(end_ns), here)
            else:
                midpoint = 0.5 * (state.gTb[:3, 3] + ahead.gTb[:3, 3])
                variance = INTEGRATION_VARIANCE
                if self._errors is not None and self._solver.may_use_cholesky:
                    variance = max(variance, INTEGRATION_SHARE**2 * _position_variance(ahead))
                add_imu(
                    graph, self._descent, last, begin_ns, int(end_ns), midpoint, state.bias, rows, variance
                )
            if reached is not None and end_ns == frame.stamp_ns:
                ahead = reached
            last += 1
            insert_state(values, last, gtsam.NavState(gtsam.Pose3(ahead.gTb), ahead.gV), ahead.bias)
            state, begin_ns = ahead, int(end_ns)
        # At the prediction and no later pose: the rims' weights must not depend on what they measured.
        frame = with_predicted_covariances(frame, state.gTb, self._descent.camera, self._descent.catalog)
        variables = RimVariables(values, self._errors, self._solver.tree.valueExists)
        add_frame(graph, self._descent, self._options, X(last), frame, variables=variables, near=state.gTb)
        samples = self._bank.at(frame.stamp_ns)
        if samples:
            weights = innovation_weights(samples, state, frame.stamp_ns)
            holds = self._solver.tree.valueExists
            add_sensors(graph, values, self._descent, samples, last, frame.stamp_ns, holds, weights)
        return last

    def _add_features(self, graph: FactorGraph, values: gtsam.Values, index: int, stamp_ns: int) -> None:
        """Add the factors of tracked points at a frame."""
        if self._features is None:
            return
        attitude = self.state.covariance[strapdown.ATTITUDE, strapdown.ATTITUDE]
        if np.diag(attitude).max() > SETTLED_ATTITUDE_RAD**2:
            return
        tree = self._solver.tree

        def pose(key: int) -> FloatArray | None:
            if values.exists(key):
                return np.asarray(values.atPose3(key).matrix())
            return np.asarray(tree.calculateEstimatePose3(key).matrix()) if tree.valueExists(key) else None

        def point(key: int) -> FloatArray | None:
            return np.asarray(tree.calculateEstimatePoint3(key)) if tree.valueExists(key) else None

        self._features.enter(graph, values, int(X(index)), stamp_ns, pose, point)

    def _update(self, graph: FactorGraph, values: gtsam.Values, last: int, stamp_ns: int) -> None:
        """Update the solver, and complete the frame or end the session.

        From then on the solver holds the frame's variables: a session that did not would give their keys to
        the next frame.
        """
        predicted = values.atPose3(X(last)).translation()
        self._add(graph, values, stamp_ns)
        try:
            pose = self._settle(predicted, last, stamp_ns)
            ahead = graph.intervals[-1] if graph.intervals else None
            state = newest_state(self._solver, self._descent, self._bank, last, stamp_ns, pose, ahead)
            self._log.append(stamp_ns, state)
            self._newest, self._last, self._stamp_ns = state, last, stamp_ns
            self._frame_states.append(last)
        except BaseException as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            self._ended = f"the session has ended: no state at the frame of {stamp_ns} ns: {reason}"
            if not isinstance(error, Exception):
                raise
            raise EstimationError(self._ended) from error

    def _settle(self, predicted: FloatArray, last: int, stamp_ns: int) -> gtsam.Pose3 | None:
        """Iterate until the newest position, which was predicted, moves no more; then move the gravity.

        Returns the newest pose, unless it has moved since it was read.
        """
        position, pose = predicted, None
        # A failure here is taken back: the frame is in, linearised less accurately.
        with suppress(EstimationError):
            settled_m = max(SETTLED_POSITION_M, SETTLED_ALTITUDE_SHARE * self._altitude_m(predicted))
            for _ in range(MAX_EXTRA_UPDATES):
                pose = self._solver.tree.calculateEstimatePose3(X(last))
                moved = pose.translation()
                if math.dist(moved, position) < settled_m:
                    break
                position, pose = moved, None
                self._solver.again()
            self._corrected = self._corrected + position - predicted
            shift_m = math.hypot(*self._corrected)
            if shift_m > MIDPOINT_TOLERANCE_M and shift_m > GRAVITY_SHIFT_SIGMAS * self._position_sigma_m():
                pose = None
                self._move_gravity(stamp_ns)
                self._corrected = np.zeros(3)
        return pose

    def _add(self, graph: FactorGraph, values: gtsam.Values, stamp_ns: int, drop: Sequence[int] = ()) -> None:
        """Update the solver; the graph begins with the factors of its intervals."""
        time_s = 1e-9 * (stamp_ns - self._descent.initial.stamp_ns)
        slots: list[int] = []
        try:
            slots = self._solver.update(graph, values, time_s, drop)
        finally:
            self._forget_void_slots()
            self._intervals += [
                ImuInterval(one.index, one.midpoint, one.pim, one.params, slot)
                for one, slot in zip(graph.intervals, slots, strict=False)
            ]
            # Those that have left the solver's lag.
            while self._intervals and not self._solver.tree.valueExists(X(self._intervals[0].index)):
                del self._intervals[0]

    def _forget_void_slots(self) -> None:
        """Forget the intervals of a tree that has been replaced: their factors keep their gravity."""
        if self._tree_of_slots != self._solver.trees:
            self._intervals.clear()
            self._tree_of_slots = self._solver.trees

    def _move_gravity(self, stamp_ns: int) -> None:
        """Evaluate the gravity of IMU factors where their states now are, and linearise them again."""
        self._forget_void_slots()
        tree = self._solver.tree
        factors = tree.getFactorsUnsafe()
        graph = FactorGraph()
        kept, drop = [], []
        there = [one for one in self._intervals if tree.valueExists(X(one.index))]
        # Neighbouring intervals share a state.
        indices = {index for one in there for index in (one.index, one.index + 1)}
        positions = {index: tree.calculateEstimatePose3(X(index)).translation() for index in indices}
        for one in there:
            midpoint = 0.5 * (positions[one.index] + positions[one.index + 1])
            if math.dist(midpoint, one.midpoint) < MIDPOINT_TOLERANCE_M:
                kept.append(one)
                continue
            graph.push_back(factors.at(one.slot))
            graph.intervals.append(one.with_gravity_at(self._descent.body, midpoint))
            drop.append(one.slot)
        self._intervals = kept
        if drop:
            self._add(graph, gtsam.Values(), stamp_ns, drop)

    def _relinearise_m(self, gTb: FloatArray) -> float:
        return max(RELINEARISE_M, RELINEARISE_ALTITUDE_SHARE * self._altitude_m(gTb[:3, 3]))

    def _altitude_m(self, gP: FloatArray) -> float:
        """Altitude above the sphere: for one point, numpy takes ten times as long."""
        return math.hypot(*gP.tolist()) - self._descent.body.radius_m

    def _position_sigma_m(self) -> float:
        """Return the standard deviation of the position at the last frame."""
        if self._newest is None:
            return float(np.sqrt(3.0) * self._descent.initial.position_sigma_m)
        return math.sqrt(_position_variance(self._newest))

    def filtered(self) -> Trajectory:
        """Estimates at every frame so far, each from the data up to its frame."""
        found = self._log.trajectory()
        return found if self._newest is None else replace(found, calibrated=self._bank.of_state(self._newest))

    def smoothed_values(self) -> gtsam.Values:
        """Estimates of all states that the solver keeps, from all data so far (see `Isam`).

        Of the error that all rims share, one variable stands for those that renew it.
        """
        values = self._solver.estimate()
        for key in values.keys():  # noqa: SIM118 (Values is no mapping)
            letter = chr(key >> INDEX_BITS)
            if letter == APART_LETTER or (letter == SHARED_LETTER and key & INDEX_MASK):
                values.erase(key)
        return values


def _position_variance(state: FilterState) -> float:
    """Sum of the variances along the axes, m^2."""
    return float(np.trace(state.covariance[strapdown.POSITION, strapdown.POSITION]))
