"""The interface of motion models: propagation with derivative and noise, and interpolation between states.

A model stands in for the accelerometer. Where there is a gyro it keeps the attitude; where there is none,
the angular velocity is a state that random-walks. It takes the place of the gyro's bias: w = rate - bias,
with the constant `rate_rad_s` of the model in place of a reading. So all estimators keep their states.
"""

from dataclasses import dataclass, field

import numpy as np

from craternav_fg.body import Body
from craternav_fg.imu import ImuNoise
from craternav_fg.motion.gravity import GravityField
from factors.arrays import FloatArray
from factors.kernels import motion

# Random walk, m/s^3/sqrt(Hz), of an accelerometer bias that a model does not use: it only keeps the
# covariance regular.
UNUSED_WALK = 1e-6
# Density, rad/s/sqrt(Hz) or m/s^2/sqrt(Hz), of white noise that there is none of.
UNUSED_DENSITY = 1e-12


@dataclass(frozen=True)
class Motion:
    """A motion model and its process noise, as continuous-time densities per axis.

    Attributes
    ----------
    name : str
        "coast", "white_acceleration" or "white_jerk".
    kind : int
        Number of the model in `factors.kernels.motion`.
    acceleration_density_m_s2_sqrt_hz : float
        White noise of the acceleration, m/s^2/sqrt(Hz).
    jerk_density_m_s3_sqrt_hz : float
        White noise of the jerk, m/s^3/sqrt(Hz).
    rate_rad_s : tuple of float
        Prior mean of the inertial angular velocity, in b; not used with a gyro.
    rate_sigma_rad_s : float
        Its standard deviation per axis.
    rate_walk_rad_s2_sqrt_hz : float
        White noise of the angular acceleration, rad/s^2/sqrt(Hz); not used with a gyro.
    acceleration_sigma_m_s2 : float
        Prior standard deviation per axis of the acceleration that is a state (`white_jerk`).
    gravity : GravityField
        In which `coast` falls.
    """

    name: str
    kind: int
    acceleration_density_m_s2_sqrt_hz: float
    jerk_density_m_s3_sqrt_hz: float = UNUSED_WALK
    rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate_sigma_rad_s: float = 0.01
    rate_walk_rad_s2_sqrt_hz: float = 1e-5
    acceleration_sigma_m_s2: float = 1e-3
    gravity: GravityField = field(default_factory=GravityField)

    @property
    def noise(self) -> ImuNoise:
        """Process noise without a gyro, as an IMU's: the random walks are of angular velocity and force."""
        return ImuNoise(
            gyro_density_rad_s_sqrt_hz=UNUSED_DENSITY,
            accelerometer_density_m_s2_sqrt_hz=max(self.acceleration_density_m_s2_sqrt_hz, UNUSED_DENSITY),
            gyro_walk_rad_s2_sqrt_hz=self.rate_walk_rad_s2_sqrt_hz,
            accelerometer_walk_m_s3_sqrt_hz=self.jerk_density_m_s3_sqrt_hz,
        )

    def transition(
        self,
        body: Body,
        state: tuple[FloatArray, FloatArray, FloatArray],
        rows: tuple[FloatArray, FloatArray],
        noise: ImuNoise,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Propagate a state.

        Parameters
        ----------
        body : Body
        state : (ndarray, ndarray, ndarray)
            Pose gTb (4, 4), m; velocity gV (3,) relative to g, in g, m/s; bias (6,), gyro (rad/s) and
            accelerometer (m/s^2), in b.
        rows : (ndarray, ndarray)
            Durations (m,), s, and angular velocities (m, 3) in b, rad/s, from which the bias is subtracted.
        noise : ImuNoise
            Noise of the gyro and the process.

        Returns
        -------
        gTb : ndarray, shape (4, 4)
            In g, m.
        gV : ndarray, shape (3,)
            In g, m/s.
        F : ndarray, shape (15, 15)
            Transition of the error state of `factors.kernels.motion`, rad, m, s.
        Q : ndarray, shape (15, 15)
            Covariance of the added noise, rad, m, s.
        """
        gTb, gV, bias = (np.ascontiguousarray(part, dtype=np.float64) for part in state)
        dt_s, gyro = (np.ascontiguousarray(part, dtype=np.float64) for part in rows)
        spin = np.array(body.spin_rad_s)
        of = self.gravity
        return motion.transition(
            self.kind,
            gTb,
            gV,
            bias,
            dt_s,
            gyro,
            body.mu_m3_s2,
            spin,
            of.radius_m,
            of.C,
            of.S,
            noise.densities,
        )

    def free(
        self, body: Body, state: tuple[FloatArray, FloatArray, FloatArray], seconds: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Propagate a state without a gyro, see `transition`.

        Parameters
        ----------
        body : Body
        state : (ndarray, ndarray, ndarray)
            As in `transition`.
        seconds : float
            Duration; negative: backwards.

        Returns
        -------
        gTb : ndarray, shape (4, 4)
            In g, m.
        gV : ndarray, shape (3,)
            In g, m/s.
        F : ndarray, shape (15, 15)
            Transition, rad, m, s.
        Q : ndarray, shape (15, 15)
            Covariance of the added noise, rad, m, s; without a meaning backwards.
        """
        rows = np.array([seconds]), np.array([self.rate_rad_s])
        return self.transition(body, state, rows, self.noise)

    def gyro_entry(self, gTb: FloatArray, gV: FloatArray) -> FloatArray:
        """Differentiate the error state's rate by the gyro's noise, see `factors.kernels.motion.gyro_entry`.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose of the body in g.
        gV : ndarray, shape (3,)
            Velocity relative to g, in g, m/s.

        Returns
        -------
        ndarray, shape (15, 3)
            Rad/s and m/s^2 per rad/s.
        """
        return motion.gyro_entry(self.kind, np.ascontiguousarray(gTb[:3, :3]), gV)
