"""The sensors of a descent as estimators take them: samples by stamp, factors, biases."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.measurement_weighting import noise_inflation
from craternav_fg.frames import right_jacobian
from craternav_fg.linalg import whitening
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.sensors.protocol import Linearisation, Sensor, SensorState
from craternav_fg.trajectory import Calibrated
from factors.arrays import FloatArray
from factors.custom import Loss
from factors.kernels import robust
from factors.kernels.strapdown import ATTITUDE, RATE, SIZE
from factors.state_measurement import state_measurement_factor

# Largest number of biases of a sensor: GTSAM's thresholds go by the letter of a key, each of one length.
MOST_BIASES = 9
# Sigmas of its innovation beyond which a sample is dropped.
GATE_SIGMAS = 10.0
LOSSES = {"none": robust.NONE, "huber": robust.HUBER, "cauchy": robust.CAUCHY}


def bias_key(number: int, size: int) -> int | None:
    """Key of a sensor's bias in a graph, a vector in units of its prior sigmas; None for none.

    Parameters
    ----------
    number : int
        Number of the sensor.
    size : int
        Size of its bias; it is the key's letter.

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
        Row of its log.
    bias : slice
        Place of the sensor's bias among those of all sensors.
    key : int or None
        Key of its bias in a graph; None when it has none.
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
        # Where each sensor's biases are among all, and their key in a graph.
        self.biases: list[tuple[slice, int]] = []
        self._parts: dict[str, slice] = {}
        begin = 0
        for number, sensor in enumerate(sensors):
            part = slice(begin, begin + len(sensor.bias_sigmas))
            begin = part.stop
            key = bias_key(number, part.stop - part.start)
            if key is not None:
                self.biases.append((part, key))
                self._parts[sensor.name] = part
            for row, stamp in enumerate(sensor.stamps_ns.tolist()):
                self._samples.setdefault(stamp, []).append(Sample(sensor, row, part, key))

    def at(self, stamp_ns: int) -> list[Sample]:
        """Return the samples at a stamp."""
        return self._samples.get(stamp_ns, [])

    def estimated(self, biases: FloatArray, sigmas: FloatArray) -> Calibrated | None:
        """Return estimated biases by sensor.

        Parameters
        ----------
        biases, sigmas : ndarray, shape (b,)
            Estimates and standard deviations of the biases of all sensors, each in its sensor's unit.

        Returns
        -------
        Calibrated or None
            None when no sensor has a bias.
        """
        found = {name: (biases[part], sigmas[part]) for name, part in self._parts.items()}
        return Calibrated(sensor_biases=found) if found else None

    def of_state(self, state: FilterState) -> Calibrated | None:
        """Return a filter's estimates of the biases, as `estimated` does."""
        b = len(self.sigmas)
        variances = np.diag(state.covariance)[SIZE : SIZE + b]
        return self.estimated(state.sensor_bias[:b], np.sqrt(variances))

    def between(self, begin_ns: int, end_ns: int) -> list[int]:
        """Return the stamps of samples inside an interval, without its ends."""
        return sorted(stamp for stamp in self._samples if begin_ns < stamp < end_ns)

    def epochs(self, frames: Sequence[FrameMeasurement]) -> tuple[FrameMeasurement, ...]:
        """Return the frames, and an empty one at each stamp between them at which only sensors measured.

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
    index: int,
    stamp_ns: int,
    holds: Callable[[int], bool] | None = None,
    weights: Sequence[float] | None = None,
) -> None:
    """Add the factors of sensors at a state; their biases become variables at their first sample.

    The weight of a robust loss follows the linearisation point, which iSAM2 holds while an estimate moves by
    many sigmas of a precise sensor. So the online smoother gives weights of its own, from the innovations.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Gets the biases that are new.
    descent : Descent
    samples : sequence of Sample
        At this stamp.
    index : int
        Index of the state.
    stamp_ns : int
    holds : callable, optional
        Whether the solver has a variable already.
    weights : sequence of float, optional
        Weights of the samples, in place of their sensors' robust losses; a sample of weight 0 is left out.
    """
    gyro, variance = gyro_at(descent, stamp_ns), gyro_variance(descent, stamp_ns)
    for number_of, sample in enumerate(samples):
        root = 1.0 if weights is None else float(np.sqrt(weights[number_of]))
        if root == 0.0:
            continue
        sensor, settings = sample.sensor, sample.sensor.settings
        key = sample.key
        if key is not None and not values.exists(key) and not (holds is not None and holds(key)):
            zero = np.zeros(len(sensor.bias_sigmas))
            values.insert(key, zero)
            graph.push_back(gtsam.PriorFactorVector(key, zero, gtsam.noiseModel.Unit.Create(len(zero))))

        def measure(
            gTb: FloatArray,
            gV: FloatArray,
            rate: FloatArray,
            z: FloatArray,
            sample: Sample = sample,
            root: float = root,
        ) -> tuple[FloatArray, FloatArray, FloatArray]:
            sigmas = sample.sensor.bias_sigmas
            state = SensorState(stamp_ns, gTb, gV, rate)
            found = with_gyro_noise(sample.sensor.linearise(sample.row, state, sigmas * z), variance)
            return root * found.error, root * found.jacobian, root * found.bias_jacobian * sigmas

        loss = Loss() if weights is not None else Loss(LOSSES[settings.loss], settings.loss_sigmas)
        keys = (int(X(index)), int(V(index)), int(B(index)))
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
    row = int(descent.imu.stamps_ns.searchsorted(stamp_ns))
    return np.asarray(descent.imu.gyro_rad_s[min(row, len(descent.imu.gyro_rad_s) - 1)])


def gyro_variance(descent: Descent, stamp_ns: int) -> float:
    """Variance per axis of what `gyro_at` gives, beside that of the bias.

    Parameters
    ----------
    descent : Descent
    stamp_ns : int

    Returns
    -------
    float
        (rad/s)^2: white noise, the mean over a row of the log.
    """
    return float(descent.imu_noise.gyro_density_rad_s_sqrt_hz**2 / descent.imu.row_s(stamp_ns))


def with_gyro_noise(found: Linearisation, variance: float) -> Linearisation:
    """Whiten a sample again whose prediction has the gyro's noise: that of a sensor with a lever arm.

    Estimators without a variable for the angular velocity take the gyro's row, less the bias.

    Parameters
    ----------
    found : Linearisation
    variance : float
        Of the gyro's row per axis, (rad/s)^2.

    Returns
    -------
    Linearisation
    """
    of_rate = found.jacobian[:, RATE]
    if not of_rate.any():
        return found
    W = whitening(np.eye(len(of_rate)) + variance * of_rate @ of_rate.T)
    return Linearisation(W @ found.error, W @ found.jacobian, W @ found.bias_jacobian)


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
        Whitened, measured minus predicted, at the state of before.
    """
    found = sample.linearise(SensorState(stamp_ns, state.gTb, state.gV, state.rate), state.sensor_bias)
    A = np.zeros((len(found.error), len(delta)))
    A[:, :SIZE] = found.jacobian
    A[:, ATTITUDE] = A[:, ATTITUDE] @ right_jacobian(delta[ATTITUDE])
    A[:, SIZE + sample.bias.start : SIZE + sample.bias.stop] = found.bias_jacobian
    return A, -found.error + A @ delta


