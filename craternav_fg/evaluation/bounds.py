"""Posterior Cramér-Rao bound of a descent: what no estimator can beat, online and in retrospect.

The information recursion at the truth: prior, IMU noise, rims and sun tilts linearised at the true states.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.ekf_measurement import linearise_arcs, linearise_rims, linearise_sun
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory
from factors.kernels import strapdown

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_POSE = slice(0, 6)
_ATTITUDE, _POSITION = slice(0, 3), slice(3, 6)
_SIZE = len(strapdown.WITHOUT_RATE)


@dataclass(frozen=True)
class PosteriorBound:
    """Least pose covariances that the data of a descent allow.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (k,)
        Of the frames.
    filtered : ndarray, shape (k, 6, 6)
        From the data up to each frame: for `online`, `fixed_lag`, `ekf`. Attitude (rotation vector in b,
        rad), then position (in g, m), as `Trajectory.pose_covariance`.
    smoothed : ndarray, shape (k, 6, 6)
        From all data: for `smoother`.
    """

    stamps_ns: IntArray
    filtered: FloatArray
    smoothed: FloatArray


def position_rms_m(pose_covariance: FloatArray) -> FloatArray:
    """Root mean square norm (...) of the position error of pose covariances (..., 6, 6), m."""
    return np.sqrt(np.trace(pose_covariance[..., _POSITION, _POSITION], axis1=-2, axis2=-1))


def attitude_rms_deg(pose_covariance: FloatArray) -> FloatArray:
    """Root mean square angle (...) of the attitude error of pose covariances (..., 6, 6), deg."""
    return np.degrees(np.sqrt(np.trace(pose_covariance[..., _ATTITUDE, _ATTITUDE], axis1=-2, axis2=-1)))


def posterior_bound(
    descent: Descent, frames: Sequence[FrameMeasurement], truth: Trajectory
) -> PosteriorBound:
    """Posterior Cramér-Rao bound of the pose at every frame.

    Parameters
    ----------
    descent : Descent
    frames : sequence of FrameMeasurement
        Of a measurement counts which crater it is of and how well, as its own covariance says, not what it
        reads: it is linearised at the truth. Every match counts as right. Edge points of arcs count where
        they were measured.
    truth : Trajectory
        At the frames' stamps, with the true biases.

    Returns
    -------
    PosteriorBound

    Raises
    ------
    EstimationError
        When truth and frames do not have the same stamps.
    ValueError
        When the IMU log does not cover the frames.
    """
    stamps = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    if not np.array_equal(stamps, truth.stamps_ns):
        raise EstimationError("frames and ground truth have different stamps")
    prior = filter_state.prior(descent).covariance
    # In units of the prior's sigmas: radians, metres and biases differ by ten orders of magnitude.
    sigmas = np.sqrt(np.diag(prior))[strapdown.WITHOUT_RATE]
    gained = [_information(descent, frame, gTb, sigmas) for frame, gTb in zip(frames, truth.gTb, strict=True)]
    steps = [_transition(descent, truth, k, sigmas) for k in range(len(frames) - 1)]

    covariance = _updated(np.eye(_SIZE), gained[0])
    filtered = [covariance]
    for (F, Q), information in zip(steps, gained[1:], strict=True):
        covariance = _updated(F @ covariance @ F.T + Q, information)
        filtered.append(covariance)
    # What later frames say of a state: their information, carried back.
    later = np.zeros((_SIZE, _SIZE))
    smoothed = [covariance]
    for k in range(len(frames) - 2, -1, -1):
        F, Q = steps[k]
        information = later + gained[k + 1]
        later = F.T @ np.linalg.solve(np.eye(_SIZE) + information @ Q, information) @ F
        later = 0.5 * (later + later.T)
        smoothed.append(_updated(filtered[k], later))
    units = np.outer(sigmas[_POSE], sigmas[_POSE])
    poses = [np.array([P[_POSE, _POSE] for P in states]) * units for states in (filtered, smoothed[::-1])]
    return PosteriorBound(stamps, *poses)


def _information(
    descent: Descent, frame: FrameMeasurement, gTb: FloatArray, sigmas: FloatArray
) -> FloatArray:
    """Give the information (15, 15) that a frame has of the state."""
    camera, catalog = descent.camera, descent.catalog
    rims, _, usable = linearise_rims(gTb, frame.rims, camera, catalog, model="chart", noise="measured")
    rows = [rims[usable].reshape(-1, 6), *(arc.A for arc in linearise_arcs(gTb, frame.arcs, camera, catalog))]
    sun = linearise_sun(gTb, frame.sun, camera)
    if sun is not None:
        rows.append(sun.A)
    A = np.concatenate(rows) * sigmas[_POSE]
    out = np.zeros((_SIZE, _SIZE))
    out[_POSE, _POSE] = A.T @ A
    return out


def _transition(
    descent: Descent, truth: Trajectory, k: int, sigmas: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Transition (15, 15) from frame k to the next, and the IMU noise (15, 15) that it adds."""
    rows = descent.imu.between(int(truth.stamps_ns[k]), int(truth.stamps_ns[k + 1]))
    noise = descent.imu_noise
    F, Q = strapdown.transition(
        truth.gTb[k],
        truth.gV[k],
        truth.bias[k],
        *rows,
        descent.body.mu_m3_s2,
        np.array(descent.body.spin_rad_s),
        np.array(
            [noise.gyro_density, noise.accelerometer_density, noise.gyro_walk, noise.accelerometer_walk]
        ),
    )
    return F * sigmas / sigmas[:, None], Q / np.outer(sigmas, sigmas)


def _updated(covariance: FloatArray, information: FloatArray) -> FloatArray:
    """Covariance (n, n) after information (n, n) is added: (P^-1 + I)^-1."""
    L = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(np.linalg.cholesky(np.eye(len(L)) + L.T @ information @ L))
    root = inverse @ L.T
    return np.asarray(root.T @ root)
