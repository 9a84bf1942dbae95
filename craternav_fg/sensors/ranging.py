"""Ranging: range and range rate from a station or an orbiter, whose state in g comes with each sample.

Zero when the sensor is as far from the station as measured, and moves away from it as fast.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from craternav_fg.config import Positive
from craternav_fg.sensors.protocol import (
    ATTITUDE,
    POSITION,
    STATE_SIZE,
    VELOCITY,
    Linearisation,
    Sensor,
    SensorSettings,
    SensorState,
)
from craternav_fg.tables import Column
from factors.arrays import FloatArray

RANGE, RATE_COLUMN = Column("range", unit="m"), Column("range_rate", unit="m s^-1")
STATION = tuple(Column(f"p_GS_{axis}", unit="m") for axis in "xyz")
STATION_VELOCITY = tuple(Column(f"v_GS_{axis}", unit="m s^-1") for axis in "xyz")


class RangingSettings(SensorSettings):
    """`mav0/ranging0/sensor.yaml`."""

    sensor_type: Literal["ranging"] = "ranging"
    range_noise_m: Positive = 3.0
    rate_noise_m_s: Positive = 0.002
    bias_sigma_m: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard deviation of the constant range bias; 0 if no bias is estimated."""


class Ranging(Sensor):
    """Range, m, and range rate, m/s, to a station whose position and velocity in g are known."""

    name = "ranging"
    Settings = RangingSettings

    @classmethod
    def columns(cls, settings: RangingSettings) -> tuple[Column, ...]:
        """Range, range rate, position and velocity of the station in g: eight columns."""
        return (RANGE, RATE_COLUMN, *STATION, *STATION_VELOCITY)

    @property
    def rows(self) -> int:
        """Length of a sample's residual."""
        return 2

    @property
    def bias_sigmas(self) -> FloatArray:
        """Of the range bias, m, shape (1,), or (0,) without one."""
        sigma = self.settings.bias_sigma_m
        return np.array([sigma]) if sigma > 0.0 else np.empty(0)

    def linearise(self, row: int, state: SensorState, bias: FloatArray) -> Linearisation:
        """Compare range and range rate with the predicted ones; see `Sensor.linearise`.

        The lever arm counts in the range; its turning does not in the rate.

        Parameters
        ----------
        row : int
        state : SensorState
        bias : ndarray, shape (1,) or (0,)
            Range bias, m.

        Returns
        -------
        Linearisation
        """
        sigmas = np.array([self.settings.range_noise_m, self.settings.rate_noise_m_s])
        gRb, arm = state.gTb[:3, :3], self.bTs[:3, 3]
        away = state.gTb[:3, 3] + gRb @ arm - self.values[row, 2:5]
        speed = state.gV - self.values[row, 5:8]
        range_m = float(np.linalg.norm(away))
        line = away / range_m
        # The rate's derivative in the position: the speed across the line, over the range.
        across = (speed - (speed @ line) * line) / range_m
        J = np.zeros((2, STATE_SIZE))
        J[:, POSITION] = line, across
        J[:, ATTITUDE] = np.cross(arm, np.stack([line, across]) @ gRb)
        J[1, VELOCITY] = line
        predicted = np.array([range_m + bias.sum(), speed @ line])
        J_bias = np.array([[1.0], [0.0]])[:, : len(bias)]
        return Linearisation(
            (predicted - self.values[row, :2]) / sigmas, J / sigmas[:, None], J_bias / sigmas[:, None]
        )

    def misreadings(self) -> dict[str, FloatArray]:
        """Everything in km and km/s, or the station alone; see `Sensor.misreadings`.

        Returns
        -------
        dict of str to ndarray, each of shape (n, 8)
        """
        station = self.values * np.repeat([1.0, 1e3], [2, 6])
        return {
            "range: expected m and m/s, found km and km/s": 1e3 * self.values,
            "p_GS_x: expected m and m/s, found km and km/s": station,
        }

    def draw(self, state: SensorState, bias: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw a sample at a true state, of an orbiter overhead at rest in g; see `Sensor.draw`.

        Parameters
        ----------
        state : SensorState
        bias : ndarray, shape (1,) or (0,)
            Range bias, m.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (8,)
        """
        settings, body = self.settings, self.surroundings.body
        station = 2.0 * body.radius_m * np.array([1.0, 0.2, 0.1])
        away = state.gTb[:3, 3] + state.gTb[:3, :3] @ self.bTs[:3, 3] - station
        range_m = float(np.linalg.norm(away))
        range_m_s = float(state.gV @ away) / range_m
        return np.array(
            [
                range_m + bias.sum() + settings.range_noise_m * rng.standard_normal(),
                range_m_s + settings.rate_noise_m_s * rng.standard_normal(),
                *station,
                0.0,
                0.0,
                0.0,
            ]
        )
