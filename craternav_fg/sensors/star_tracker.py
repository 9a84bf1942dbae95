"""Star tracker: the attitude of the body in the inertial frame, turned into g by the body's spin.

Zero when the measured attitude of the sensor is iRg(t) gRb bRs.
"""

from typing import Literal

import numpy as np

from craternav_fg import frames
from craternav_fg.config import Positive, Quaternion
from craternav_fg.sensors.protocol import (
    ATTITUDE,
    STATE_SIZE,
    Linearisation,
    Sensor,
    SensorSettings,
    SensorState,
)
from craternav_fg.tables import Column
from factors.arrays import FloatArray

QUATERNION = ("q_IS_w", "q_IS_x", "q_IS_y", "q_IS_z")
# Largest deviation of a quaternion's length from 1: rounding of numbers with five digits.
UNIT_TOLERANCE = 1e-4


class StarTrackerSettings(SensorSettings):
    """`mav0/star_tracker0/sensor.yaml`."""

    sensor_type: Literal["star_tracker"] = "star_tracker"
    epoch_ns: int = 0
    """Time at which the next key holds."""
    inertial_attitude_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """iRg at the epoch: the attitude of the body-fixed frame in the inertial one, Hamilton, scalar first."""
    cross_sigma_arcsec: Positive = 10.0
    """Standard deviation about each axis across the boresight, which is the sensor's z."""
    roll_sigma_arcsec: Positive = 60.0
    """Standard deviation about the boresight."""


class StarTracker(Sensor):
    """Attitudes of the sensor in the inertial frame."""

    name = "star_tracker"
    Settings = StarTrackerSettings

    @classmethod
    def columns(cls, settings: StarTrackerSettings) -> tuple[Column, ...]:
        """Four columns: the Hamilton quaternion iRs, scalar first."""
        return tuple(Column(name) for name in QUATERNION)

    @property
    def rows(self) -> int:
        """Length of a sample's residual."""
        return 3

    def linearise(self, row: int, state: SensorState, bias: FloatArray) -> Linearisation:
        """Compare an attitude with the predicted one; see `Sensor.linearise`.

        Parameters
        ----------
        row : int
        state : SensorState
        bias : ndarray, shape (0,)
            Empty: unit-less.

        Returns
        -------
        Linearisation
        """
        measured = frames.from_quaternion_wxyz(self.values[row])
        error = frames.rotation_log(measured.T @ self._attitude(state))
        J = np.zeros((3, STATE_SIZE))
        J[:, ATTITUDE] = (
            np.linalg.solve(frames.right_jacobian(error), self.bTs[:3, :3].T) / self._sigmas[:, None]
        )
        return Linearisation(error / self._sigmas, J, np.zeros((3, len(bias))))

    def draw(self, state: SensorState, bias: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw an attitude at a true state; see `Sensor.draw`.

        Parameters
        ----------
        state : SensorState
        bias : ndarray, shape (0,)
            Empty: unit-less.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (4,)
        """
        noise = frames.rotation_exp(self._sigmas * rng.standard_normal(3))
        return frames.to_quaternion_wxyz(self._attitude(state) @ noise.T)

    def outlier(self, values: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw any attitude: a false star pattern; see `Sensor.outlier`.

        Parameters
        ----------
        values : ndarray, shape (4,)
            Unit quaternion.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (4,)
        """
        drawn = rng.standard_normal(4)
        return np.asarray(drawn / np.linalg.norm(drawn))

    def fault(self, row: int) -> tuple[str, str] | None:
        """Refuse quaternions that are not of unit length; see `Sensor.fault`.

        Parameters
        ----------
        row : int

        Returns
        -------
        tuple of (str, str) or None
        """
        length = float(np.linalg.norm(self.values[row]))
        if abs(length - 1.0) <= UNIT_TOLERANCE:
            return None
        return ",".join(QUATERNION), f"expected a unit quaternion, its length is {length:.9g}"

    def misreadings(self) -> dict[str, FloatArray]:
        """Quaternions with the scalar last, and those of the inertial frame in the sensor.

        See `Sensor.misreadings`.

        Returns
        -------
        dict of str to ndarray, each of shape (n, 4)
        """
        first, last = self.values, np.roll(self.values, 1, axis=1)
        inverse = np.array([1.0, -1.0, -1.0, -1.0])
        order, attitude = (
            "expected the order w, x, y, z, found x, y, z, w",
            "of the sensor in the inertial frame",
        )
        return {
            f"{QUATERNION[0]}: {order}": last,
            f"{QUATERNION[0]}: expected the attitude {attitude}, found the inverse": first * inverse,
            f"{QUATERNION[0]}: {order}, and the inverse of the attitude {attitude}": last * inverse,
        }

    @property
    def _sigmas(self) -> FloatArray:
        given = self.settings
        return np.radians([given.cross_sigma_arcsec] * 2 + [given.roll_sigma_arcsec]) / 3600.0

    def _attitude(self, state: SensorState) -> FloatArray:
        """Attitude (3, 3) of the sensor in the inertial frame."""
        epoch = frames.from_quaternion_wxyz(np.array(self.settings.inertial_attitude_wxyz))
        elapsed_s = 1e-9 * (state.stamp_ns - self.settings.epoch_ns)
        turn = frames.rotation_exp(elapsed_s * np.array(self.surroundings.body.spin_rad_s))
        return np.asarray(epoch @ turn @ state.gTb[:3, :3] @ self.bTs[:3, :3])
