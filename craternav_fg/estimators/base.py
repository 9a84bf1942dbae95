"""The interface of all estimators: the problem they are given, and what they return."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.motion.model import Motion
from craternav_fg.sensors.point_features import FeatureTracks
from craternav_fg.sensors.protocol import Sensor
from craternav_fg.trajectory import InitialState, Trajectory
from factors.arrays import FloatArray
from factors.errors import FactorError

# Errors that extreme numbers cause: a factor that is not finite, a system that GTSAM cannot solve.
NUMERICAL_ERRORS = (FactorError, RuntimeError, OverflowError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Start:
    """The start that all estimators share: a maximum a posteriori pose.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose from the prior, the rims of the first frame that has any, and its sun tilt.
    pose_covariance : ndarray, shape (6, 6)
        Its Gaussian covariance: attitude (rotation vector in b, rad), then position (in g, m).
    frame : int
        Index of that frame; before it there are only the prior and the IMU.
    """

    gTb: FloatArray
    pose_covariance: FloatArray
    frame: int


@dataclass(frozen=True)
class Descent:
    """What is known of a descent before any image is taken into account.

    Attributes
    ----------
    body : Body
    camera : Camera
    catalog : Catalog
    imu : ImuLog
        Without an IMU, of the motion model's constant angular velocity.
    imu_noise : ImuNoise
        With a motion model, its process noise in place of the accelerometer's.
    initial : InitialState
        The prior, before the first frame.
    sensors : tuple of Sensor
        Other than camera and IMU.
    features : FeatureTracks or None
        Points tracked from frame to frame.
    motion : Motion or None
        Model that is used in place of the accelerometer.
    """

    body: Body
    camera: Camera
    catalog: Catalog
    imu: ImuLog
    imu_noise: ImuNoise
    initial: InitialState
    sensors: tuple[Sensor, ...] = field(default=(), kw_only=True)
    features: FeatureTracks | None = field(default=None, kw_only=True)
    motion: Motion | None = field(default=None, kw_only=True)

    @staticmethod
    def of(dataset: Dataset, initial: InitialState | None = None) -> "Descent":
        """Take from a data set what is known of its descent.

        Parameters
        ----------
        dataset : Dataset
        initial : InitialState, optional
            In place of the data set's own.

        Returns
        -------
        Descent

        Raises
        ------
        EstimationError
            When neither the caller nor the data set gives an initial state.
        """
        known = initial or dataset.initial
        if known is None:
            raise EstimationError("expected an initial state: the data set has none")
        imu, noise = _log(dataset, known)
        return Descent(
            dataset.body, dataset.camera, dataset.catalog, imu, noise, known,
            sensors=dataset.sensors, features=dataset.features, motion=dataset.motion,
        )  # fmt: skip


def _log(dataset: Dataset, initial: InitialState) -> tuple[ImuLog, ImuNoise]:
    """Log and noise of the IMU; those of the motion model where it stands in for a part of it."""
    imu, noise, motion = dataset.imu, dataset.imu_noise, dataset.motion
    if motion is None:
        if imu is None or noise is None:
            raise EstimationError("expected an IMU or a motion model: the data set has neither")
        return imu, noise
    free = motion.noise
    if imu is None or noise is None:
        rate = initial.angular_velocity_rad_s or motion.rate_rad_s
        return ImuLog.constant(int(dataset.stamps_ns[0]), int(dataset.stamps_ns[-1]), rate), free
    return imu, replace(
        free,
        gyro_density_rad_s_sqrt_hz=noise.gyro_density_rad_s_sqrt_hz,
        gyro_walk_rad_s2_sqrt_hz=noise.gyro_walk_rad_s2_sqrt_hz,
    )


@dataclass(frozen=True)
class Problem(Descent):
    """Everything an estimator may know of a descent.

    Attributes
    ----------
    start : Start
        An estimator that begins from its covariance must not use its frame again.
    frames : sequence of FrameMeasurement
        In the order of time; the first frame's stamp is that of the initial state.
    """

    start: Start
    frames: Sequence[FrameMeasurement]


class Estimator(Protocol):
    """An estimator: computes a trajectory at the frames' stamps from measurements."""

    @property
    def name(self) -> str:
        """Name under which its results are stored."""
        ...

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate pose, velocity and biases, with covariances, at every frame.

        Parameters
        ----------
        problem : Problem

        Returns
        -------
        Trajectory
            At the frames' stamps.
        """
        ...
