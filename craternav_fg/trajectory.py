"""Motion of the lander, estimated or true, at the stamps of the images."""

import itertools
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from factors.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class InitialState:
    """State of the lander as known before the first image: a mean with independent Gaussian errors.

    Attributes
    ----------
    stamp_ns : int
        Time at which it holds: the stamp of the first image.
    gTb : ndarray, shape (4, 4)
        Pose of b in g.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    attitude_sigma_rad, position_sigma_m, velocity_sigma_m_s : float
        Standard deviation per axis; attitude as a rotation vector in b.
    angular_velocity_sigma_rad_s : float
        Standard deviation per axis of the angular velocity, whose mean is the gyro's first measurement.
    gyro_bias_sigma_rad_s, accelerometer_bias_sigma_m_s2 : float
        Standard deviations per axis of the turn-on biases, whose mean is zero. Without an IMU those of the
        angular velocity and of the acceleration that the motion model lacks.
    angular_velocity_rad_s : tuple of float or None
        Mean of the angular velocity in b, where there is no gyro; None for that of the motion model.
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
    angular_velocity_rad_s: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Calibrated:
    """Calibration and map errors that were estimated along with a trajectory, with standard deviations.

    Attributes
    ----------
    mounting_rad : (ndarray, ndarray), shape (3,) each, or None
        Rotation vector in b from the mounting of `Camera` to the estimated one.
    time_offset_s : (float, float), or None
        Camera-IMU time offset: from an image's stamp to its exposure.
    map_errors : dict of int to (ndarray, ndarray), shape (6,) each, or None
        By row of the catalogue, true minus map, in units of the mean radius: shift of the centre along the
        major axis, the minor axis and the normal; growth along the major axis, shear, growth along the minor
        axis.
    intrinsics : (ndarray, ndarray), shape (4,) each, or None
        True less stated: share of the focal length; principal point x and y, px; radial distortion k1.
    sensor_biases : dict of str to (ndarray, ndarray), shape (b,) each, or None
        By the sensor's name: its biases, in the unit of `Sensor.bias_sigmas`. Those of a filter are the
        estimates at its last frame.
    """

    mounting_rad: tuple[FloatArray, FloatArray] | None = None
    time_offset_s: tuple[float, float] | None = None
    map_errors: dict[int, tuple[FloatArray, FloatArray]] | None = None
    intrinsics: tuple[FloatArray, FloatArray] | None = None
    sensor_biases: dict[str, tuple[FloatArray, FloatArray]] | None = None


@dataclass(frozen=True)
class Trajectory:
    """States of the lander, with covariances where they are estimates.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (k,)
        Strictly increasing.
    gTb : ndarray, shape (k, 4, 4)
        Poses of b in g.
    gV : ndarray, shape (k, 3)
        Velocity relative to g, in g, m/s.
    bias : ndarray, shape (k, 6)
        Gyro bias (rad/s), then accelerometer bias (m/s^2), in b.
    pose_covariance : ndarray, shape (k, 6, 6), or None
        Covariances of the attitude error phi (rotation vector in b, rad) and the position error p (in g, m):
        R_true = R exp(phi), P_true = P + p.
    velocity_covariance : ndarray, shape (k, 3, 3), or None
        In g, m^2/s^2.
    bias_covariance : ndarray, shape (k, 6, 6), or None
        Covariance of the gyro bias, (rad/s)^2, then the accelerometer bias, (m/s^2)^2, in b.
    rim_weights : tuple of ndarray, or None
        For each stamp, the weights (n,) of the measured rims' matches: 1 accepted, 0 rejected as wrong. None
        when the estimator accepts all.
    rim_craters : tuple of ndarray, or None
        With `rim_weights`: for each stamp, the catalogue rows (n,) of the craters that the rims were matched
        to in the end: another crater where a match was rejected, -1 where the rim was not used.
    calibrated : Calibrated, or None
        What else was estimated, if anything; that of the last segment, if there are several.
    calibrated_at : tuple of Calibrated, or None
        With several segments: for each stamp, what was estimated in its segment.
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
    calibrated_at: tuple[Calibrated, ...] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def gP(self) -> FloatArray:
        """Positions of b in g, shape (k, 3), m."""
        return self.gTb[:, :3, 3]

    @property
    def gRb(self) -> FloatArray:
        """Attitudes: rotations (k, 3, 3) from b to g."""
        return self.gTb[:, :3, :3]

    def segments(self) -> list["Trajectory"]:
        """Divide the states where another segment begins.

        Returns
        -------
        list of Trajectory
            Each with what was estimated in it as its `calibrated`.
        """
        if self.calibrated_at is None or not len(self):
            return [self]
        each = self.calibrated_at
        begins = [k for k in range(len(self)) if not k or each[k] is not each[k - 1]]
        return [
            replace(self.take(np.arange(begin, end)), calibrated=each[begin], calibrated_at=None)
            for begin, end in itertools.pairwise([*begins, len(self)])
        ]

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
