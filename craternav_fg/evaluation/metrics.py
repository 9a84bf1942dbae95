"""Errors of an estimated trajectory, and the figures that sum them up."""

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.trajectory import Trajectory

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


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
        """Attitude, then position error, shape (k, 6): the order of a pose covariance."""
        return np.concatenate([self.attitude_rad, self.position_m], axis=1)


@dataclass(frozen=True)
class Metrics:
    """An estimator's errors in figures; None where there is no truth (or no covariance).

    Attributes
    ----------
    position_rms_m, position_final_m : float or None
        Norm of the position error over all frames, and at the last.
    velocity_rms_m_s : float or None
    attitude_rms_deg, attitude_final_deg : float or None
        Angle of the attitude error.
    anees : float or None
        Mean of the pose's normalised estimation error squared; 6 when the covariances are honest.
    frames : int
    """

    position_rms_m: float | None
    position_final_m: float | None
    velocity_rms_m_s: float | None
    attitude_rms_deg: float | None
    attitude_final_deg: float | None
    anees: float | None
    frames: int

    def as_dict(self) -> dict[str, float | int | None]:
        """Give the fields by name, as metrics.json holds them."""
        return asdict(self)


def at_stamps(trajectory: Trajectory, stamps_ns: IntArray) -> Trajectory:
    """Interpolate pose and velocity: cubic in position (its velocities are met), slerp in attitude.

    Raises
    ------
    EstimationError
        When a stamp lies outside the trajectory.
    """
    known = trajectory.stamps_ns
    if np.isin(stamps_ns, known).all():
        rows = np.searchsorted(known, stamps_ns)
        return Trajectory(stamps_ns, trajectory.gTb[rows], trajectory.gV[rows], trajectory.bias[rows])
    if stamps_ns[0] < known[0] or stamps_ns[-1] > known[-1]:
        raise EstimationError(
            f"ground truth covers {known[0]} to {known[-1]} ns, frames {stamps_ns[0]} to {stamps_ns[-1]} ns"
        )
    t_known = (known - known[0]) * 1e-9
    t = (stamps_ns - known[0]) * 1e-9
    position = CubicHermiteSpline(t_known, trajectory.gP, trajectory.gV)
    gTb = np.zeros((len(t), 4, 4))
    gTb[:, :3, :3] = Slerp(t_known, Rotation.from_matrix(trajectory.gRb))(t).as_matrix()
    gTb[:, :3, 3] = position(t)
    gTb[:, 3, 3] = 1.0
    bias = np.stack([np.interp(t, t_known, column) for column in trajectory.bias.T], axis=-1)
    return Trajectory(stamps_ns, gTb, position.derivative()(t), bias)


def errors(estimate: Trajectory, truth: Trajectory) -> Errors:
    """Errors of an estimate against the truth, which is interpolated to the estimate's stamps."""
    there = at_stamps(truth, estimate.stamps_ns)
    turn = np.swapaxes(estimate.gRb, 1, 2) @ there.gRb
    return Errors(
        estimate.stamps_ns,
        there.gP - estimate.gP,
        there.gV - estimate.gV,
        frames.rotation_log(turn),
    )


def nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normalised estimation error squared e' S^-1 e, shape (k,), of errors (k, d)."""
    # Scaled to unit diagonal: radians beside metres would cost half the digits.
    scale = np.sqrt(np.einsum("kii->ki", covariance))
    correlation = covariance / (scale[:, :, None] * scale[:, None, :])
    e = error / scale
    return np.asarray(np.einsum("ki,ki->k", e, np.linalg.solve(correlation, e[..., None])[..., 0]))


def metrics(estimate: Trajectory, truth: Trajectory | None) -> Metrics:
    """Sum up an estimate's errors; without truth only the number of frames is known."""
    if truth is None:
        return Metrics(None, None, None, None, None, None, len(estimate))
    e = errors(estimate, truth)
    position = np.linalg.norm(e.position_m, axis=1)
    attitude = np.degrees(np.linalg.norm(e.attitude_rad, axis=1))
    speed = np.linalg.norm(e.velocity_m_s, axis=1)
    anees = None
    if estimate.pose_covariance is not None:
        anees = float(nees(e.pose, estimate.pose_covariance).mean())
    return Metrics(
        position_rms_m=_rms(position),
        position_final_m=float(position[-1]),
        velocity_rms_m_s=_rms(speed),
        attitude_rms_deg=_rms(attitude),
        attitude_final_deg=float(attitude[-1]),
        anees=anees,
        frames=len(estimate),
    )


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))
