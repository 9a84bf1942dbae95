"""The interface of all estimators: the problem they are given, and what they return."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.errors import EstimationError
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.sensors.point_features import FeatureTracks
from craternav_fg.sensors.protocol import Sensor
from craternav_fg.trajectory import InitialState, Trajectory

FloatArray = npt.NDArray[np.float64]


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
    imu_noise : ImuNoise
    initial : InitialState
        The prior, before the first frame.
    sensors : tuple of Sensor
        Other than camera and IMU.
    features : FeatureTracks or None
        Points tracked from frame to frame.
    """

    body: Body
    camera: Camera
    catalog: Catalog
    imu: ImuLog
    imu_noise: ImuNoise
    initial: InitialState
    sensors: tuple[Sensor, ...] = field(default=(), kw_only=True)
    features: FeatureTracks | None = field(default=None, kw_only=True)

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
        return Descent(
            dataset.body, dataset.camera, dataset.catalog, dataset.imu, dataset.imu_noise, known,
            sensors=dataset.sensors, features=dataset.features,
        )  # fmt: skip


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
    """An estimator: gives a trajectory at the frames' stamps from measurements."""

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
