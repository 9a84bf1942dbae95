"""The camera's mounting and the delay of its images, estimated along with a descent."""

from dataclasses import dataclass, fields

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import C, D, X, Y

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent
from craternav_fg.trajectory import Calibrated
from factors.exposure import exposure_factor

FloatArray = npt.NDArray[np.float64]

MOUNTING_KEY, DELAY_KEY = C(0), D(0)
# The camera's place on the lander is known far better than images tell.
LEVER_SIGMA_M = 1e-3


@dataclass(frozen=True)
class Calibration:
    """What is estimated along: standard deviations before the first image, 0 for what is known.

    Attributes
    ----------
    mounting_sigma_rad : float
        Of the camera's rotation on the lander, per axis.
    image_delay_sigma_s : float
        Of the time from an image's stamp to its exposure, the same for all images.
    """

    mounting_sigma_rad: float = 0.0
    image_delay_sigma_s: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < np.inf:
                raise EstimationError(f"{field.name}: expected 0 or more, found {value}")

    def __bool__(self) -> bool:
        """Whether there is anything to estimate."""
        return any(getattr(self, field.name) > 0.0 for field in fields(self))


def add_calibration(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: Calibration) -> None:
    """Add the priors of what is estimated along to a graph, and where it is missing its start to values."""
    if options.mounting_sigma_rad > 0.0:
        sigmas = np.repeat([options.mounting_sigma_rad, LEVER_SIGMA_M], 3)
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        graph.push_back(gtsam.PriorFactorPose3(MOUNTING_KEY, gtsam.Pose3(), noise))
        if not values.exists(MOUNTING_KEY):
            values.insert(MOUNTING_KEY, gtsam.Pose3())
    if options.image_delay_sigma_s > 0.0:
        noise = gtsam.noiseModel.Isotropic.Sigma(1, options.image_delay_sigma_s)
        graph.push_back(gtsam.PriorFactorVector(DELAY_KEY, np.zeros(1), noise))
        if not values.exists(DELAY_KEY):
            values.insert(DELAY_KEY, np.zeros(1))


def add_exposure(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    descent: Descent,
    options: Calibration,
    number: int,
    stamp_ns: int,
    state: tuple[gtsam.Pose3, FloatArray, gtsam.imuBias.ConstantBias],
) -> int:
    """Add the pose of an exposure; its key is that of the image's factors.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Gets the exposure's pose, if it has none.
    descent : Descent
    options : Calibration
    number : int
        Of the state at the image's stamp.
    stamp_ns : int
        The image's.
    state : (Pose3, ndarray, ConstantBias)
        Pose, velocity and bias there: good to a few per cent of the motion during a delay.

    Returns
    -------
    int
    """
    pose, gV, bias = state
    gRb = pose.rotation().matrix()
    rate = _angular_velocity(descent, stamp_ns) - bias.gyroscope()
    twist = np.concatenate([rate - gRb.T @ np.array(descent.body.spin_rad_s), gRb.T @ gV])
    keys = {
        "delay_key": DELAY_KEY if options.image_delay_sigma_s > 0.0 else None,
        "mounting_key": MOUNTING_KEY if options.mounting_sigma_rad > 0.0 else None,
    }
    graph.push_back(exposure_factor(X(number), Y(number), twist, **keys))
    if not values.exists(Y(number)):
        values.insert(Y(number), pose)
    return int(Y(number))


def calibrated(tree: gtsam.ISAM2, values: gtsam.Values) -> Calibrated | None:
    """Read what was estimated along off an optimum; None when there was nothing."""
    mounting = delay = None
    if values.exists(MOUNTING_KEY):
        turn = frames.rotation_log(values.atPose3(MOUNTING_KEY).rotation().matrix())
        mounting = (turn, np.sqrt(np.diag(tree.marginalCovariance(MOUNTING_KEY))[:3]))
    if values.exists(DELAY_KEY):
        variance = float(tree.marginalCovariance(DELAY_KEY)[0, 0])
        delay = (float(values.atVector(DELAY_KEY)[0]), float(np.sqrt(variance)))
    return None if mounting is None and delay is None else Calibrated(mounting, delay)


def _angular_velocity(descent: Descent, stamp_ns: int) -> FloatArray:
    """Mean of the gyro's rows on both sides of a stamp, rad/s."""
    stamps, gyro = descent.imu.stamps_ns, descent.imu.gyro
    after = int(np.searchsorted(stamps, stamp_ns, side="right"))
    rows = np.clip([after - 1, after], 0, len(stamps) - 1)
    return np.asarray(gyro[rows].mean(axis=0))
