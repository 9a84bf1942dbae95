"""Estimated or true motion of the lander, at the stamps of the images."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class InitialState:
    """What is known of the lander before the first image: a mean and independent Gaussian errors.

    Attributes
    ----------
    stamp_ns : int
        Time at which it holds: that of the first image.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    attitude_sigma_rad, position_sigma_m, velocity_sigma_m_s : float
        Standard deviation per axis; attitude as a rotation vector in b.
    angular_velocity_sigma_rad_s : float
        Standard deviation per axis of the angular velocity, whose mean is what the gyro says.
    gyro_bias_sigma_rad_s, accelerometer_bias_sigma_m_s2 : float
        Turn-on biases, zero mean, per axis.
    """

    stamp_ns: int
    gTb: FloatArray
    gV: FloatArray
    attitude_sigma_rad: float
    position_sigma_m: float
    velocity_sigma_m_s: float
    angular_velocity_sigma_rad_s: float
    gyro_bias_sigma_rad_s: float
    accelerometer_bias_sigma_m_s2: float


@dataclass(frozen=True)
class Calibrated:
    """What was estimated along with a trajectory, each with its standard deviation.

    Attributes
    ----------
    mounting_rad : (ndarray, ndarray), shape (3,) each, or None
        Rotation vector, in b, that turns the mounting believed into the camera's.
    image_delay_s : (float, float), or None
        From an image's stamp to its exposure.
    map_errors : dict of int to (ndarray, ndarray), shape (6,) each, or None
        By row of the catalogue, true minus map: shift of the centre along the major axis, the minor axis and
        their normal, growth along the major axis, shear, growth along the minor axis; as parts of the mean
        radius.
    """

    mounting_rad: tuple[FloatArray, FloatArray] | None = None
    image_delay_s: tuple[float, float] | None = None
    map_errors: dict[int, tuple[FloatArray, FloatArray]] | None = None


@dataclass(frozen=True)
class Trajectory:
    """States of the lander, with covariances where they are estimates.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (k,)
        Strictly increasing.
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g.
    gV : ndarray, shape (k, 3)
        Velocity relative to g, in g, m/s.
    bias : ndarray, shape (k, 6)
        Gyro bias (rad/s), then accelerometer bias (m/s^2), in b.
    pose_covariance : ndarray, shape (k, 6, 6), or None
        Of the attitude error (rotation vector in b, rad), then the position error (in g, m):
        R_true = R exp(phi), P_true = P + p.
    velocity_covariance : ndarray, shape (k, 3, 3), or None
        In g, m^2/s^2.
    bias_covariance : ndarray, shape (k, 6, 6), or None
        Gyro, then accelerometer.
    rim_weights : tuple of ndarray, or None
        For each stamp, the weights (n,) of the measured rims' matches: 1 right, 0 rejected as wrong. None
        where nothing chose among them.
    rim_craters : tuple of ndarray, or None
        With `rim_weights`: for each stamp, the rows (n,) of the catalogue's craters that the rims were taken
        for, which of a rejected match is another one; -1 for a rim that was not used.
    calibrated : Calibrated, or None
        What was estimated along.
    """

    stamps_ns: IntArray
    gTb: FloatArray
    gV: FloatArray
    bias: FloatArray
    pose_covariance: FloatArray | None = None
    velocity_covariance: FloatArray | None = None
    bias_covariance: FloatArray | None = None
    rim_weights: tuple[FloatArray, ...] | None = None
    rim_craters: tuple[IntArray, ...] | None = None
    calibrated: Calibrated | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def gP(self) -> FloatArray:
        """Positions in g, shape (k, 3), m."""
        return self.gTb[:, :3, 3]

    @property
    def gRb(self) -> FloatArray:
        """Attitudes, shape (k, 3, 3)."""
        return self.gTb[:, :3, :3]

    def take(self, rows: IntArray) -> "Trajectory":
        """Return the states of some rows.

        Parameters
        ----------
        rows : ndarray of int, shape (m,)
            Increasing; without a unit.

        Returns
        -------
        Trajectory
        """
        values: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.ndarray):
                value = value[rows]
            elif isinstance(value, tuple):
                value = tuple(value[row] for row in rows.tolist())
            values[one.name] = value
        return Trajectory(**values)
