"""The sensors of a descent as estimators take them: samples by stamp, factors, biases."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.frames import right_jacobian
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.sensors.protocol import Linearisation, Sensor, SensorState
from factors.custom import Loss
from factors.kernels import robust
from factors.kernels.strapdown import ATTITUDE, SIZE
from factors.state_measurement import state_measurement_factor

FloatArray = npt.NDArray[np.float64]

# Largest number of biases of a sensor: GTSAM's thresholds go by the letter of a key, each of one length.
MOST_BIASES = 9
LOSSES = {"none": robust.NONE, "huber": robust.HUBER, "cauchy": robust.CAUCHY}


def bias_key(number: int, size: int) -> int | None:
    """Key of a sensor's bias in a graph, a vector in units of its prior sigmas; None for none.

    Parameters
    ----------
    number : int
        Of the sensor.
    size : int
        Of its bias; it is the key's letter.

    Returns
    -------
    int or None

    Raises
    ------
    EstimationError
        When there are more than `MOST_BIASES`.
    """
    if size > MOST_BIASES:
        raise EstimationError(f"a sensor with {size} biases: expected at most {MOST_BIASES}")
    return int(gtsam.symbol(str(size), number)) if size else None


@dataclass(frozen=True)
class Sample:
    """One sample of one sensor.

    Attributes
    ----------
    sensor : Sensor
    row : int
        Of its log.
    bias : slice
        Of the sensor's bias among those of all sensors.
    key : int or None
        Of its bias in a graph; None when it has none.
    """

    sensor: Sensor
    row: int
    bias: slice
    key: int | None

    def linearise(self, state: SensorState, biases: FloatArray) -> Linearisation:
        """Compare the sample with a state.

        Parameters
        ----------
        state : SensorState
        biases : ndarray, shape (b,)
            Biases of all sensors, each in its sensor's unit.

        Returns
        -------
        Linearisation
        """
        return self.sensor.linearise(self.row, state, biases[self.bias])


class SensorBank:
    """Samples of all sensors by their stamps.

    Parameters
    ----------
    sensors : sequence of Sensor
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._samples: dict[int, list[Sample]] = {}
        self.sigmas = np.concatenate([np.empty(0), *(sensor.bias_sigmas for sensor in sensors)])
        begin = 0
        for number, sensor in enumerate(sensors):
            part = slice(begin, begin + len(sensor.bias_sigmas))
            begin = part.stop
            key = bias_key(number, part.stop - part.start)
            for row, stamp in enumerate(sensor.stamps_ns.tolist()):
                self._samples.setdefault(stamp, []).append(Sample(sensor, row, part, key))

    def at(self, stamp_ns: int) -> list[Sample]:
        """Give the samples at a stamp."""
        return self._samples.get(stamp_ns, [])

    def between(self, begin_ns: int, end_ns: int) -> list[int]:
        """Give the stamps of samples inside an interval, without its ends."""
        return sorted(stamp for stamp in self._samples if begin_ns < stamp < end_ns)

    def epochs(self, frames: Sequence[FrameMeasurement]) -> tuple[FrameMeasurement, ...]:
        """Give the frames, and an empty one at each stamp between them at which only sensors measured.

        Parameters
        ----------
        frames : sequence of FrameMeasurement
            In the order of time.

        Returns
        -------
        tuple of FrameMeasurement
            In the order of time.
        """
        by_stamp = {frame.stamp_ns: frame for frame in frames}
        first, last = frames[0].stamp_ns, frames[-1].stamp_ns
        stamps = sorted({*by_stamp, *self.between(first, last)})
        return tuple(by_stamp.get(stamp) or FrameMeasurement(stamp, RimSet.empty(), None) for stamp in stamps)


def add_sensors(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    descent: Descent,
    samples: Sequence[Sample],
    number: int,
    stamp_ns: int,
    holds: Callable[[int], bool] | None = None,
) -> None:
    """Add the factors of sensors at a state; their biases become variables at their first sample.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Gets the biases that are new.
    descent : Descent
    samples : sequence of Sample
        At this stamp.
    number : int
        Of the state.
    stamp_ns : int
    holds : callable, optional
        Whether the solver has a variable already.
    """
    for sample in samples:
        sensor, settings = sample.sensor, sample.sensor.settings
        key = sample.key
        if key is not None and not values.exists(key) and not (holds is not None and holds(key)):
            zero = np.zeros(len(sensor.bias_sigmas))
            values.insert(key, zero)
            graph.push_back(gtsam.PriorFactorVector(key, zero, gtsam.noiseModel.Unit.Create(len(zero))))

        def measure(
            gTb: FloatArray, gV: FloatArray, rate: FloatArray, z: FloatArray, sample: Sample = sample
        ) -> tuple[FloatArray, FloatArray, FloatArray]:
            sigmas = sample.sensor.bias_sigmas
            state = SensorState(stamp_ns, gTb, gV, rate)
            found = sample.sensor.linearise(sample.row, state, sigmas * z)
            return found.error, found.jacobian, found.bias_jacobian * sigmas

        loss = Loss(LOSSES[settings.loss], settings.loss_sigmas)
        gyro = gyro_at(descent, stamp_ns)
        keys = (int(X(number)), int(V(number)), int(B(number)))
        graph.push_back(state_measurement_factor(keys, gyro, sensor.rows, measure, key, loss))


def gyro_at(descent: Descent, stamp_ns: int) -> FloatArray:
    """Angular velocity that the gyro measured at a stamp, its bias included.

    Parameters
    ----------
    descent : Descent
    stamp_ns : int

    Returns
    -------
    ndarray, shape (3,)
        In b, rad/s.
    """
    row = int(np.searchsorted(descent.imu.stamps_ns, stamp_ns))
    return np.asarray(descent.imu.gyro[min(row, len(descent.imu.gyro) - 1)])


def linearise_sample(
    sample: Sample, state: FilterState, delta: FloatArray, stamp_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Linearise a sample at a filter's state that was moved, in the error state of before.

    Parameters
    ----------
    sample : Sample
    state : FilterState
        The moved state; its error state is the lander's 18, then the biases of all sensors.
    delta : ndarray, shape (18 + b,)
        By which it was moved; in the units of the error state.
    stamp_ns : int

    Returns
    -------
    A : ndarray, shape (m, 18 + b)
        Whitened derivatives.
    residual : ndarray, shape (m,)
        Whitened, measured less predicted, at the state of before.
    """
    found = sample.linearise(SensorState(stamp_ns, state.gTb, state.gV, state.rate), state.sensor_bias)
    A = np.zeros((len(found.error), len(delta)))
    A[:, :SIZE] = found.jacobian
    A[:, ATTITUDE] = A[:, ATTITUDE] @ right_jacobian(delta[ATTITUDE])
    A[:, SIZE + sample.bias.start : SIZE + sample.bias.stop] = found.bias_jacobian
    return A, -found.error + A @ delta
