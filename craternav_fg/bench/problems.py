"""Problems of any size to time, and the same ones made of GTSAM's own factors.

A lander on a circular orbit 50 km above the Moon's equator looks down; every frame has the same number of
craters, each seen once. The problems are for timing, not for accuracy.
"""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import X

from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.graph import insert_state
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import SHARED_SIZE, FrameMeasurement, RimSet
from craternav_fg.simulation.flat_scenes import CAMERA
from craternav_fg.simulation.scenes import ALTITUDE_M, FOCAL_PX, MOON
from craternav_fg.trajectory import InitialState
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Time between frames; noise of the IMU.
NOISE = ImuNoise(2.0e-5, 3.4e-4, 2e-8, 3e-7)  # LN-200S class
PERIOD_S = 1.0
# Few IMU rows per frame: preintegration costs both sides the same and would hide the difference.
IMU_HZ = 10
EDGE_SIGMA_PX = 0.3
POINT_SIGMA_M = 20.0
# Of the descent with errors that last: every fourth frame, with states between.
TRACKED_EVERY = 4
# Craters lie up to this far from the point below the lander, north and east.
SPREAD_M = 12e3
# Standard deviations of the initial state, per axis.
START_SIGMA_RAD, START_SIGMA_M = 0.01, 300.0


@dataclass(frozen=True)
class Bench:
    """One descent, measured twice.

    Attributes
    ----------
    problem : Problem
        For our estimators.
    points : ndarray, shape (frames, craters, 3)
        The same craters' centres as measured in b, m: what GTSAM's factors take.
    gTb, gV : ndarray, shape (frames, 4, 4), (frames, 3)
        Truth.
    """

    problem: Problem
    points: FloatArray
    gTb: FloatArray
    gV: FloatArray

    def values(self, rng: np.random.Generator, scale: float = 1.0) -> gtsam.Values:
        """Draw a start for a batch optimiser: 1 mrad, 50 m and 0.5 m/s from the truth, times `scale`."""
        values = gtsam.Values()
        sigmas = scale * np.repeat([1e-3, 50.0], 3)
        for i, (T, V) in enumerate(zip(self.gTb, self.gV, strict=True)):
            pose = gtsam.Pose3(T).retract(rng.normal(0.0, sigmas))
            state = gtsam.NavState(pose, V + rng.normal(0.0, 0.5 * scale, 3))
            insert_state(values, i, state, np.zeros(6))
        return values

    def landmark_factors(self, graph: gtsam.NonlinearFactorGraph, number: int) -> None:
        """Add one C++ factor per crater of a frame, in place of our stacked one."""
        model = gtsam.noiseModel.Isotropic.Sigma(3, POINT_SIGMA_M)
        centres = self.problem.catalog.centres[self.problem.frames[number].rims.craters]
        for centre, point in zip(centres, self.points[number], strict=True):
            graph.push_back(gtsam.KnownLandmarkFactorPose3(X(number), centre, point, model))


def make(frames_number: int, craters: int, seed: int = 0, imu_hz: int = IMU_HZ) -> Bench:
    """Make a descent.

    Parameters
    ----------
    frames_number : int
        Number of images, one a second.
    craters : int
        In each.
    seed : int
    imu_hz : int

    Returns
    -------
    Bench
    """
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(frames_number, dtype=np.float64)
    gTb, gV, orbit, rate = _orbit(t)
    n = frames_number * craters
    spread_rad = SPREAD_M / MOON.radius_m
    minor = rng.uniform(800.0, 2000.0, n)
    catalog = Catalog(
        tuple(map(str, range(n))),
        rng.uniform(-spread_rad, spread_rad, n),
        np.repeat(rate * t, craters) + rng.uniform(-spread_rad, spread_rad, n),
        minor * rng.uniform(1.05, 1.4, n),
        minor,
        rng.uniform(-np.pi, np.pi, n),
        np.zeros(n),
        MOON,
    )
    stamps = np.round(t * 1e9).astype(np.int64)
    measured, points = _measure(rng, catalog, gTb, stamps, craters)
    initial = InitialState(
        stamp_ns=0,
        gTb=gTb[0],
        gV=gV[0],
        attitude_sigma_rad=START_SIGMA_RAD,
        position_sigma_m=START_SIGMA_M,
        velocity_sigma_m_s=2.0,
        angular_velocity_sigma_rad_s=0.01,
        gyro_bias_sigma_rad_s=5e-6,
        accelerometer_bias_sigma_m_s2=3e-3,
    )
    imu = _imu(rng, t[-1], orbit, imu_hz)
    descent = Descent(MOON, CAMERA, catalog, imu, NOISE, initial)
    start = Start(gTb[0], np.diag(np.repeat([START_SIGMA_RAD**2, START_SIGMA_M**2], 3)), 0)
    return Bench(Problem(**vars(descent), start=start, frames=measured), points, gTb, gV)