def innovation_weight(
    sample: Sample, A: FloatArray, residual: FloatArray, covariance: FloatArray, gate_sigmas: float
) -> float:
    """Weight of a sample by its innovation: 1 up to its sensor's limit, 0 beyond the gate.

    Parameters
    ----------
    sample : Sample
    A : ndarray, shape (m, 18 + b)
        Whitened derivatives at the prediction, see `linearise_sample`.
    residual : ndarray, shape (m,)
        Whitened, measured minus predicted.
    covariance : ndarray, shape (18 + b, 18 + b)
        Covariance of the prediction, in the units of the error state.
    gate_sigmas : float

    Returns
    -------
    float
        Factor on the sample's information.
    """
    settings = sample.sensor.settings
    if settings.loss == "none":
        return 1.0
    sigmas, factors = noise_inflation(A[None], residual[None], covariance, settings.loss_sigmas)
    return 0.0 if sigmas[0] > gate_sigmas else 1.0 / float(factors[0])


def innovation_weights(samples: Sequence[Sample], predicted: FilterState, stamp_ns: int) -> list[float]:
    """Weights of samples at a predicted state.

    Parameters
    ----------
    samples : sequence of Sample
    predicted : FilterState
        With the biases of all sensors.
    stamp_ns : int

    Returns
    -------
    list of float
    """
    P, zero = predicted.covariance, np.zeros(len(predicted.covariance))
    return [
        innovation_weight(one, *linearise_sample(one, predicted, zero, stamp_ns), P, GATE_SIGMAS)
        for one in samples
    ]
