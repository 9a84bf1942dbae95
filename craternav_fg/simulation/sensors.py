"""Simulated measurements of a known motion: IMU log, rims and sun tilts, initial state."""

import math

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import ground_sun_direction
from craternav_fg.ellipse import chart_covariance
from craternav_fg.imu import ImuLog
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.simulation.scenario_tables import ImuSection, InitialErrorSection, MeasurementSection
from craternav_fg.simulation.trajectory import Track
from craternav_fg.trajectory import InitialState
from factors.arrays import FloatArray, IntArray
from factors.kernels.sun import sun_tilt, wrap

# Gauss-Legendre nodes and weights on [0, 1]: exact for polynomials of degree 5.
_NODES = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


def imu_stamps(options: ImuSection, start_ns: int, end_ns: int) -> IntArray:
    """Stamps of a log whose first interval begins at the start and whose last one reaches the end.

    Parameters
    ----------
    options : ImuSection
    start_ns, end_ns : int

    Returns
    -------
    ndarray of int, shape (n,)
        Ends of the intervals, ns.
    """
    step = round(1e9 / options.rate_hz)
    return start_ns + step * np.arange(1, -(-(end_ns - start_ns) // step) + 1, dtype=np.int64)


def ideal_imu(descent: Track, stamps_ns: IntArray, start_ns: int) -> ImuLog:
    """IMU log without errors (see `ImuLog` for what its rows mean).

    Parameters
    ----------
    descent : Track
        Its polynomials also hold after its end.
    stamps_ns : ndarray of int, shape (n,)
        Ends of the intervals; the first begins at `start_ns`.
    start_ns : int
        Time at which the descent begins.

    Returns
    -------
    ImuLog
    """
    edges = np.concatenate([[start_ns], stamps_ns]) - start_ns
    t = edges * 1e-9
    dt = np.diff(edges) * 1e-9
    R = descent.evaluate(t).gRb
    # The inertial rotation is that of b in g and that of g.
    turned = frames.rotation_exp(np.multiply.outer(dt, np.array(descent.body.spin_rad_s)))
    gyro = frames.rotation_log(np.swapaxes(R[:-1], 1, 2) @ turned @ R[1:]) / dt[:, None]
    force = sum(
        weight * descent.evaluate(t[:-1] + node * dt).specific_force_m_s2
        for node, weight in zip(_NODES, _WEIGHTS, strict=True)
    )
    return ImuLog(stamps_ns, gyro, np.asarray(force))


def corrupt_imu(log: ImuLog, options: ImuSection, rng: np.random.Generator) -> tuple[ImuLog, FloatArray]:
    """Add white noise, turn-on bias and bias random walk.

    Parameters
    ----------
    log : ImuLog
        Without errors.
    options : ImuSection
    rng : Generator

    Returns
    -------
    log : ImuLog
    bias : ndarray, shape (n, 6)
        Gyro (rad/s), then accelerometer (m/s^2), during each row's interval.
    """
    noise = options.noise()
    n = len(log.stamps_ns)
    steps_ns = np.diff(log.stamps_ns)
    root_dt = np.sqrt(np.concatenate([steps_ns[:1], steps_ns]) * 1e-9)[:, None]
    turn_on = np.repeat([options.gyro_bias_rad_s, options.accelerometer_bias_m_s2], 3)
    walk = np.repeat([noise.gyro_walk_rad_s2_sqrt_hz, noise.accelerometer_walk_m_s3_sqrt_hz], 3)
    density = np.repeat([noise.gyro_density_rad_s_sqrt_hz, noise.accelerometer_density_m_s2_sqrt_hz], 3)
    steps = walk * root_dt * rng.standard_normal((n, 6))
    steps[0] = turn_on * rng.standard_normal(6)
    bias = np.cumsum(steps, axis=0)
    rates = np.hstack([log.gyro_rad_s, log.accelerometer_m_s2]) + bias
    rates += density / root_dt * rng.standard_normal((n, 6))
    return ImuLog(log.stamps_ns, rates[:, :3].copy(), rates[:, 3:].copy()), bias


def initial_state(
    gTb: FloatArray,
    gV: FloatArray,
    stamp_ns: int,
    errors: InitialErrorSection,
    biases: tuple[float, float],
    rng: np.random.Generator,
    angular_velocity: FloatArray | None = None,
) -> InitialState:
    """Draw the initial state: the truth with errors of given standard deviations.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        True pose.
    gV : ndarray, shape (3,)
        True velocity in g, m/s.
    stamp_ns : int
    errors : InitialErrorSection
    biases : (float, float)
        Standard deviations of what takes the gyro's bias, rad/s, and the accelerometer's, m/s^2.
    rng : Generator
    angular_velocity : ndarray, shape (3,), optional
        True angular velocity in b, rad/s, where there is no gyro: it is then a part of the state.

    Returns
    -------
    InitialState
    """
    attitude = math.radians(errors.attitude_deg)
    # The truth is R exp(phi) of the estimate's R.
    R = gTb[:3, :3] @ frames.rotation_exp(-attitude * rng.standard_normal(3))
    rate = None
    if angular_velocity is not None:
        rate = angular_velocity - biases[0] * rng.standard_normal(3)
    return InitialState(
        stamp_ns=stamp_ns,
        gTb=frames.pose(R, gTb[:3, 3] - errors.position_m * rng.standard_normal(3)),
        gV=gV - errors.velocity_m_s * rng.standard_normal(3),
        attitude_sigma_rad=attitude,
        position_sigma_m=errors.position_m,
        velocity_sigma_m_s=errors.velocity_m_s,
        angular_velocity_sigma_rad_s=math.radians(errors.angular_velocity_deg_s),
        gyro_bias_sigma_rad_s=biases[0],
        accelerometer_bias_sigma_m_s2=biases[1],
        angular_velocity_rad_s=None if rate is None else (float(rate[0]), float(rate[1]), float(rate[2])),
    )


def measure(
    gTb: FloatArray,
    stamp_ns: int,
    sun: FloatArray,
    *,
    camera: Camera,
    catalog: Catalog,
    prior_gP: FloatArray,
    options: MeasurementSection,
    rng: np.random.Generator,
) -> FrameMeasurement:
    """Simulate the measurement of rims and sun tilt by an efficient front end, without an image.

    A chart is drawn from the Gaussian of the true rim; its covariance is evaluated at the measured rim, as
    that of a fit. The sun tilt is measured at the mean of the measured rims' centres.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        True pose.
    stamp_ns : int
    sun : ndarray, shape (3,)
        Unit vector towards the sun in g.
    camera : Camera
    catalog : Catalog
    prior_gP : ndarray, shape (3,)
        Position of the initial state in g, m (see `ground_sun_direction`).
    options : MeasurementSection
    rng : Generator

    Returns
    -------
    FrameMeasurement
    """
    rows, charts = catalog.visible(camera, gTb, min_semi_minor_px=options.min_semi_minor_px)
    if len(rows):
        root = np.linalg.cholesky(
            chart_covariance(charts, camera, options.edge_sigma_px, options.points_per_rim)
        )
        charts = charts + np.einsum("nij,nj->ni", root, rng.standard_normal(charts.shape))
    covariance = chart_covariance(charts, camera, options.edge_sigma_px, options.points_per_rim)
    point = charts[:, :2].mean(axis=0) if len(rows) else np.zeros(2)
    direction = ground_sun_direction(sun, catalog, rows, prior_gP)
    tilt, strength = sun_tilt(gTb, camera.bTc, direction, point[0], point[1], np.empty((1, 6)))
    sigma = math.radians(options.sun_tilt_sigma_deg)
    measured = float(wrap(tilt + sigma * rng.standard_normal()))
    seen = SunTilt(measured, sigma, point, direction) if strength > 0.0 else None
    return FrameMeasurement(stamp_ns, RimSet(rows, charts, covariance), seen)
