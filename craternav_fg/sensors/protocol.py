"""What a sensor is: its files, its measurement equation and its simulation, in one class.

Your own sensor derives from `Sensor` and defines

- `name`: its folder is `mav0/NAME0`;
- `Settings`: the keys of its `sensor.yaml` (a subclass of `SensorSettings`);
- `columns`: the columns of its `data.csv` after the stamp;
- `rows`: the length of a sample's residual;
- `linearise`: predicted minus measured, in sigmas, with derivatives. The factor of the smoothers, the update
  of the filters, the innovations and the bound all call this one function;
- `draw`: a measurement drawn at a true state, for simulation.

Everything else is inherited.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from craternav_fg.body import Body
from craternav_fg.config import Positive, Section
from craternav_fg.tables import Column
from factors.arrays import FloatArray, IntArray

# Error state of a measurement's derivative: attitude (rotation vector in b), position and velocity (in g),
# inertial angular velocity (in b), gyro bias, accelerometer bias. As `factors.kernels.strapdown` has it.
ATTITUDE, POSITION, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
STATE_SIZE = 18

Matrix = Annotated[tuple[float, ...], Field(min_length=16, max_length=16)]


class Mounting(Section):
    """A pose as EuRoC writes it: T_BS, from the sensor's axes to the body's."""

    cols: Literal[4] = 4
    rows: Literal[4] = 4
    data: Matrix = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    @property
    def bTs(self) -> FloatArray:
        """Pose of the sensor in b, shape (4, 4), m."""
        return np.array(self.data).reshape(4, 4)


class SensorSettings(Section):
    """Keys that every `sensor.yaml` may have."""

    sensor_type: str
    comment: str | None = None
    T_BS: Mounting = Mounting()
    """Pose of the sensor in b: its lever arm and axes."""
    rate_hz: Positive = 1.0
    loss: Literal["none", "huber", "cauchy"] = "huber"
    """Robust loss on the norm of a sample's whitened residual."""
    loss_sigmas: Positive = 3.0
    """Norm beyond which a sample loses weight."""


@dataclass(frozen=True)
class SensorState:
    """State of the lander at a sample.

    Attributes
    ----------
    stamp_ns : int
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    rate_rad_s : ndarray, shape (3,)
        Inertial angular velocity in b, rad/s.
    """

    stamp_ns: int
    gTb: FloatArray
    gV: FloatArray
    rate_rad_s: FloatArray


@dataclass(frozen=True)
class Linearisation:
    """A sample at a state.

    Attributes
    ----------
    error : ndarray, shape (m,)
        Predicted minus measured, in sigmas: of unit covariance at the true state.
    jacobian : ndarray, shape (m, 18)
        Its derivative in the error state, see `STATE_SIZE`.
    bias_jacobian : ndarray, shape (m, b)
        Its derivative in the sensor's bias.
    """

    error: FloatArray
    jacobian: FloatArray
    bias_jacobian: FloatArray

    @property
    def informative(self) -> bool:
        """Whether the sample says anything of the state: not if a beam misses the ground, for example."""
        return bool(self.jacobian.any())


@dataclass(frozen=True)
class Surroundings:
    """What a sensor may know of the world.

    Attributes
    ----------
    body : Body
    height_m : callable
        Height of the ground above the body's sphere, m, at a position (3,) in g.
    """

    body: Body
    height_m: Callable[[FloatArray], float]


class Sensor(ABC):
    """A sensor's log and its measurement equation.

    Parameters
    ----------
    settings : SensorSettings
    stamps_ns : ndarray of int, shape (n,)
        Strictly increasing, ns.
    values : ndarray, shape (n, c)
        One row per sample, one column per entry of `columns`.
    surroundings : Surroundings
    """

    name: ClassVar[str]
    Settings: ClassVar[type[SensorSettings]]

    def __init__(
        self, settings: Any, stamps_ns: IntArray, values: FloatArray, surroundings: Surroundings
    ) -> None:
        self.settings = settings
        self.stamps_ns = stamps_ns
        self.values = values
        self.surroundings = surroundings
        self.bTs: FloatArray = settings.T_BS.bTs

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @classmethod
    @abstractmethod
    def columns(cls, settings: Any) -> tuple[Column, ...]:
        """Columns of `data.csv` after the stamp, with their units."""

    @property
    @abstractmethod
    def rows(self) -> int:
        """Length of a sample's residual."""

    @property
    def bias_sigmas(self) -> FloatArray:
        """Prior sigmas of the sensor's constant bias, shape (b,), in its unit; none unless overridden."""
        return np.empty(0)

    @abstractmethod
    def linearise(self, row: int, state: SensorState, bias: FloatArray) -> Linearisation:
        """Compare a sample with what a state and a bias predict.

        Parameters
        ----------
        row : int
            Row of the sample.
        state : SensorState
        bias : ndarray, shape (b,)
            In the unit of `bias_sigmas`.

        Returns
        -------
        Linearisation
        """

    @abstractmethod
    def draw(self, state: SensorState, bias: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw a measurement at a true state.

        Parameters
        ----------
        state : SensorState
        bias : ndarray, shape (b,)
            In the unit of `bias_sigmas`.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (c,)
        """

    def outlier(self, values: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw a faulty sample: each value is wrong by up to half of itself.

        Parameters
        ----------
        values : ndarray, shape (c,)
            A sound measurement, in the units of `columns`.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (c,)
        """
        return np.asarray(values * rng.uniform(0.5, 1.5, len(values)))

    def fault(self, row: int) -> tuple[str, str] | None:
        """Describe the fault of an impossible sample: its column, and what was expected and found; else None.

        Parameters
        ----------
        row : int
            Row of the sample.

        Returns
        -------
        tuple of (str, str) or None
        """
        del row
        return None

    def misreadings(self) -> dict[str, FloatArray]:
        """Undo each of the usual mistakes of a log, such as a wrong unit or order.

        Returns
        -------
        dict of str to ndarray
            Corrected values (n, c) by the text of the mistake: column, what was expected and found.
        """
        return {}

    @classmethod
    def simulate(
        cls,
        settings: Any,
        states: Sequence[SensorState],
        surroundings: Surroundings,
        rng: np.random.Generator,
        outlier_share: float = 0.0,
    ) -> Self:
        """Draw a log along a true motion, with one bias for all of it.

        Parameters
        ----------
        settings : SensorSettings
            Settings of this sensor's class.
        states : sequence of SensorState
            True states at the samples, n of them.
        surroundings : Surroundings
            The true ones.
        rng : numpy.random.Generator
        outlier_share : float
            Share of the samples that are outliers.

        Returns
        -------
        Sensor
            With n samples.
        """
        width = len(cls.columns(settings))
        stamps = np.array([state.stamp_ns for state in states], dtype=np.int64)
        sensor = cls(settings, stamps, np.zeros((len(states), width)), surroundings)
        bias = sensor.bias_sigmas * rng.standard_normal(len(sensor.bias_sigmas))
        for row, state in enumerate(states):
            values = sensor.draw(state, bias, rng)
            sensor.values[row] = sensor.outlier(values, rng) if rng.random() < outlier_share else values
        return sensor
