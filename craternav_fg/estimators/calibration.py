"""Self-calibration and map refinement: mounting, time offset and errors of the map as variables."""

from dataclasses import dataclass, fields

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, D, M, X, Y

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent, Problem
from craternav_fg.estimators.intrinsics import add_intrinsics, estimated_intrinsics
from craternav_fg.estimators.marginals import Marginals
from craternav_fg.estimators.sensor_bank import SensorBank
from craternav_fg.measurements import RimSet
from craternav_fg.trajectory import Calibrated
from factors.arrays import FloatArray, IntArray
from factors.conic_shape import ChartError
from factors.exposure import exposure_factor
from factors.kernels.rim_errors import ground_slopes

MOUNTING_KEY, DELAY_KEY = C(0), D(0)
# Errors of a crater on the map, see `ground_slopes`.
MAP_ERRORS = 6
# The camera's position on the lander is known far better than images tell.
LEVER_SIGMA_M = 1e-3


@dataclass(frozen=True)
class Calibration:
    """Parameters estimated beside the trajectory: prior standard deviations; with 0 one is taken as known.

    Attributes
    ----------
    mounting_sigma_rad : float
        Standard deviation of the camera's rotation relative to the body, per axis.
    time_offset_sigma_s : float
        Standard deviation of the camera-IMU time offset, from an image's stamp to its exposure, the same for
        all images.
    map_place_sigma_share : float
        Standard deviation of a crater's place on the map, east and north, as a share of its mean radius. If a
        catalogue states its craters' errors, they replace this one and the next two; 0 in all three takes the
        map as exact.
    map_height_sigma_share : float
        Standard deviation of its rim's height, as a share of its mean radius.
    map_size_sigma_share : float
        Standard deviation of its semi-axes, each as a share of itself.
    focal_sigma_share : float
        Standard deviation of the focal length, as a share of it. If this one or one of the next two is above
        0, arcs and tracked points are not used: only rims are measured by the estimated intrinsics, and the
        sun's tilt, a fraction of a degree at best, by the stated ones.
    principal_point_sigma_px : float
        Standard deviation of the principal point, per coordinate.
    k1_sigma : float
        Standard deviation of the radial distortion k1.
    """

    mounting_sigma_rad: float = 0.0
    time_offset_sigma_s: float = 0.0
    map_place_sigma_share: float = 0.0
    map_height_sigma_share: float = 0.0
    map_size_sigma_share: float = 0.0
    focal_sigma_share: float = 0.0
    principal_point_sigma_px: float = 0.0
    k1_sigma: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < np.inf:
                raise EstimationError(f"{field.name}: expected 0 or more, found {value}")

    @property
    def of_exposure(self) -> bool:
        """Whether the pose at an exposure differs from that at the image's stamp."""
        return self.mounting_sigma_rad > 0.0 or self.time_offset_sigma_s > 0.0

    @property
    def intrinsic_sigmas(self) -> FloatArray:
        """Standard deviations (4,): share of the focal length, principal point x and y in px, k1."""
        point_px = self.principal_point_sigma_px
        return np.array([self.focal_sigma_share, point_px, point_px, self.k1_sigma])

    @property
    def of_charts(self) -> bool:
        """Whether variables that only ellipse charts have are estimated: errors of map or intrinsics."""
        return bool(self.intrinsic_sigmas.any() or self.map_sigmas.any())

    @property
    def map_sigmas(self) -> FloatArray:
        """Standard deviations (6,) of a crater's errors, as shares, in the order of `ground_slopes`."""
        place, height, size = (
            self.map_place_sigma_share,
            self.map_height_sigma_share,
            self.map_size_sigma_share,
        )
        # The shear follows from independent errors of the axes, whose directions are arbitrary for a circle.
        return np.array([place, place, height, size, np.sqrt(0.5) * size, size])


def add_calibration(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: Calibration) -> None:
    """Add the priors of the calibration's variables to a graph, and missing variables to values.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
    options : Calibration
    """
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
    if options.intrinsic_sigmas.any():
        add_intrinsics(graph, values)


def add_exposure(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    descent: Descent,
    options: Calibration,
    index: int,
    stamp_ns: int,
    state: tuple[gtsam.Pose3, FloatArray, gtsam.imuBias.ConstantBias],
) -> int:
    """Add the pose of an exposure as a variable.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Gets the exposure's pose, if it has none.
    descent : Descent
    options : Calibration
    index : int
        Index of the state at the image's stamp.
    stamp_ns : int
        The image's.
    state : (Pose3, ndarray, ConstantBias)
        Pose, velocity (3,) in g, m/s, and bias there, accurate to a few per cent of the motion during the
        offset.

    Returns
    -------
    int
        Key of that pose, to which the image's factors are attached.
    """
    pose, gV, bias = state
    gRb = pose.rotation().matrix()
    rate = _angular_velocity(descent, stamp_ns) - bias.gyroscope()
    twist = np.concatenate([rate - gRb.T @ np.array(descent.body.spin_rad_s), gRb.T @ gV])
    keys = {
        "delay_key": DELAY_KEY if options.time_offset_sigma_s > 0.0 else None,
        "mounting_key": MOUNTING_KEY if options.mounting_sigma_rad > 0.0 else None,
    }
    graph.push_back(exposure_factor(X(index), Y(index), twist, **keys))
    if not values.exists(Y(index)):
        values.insert(Y(index), pose)
    return int(Y(index))


