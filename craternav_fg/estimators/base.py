"""What every estimator takes and gives."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalog import Catalog
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import InitialState, Trajectory

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """The common start of all estimators: the first frame's maximum a posteriori pose.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose from the prior, the first frame's rims and its sun tilt.
    pose_covariance : ndarray, shape (6, 6)
        Its Gaussian covariance: attitude (rotation vector in b, rad), then position (in g, m).
    """

    gTb: FloatArray
    pose_covariance: FloatArray


@dataclass(frozen=True)
class Descent:
    """What is known of a descent before any image is looked at.

    Attributes
    ----------
    body : Body
    camera : Camera
    catalog : Catalog
    imu : ImuLog
    imu_noise : ImuNoise
    initial : InitialState
        The prior, before the first frame.
    """

    body: Body
    camera: Camera
    catalog: Catalog
    imu: ImuLog
    imu_noise: ImuNoise
    initial: InitialState


@dataclass(frozen=True)
class Problem(Descent):
    """Everything an estimator may know of a descent.

    Attributes
    ----------
    start : Start
        After the first frame: whoever begins from its covariance must not use that frame again.
    frames : sequence of FrameMeasurement
        In the order of time; the first one's stamp is the initial state's.
    """

    start: Start
    frames: Sequence[FrameMeasurement]


class Estimator(Protocol):
    """From measurements to a trajectory at the frames' stamps."""

    @property
    def name(self) -> str:
        """Under which its result is kept."""
        ...

    def estimate(self, problem: Problem) -> Trajectory:
        """Estimate pose, velocity and biases, with covariances, at every frame."""
        ...
