"""A small descent, known exactly, from which the filter tests draw problems."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.estimators.base import Problem, Start
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.trajectory import InitialState
from factors.kernels import sun

MOON = Body("Moon", 1_737_400.0, 4.902_800_118e12, (0.0, 0.0, 2.661_7e-6))
FOCAL_PX = 512 / np.tan(np.radians(22))
NOISE = ImuNoise(2.0e-5, 3.4e-4, 1e-8, 1e-7)
RATE_HZ = 50
SIGMAS = {"attitude": np.radians(1.0), "position": 300.0, "velocity": 5.0, "gyro": 4.8e-6, "acc": 2.9e-3}
MOUNTING = frames.pose(np.eye(3), np.array([1.0, 0.0, 0.5]))
SUN_SIGMA_RAD = np.radians(10.0)


@dataclasses.dataclass(frozen=True)
class World:
    """A descent of 100 s from 50 km, known exactly, above random craters."""

    camera: Camera
    catalog: Catalog
    stamps_ns: np.ndarray
    gTb: np.ndarray
    gV: np.ndarray
    imu: ImuLog
    seen: tuple
    sun: np.ndarray


def motion(t):
    """Poses, velocities, accelerations in g and gyro rates in b, at times (n,)."""
    R0 = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # nadir at lon 0: z down
    w = np.array([0.0006, -0.0009, 0.002])
    R = R0 @ Rotation.from_rotvec(t[:, None] * w).as_matrix()
    P0 = np.array([MOON.radius_m + 50e3, -20e3, 5e3])
    V0, A = np.array([-500.0, 500.0, -100.0]), np.array([2.0, -3.0, 0.5])
    P = P0 + t[:, None] * V0 + 0.5 * t[:, None] ** 2 * A
    V = V0 + t[:, None] * A
    spin = np.array(MOON.spin_rad_s)
    acc = A - MOON.gravity(P) + 2 * np.cross(spin, V) + np.cross(spin, np.cross(spin, P))
    f = np.einsum("nji,nj->ni", R, acc)
    return R, P, V, f, w + np.einsum("nji,j->ni", R, spin)


def make_world(seed=0, duration_s=100.0, period_s=2.0, craters=60):
    rng = np.random.default_rng(seed)
    b = rng.uniform(500.0, 2000.0, craters)
    catalog = Catalog(
        tuple(f"C{i}" for i in range(craters)),
        rng.uniform(-40e3, 40e3, craters) / MOON.radius_m,
        rng.uniform(-40e3, 40e3, craters) / MOON.radius_m,
        b * rng.uniform(1.05, 1.4, craters),
        b,
        rng.uniform(-np.pi, np.pi, craters),
        rng.uniform(-300.0, 300.0, craters),
        MOON,
    )
    camera = Camera(
        1024, 1024, FOCAL_PX, FOCAL_PX, 511.5, 511.5, frames.pose(np.eye(3), np.array([1.0, 0, 0.5]))
    )
    n = round(duration_s * RATE_HZ)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    t = ((np.arange(n)[:, None] + 0.5 + 0.5 * nodes) / RATE_HZ).ravel()
    _, _, _, f, w = motion(t)
    means = [np.einsum("nkj,k->nj", v.reshape(n, 3, 3), 0.5 * weights) for v in (w, f)]
    stamps = (np.arange(1, n + 1) * (10**9 // RATE_HZ)).astype(np.int64)
    at = np.arange(0.0, duration_s + 1e-9, period_s)
    R, P, V, _, _ = motion(at)
    gTb = np.array([frames.pose(*pair) for pair in zip(R, P, strict=True)])
    seen = tuple(catalog.visible(camera, T, min_semi_minor_px=8.0) for T in gTb)
    return World(
        camera,
        catalog,
        np.round(at * 1e9).astype(np.int64),
        gTb,
        V,
        ImuLog(stamps, *means),
        seen,
        np.array([0.5, 0.6, 0.6245]),
    )


def rim_covariance(y, sigma_px=0.4):
    """Chart covariance of a rim measured by evenly spread edge points; correlated, as fits are."""
    size = np.exp(np.array([0.0, 0.0, -y[2], -y[2], -y[2]]))
    root = np.tril(np.full((5, 5), 0.2)) + 0.8 * np.eye(5)
    root = size[:, None] * sigma_px / FOCAL_PX * root
    return root @ root.T


def drawn(charts, S, rng):
    """Charts (n, 5) with Gaussian errors of covariances (n, 5, 5)."""
    return charts + np.einsum("nij,nj->ni", np.linalg.cholesky(S), rng.normal(size=charts.shape))


def draw(world, rng, *, start_scale=1.0):
    """One problem: measurements and start drawn about the truth from their own covariances."""
    measured = []
    for stamp, T, (rows, charts) in zip(world.stamps_ns, world.gTb, world.seen, strict=True):
        S = np.array([rim_covariance(y) for y in charts]).reshape(-1, 5, 5)
        y = drawn(charts, S, rng)
        tilt, _ = sun.sun_tilt(T, world.camera.bTc, world.sun, 0.0, 0.0, np.zeros((1, 6)))
        tilt = sun.wrap(tilt + SUN_SIGMA_RAD * rng.normal())
        measured.append(
            FrameMeasurement(
                int(stamp), RimSet(rows, y, S), SunTilt(tilt, SUN_SIGMA_RAD, np.zeros(2), world.sun)
            )
        )
    sigma = start_scale * np.repeat([SIGMAS["attitude"], SIGMAS["position"]], 3)
    # Correlated, as a start from rims is: a turn and a shift look alike.
    root = np.diag(sigma) @ np.linalg.cholesky(0.5 * np.eye(6) + 0.5 * np.ones((6, 6)))
    error = root @ rng.normal(size=6)
    start = world.gTb[0].copy()
    start[:3, :3] = start[:3, :3] @ frames.rotation_exp(-error[:3])
    start[:3, 3] -= error[3:]
    dt = 1.0 / RATE_HZ
    bias = np.repeat([SIGMAS["gyro"], SIGMAS["acc"]], 3) * rng.normal(size=6)
    n = len(world.imu.stamps_ns)
    walk = np.cumsum(rng.normal(size=(n, 6)) * np.sqrt(dt), axis=0)
    walk *= np.repeat([NOISE.gyro_walk_rad_s2_sqrt_hz, NOISE.accelerometer_walk_m_s3_sqrt_hz], 3)
    white = rng.normal(size=(n, 6)) / np.sqrt(dt)
    white *= np.repeat([NOISE.gyro_density_rad_s_sqrt_hz, NOISE.accelerometer_density_m_s2_sqrt_hz], 3)
    added = bias + walk + white
    return Problem(
        body=MOON,
        camera=world.camera,
        catalog=world.catalog,
        imu=ImuLog(
            world.imu.stamps_ns,
            world.imu.gyro_rad_s + added[:, :3],
            world.imu.accelerometer_m_s2 + added[:, 3:],
        ),
        imu_noise=NOISE,
        initial=InitialState(
            stamp_ns=int(world.stamps_ns[0]),
            gTb=start,
            gV=world.gV[0] + SIGMAS["velocity"] * rng.normal(size=3),
            attitude_sigma_rad=SIGMAS["attitude"],
            position_sigma_m=SIGMAS["position"],
            velocity_sigma_m_s=SIGMAS["velocity"],
            angular_velocity_sigma_rad_s=np.radians(5.0),
            gyro_bias_sigma_rad_s=SIGMAS["gyro"],
            accelerometer_bias_sigma_m_s2=SIGMAS["acc"],
        ),
        start=Start(start, root @ root.T, 0),
        frames=measured,
    )


def pose_errors(trajectory, world):
    """Errors (k, 6) of attitude (in b) and position, truth minus estimate."""
    phi = frames.rotation_log(np.swapaxes(trajectory.gRb, 1, 2) @ world.gTb[:, :3, :3])
    return np.concatenate([phi, world.gTb[:, :3, 3] - trajectory.gP], axis=1)


def nees(trajectory, world):
    e = pose_errors(trajectory, world)
    return np.einsum("ki,ki->k", e, np.linalg.solve(trajectory.pose_covariance, e[:, :, None])[:, :, 0])
