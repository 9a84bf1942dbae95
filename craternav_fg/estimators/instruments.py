"""One interface for all measurements: rims, sun tilt, IMU, and the sensors of `craternav_fg.sensors`.

An instrument has a name, compares its measurements at a frame with a predicted state, returns normalised
innovations, and can be excluded. Innovations, `craternav sensors` and `reconstruct --without` treat all
instruments alike.

Factors differ, because of their cost. The rims of a frame are one factor with one compiled kernel
(`graph.add_frame`); separate factors for ten rims would cost eight times as much. The IMU's factor links two
states (`graph.add_imu`). Each sample of a sensor has its own factor (`sensor_bank.add_sensors`). A `Sensor`
has a log with one row per sample, while a rim is found near a prediction, where its covariance is evaluated.
A test checks that the factors agree with the instruments.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.linearisation import (
    LinearMeasurement,
    arc_means,
    linearise_rims,
    linearise_sun,
)
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.sensor_bank import SensorBank, linearise_sample
from craternav_fg.linalg import whitening
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimSet
from factors.arrays import FloatArray

RIMS, SUN, IMU = "rims", "sun", "imu"
# Singular value of a frame's rows, in units of the prediction's sigma, below which a direction is unobserved.
_MIN_SINGULAR_VALUE = 1e-3


class Instrument(ABC):
    """Something that measures, as evaluation and command line see it.

    Attributes
    ----------
    name : str
    """

    name: str

    @abstractmethod
    def compare(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[LinearMeasurement]:
        """Compare what was measured at a frame with a predicted state.

        Parameters
        ----------
        predicted : FilterState
            At the frame's stamp, from earlier data.
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of LinearMeasurement
            One for each rim, tilt or sample, in the first states of the error state.
        """

    def nis(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[tuple[float, int]]:
        """Return the normalised innovations squared of a frame.

        Parameters
        ----------
        predicted : FilterState
            At the frame's stamp, from earlier data.
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of (float, int)
            NIS and dimension of each measurement; 0 and 0 where it says nothing of the state, as a range does
            whose beam misses the ground.
        """
        compared = self.compare(predicted, frame, descent)
        # All rims of a frame have rows of one shape, and are whitened at once: one by one they would cost
        # several times as much as the filter's step.
        alike: dict[tuple[int, ...], list[int]] = {}
        for k, one in enumerate(compared):
            alike.setdefault(one.A.shape, []).append(k)
        nis = np.empty(len(compared))
        for (_, size), members in alike.items():
            A = np.array([compared[k].A for k in members])
            residual = np.array([compared[k].residual for k in members])
            W = _innovation_whitening(A, predicted.covariance[:size, :size])
            nis[members] = np.sum((W @ residual[:, :, None])[:, :, 0] ** 2, axis=1)
        return [
            (float(d2), len(one.residual)) if one.A.any() else (0.0, 0)
            for d2, one in zip(nis, compared, strict=True)
        ]

    def left_out(self, frame: FrameMeasurement) -> FrameMeasurement:
        """Take what it measured out of a frame.

        Parameters
        ----------
        frame : FrameMeasurement

        Returns
        -------
        FrameMeasurement
            The same where nothing of it is in frames.
        """
        return frame


class Rims(Instrument):
    """Crater rims: ellipses in images, or as measured (mav0/cam0, rims.parquet; craternav_fg)."""

    name = RIMS

    def compare(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[LinearMeasurement]:
        """Compare rims and arcs; see `Instrument.compare`.

        Parameters
        ----------
        predicted : FilterState
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of LinearMeasurement
            In the pose: five rows of a rim's ellipse chart; one of an arc, the mean distance of its points,
            whose errors are largely the same.
        """
        gTb, camera, catalog = predicted.gTb, descent.camera, descent.catalog
        rims = with_predicted_covariances(frame, gTb, camera, catalog).rims
        A, residual, usable = linearise_rims(gTb, rims, camera, catalog, model="chart", noise="measured")
        whole = [LinearMeasurement(a, r) for a, r in zip(A[usable], residual[usable], strict=True)]
        # The errors of one frame, time-correlated ones included: so large that their mean has the right one.
        arcs = frame.inflate_correlated(1.0).arcs
        return whole + arc_means(gTb, arcs, camera, catalog)[1]

    def left_out(self, frame: FrameMeasurement) -> FrameMeasurement:
        """Take rims and arcs out of a frame."""
        return replace(frame, rims=RimSet.empty(), arcs=ArcSet.empty())


class Sun(Instrument):
    """The sun's tilt in images, or as measured (mav0/cam0, sun_tilts.csv; craternav_fg)."""

    name = SUN

    def compare(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[LinearMeasurement]:
        """Compare the tilt, if there is one; see `Instrument.compare`.

        Parameters
        ----------
        predicted : FilterState
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of LinearMeasurement
            In the pose.
        """
        tilt = linearise_sun(predicted.gTb, frame.sun, descent.camera)
        return [] if tilt is None else [tilt]

    def left_out(self, frame: FrameMeasurement) -> FrameMeasurement:
        """Take the tilt out of a frame."""
        return replace(frame, sun=None)


class Imu(Instrument):
    """Gyro and accelerometer (mav0/imu0; craternav_fg)."""

    name = IMU

    def compare(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[LinearMeasurement]:
        """Compare the pose that the IMU predicts with all that the camera measured at a frame.

        Parameters
        ----------
        predicted : FilterState
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of LinearMeasurement
            The camera's rows as one; empty without any.
        """
        seen = [row for one in (Rims(), Sun()) for row in one.compare(predicted, frame, descent)]
        if not seen:
            return []
        A, residual = np.concatenate([r.A for r in seen]), np.concatenate([r.residual for r in seen])
        return [LinearMeasurement(A, residual)]

    def nis(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[tuple[float, int]]:
        """Return the part of a frame's innovation that an error of the predicted pose can cause.

        Parameters
        ----------
        predicted : FilterState
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of (float, int)
            NIS and dimension, at most six; empty without a rim or tilt.
        """
        out = []
        sigmas = np.sqrt(np.diag(predicted.covariance[POSE, POSE]))
        for one in self.compare(predicted, frame, descent):
            W = _innovation_whitening(one.A, predicted.covariance[POSE, POSE])
            U, strengths, _ = np.linalg.svd(W @ one.A * sigmas, full_matrices=False)
            U = U[:, strengths > _MIN_SINGULAR_VALUE]
            out.append((float(np.sum((U.T @ (W @ one.residual)) ** 2)), U.shape[1]))
        return out


@dataclass(frozen=True)
class Sampled(Instrument):
    """A sensor with a log of samples.

    Attributes
    ----------
    name : str
        The sensor's name.
    bank : SensorBank
        All sensors whose biases are in the state.
    """

    name: str
    bank: SensorBank

    def compare(
        self, predicted: FilterState, frame: FrameMeasurement, descent: Descent
    ) -> list[LinearMeasurement]:
        """Compare its samples at the frame's stamp; see `Instrument.compare`.

        Parameters
        ----------
        predicted : FilterState
        frame : FrameMeasurement
        descent : Descent

        Returns
        -------
        list of LinearMeasurement
            In the whole error state.
        """
        zero = np.zeros(len(predicted.covariance))
        return [
            LinearMeasurement(*linearise_sample(sample, predicted, zero, frame.stamp_ns))
            for sample in self.bank.at(frame.stamp_ns)
            if sample.sensor.name == self.name
        ]


# Those of every data set; their docstrings are what `craternav sensors` tells.
CAMERA_AND_IMU: tuple[Instrument, ...] = (Rims(), Sun(), Imu())


def instruments(descent: Descent) -> tuple[Instrument, ...]:
    """Return all instruments of a descent.

    Parameters
    ----------
    descent : Descent

    Returns
    -------
    tuple of Instrument
        Rims, sun tilt and IMU, then the other sensors.
    """
    bank = SensorBank(descent.sensors)
    return (*CAMERA_AND_IMU, *(Sampled(sensor.name, bank) for sensor in descent.sensors))


def _innovation_whitening(A: FloatArray, P: FloatArray) -> FloatArray:
    """Whitening (..., m, m) of innovations with whitened rows A (..., m, k), for a prediction's P (k, k)."""
    return whitening(A @ P @ np.swapaxes(A, -1, -2) + np.eye(A.shape[-2]))
