"""State of a recursive filter: mean and covariance, propagation by the IMU, corrections."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from craternav_fg import frames
from craternav_fg.estimators import filter_kernel
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.imu import ImuRows
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.motion.model import Motion
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray
from factors.kernels import strapdown
from factors.kernels.strapdown import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    RATE,
    SIZE,
    VELOCITY,
)

POSE = slice(0, 6)
# Share of the variance of a motion model's angular velocity that is added to keep covariances regular.
_RATE_REGULARISATION = 1e-6
# Iterations of the trajectory to the start at most, change of a state, over its sigma, at which they end, and
# share of the prior's offset by which its effect at the start is found.
_START_STEPS, _SETTLED_SIGMAS, _DIFFERENCE = 10, 0.01, 1e-3
BIAS = slice(12, 18)
_RATES = np.arange(RATE.start, RATE.stop)


@dataclass(frozen=True)
class FilterState:
    """Mean and covariance of the lander's state.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    rate : ndarray, shape (3,)
        Inertial angular velocity in b, rad/s.
    bias : ndarray, shape (6,)
        Gyro (rad/s), accelerometer (m/s^2), in b.
    covariance : ndarray, shape (18 + b, 18 + b)
        Covariance of the errors of attitude (rotation vector in b, R_true = R exp(phi)), position and
        velocity (in g), angular velocity (in b), gyro bias, accelerometer bias, sensors' biases; truth minus
        mean.
    sensor_bias : ndarray, shape (b,)
        Biases of the sensors beside the IMU, each in its sensor's unit.
    """

    gTb: FloatArray
    gV: FloatArray
    rate: FloatArray
    bias: FloatArray
    covariance: FloatArray
    sensor_bias: FloatArray = field(default_factory=lambda: np.empty(0))

    def corrected(self, delta: FloatArray, covariance: FloatArray) -> "FilterState":
        """Correct the mean by an error-state vector.

        Parameters
        ----------
        delta : ndarray, shape (18 + b,)
            Correction, in the units of the error state.
        covariance : ndarray, shape (18 + b, 18 + b)
            Covariance of the error about `delta`, in the coordinates of this state.

        Returns
        -------
        FilterState
            Its covariance refers to the corrected attitude.
        """
        gTb, reset = filter_kernel.corrected(self.gTb, covariance, delta)
        return FilterState(
            gTb,
            self.gV + delta[VELOCITY],
            self.rate + delta[RATE],
            self.bias + delta[BIAS],
            reset,
            self.sensor_bias + delta[SIZE:],
        )

    def minus(self, reference: "FilterState") -> FloatArray:
        """Difference of two means in the error state.

        Parameters
        ----------
        reference : FilterState

        Returns
        -------
        ndarray, shape (18 + b,)
            Error-state vector that takes the reference's mean to this one's.
        """
        return np.concatenate(
            [
                frames.rotation_log(reference.gTb[:3, :3].T @ self.gTb[:3, :3]),
                self.gTb[:3, 3] - reference.gTb[:3, 3],
                self.gV - reference.gV,
                self.rate - reference.rate,
                self.bias - reference.bias,
                self.sensor_bias - reference.sensor_bias,
            ]
        )


def prior(descent: Descent) -> FilterState:
    """State at the first frame, before any measurement."""
    initial = descent.initial
    biases = np.concatenate([np.empty(0), *(sensor.bias_sigmas for sensor in descent.sensors)])
    covariance = np.zeros((SIZE + len(biases), SIZE + len(biases)))
    covariance[SIZE:, SIZE:] = np.diag(biases**2)
    for part, sigma in (
        (ATTITUDE, initial.attitude_sigma_rad),
        (POSITION, initial.position_sigma_m),
        (VELOCITY, initial.velocity_sigma_m_s),
        (RATE, initial.angular_velocity_sigma_rad_s),
        (GYRO_BIAS, initial.gyro_bias_sigma_rad_s),
        (ACCELEROMETER_BIAS, initial.accelerometer_bias_sigma_m_s2),
    ):
        covariance[part, part] = sigma**2 * np.eye(3)
    first = int(np.searchsorted(descent.imu.stamps_ns, initial.stamp_ns))
    return FilterState(
        np.array(initial.gTb, dtype=np.float64),
        np.array(initial.gV, dtype=np.float64),
        np.array(descent.imu.gyro_rad_s[min(first, len(descent.imu.gyro_rad_s) - 1)]),
        np.zeros(6),
        covariance,
        np.zeros(len(biases)),
    )


def propagated_prior(descent: Descent, frames: Sequence[FrameMeasurement]) -> list[FilterState]:
    """States at frames: the prior at the first, propagated by the IMU alone."""
    return _propagated(prior(descent), descent, frames)


def states_to_start(problem: Problem) -> list[FilterState]:
    """States at the frames up to the start's: the prior propagated by the IMU, then the start.

    The start gives the pose; velocity and biases follow from their correlation with the pose in the prior.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    list of FilterState

    Raises
    ------
    ValueError
        When the IMU log does not cover the frames.
    """
    before = propagated_prior(problem, problem.frames[: problem.start.frame])
    return [*before[: problem.start.frame], states_through_start(problem)[-1]]


def states_through_start(problem: Problem) -> list[FilterState]:
    """States at the frames up to the start's, on the trajectory that the IMU leads to the start.

    After minutes without rims, an attitude that is off by 25 deg has led the prior's mean far away. What the
    start tells of the velocity is linearised about this trajectory instead, found by iteration.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    list of FilterState
        The last one has the start's distribution; the covariances of the others are the prior's.

    Raises
    ------
    ValueError
        When the IMU log does not cover the frames.
    """
    start, before = problem.start, problem.frames[: problem.start.frame + 1]
    expected = prior(problem)
    states, offset = _propagated(expected, problem, before), np.zeros(len(expected.covariance))
    found = _conditioned(states[-1], offset, start.gTb, start.pose_covariance)
    for _ in range(_START_STEPS if start.frame else 0):
        origin = _moved_alike(states[0], states[-1], found)
        origin = expected.corrected(origin.minus(expected), expected.covariance)
        states = _propagated(origin, problem, before)
        # The prior's mean, in the error state of this trajectory.
        away = _DIFFERENCE * expected.minus(origin)
        shifted = _propagated(origin.corrected(away, origin.covariance), problem, before)[-1]
        offset = shifted.minus(states[-1]) / _DIFFERENCE
        previous, found = found, _conditioned(states[-1], offset, start.gTb, start.pose_covariance)
        sigma = np.sqrt(np.diag(found.covariance))
        if (np.abs(found.minus(previous)) < _SETTLED_SIGMAS * sigma).all():
            break
    return [*states[:-1], found]


def _propagated(
    state: FilterState, descent: Descent, frames: Sequence[FrameMeasurement]
) -> list[FilterState]:
    states = [state]
    for before, frame in itertools.pairwise(frames):
        states.append(propagate(states[-1], descent, before.stamp_ns, frame.stamp_ns))
    return states


def _moved_alike(first: FilterState, last: FilterState, wanted: FilterState) -> FilterState:
    """Move a first state so that the IMU, which led it to `last`, leads it near `wanted`."""
    gTb = first.gTb.copy()
    gTb[:3, :3] = wanted.gTb[:3, :3] @ last.gTb[:3, :3].T @ first.gTb[:3, :3]
    gTb[:3, 3] += wanted.gTb[:3, 3] - last.gTb[:3, 3]
    return replace(
        first,
        gTb=gTb,
        gV=first.gV + wanted.gV - last.gV,
        rate=first.rate + wanted.rate - last.rate,
        bias=wanted.bias,
        sensor_bias=wanted.sensor_bias,
    )


def _conditioned(
    state: FilterState, offset: FloatArray, gTb: FloatArray, pose_covariance: FloatArray
) -> FilterState:
    """Replace the pose's distribution; the other states keep their distribution given the pose.

    The state's distribution is about its mean moved by `offset`.
    """
    step = np.concatenate(
        [
            frames.rotation_log(state.gTb[:3, :3].T @ gTb[:3, :3]),
            gTb[:3, 3] - state.gTb[:3, 3],
        ]
    )
    P = state.covariance
    rest = slice(POSE.stop, len(P))
    gain = np.linalg.solve(P[POSE, POSE], P[POSE, rest]).T
    delta = offset[rest] + gain @ (step - offset[POSE])
    S = np.empty_like(P)
    S[POSE, POSE] = pose_covariance
    S[rest, POSE] = gain @ pose_covariance
    S[POSE, rest] = S[rest, POSE].T
    S[rest, rest] = P[rest, rest] + gain @ (pose_covariance - P[POSE, POSE]) @ gain.T
    return FilterState(
        np.array(gTb, dtype=np.float64),
        state.gV + delta[:3],
        state.rate + delta[3:6],
        state.bias + delta[6:12],
        0.5 * (S + S.T),
        state.sensor_bias + delta[12:],
    )


def propagate(state: FilterState, descent: Descent, begin_ns: int, end_ns: int) -> FilterState:
    """Propagate a state over an interval by the IMU alone.

    Parameters
    ----------
    state : FilterState
    descent : Descent
    begin_ns, end_ns : int
        The interval.

    Returns
    -------
    FilterState

    Raises
    ------
    ValueError
        When the IMU log does not cover the interval.
    """
    return propagate_through(state, descent, descent.imu.between(begin_ns, end_ns), end_ns)


def propagate_through(state: FilterState, descent: Descent, rows: ImuRows, end_ns: int) -> FilterState:
    """Propagate a state through rows of the IMU log.

    Parameters
    ----------
    state : FilterState
    descent : Descent
    rows : (ndarray, ndarray, ndarray)
        What `ImuLog.between` gives.
    end_ns : int
        Stamp at which they end.

    Returns
    -------
    FilterState
    """
    row_s = descent.imu.row_s(end_ns)
    if descent.motion is not None:
        return _moved(state, descent, descent.motion, rows[:2], row_s)
    body = descent.body.mu_m3_s2, np.array(descent.body.spin_rad_s)
    densities = descent.imu_noise.densities
    core = np.ascontiguousarray(state.covariance[:SIZE, :SIZE])
    gTb, gV, rate, covariance = strapdown.propagate(
        state.gTb, state.gV, state.bias, core, *rows, *body, densities, row_s
    )
    if len(state.sensor_bias):
        whole = np.empty_like(state.covariance)
        whole[:SIZE, :SIZE], whole[SIZE:, SIZE:] = covariance, state.covariance[SIZE:, SIZE:]
        F, _ = strapdown.transition(state.gTb, state.gV, state.bias, *rows, *body, densities)
        cross = np.zeros((SIZE, len(state.sensor_bias)))
        cross[strapdown.WITHOUT_RATE] = F @ state.covariance[strapdown.WITHOUT_RATE, SIZE:]
        cross[RATE] = -cross[GYRO_BIAS]
        whole[:SIZE, SIZE:], whole[SIZE:, :SIZE] = cross, cross.T
        covariance = whole
    return FilterState(gTb, gV, rate, state.bias, covariance, state.sensor_bias)


def _moved(
    state: FilterState, descent: Descent, motion: Motion, rows: tuple[FloatArray, FloatArray], row_s: float
) -> FilterState:
    """Propagate a state by a motion model; the angular velocity is that of the last row less the bias."""
    of = state.gTb, state.gV, state.bias
    gTb, gV, F, Q = motion.transition(descent.body, of, rows, descent.imu_noise)
    whole = np.eye(len(state.covariance))
    kept = strapdown.WITHOUT_RATE
    whole[np.ix_(kept, kept)] = F
    whole[RATE] = -whole[GYRO_BIAS]
    covariance = whole @ state.covariance @ whole.T
    added = np.zeros_like(covariance)
    added[np.ix_(kept, kept)] = Q
    added[RATE], added[:, RATE] = -added[GYRO_BIAS], -added[:, GYRO_BIAS]
    added[RATE, RATE] = added[GYRO_BIAS, GYRO_BIAS]
    # The noise of the last row's mean rate is also in what that row turned until the end.
    variance, dt_s = descent.imu_noise.gyro_density_rad_s_sqrt_hz**2, rows[0][-1]
    shared = -variance * dt_s / row_s * motion.gyro_entry(gTb, gV)
    shared[POSITION] = 0.5 * dt_s * shared[VELOCITY]
    added[np.ix_(kept, _RATES)] += shared
    added[np.ix_(_RATES, kept)] += shared.T
    added[RATE, RATE] += variance / row_s * np.eye(3)
    covariance = covariance + added
    # Without a gyro's noise the angular velocity is known from its bias, and the covariance is singular.
    covariance[RATE, RATE] += _RATE_REGULARISATION * np.diag(np.diag(covariance[GYRO_BIAS, GYRO_BIAS]))
    rate = rows[1][-1] - state.bias[:3]
    return FilterState(gTb, gV, rate, state.bias, 0.5 * (covariance + covariance.T), state.sensor_bias)


def trajectory(stamps_ns: Sequence[int], states: Sequence[FilterState]) -> Trajectory:
    """Gather a filter's states, one per stamp, as a trajectory."""
    covariances = np.array([state.covariance for state in states])
    return Trajectory(
        stamps_ns=np.array(stamps_ns, dtype=np.int64),
        gTb=np.array([state.gTb for state in states]),
        gV=np.array([state.gV for state in states]),
        bias=np.array([state.bias for state in states]),
        pose_covariance=covariances[:, POSE, POSE],
        velocity_covariance=covariances[:, VELOCITY, VELOCITY],
        bias_covariance=covariances[:, BIAS, BIAS],
    )
