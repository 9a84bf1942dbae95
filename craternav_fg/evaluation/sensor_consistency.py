"""Consistency without truth: the initial state and each sensor's residuals at a smoothed trajectory.

A smoother fits the states to all data. Wrong data then show: the initial state or a bias leaves its prior, or
a sensor's residuals have a mean, or are larger or smaller than their noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chdtrc

from craternav_fg import frames
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.instruments import RIMS, SUN
from craternav_fg.estimators.linearisation import linearise_sun
from craternav_fg.estimators.sensor_bank import SensorBank, gyro_at, gyro_variance, with_gyro_noise
from craternav_fg.evaluation.residuals import poses_at_exposure, rim_residuals
from craternav_fg.sensors.protocol import SensorState
from craternav_fg.trajectory import InitialState, Trajectory
from factors.arrays import FloatArray

# Probability below which chance does not explain a mean square.
IMPROBABLE = 1e-7


@dataclass(frozen=True)
class ResidualSummary:
    """Whitened residuals of a sensor.

    Attributes
    ----------
    count : int
        Number of samples.
    mean : ndarray, shape (d,)
        Mean of each component, in sigmas.
    square : float
        Mean square of a component: 1 or a little less when the noise is as stated.
    """

    count: int
    mean: FloatArray
    square: float


def prior_sigmas(initial: InitialState, trajectory: Trajectory) -> dict[str, float]:
    """Distance of the smoothed first state from the initial state.

    Parameters
    ----------
    initial : InitialState
        At the trajectory's first stamp.
    trajectory : Trajectory
        Trajectory of a smoother.

    Returns
    -------
    dict of str to float
        Norms of the errors of attitude, position, velocity and biases, three components each, over a
        component's sigma in the prior.
    """
    turn = frames.rotation_log(initial.gTb[:3, :3].T @ trajectory.gTb[0, :3, :3])
    found = {
        "attitude": (turn, initial.attitude_sigma_rad),
        "position": (trajectory.gTb[0, :3, 3] - initial.gTb[:3, 3], initial.position_sigma_m),
        "velocity": (trajectory.gV[0] - initial.gV, initial.velocity_sigma_m_s),
        "gyro bias": (trajectory.bias[0, :3], initial.gyro_bias_sigma_rad_s),
        "accelerometer bias": (trajectory.bias[0, 3:], initial.accelerometer_bias_sigma_m_s2),
    }
    return {
        name: float(np.linalg.norm(error)) / sigma for name, (error, sigma) in found.items() if sigma > 0.0
    }


def smoothed_residuals(problems: Sequence[Problem], trajectory: Trajectory) -> dict[str, FloatArray]:
    """Whitened residuals of each sensor at a trajectory.

    Parameters
    ----------
    problems : sequence of Problem
        The segments of a descent.
    trajectory : Trajectory
        At the stamps of their frames, or of some.

    Returns
    -------
    dict of str to ndarray
        "rims": (n, 5); "sun": (n, 1); other sensors by their names, (n, d), with the bias that fits best.
        Sensors without a sample are left out.
    """
    row_of = {stamp: k for k, stamp in enumerate(trajectory.stamps_ns.tolist())}
    seen = [f for problem in problems for f in problem.frames if f.stamp_ns in row_of]
    rows = np.array([row_of[frame.stamp_ns] for frame in seen], dtype=np.int64)
    at = trajectory.take(rows)
    descent = problems[0]
    out = {RIMS: rim_residuals(at, seen, descent.camera, descent.catalog)}
    tilts = [
        linearise_sun(gTb, frame.sun, descent.camera)
        for gTb, frame in zip(poses_at_exposure(at), seen, strict=True)
    ]
    out[SUN] = np.array([tilt.residual for tilt in tilts if tilt is not None]).reshape(-1, 1)
    out.update(_of_other_sensors(descent, at))
    return {name: residuals for name, residuals in out.items() if len(residuals)}


def _of_other_sensors(descent: Descent, at: Trajectory) -> dict[str, FloatArray]:
    """Residuals (n, d) of the sensors beside camera and IMU, each with the bias that fits it best."""
    out: dict[str, FloatArray] = {}
    for sensor in descent.sensors:
        bank = SensorBank([sensor])
        found = []
        for k, stamp in enumerate(at.stamps_ns.tolist()):
            state = SensorState(stamp, at.gTb[k], at.gV[k], gyro_at(descent, stamp) - at.bias[k, :3])
            variance, none = gyro_variance(descent, stamp), np.zeros(len(bank.sigmas))
            samples = [with_gyro_noise(one.linearise(state, none), variance) for one in bank.at(stamp)]
            found += [sample for sample in samples if sample.informative]
        if not found:
            continue
        errors = np.array([-one.error for one in found])
        if len(bank.sigmas):
            J = np.concatenate([one.bias_jacobian for one in found] + [np.diag(1.0 / bank.sigmas)])
            e = np.concatenate([errors.ravel(), np.zeros(len(bank.sigmas))])
            bias = np.linalg.lstsq(J, e, rcond=None)[0]
            errors = errors - np.array([one.bias_jacobian @ bias for one in found])
        out[sensor.name] = errors
    return out


def summarise(residuals: Mapping[str, FloatArray]) -> dict[str, ResidualSummary]:
    """Mean and square of each sensor's residuals, those that are not finite left out.

    Parameters
    ----------
    residuals : mapping of str to ndarray, each of shape (n, d)
        See `smoothed_residuals`, without a unit.

    Returns
    -------
    dict of str to ResidualSummary
    """
    out = {}
    for name, found in residuals.items():
        sound = found[np.isfinite(found).all(axis=1)]
        if len(sound):
            out[name] = ResidualSummary(len(sound), sound.mean(axis=0), float(np.mean(sound**2)))
    return out


def improbable(mean_square: float, dimension: int) -> bool:
    """Whether a mean of squares of unit normals is beyond what chance gives, on either side.

    Parameters
    ----------
    mean_square : float
    dimension : int
        Number of squares.

    Returns
    -------
    bool
    """
    total = mean_square * dimension
    return bool(min(chdtr(dimension, total), chdtrc(dimension, total)) < IMPROBABLE)
