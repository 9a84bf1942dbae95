"""Altimeter: the range along a boresight to the ground.

The ground is the body's sphere raised by the height of the surroundings. Zero when the end of the measured
range lies on it: |P + rho u| = R + h.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from craternav_fg.config import Direction, Positive
from craternav_fg.frames import cross_matrix
from craternav_fg.sensors.protocol import (
    ATTITUDE,
    POSITION,
    STATE_SIZE,
    Linearisation,
    Sensor,
    SensorSettings,
    SensorState,
)
from craternav_fg.tables import Column
from factors.arrays import FloatArray

RANGE = "range"
# The height of the ground is looked up where the beam meets it: so often, from the sphere on.
HEIGHT_ITERATIONS = 3
# A beam this near to grazing measures no height.
LEAST_COSINE = 0.05


class AltimeterSettings(SensorSettings):
    """`mav0/altimeter0/sensor.yaml`."""

    sensor_type: Literal["altimeter"] = "altimeter"
    boresight: Direction = (0.0, 0.0, 1.0)
    """Direction of the beam in the sensor's axes; its length does not matter."""
    noise_m: Positive = 1.0
    """Standard deviation of a range."""
    noise_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Further standard deviation, as a share of the range."""
    surface_sigma_m: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard deviation of the ground about the height that the catalogue states."""
    bias_sigma_m: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard deviation of the constant range bias; 0 if no bias is estimated."""


class Altimeter(Sensor):
    """Ranges to the ground, m."""

    name = "altimeter"
    Settings = AltimeterSettings

    @classmethod
    def columns(cls, settings: AltimeterSettings) -> tuple[Column, ...]:
        """One column: the range, m."""
        return (Column(RANGE, unit="m"),)

    @property
    def rows(self) -> int:
        """Length of a sample's residual."""
        return 1

    @property
    def bias_sigmas(self) -> FloatArray:
        """Of the range bias, m, shape (1,), or (0,) without one."""
        sigma = self.settings.bias_sigma_m
        return np.array([sigma]) if sigma > 0.0 else np.empty(0)

    def linearise(self, row: int, state: SensorState, bias: FloatArray) -> Linearisation:
        """Compare a range with the predicted one; see `Sensor.linearise`.

        Parameters
        ----------
        row : int
        state : SensorState
        bias : ndarray, shape (1,) or (0,)
            Range bias, m.

        Returns
        -------
        Linearisation
            Without information where the beam does not meet the ground.
        """
        measured = float(self.values[row, 0])
        sigma = self._sigma(measured)
        J, J_bias = np.zeros((1, STATE_SIZE)), np.full((1, len(bias)), 1.0 / sigma)
        hit = self._hit(state)
        if hit is None:
            return Linearisation(np.zeros(1), J, 0.0 * J_bias)
        range_m, beam, normal = hit
        # Of |P + rho u| = R + h, the height taken as level around the beam's foot.
        slope = -normal / (normal @ beam)
        arm, line = self.bTs[:3, 3], state.gTb[:3, :3].T @ slope
        lever = arm + range_m * (state.gTb[:3, :3].T @ beam)
        J[0, ATTITUDE] = cross_matrix(lever) @ line / sigma
        J[0, POSITION] = slope / sigma
        return Linearisation(np.array([(range_m + bias.sum() - measured) / sigma]), J, J_bias)

    def draw(self, state: SensorState, bias: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw a range at a true state; see `Sensor.draw`.

        Parameters
        ----------
        state : SensorState
        bias : ndarray, shape (1,) or (0,)
            Range bias, m.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (1,)
            NaN where the beam does not meet the ground, or the ground is too near to measure.
        """
        hit = self._hit(state)
        if hit is None:
            return np.full(1, np.nan)
        range_m = hit[0] + bias.sum() + self._sigma(hit[0]) * rng.standard_normal()
        return np.array([range_m if range_m > 0.0 else np.nan])

    def fault(self, row: int) -> tuple[str, str] | None:
        """Refuse ranges that are not positive or beyond ten radii; see `Sensor.fault`.

        Parameters
        ----------
        row : int

        Returns
        -------
        tuple of (str, str) or None
        """
        limit_m = 10.0 * self.surroundings.body.radius_m
        found = self.values[row, 0]
        return None if 0.0 < found < limit_m else (RANGE, f"expected 0 to {limit_m:g} m, found {found:g}")

    def misreadings(self) -> dict[str, FloatArray]:
        """Ranges in km; see `Sensor.misreadings`.

        Returns
        -------
        dict of str to ndarray, each of shape (n, 1)
        """
        return {f"{RANGE}: expected m, found km": 1e3 * self.values}

    def _sigma(self, range_m: float) -> float:
        given = self.settings
        return float(np.hypot(np.hypot(given.noise_m, given.noise_share * range_m), given.surface_sigma_m))

    def _hit(self, state: SensorState) -> tuple[float, FloatArray, FloatArray] | None:
        """Range, m, beam and the ground's normal (3,) in g; None where the beam misses."""
        gRb = state.gTb[:3, :3]
        origin = state.gTb[:3, 3] + gRb @ self.bTs[:3, 3]
        beam = gRb @ self.bTs[:3, :3] @ np.array(self.settings.boresight)
        beam = beam / np.linalg.norm(beam)
        height_m, range_m = 0.0, 0.0
        foot = origin
        for _ in range(HEIGHT_ITERATIONS):
            radius_m = self.surroundings.body.radius_m + height_m
            along = -float(origin @ beam)
            root2 = radius_m**2 - (float(origin @ origin) - along**2)
            if along <= 0.0 or root2 <= 0.0:
                return None
            range_m = along - float(np.sqrt(root2))
            foot = origin + range_m * beam
            height_m = self.surroundings.height_m(foot)
        normal = foot / np.linalg.norm(foot)
        return (range_m, beam, normal) if -float(normal @ beam) > LEAST_COSINE and range_m > 0.0 else None
