"""State of a recursive filter: mean, covariance, propagation by the IMU, and small corrections."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory
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

FloatArray = npt.NDArray[np.float64]

POSE = slice(0, 6)
BIAS = slice(12, 18)


@dataclass(frozen=True)
class FilterState:
    """Mean and covariance of the lander's state.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    rate : ndarray, shape (3,)
        Inertial angular velocity in b, rad/s.
    bias : ndarray, shape (6,)
        Gyro (rad/s), accelerometer (m/s^2).
    covariance : ndarray, shape (18, 18)
        Of the errors of attitude (rotation vector in b, R_true = R exp(phi)), position and velocity
        (in g), angular velocity (in b), gyro bias, accelerometer bias; truth minus mean.
    """

    gTb: FloatArray
    gV: FloatArray
    rate: FloatArray
    bias: FloatArray
    covariance: FloatArray

    def moved(self, delta: FloatArray, covariance: FloatArray) -> "FilterState":
        """Correct the mean by an error-state vector (18,).

        `covariance` (18, 18) is that of the error about `delta`, in the coordinates of this state; the
        result's refers to the corrected attitude.
        """
        gTb = self.gTb.copy()
        gTb[:3, :3] = self.gTb[:3, :3] @ frames.rotation_exp(delta[ATTITUDE])
        gTb[:3, 3] += delta[POSITION]
        J = right_jacobian(delta[ATTITUDE])
        reset = covariance.copy()
        reset[ATTITUDE] = J @ reset[ATTITUDE]
        reset[:, ATTITUDE] = reset[:, ATTITUDE] @ J.T
        return FilterState(
            gTb,
            self.gV + delta[VELOCITY],
            self.rate + delta[RATE],
            self.bias + delta[BIAS],
            0.5 * (reset + reset.T),
        )

    def minus(self, reference: "FilterState") -> FloatArray:
        """Error-state vector (18,) that moves the reference's mean to this one's."""
        return np.concatenate(
            [
                frames.rotation_log(reference.gTb[:3, :3].T @ self.gTb[:3, :3]),
                self.gTb[:3, 3] - reference.gTb[:3, 3],
                self.gV - reference.gV,
                self.rate - reference.rate,
                self.bias - reference.bias,
            ]
        )


def right_jacobian(w: FloatArray) -> FloatArray:
    """Jacobian (3, 3) with exp(w + d) = exp(w) exp(J d) for small d."""
    angle2 = float(w @ w)
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    if angle2 < 1e-8:
        return np.asarray(np.eye(3) - 0.5 * W + W @ W / 6.0)
    angle = np.sqrt(angle2)
    return np.asarray(
        np.eye(3) - (1.0 - np.cos(angle)) / angle2 * W + (angle - np.sin(angle)) / angle2 / angle * W @ W
    )


def prior(descent: Descent) -> FilterState:
    """State at the first frame, before it is looked at."""
    initial = descent.initial
    covariance = np.zeros((SIZE, SIZE))
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
        np.array(descent.imu.gyro[min(first, len(descent.imu.gyro) - 1)]),
        np.zeros(6),
        covariance,
    )


def carried_prior(descent: Descent, frames: Sequence[FrameMeasurement]) -> list[FilterState]:
    """States at frames: the prior at the first, carried on by the IMU alone."""
    states = [prior(descent)]
    for before, frame in itertools.pairwise(frames):
        states.append(propagate(states[-1], descent, before.stamp_ns, frame.stamp_ns))
    return states


def until_start(problem: Problem) -> list[FilterState]:
    """States at the frames up to the start's: the prior carried on by the IMU, then the start.

    The start gives the pose; velocity and biases follow it as far as the prior ties them to the pose.
    """
    states = carried_prior(problem, problem.frames[: problem.start.frame + 1])
    states[-1] = _conditioned(states[-1], problem.start.gTb, problem.start.pose_covariance)
    return states


def _conditioned(state: FilterState, gTb: FloatArray, pose_covariance: FloatArray) -> FilterState:
    """Replace the pose's distribution; what is left keeps its distribution given the pose."""
    step = np.concatenate(
        [
            frames.rotation_log(state.gTb[:3, :3].T @ gTb[:3, :3]),
            gTb[:3, 3] - state.gTb[:3, 3],
        ]
    )
    P = state.covariance
    rest = slice(POSE.stop, SIZE)
    gain = np.linalg.solve(P[POSE, POSE], P[POSE, rest]).T
    delta = gain @ step
    S = np.empty_like(P)
    S[POSE, POSE] = pose_covariance
    S[rest, POSE] = gain @ pose_covariance
    S[POSE, rest] = S[rest, POSE].T
    S[rest, rest] = P[rest, rest] + gain @ (pose_covariance - P[POSE, POSE]) @ gain.T
    return FilterState(
        np.array(gTb, dtype=np.float64),
        state.gV + delta[:3],
        state.rate + delta[3:6],
        state.bias + delta[6:],
        0.5 * (S + S.T),
    )


def propagate(state: FilterState, descent: Descent, begin_ns: int, end_ns: int) -> FilterState:
    """Carry a state over an interval by the IMU alone.

    Raises
    ------
    ValueError
        When the IMU log does not cover the interval.
    """
    dt_s, gyro, accelerometer = descent.imu.between(begin_ns, end_ns)
    noise = descent.imu_noise
    gTb, gV, rate, covariance = strapdown.propagate(
        state.gTb,
        state.gV,
        state.bias,
        state.covariance,
        dt_s,
        gyro,
        accelerometer,
        descent.body.mu_m3_s2,
        np.array(descent.body.spin_rad_s),
        np.array(
            [noise.gyro_density, noise.accelerometer_density, noise.gyro_walk, noise.accelerometer_walk]
        ),
    )
    return FilterState(gTb, gV, rate, state.bias, covariance)


def trajectory(stamps_ns: Sequence[int], states: Sequence[FilterState]) -> Trajectory:
    """Gather a filter's states, one per stamp."""
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
