"""Errors of an estimated trajectory, and the figures that summarise them."""

from dataclasses import asdict, dataclass

import numpy as np

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.linalg import squared_distance
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Errors:
    """Truth minus estimate at every stamp of the estimate.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (k,)
    position_m : ndarray, shape (k, 3)
        In g.
    velocity_m_s : ndarray, shape (k, 3)
        In g.
    attitude_rad : ndarray, shape (k, 3)
        Rotation vector in b: R_true = R exp(phi).
    """

    stamps_ns: IntArray
    position_m: FloatArray
    velocity_m_s: FloatArray
    attitude_rad: FloatArray

    @property
    def pose(self) -> FloatArray:
        """Attitude, then position error, shape (k, 6), rad and m: the order of a pose covariance."""
        return np.concatenate([self.attitude_rad, self.position_m], axis=1)


@dataclass(frozen=True)
class Metrics:
    """An estimator's errors in figures; None where there is no truth (or no covariance).

    Attributes
    ----------
    position_rms_m, position_final_m : float or None
        Norm of the position error: RMS over all frames, and at the last.
    velocity_rms_m_s : float or None
    attitude_rms_deg, attitude_final_deg : float or None
        Angle of the attitude error.
    ate_m : float or None
        Absolute trajectory error: RMS of the position error after the estimate is aligned with the truth by a
        rotation and a shift, as `evo_ape -a` has it. It shows the error of the trajectory's shape.
    rpe_m, rpe_deg : float or None
        Relative pose error: RMS of the error of the motion from frame to frame, as `evo_rpe` has it.
    anees : float or None
        Average normalised estimation error squared of the pose; 6 for a consistent estimator.
    frames : int
    """

    position_rms_m: float | None
    position_final_m: float | None
    velocity_rms_m_s: float | None
    attitude_rms_deg: float | None
    attitude_final_deg: float | None
    ate_m: float | None
    rpe_m: float | None
    rpe_deg: float | None
    anees: float | None
    frames: int

    def as_dict(self) -> dict[str, float | int | None]:
        """Return the fields by name, as metrics.json holds them."""
        return asdict(self)


def errors(estimate: Trajectory, truth: Trajectory) -> Errors:
    """Errors of an estimate against the truth.

    Parameters
    ----------
    estimate, truth : Trajectory

    Returns
    -------
    Errors

    Raises
    ------
    EstimationError
        When the two do not have the same stamps.
    """
    if not np.array_equal(estimate.stamps_ns, truth.stamps_ns):
        raise EstimationError("estimate and ground truth have different stamps")
    turn = np.swapaxes(estimate.gRb, 1, 2) @ truth.gRb
    return Errors(
        estimate.stamps_ns,
        truth.gP - estimate.gP,
        truth.gV - estimate.gV,
        frames.rotation_log(turn),
    )


def nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normalised estimation error squared e' S^-1 e.

    Parameters
    ----------
    error : ndarray, shape (k, d)
        In the units of the covariance.
    covariance : ndarray, shape (k, d, d)

    Returns
    -------
    ndarray, shape (k,)
        NEES; its expectation is d for a consistent estimator.
    """
    return squared_distance(error, covariance)


def metrics(estimate: Trajectory, truth: Trajectory | None) -> Metrics:
    """Summarise the errors of an estimate.

    Parameters
    ----------
    estimate : Trajectory
    truth : Trajectory or None
        Without it only the number of frames is known.

    Returns
    -------
    Metrics
    """
    if truth is None:
        return Metrics(None, None, None, None, None, None, None, None, None, len(estimate))
    e = errors(estimate, truth)
    position = np.linalg.norm(e.position_m, axis=1)
    attitude = np.degrees(np.linalg.norm(e.attitude_rad, axis=1))
    speed = np.linalg.norm(e.velocity_m_s, axis=1)
    steps = step_errors(estimate.gTb, truth.gTb)
    anees = None
    if estimate.pose_covariance is not None:
        anees = float(nees(e.pose, estimate.pose_covariance).mean())
    return Metrics(
        position_rms_m=_rms(position),
        position_final_m=float(position[-1]),
        velocity_rms_m_s=_rms(speed),
        attitude_rms_deg=_rms(attitude),
        attitude_final_deg=float(attitude[-1]),
        ate_m=ate_m(estimate.gP, truth.gP),
        rpe_m=None if len(estimate) < 2 else _rms(np.linalg.norm(steps[:, :3, 3], axis=1)),
        rpe_deg=None if len(estimate) < 2 else float(np.degrees(_rms(_angles(steps)))),
        anees=anees,
        frames=len(estimate),
    )


def ate_m(gP: FloatArray, true_gP: FloatArray) -> float:
    """RMS distance of positions from the true ones after the best rotation and shift.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 13 (4),
    1991, without a scale.

    Parameters
    ----------
    gP, true_gP : ndarray, shape (k, 3)
        In g, m.

    Returns
    -------
    float
        In m.
    """
    x, y = gP - gP.mean(axis=0), true_gP - true_gP.mean(axis=0)
    U, _, Vt = np.linalg.svd(y.T @ x)
    turn = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))]) @ Vt
    return _rms(np.linalg.norm(y - x @ turn.T, axis=1))


def step_errors(gTb: FloatArray, true_gTb: FloatArray) -> FloatArray:
    """Errors of the motion from frame to frame.

    Parameters
    ----------
    gTb, true_gTb : ndarray, shape (k, 4, 4)
        Poses in g, m.

    Returns
    -------
    ndarray, shape (k - 1, 4, 4)
        Poses of the estimated motion relative to the true one, in the body's frame; the identity without
        error.
    """
    steps, true = (np.linalg.solve(T[:-1], T[1:]) for T in (gTb, true_gTb))
    return np.asarray(np.linalg.solve(true, steps))


def _angles(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(frames.rotation_log(T[:, :3, :3]), axis=1))


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))
