"""Doppler velocimeter: the velocity along a few beams, relative to the rotating ground.

Zero when each measured speed is d . v, d the beam's direction and v the sensor's velocity relative to the
ground: positive where the sensor moves along its beam, towards the ground.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from craternav_fg.config import Direction, Positive
from craternav_fg.sensors.protocol import (
    ATTITUDE,
    RATE,
    STATE_SIZE,
    VELOCITY,
    Linearisation,
    Sensor,
    SensorSettings,
    SensorState,
)
from craternav_fg.tables import Column
from factors.arrays import FloatArray

# Speeds beyond are none of a lander near the ground: km/s would stand for m/s the other way round.
LARGEST_SPEED_M_S = 1e4
SLANT = 0.3826834323650898  # sin 22.5 deg


class VelocimeterSettings(SensorSettings):
    """`mav0/velocimeter0/sensor.yaml`."""

    sensor_type: Literal["velocimeter"] = "velocimeter"
    beams: Annotated[tuple[Direction, ...], Field(min_length=1, max_length=8)] = (
        (SLANT, 0.0, 0.9238795325112867),
        (-SLANT, 0.0, 0.9238795325112867),
        (0.0, SLANT, 0.9238795325112867),
        (0.0, -SLANT, 0.9238795325112867),
    )
    """Directions in the sensor's axes; their lengths do not matter."""
    noise_m_s: Positive = 0.05
    """Standard deviation of a beam's speed."""
    noise_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Further standard deviation, as a share of the speed."""
    bias_sigma_m_s: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard deviation of each beam's constant bias; 0 if no bias is estimated."""


class Velocimeter(Sensor):
    """Speeds along the beams, m/s."""

    name = "velocimeter"
    Settings = VelocimeterSettings

    @classmethod
    def columns(cls, settings: VelocimeterSettings) -> tuple[Column, ...]:
        """One column per beam, m/s."""
        return tuple(Column(f"speed_{k}", unit="m s^-1") for k in range(len(settings.beams)))

    @property
    def rows(self) -> int:
        """Length of a sample's residual."""
        return len(self.settings.beams)

    @property
    def bias_sigmas(self) -> FloatArray:
        """Of the beams' biases, m/s, shape (k,), or (0,) without."""
        sigma = self.settings.bias_sigma_m_s
        return np.full(len(self.settings.beams), sigma) if sigma > 0.0 else np.empty(0)

    def linearise(self, row: int, state: SensorState, bias: FloatArray) -> Linearisation:
        """Compare the beams' speeds with the predicted ones; see `Sensor.linearise`.

        Parameters
        ----------
        row : int
        state : SensorState
        bias : ndarray, shape (k,) or (0,)
            Bias of each beam, m/s.

        Returns
        -------
        Linearisation
        """
        measured = self.values[row]
        sigma = self._sigmas(measured)
        beams = self._beams
        gRb, spin = state.gTb[:3, :3], np.array(self.surroundings.body.spin_rad_s)
        seen, arm = gRb.T @ state.gV, self.bTs[:3, 3]
        turning = gRb.T @ spin
        predicted = beams @ (seen + _cross(state.rate_rad_s - turning) @ arm)
        J = np.zeros((len(beams), STATE_SIZE))
        # bRg v changes by (bRg v) x dphi; so does the spin seen from b.
        J[:, ATTITUDE] = beams @ (_cross(seen) + _cross(arm) @ _cross(turning))
        J[:, VELOCITY] = beams @ gRb.T
        J[:, RATE] = -beams @ _cross(arm)
        error = predicted - measured + (bias if len(bias) else 0.0)
        J_bias = np.diag(1.0 / sigma) if len(bias) else np.zeros((len(beams), 0))
        return Linearisation(error / sigma, J / sigma[:, None], J_bias)

    def draw(self, state: SensorState, bias: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw the beams' speeds at a true state; see `Sensor.draw`.

        Parameters
        ----------
        state : SensorState
        bias : ndarray, shape (k,) or (0,)
            Bias of each beam, m/s.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (k,)
        """
        gRb, spin = state.gTb[:3, :3], np.array(self.surroundings.body.spin_rad_s)
        ground = state.rate_rad_s - gRb.T @ spin
        speeds = self._beams @ (gRb.T @ state.gV + np.cross(ground, self.bTs[:3, 3]))
        speeds = speeds + (bias if len(bias) else 0.0)
        return np.asarray(speeds + self._sigmas(speeds) * rng.standard_normal(len(speeds)))

    def outlier(self, values: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Redraw one beam anywhere within twice the largest speed; see `Sensor.outlier`.

        Parameters
        ----------
        values : ndarray, shape (k,)
            m/s.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (k,)
        """
        out = values.copy()
        out[rng.integers(len(out))] = rng.uniform(-2.0, 2.0) * np.max(np.abs(values))
        return out

    def fault(self, row: int) -> tuple[str, str] | None:
        """Refuse speeds beyond those of any landing; see `Sensor.fault`.

        Parameters
        ----------
        row : int

        Returns
        -------
        tuple of (str, str) or None
        """
        for column, found in zip(self.columns(self.settings), self.values[row], strict=True):
            if not abs(found) <= LARGEST_SPEED_M_S:
                return column.name, f"expected at most {LARGEST_SPEED_M_S:g} m/s in size, found {found:g}"
        return None

    def misreadings(self) -> dict[str, FloatArray]:
        """Speeds in km/s; see `Sensor.misreadings`.

        Returns
        -------
        dict of str to ndarray, each of shape (n, k)
        """
        return {"speed_0: expected m/s, found km/s": 1e3 * self.values}

    @property
    def _beams(self) -> FloatArray:
        """Unit directions (k, 3) in b."""
        beams = np.array(self.settings.beams)
        return np.asarray(beams / np.linalg.norm(beams, axis=1, keepdims=True) @ self.bTs[:3, :3].T)

    def _sigmas(self, speeds: FloatArray) -> FloatArray:
        return np.hypot(self.settings.noise_m_s, self.settings.noise_share * speeds)


def _cross(v: FloatArray) -> FloatArray:
    """Matrix (3, 3) of the product v x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
