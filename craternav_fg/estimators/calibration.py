"""The camera's mounting, the delay of its images and errors of the map, estimated along with a descent."""

from dataclasses import dataclass, fields

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import C, D, M, X, Y

from craternav_fg import frames
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.measurements import RimSet
from craternav_fg.trajectory import Calibrated
from factors.conic_shape import ChartError
from factors.exposure import exposure_factor
from factors.kernels.rim_errors import ground_slopes

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
    time_offset_sigma_s : float
        Of the camera-IMU time offset: from an image's stamp to its exposure, the same for all images.
    map_place_sigma : float
        Of a crater's place on the map, east and north, as a part of its mean radius.
    map_height_sigma : float
        Of its rim's height, as a part of its mean radius.
    map_size_sigma : float
        Of its semi-axes, each as a part of itself.
    """

    mounting_sigma_rad: float = 0.0
    time_offset_sigma_s: float = 0.0
    map_place_sigma: float = 0.0
    map_height_sigma: float = 0.0
    map_size_sigma: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < np.inf:
                raise EstimationError(f"{field.name}: expected 0 or more, found {value}")

    @property
    def of_exposure(self) -> bool:
        """Whether an exposure's pose is another one than the state's at its stamp."""
        return self.mounting_sigma_rad > 0.0 or self.time_offset_sigma_s > 0.0

    @property
    def map_sigmas(self) -> FloatArray:
        """Standard deviations (6,) of a crater's errors, in the order of `ground_slopes`."""
        place, height, size = self.map_place_sigma, self.map_height_sigma, self.map_size_sigma
        # The shear of independent axes whose directions mean nothing: a circle has none.
        return np.array([place, place, height, size, np.sqrt(0.5) * size, size])


def add_calibration(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: Calibration) -> None:
    """Add the priors of what is estimated along to a graph, and where it is missing its start to values."""
    if options.mounting_sigma_rad > 0.0:
        sigmas = np.repeat([options.mounting_sigma_rad, LEVER_SIGMA_M], 3)
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        graph.push_back(gtsam.PriorFactorPose3(MOUNTING_KEY, gtsam.Pose3(), noise))
        if not values.exists(MOUNTING_KEY):
            values.insert(MOUNTING_KEY, gtsam.Pose3())
    if options.time_offset_sigma_s > 0.0:
        noise = gtsam.noiseModel.Isotropic.Sigma(1, options.time_offset_sigma_s)
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
        "delay_key": DELAY_KEY if options.time_offset_sigma_s > 0.0 else None,
        "mounting_key": MOUNTING_KEY if options.mounting_sigma_rad > 0.0 else None,
    }
    graph.push_back(exposure_factor(X(number), Y(number), twist, **keys))
    if not values.exists(Y(number)):
        values.insert(Y(number), pose)
    return int(Y(number))


def map_errors(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    descent: Descent,
    options: Calibration,
    rims: RimSet,
    gTb: FloatArray,
    known: set[int],
) -> list[ChartError]:
    """Give a frame's rims the errors that their craters have on the map: one vector for each crater.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Gets the priors of craters that are new.
    values : gtsam.Values
        Gets their errors, as zero, if it has none.
    descent : Descent
    options : Calibration
    rims : RimSet
    gTb : ndarray, shape (4, 4)
        Pose of the lander to a per cent of the range: what an error on the ground does to the image.
    known : set of int
        Craters whose priors the graph has; gets those that are new.

    Returns
    -------
    list of ChartError
        Empty when the map is taken as right.
    """
    sigmas = options.map_sigmas
    if not sigmas.any():
        return []
    catalog = descent.catalog
    centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
    roots = ground_slopes(gTb, descent.camera.bTc, centres, axes) * sigmas
    out = []
    for i, crater in enumerate(rims.craters.tolist()):
        key = int(M(crater))
        if not values.exists(key):
            values.insert(key, np.zeros(len(sigmas)))
        if crater not in known:
            known.add(crater)
            unit = gtsam.noiseModel.Unit.Create(len(sigmas))
            graph.push_back(gtsam.PriorFactorVector(key, np.zeros(len(sigmas)), unit))
        out.append(ChartError(key, [i], roots[i : i + 1]))
    return out


def calibrated(
    tree: gtsam.ISAM2, values: gtsam.Values, options: Calibration, problem: Problem
) -> Calibrated | None:
    """Read what was estimated along off an optimum; None when there was nothing."""
    mounting = delay = craters = None
    if options.mounting_sigma_rad > 0.0:
        turn = frames.rotation_log(values.atPose3(MOUNTING_KEY).rotation().matrix())
        mounting = (turn, np.sqrt(np.diag(tree.marginalCovariance(MOUNTING_KEY))[:3]))
    if options.time_offset_sigma_s > 0.0:
        variance = float(tree.marginalCovariance(DELAY_KEY)[0, 0])
        delay = (float(values.atVector(DELAY_KEY)[0]), float(np.sqrt(variance)))
    sigmas = options.map_sigmas
    if sigmas.any():
        seen = np.unique(np.concatenate([frame.rims.craters for frame in problem.frames])).tolist()
        errors = [sigmas * values.atVector(M(crater)) for crater in seen]
        spread = [sigmas * np.sqrt(np.diag(tree.marginalCovariance(M(crater)))) for crater in seen]
        craters = {crater: (error, sigma) for crater, error, sigma in zip(seen, errors, spread, strict=True)}
    if mounting is None and delay is None and craters is None:
        return None
    return Calibrated(mounting, delay, craters)


def _angular_velocity(descent: Descent, stamp_ns: int) -> FloatArray:
    """Mean of the gyro's rows on both sides of a stamp, rad/s."""
    stamps, gyro = descent.imu.stamps_ns, descent.imu.gyro
    after = int(np.searchsorted(stamps, stamp_ns, side="right"))
    rows = np.clip([after - 1, after], 0, len(stamps) - 1)
    return np.asarray(gyro[rows].mean(axis=0))
