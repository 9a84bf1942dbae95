"""Descents of any size to time, and the same ones made of GTSAM's own factors.

A lander in free fall on a circular orbit 50 km above the Moon's equator looks down; every frame has the
same number of craters, each its own. Nothing here is a test of accuracy.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import X

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.base import Descent, Problem, Start
from craternav_fg.estimators.graph import insert_state
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.simulation.scenes import ALTITUDE_M, FOCAL_PX, MOON
from craternav_fg.trajectory import InitialState
from factors.kernels.conic import project_rims

FloatArray = npt.NDArray[np.float64]

NOISE = ImuNoise(2.0e-5, 3.4e-4, 2e-8, 3e-7)  # LN-200S class
PERIOD_S = 1.0
# Few rows an interval: preintegration costs both sides the same and would hide the difference.
IMU_HZ = 10
EDGE_SIGMA_PX = 0.3
POINT_SIGMA_M = 20.0


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


def make(frames_number: int, craters: int, seed: int = 0) -> Bench:
    """Make a descent.

    Parameters
    ----------
    frames_number : int
        Of images, one a second.
    craters : int
        In each.
    seed : int

    Returns
    -------
    Bench
    """
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(frames_number)
    radius = MOON.radius_m + ALTITUDE_M
    orbit = np.sqrt(MOON.mu_m3_s2 / radius**3)
    # In the turning frame the lander is slower by the body's spin.
    rate = orbit - MOON.spin_rad_s[2]
    up = np.stack([np.cos(rate * t), np.sin(rate * t), np.zeros_like(t)], axis=1)
    ahead = np.stack([-np.sin(rate * t), np.cos(rate * t), np.zeros_like(t)], axis=1)
    north = np.array([0.0, 0.0, 1.0])
    gTb = np.zeros((frames_number, 4, 4))
    gTb[:, :3, 0] = ahead
    gTb[:, :3, 1] = -north
    gTb[:, :3, 2] = -up
    gTb[:, :3, 3] = radius * up
    gTb[:, 3, 3] = 1.0
    gV = radius * rate * ahead
    camera = Camera(1024, 1024, FOCAL_PX, FOCAL_PX, 511.5, 511.5, frames.pose(np.eye(3), np.zeros(3)))
    n = frames_number * craters
    spread_rad = 12e3 / MOON.radius_m
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
    measured = []
    points = np.empty((frames_number, craters, 3))
    for i in range(frames_number):
        rows = np.arange(i * craters, (i + 1) * craters)
        charts, _ = project_rims(gTb[i], camera.bTc, catalog.centres[rows], catalog.axes[rows])
        sigmas = np.tile([0.5, 0.5, 0.0, 0.0, 0.0], (craters, 1)) * EDGE_SIGMA_PX / FOCAL_PX
        sigmas[:, 2:] = EDGE_SIGMA_PX / FOCAL_PX / np.exp(charts[:, 2:3])
        S = np.einsum("ni,ij->nij", sigmas**2, np.eye(5))
        charts = charts + rng.normal(size=charts.shape) * sigmas
        measured.append(FrameMeasurement(int(stamps[i]), RimSet(rows, charts, S), None))
        points[i] = (catalog.centres[rows] - gTb[i, :3, 3]) @ gTb[i, :3, :3]
        points[i] += rng.normal(0.0, POINT_SIGMA_M, points[i].shape)
    dt = 1.0 / IMU_HZ
    rows_number = max(2, round((frames_number - 1) * PERIOD_S * IMU_HZ))
    imu = ImuLog(
        (np.arange(1, rows_number + 1) * (10**9 // IMU_HZ)).astype(np.int64),
        # The inertial turn is about north, which is -y of b.
        np.array([0.0, -orbit, 0.0]) + rng.normal(size=(rows_number, 3)) * NOISE.gyro_density / np.sqrt(dt),
        rng.normal(size=(rows_number, 3)) * NOISE.accelerometer_density / np.sqrt(dt),
    )
    initial = InitialState(
        stamp_ns=0,
        gTb=gTb[0],
        gV=gV[0],
        attitude_sigma_rad=0.01,
        position_sigma_m=300.0,
        velocity_sigma_m_s=2.0,
        angular_velocity_sigma_rad_s=0.01,
        gyro_bias_sigma_rad_s=5e-6,
        accelerometer_bias_sigma_m_s2=3e-3,
    )
    descent = Descent(MOON, camera, catalog, imu, NOISE, initial)
    start = Start(gTb[0], np.diag(np.repeat([0.01**2, 300.0**2], 3)), 0)
    return Bench(Problem(**vars(descent), start=start, frames=measured), points, gTb, gV)
