"""A descent as it was recorded or simulated: its measurements, and what else is known."""

from dataclasses import dataclass

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.apriori import AprioriStates
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.motion.model import Motion
from craternav_fg.sensors.point_features import FeatureTracks
from craternav_fg.sensors.protocol import Sensor
from craternav_fg.trajectory import InitialState, Trajectory
from factors.arrays import IntArray


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Contents of a data set but for its images.

    Attributes
    ----------
    body : Body
    camera : Camera
    catalog : Catalog
        Catalogue of the craters on the body.
    imu : ImuLog or None
        None when there is none; `motion` is then given.
    imu_noise : ImuNoise or None
        None without an IMU.
    initial : InitialState or None
        State at the stamp of the first frame; None when nothing is known before the first image.
    sun : SunVectors
        `sun.at(stamp_ns)` is the unit vector towards the sun in g.
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames, strictly increasing.
    truth : Trajectory or None
        For evaluation only; None when it is not known.
    measurements : tuple of FrameMeasurement, length k, or None
        What the frames measured; None when it is to be measured in the images.
    sensors : tuple of Sensor
        Logs of the sensors beside camera and IMU.
    features : FeatureTracks or None
        Points tracked from frame to frame.
    motion : Motion or None
        Motion model in place of the accelerometer; None when the IMU tells the motion.
    apriori : AprioriStates or None
        States that somebody else stated, for comparison.
    """

    body: Body
    camera: Camera
    catalog: Catalog
    imu: ImuLog | None
    imu_noise: ImuNoise | None
    initial: InitialState | None
    sun: SunVectors
    stamps_ns: IntArray
    truth: Trajectory | None = None
    measurements: tuple[FrameMeasurement, ...] | None = None
    sensors: tuple[Sensor, ...] = ()
    features: FeatureTracks | None = None
    motion: Motion | None = None
    apriori: AprioriStates | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)