def map_sigmas(catalog: Catalog, craters: IntArray, options: Calibration) -> FloatArray:
    """Return the prior standard deviations of craters' errors on the map.

    Parameters
    ----------
    catalog : Catalog
    craters : ndarray of int, shape (n,)
        Rows.
    options : Calibration
        Used where the catalogue states no errors.

    Returns
    -------
    ndarray, shape (n, 6)
        In units of the mean radius, in the order of `ground_slopes`.
    """
    if catalog.errors is None:
        return np.broadcast_to(options.map_sigmas, (len(craters), MAP_ERRORS))
    radius_m = np.sqrt(catalog.semi_major_m[craters] * catalog.semi_minor_m[craters])
    return np.sqrt(catalog.errors.take(craters).variances(radius_m))


def map_errors(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    descent: Descent,
    options: Calibration,
    rims: RimSet,
    gTb: FloatArray,
    known: set[int],
) -> list[ChartError]:
    """Make the errors of the craters on the map variables of a frame's rims: one vector for each crater.

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
        Pose of the body in g, accurate to a per cent of the range: it tells what an error on the ground does
        to the image.
    known : set of int
        Craters whose priors the graph has; gets those that are new.

    Returns
    -------
    list of ChartError
        Empty when the map is taken as exact.
    """
    if not options.map_sigmas.any() or not len(rims):
        return []
    catalog = descent.catalog
    sigmas = map_sigmas(catalog, rims.craters, options)
    centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
    roots = ground_slopes(gTb, descent.camera.bTc, centres, axes) * sigmas[:, None]
    keys = [int(M(crater)) for crater in rims.craters.tolist()]
    for key, crater in zip(keys, rims.craters.tolist(), strict=True):
        if not values.exists(key):
            values.insert(key, np.zeros(MAP_ERRORS))
        if crater not in known:
            known.add(crater)
            unit = gtsam.noiseModel.Unit.Create(MAP_ERRORS)
            graph.push_back(gtsam.PriorFactorVector(key, np.zeros(MAP_ERRORS), unit))
    return [ChartError(keys, roots)]


def calibrated(
    marginals: Marginals, values: gtsam.Values, options: Calibration, problem: Problem
) -> Calibrated | None:
    """Read the calibration from an optimum.

    Parameters
    ----------
    marginals : Marginals
    values : gtsam.Values
    options : Calibration
    problem : Problem

    Returns
    -------
    Calibrated or None
        None when nothing was calibrated.
    """
    mounting = delay = craters = None
    if options.mounting_sigma_rad > 0.0:
        turn = frames.rotation_log(values.atPose3(MOUNTING_KEY).rotation().matrix())
        mounting = (turn, np.sqrt(np.diag(marginals.covariances([MOUNTING_KEY])[MOUNTING_KEY])[:3]))
    if options.time_offset_sigma_s > 0.0:
        variance = float(marginals.covariances([DELAY_KEY])[DELAY_KEY][0, 0])
        delay = (float(values.atVector(DELAY_KEY)[0]), float(np.sqrt(variance)))
    if options.map_sigmas.any():
        seen = np.unique(np.concatenate([frame.rims.craters for frame in problem.frames]))
        covariances = marginals.covariances([int(M(crater)) for crater in seen])
        craters = {
            crater: (
                sigma * values.atVector(M(crater)),
                sigma * np.sqrt(np.diag(covariances[M(crater)])),
            )
            for crater, sigma in zip(seen.tolist(), map_sigmas(problem.catalog, seen, options), strict=True)
        }
    intrinsics = None
    if options.intrinsic_sigmas.any():
        intrinsics = estimated_intrinsics(marginals, values, options.intrinsic_sigmas)
    biases = _sensor_biases(marginals, values, SensorBank(problem.sensors))
    if all(part is None for part in (mounting, delay, craters, intrinsics, biases)):
        return None
    return Calibrated(mounting, delay, craters, intrinsics, biases)


def _sensor_biases(
    marginals: Marginals, values: gtsam.Values, bank: SensorBank
) -> dict[str, tuple[FloatArray, FloatArray]] | None:
    """Biases of the sensors; those of one that has not measured are the prior's."""
    biases, sigmas = np.zeros(len(bank.sigmas)), bank.sigmas.copy()
    known = [(part, key) for part, key in bank.biases if values.exists(key)]
    covariances = marginals.covariances([key for _, key in known]) if known else {}
    for part, key in known:
        biases[part] = bank.sigmas[part] * values.atVector(key)
        sigmas[part] = bank.sigmas[part] * np.sqrt(np.diag(covariances[key]))
    found = bank.estimated(biases, sigmas)
    return None if found is None else found.sensor_biases


def _angular_velocity(descent: Descent, stamp_ns: int) -> FloatArray:
    """Mean of the gyro's rows before and after a stamp, (3,), in b, rad/s."""
    stamps, gyro = descent.imu.stamps_ns, descent.imu.gyro_rad_s
    after = int(np.searchsorted(stamps, stamp_ns, side="right"))
    rows = np.clip([after - 1, after], 0, len(stamps) - 1)
    return np.asarray(gyro[rows].mean(axis=0))
