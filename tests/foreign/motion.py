"""Motion of the lander in the tangent frame, and what an IMU measures of it."""

from dataclasses import dataclass

import numpy as np

from factors.arrays import FloatArray
from tests.foreign.ground import MOON_RADIUS_M

MU_M3_S2 = 4.9028e12
SPIN_RAD_S = np.array([0.0, 0.0, 2.6616995e-6])
GYRO_NOISE, GYRO_WALK, ACCEL_NOISE, ACCEL_WALK = 2e-5, 1e-7, 3e-4, 1e-5
GYRO_BIAS_SIGMA, ACCEL_BIAS_SIGMA = 5e-6, 2e-3
# Nadir camera on a lander whose z axis is up: camera x is the lander's x, camera z its -z.
BODY_CAMERA = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Site:
    """Tangent frame of a place: rotation from it to g, and its origin in g on the sphere."""

    turn: FloatArray
    origin: FloatArray

    @classmethod
    def at(cls, latitude: float, longitude: float) -> "Site":
        """Site at a latitude and longitude, rad; axes east, north, up."""
        c, s, cl, sl = np.cos(latitude), np.sin(latitude), np.cos(longitude), np.sin(longitude)
        turn = np.array([[-sl, -s * cl, c * cl], [cl, -s * sl, c * sl], [0.0, c, s]])
        return cls(turn, MOON_RADIUS_M * turn[:, 2])


@dataclass(frozen=True)
class Motion:
    """A descent: polynomials of time for the place, sines for the attitude."""

    site: Site
    duration_s: float
    place: FloatArray
    sway: FloatArray
    rate: FloatArray
    phase: FloatArray
    heading: float

    def position(self, t: float) -> FloatArray:
        """Place in the tangent frame, m; `place` (4, 3) has a row for each power of time."""
        return np.array([1.0, t, t * t, t**3]) @ self.place

    def velocity(self, t: float) -> FloatArray:
        """Velocity in the tangent frame relative to the ground, m/s."""
        return np.array([0.0, 1.0, 2.0 * t, 3.0 * t * t]) @ self.place

    def attitude(self, t: float) -> FloatArray:
        """Body axes as columns in the tangent frame."""
        roll, pitch, yaw = self.sway * np.sin(self.rate * t + self.phase)
        yaw += self.heading
        return _axis(2, yaw) @ _axis(1, pitch) @ _axis(0, roll)

    def gTb(self, t: float) -> FloatArray:
        """Pose of the body in g."""
        pose = np.eye(4)
        pose[:3, :3] = self.site.turn @ self.attitude(t)
        pose[:3, 3] = self.site.origin + self.site.turn @ self.position(t)
        return pose

    def imu(self, t: float) -> FloatArray:
        """Angular velocity (3,) and specific force (3,) in b, without errors."""
        R = self.site.turn @ self.attitude(t)
        p = self.site.origin + self.site.turn @ self.position(t)
        v = self.site.turn @ self.velocity(t)
        a = self.site.turn @ (np.array([0.0, 0.0, 2.0, 6.0 * t]) @ self.place)
        a = a + 2.0 * np.cross(SPIN_RAD_S, v) + np.cross(SPIN_RAD_S, np.cross(SPIN_RAD_S, p))
        force = a + MU_M3_S2 * p / np.linalg.norm(p) ** 3
        h = 1e-4
        turned = self.attitude(t).T @ (self.attitude(t + h) - self.attitude(t - h)) / (2.0 * h)
        own = 0.5 * np.array(
            [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        )
        return np.concatenate([own + R.T @ SPIN_RAD_S, R.T @ force])


def draw_motion(
    rng: np.random.Generator, site: Site, high_m: float, low_m: float, duration_s: float
) -> Motion:
    """Draw a descent from `high_m` to `low_m` above the site, over its middle."""
    place = np.zeros((4, 3))
    drift = rng.uniform(-0.08, 0.08, 2) * high_m
    place[0, :2], place[1, :2] = -0.5 * drift, drift / duration_s
    curve = rng.uniform(-0.15, 0.15) * (high_m - low_m)
    place[0, 2], place[2, 2] = high_m, curve / duration_s**2
    place[1, 2] = (low_m - high_m - curve) / duration_s
    sway = np.radians([3.0, 3.0, 6.0]) * rng.uniform(0.5, 1.0, 3)
    return Motion(
        site, duration_s, place, sway, rng.uniform(0.5, 2.0, 3) * 2.0 * np.pi / duration_s,
        rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.0, 2.0 * np.pi),
    )  # fmt: skip


def imu_log(
    rng: np.random.Generator, motion: Motion, rate_hz: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times at the ends of the intervals (n,), samples (n, 6), biases (n, 6) of gyro and accelerometer."""
    dt = 1.0 / rate_hz
    count = round(motion.duration_s * rate_hz) + 2
    ends = dt * np.arange(count)
    # Gauss's two points: exact for cubics, so that the means over intervals are.
    node = 0.5 * dt / np.sqrt(3.0)
    true = np.array([0.5 * sum(motion.imu(t - 0.5 * dt + s) for s in (-node, node)) for t in ends])
    size = np.repeat([GYRO_BIAS_SIGMA, ACCEL_BIAS_SIGMA], 3)
    walk = np.repeat([GYRO_WALK, ACCEL_WALK], 3) * np.sqrt(dt)
    bias = size * rng.standard_normal(6) + np.cumsum(walk * rng.standard_normal(true.shape), axis=0)
    noise = np.repeat([GYRO_NOISE, ACCEL_NOISE], 3) / np.sqrt(dt) * rng.standard_normal(true.shape)
    return ends, true + bias + noise, bias


def _axis(k: int, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (k + 1) % 3, (k + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[j, i], R[i, j] = s, -s
    return R