def tracked(frames_number: int, craters: int, seed: int = 0) -> Problem:
    """Make a descent that sees each crater in as many successive images, with errors that last.

    Parameters
    ----------
    frames_number : int
        Number of images, one in four seconds, with IMU at 100 Hz.
    craters : int
        In each, but for the first and the last ones.
    seed : int

    Returns
    -------
    Problem
    """
    base = make(TRACKED_EVERY * frames_number, 1, seed, imu_hz=100)
    rng = np.random.default_rng([seed, 1])
    own, everyone = rng.standard_normal((len(base.gTb), 5)), rng.standard_normal(SHARED_SIZE)
    catalog = base.problem.catalog
    frames = []
    for k in range(frames_number):
        seen = np.arange(max(0, k - craters // 2), min(frames_number, k - craters // 2 + craters))
        i, rows = TRACKED_EVERY * k, TRACKED_EVERY * seen
        frame = base.problem.frames[i]
        charts, _ = project_rims(base.gTb[i], CAMERA.bTc, catalog.centres[rows], catalog.axes[rows])
        white = np.repeat(frame.rims.covariance, len(rows), axis=0)
        A = 2.0 * np.sqrt(white)
        B = np.zeros((len(rows), 5, SHARED_SIZE))
        B[:, :, :5] = 0.5 * np.sqrt(white)
        charts += np.einsum("nij,nj->ni", A, own[rows]) + B @ everyone
        charts += rng.standard_normal(charts.shape) * np.sqrt(np.diagonal(white, axis1=1, axis2=2))
        S = white + A @ np.swapaxes(A, 1, 2) + B @ np.swapaxes(B, 1, 2)
        frames.append(replace(frame, rims=RimSet(rows, charts, S, correlated=A, shared=B)))
    return replace(base.problem, frames=frames)


def _orbit(t: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Poses (k, 4, 4) and velocities (k, 3) in g at times (k,); orbital rate, inertial and in g, rad/s."""
    radius = MOON.radius_m + ALTITUDE_M
    orbit = float(np.sqrt(MOON.mu_m3_s2 / radius**3))
    # In g, which rotates with the body, the lander is slower by the body's spin.
    rate = orbit - MOON.spin_rad_s[2]
    up = np.stack([np.cos(rate * t), np.sin(rate * t), np.zeros_like(t)], axis=1)
    ahead = np.stack([-np.sin(rate * t), np.cos(rate * t), np.zeros_like(t)], axis=1)
    gTb = np.zeros((len(t), 4, 4))
    gTb[:, :3, 0] = ahead
    gTb[:, :3, 1] = [0.0, 0.0, -1.0]
    gTb[:, :3, 2] = -up
    gTb[:, :3, 3] = radius * up
    gTb[:, 3, 3] = 1.0
    return gTb, radius * rate * ahead, orbit, rate


def _measure(
    rng: np.random.Generator,
    catalog: Catalog,
    gTb: FloatArray,
    stamps: npt.NDArray[np.int64],
    craters: int,
) -> tuple[list[FrameMeasurement], FloatArray]:
    """Measure the craters of each frame: as rims, and as points (frames, craters, 3) in b, m."""
    measured = []
    points = np.empty((len(gTb), craters, 3))
    for i, T in enumerate(gTb):
        rows = np.arange(i * craters, (i + 1) * craters)
        charts, _ = project_rims(T, CAMERA.bTc, catalog.centres[rows], catalog.axes[rows])
        sigmas = np.tile([0.5, 0.5, 0.0, 0.0, 0.0], (craters, 1)) * EDGE_SIGMA_PX / FOCAL_PX
        sigmas[:, 2:] = EDGE_SIGMA_PX / FOCAL_PX / np.exp(charts[:, 2:3])
        S = np.einsum("ni,ij->nij", sigmas**2, np.eye(5))
        charts = charts + rng.normal(size=charts.shape) * sigmas
        measured.append(FrameMeasurement(int(stamps[i]), RimSet(rows, charts, S), None))
        points[i] = (catalog.centres[rows] - T[:3, 3]) @ T[:3, :3]
        points[i] += rng.normal(0.0, POINT_SIGMA_M, points[i].shape)
    return measured, points


def _imu(rng: np.random.Generator, end_s: float, orbit: float, hz: int) -> ImuLog:
    """Log of free fall at an orbital rate, rad/s."""
    dt = 1.0 / hz
    rows = max(2, round(end_s * hz))
    return ImuLog(
        (np.arange(1, rows + 1) * (10**9 // hz)).astype(np.int64),
        # The inertial rotation is about north, which is -y of b.
        np.array([0.0, -orbit, 0.0])
        + rng.normal(size=(rows, 3)) * NOISE.gyro_density_rad_s_sqrt_hz / np.sqrt(dt),
        rng.normal(size=(rows, 3)) * NOISE.accelerometer_density_m_s2_sqrt_hz / np.sqrt(dt),
    )
