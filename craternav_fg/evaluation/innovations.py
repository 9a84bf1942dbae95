"""Normalised innovations squared (NIS) of a filter, sensor by sensor.

An innovation is a measurement minus its prediction from earlier data. The innovations of a consistent filter
scatter as predicted. Unlike errors, they do not need the truth, and those of different frames are
independent, so that their sum has a sharp chi-square interval.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.filter_state import POSE, FilterState
from craternav_fg.estimators.linearisation import linearise_arcs, linearise_rims, linearise_sun
from craternav_fg.estimators.measurement_weighting import with_predicted_covariances
from craternav_fg.estimators.sensor_bank import SensorBank, linearise_sample
from craternav_fg.evaluation.consistency import mean_interval
from craternav_fg.linalg import whitening

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

IMU, RIMS, SUN = SENSORS = ("imu", "rims", "sun")
# Singular value of a frame's rows, in units of the prediction's sigma, below which a direction is unobserved.
_MIN_SINGULAR_VALUE = 1e-3


@dataclass(frozen=True)
class Innovations:
    """Normalised innovations squared of a filter's run.

    Attributes
    ----------
    sensor : tuple of str, length n
        "rims": a rim's five (or an arc's points') innovations; "sun": the tilt's one; "imu": the part of all
        innovations of a frame that errors of the predicted pose can cause, of at most six dimensions. The
        rest tells how far the frame's measurements agree with each other. Further sensors by their names,
        each sample by itself.
    stamps_ns : ndarray of int, shape (n,)
    nis : ndarray, shape (n,)
        NIS; its expectation is the dimension if prediction and measurement have the covariances that they
        claim.
    dimension : ndarray of int, shape (n,)
    """

    sensor: tuple[str, ...]
    stamps_ns: IntArray
    nis: FloatArray
    dimension: IntArray

    def of(self, sensor: str) -> "Innovations":
        """Select those of one sensor."""
        rows = np.array([i for i, name in enumerate(self.sensor) if name == sensor], dtype=np.int64)
        return Innovations((sensor,) * len(rows), self.stamps_ns[rows], self.nis[rows], self.dimension[rows])

    @classmethod
    def joined(cls, parts: Iterable["Innovations"]) -> "Innovations":
        """Concatenate those of several runs, or of the segments of a descent."""
        every = list(parts)
        return cls(
            tuple(itertools.chain.from_iterable(part.sensor for part in every)),
            np.concatenate([part.stamps_ns for part in every]),
            np.concatenate([part.nis for part in every]),
            np.concatenate([part.dimension for part in every]),
        )

    def as_dict(self) -> dict[str, dict[str, float | int]]:
        """Give mean, interval and total dimension of each sensor that measured, as metrics.json has them."""
        others = sorted(set(self.sensor) - set(SENSORS))
        parts = {sensor: self.of(sensor) for sensor in (*SENSORS, *others) if sensor in self.sensor}
        return {
            sensor: {
                "mean": part.mean,
                "low": part.interval[0],
                "high": part.interval[1],
                "dimension": int(part.dimension.sum()),
            }
            for sensor, part in parts.items()
        }

    @property
    def mean(self) -> float:
        """NIS per dimension: its expectation is 1 for a consistent filter; NaN without any."""
        return float(self.nis.sum() / self.dimension.sum()) if len(self.nis) else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the mean with a probability of 95 % for a consistent filter."""
        return mean_interval(1, max(int(self.dimension.sum()), 1))


def innovations(problem: Problem, states: Sequence[FilterState]) -> Innovations:
    """Innovations of the frames after the start's.

    Parameters
    ----------
    problem : Problem
    states : sequence of FilterState
        A filter's, at every frame, each from the data up to it: `DistributedEkf.states`,
        `OnlineSession.states`. From each the next frame is predicted by the IMU.

    Returns
    -------
    Innovations

    Raises
    ------
    ValueError
        When the IMU log does not cover the frames.
    """
    sensor: list[str] = []
    stamps: list[int] = []
    values: list[float] = []
    sizes: list[int] = []
    first = problem.start.frame
    bank = SensorBank(problem.sensors)
    for state, (before, frame) in zip(
        states[first:], itertools.pairwise(problem.frames[first:]), strict=False
    ):
        predicted = filter_state.propagate(state, problem, before.stamp_ns, frame.stamp_ns)
        # The errors of one frame, time-correlated ones included.
        seen = frame.inflate_correlated(1.0)
        gTb, P = predicted.gTb, predicted.covariance[POSE, POSE]
        camera, catalog = problem.camera, problem.catalog
        A, residual, usable = linearise_rims(
            gTb,
            with_predicted_covariances(frame, gTb, camera, catalog).rims,
            camera,
            catalog,
            model="chart",
            noise="measured",
        )
        parts = [(RIMS, a, r) for a, r in zip(A[usable], residual[usable], strict=True)]
        parts += [(RIMS, one.A, one.residual) for one in linearise_arcs(gTb, seen.arcs, camera, catalog)]
        sun = linearise_sun(gTb, frame.sun, camera)
        if sun is not None:
            parts.append((SUN, sun.A, sun.residual))
        for sample in bank.at(frame.stamp_ns):
            rows = linearise_sample(sample, predicted, np.zeros(len(predicted.covariance)), frame.stamp_ns)
            _, whitened = _whitened(*rows, predicted.covariance)
            sensor.append(sample.sensor.name)
            stamps.append(frame.stamp_ns)
            values.append(float(np.sum(whitened**2)))
            sizes.append(len(whitened))
        if not parts:
            continue
        all_rows = (np.concatenate([a for _, a, _ in parts]), np.concatenate([r for _, _, r in parts]))
        found = [(name, float(np.sum(_whitened(a, r, P)[1] ** 2)), len(r)) for name, a, r in parts]
        found.append((IMU, *_along_prediction(*_whitened(*all_rows, P))))
        for name, nis, size in found:
            sensor.append(name)
            stamps.append(frame.stamp_ns)
            values.append(nis)
            sizes.append(size)
    return Innovations(
        tuple(sensor), np.array(stamps, dtype=np.int64), np.array(values), np.array(sizes, dtype=np.int64)
    )


def _whitened(A: FloatArray, residual: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows (m, 6) in units of the prediction's sigmas, and innovations (m,), both of unit covariance."""
    W = whitening(A @ P @ A.T + np.eye(len(A)))
    return W @ A * np.sqrt(np.diag(P)), W @ residual


def _along_prediction(rows: FloatArray, innovation: FloatArray) -> tuple[float, int]:
    """Part of the innovation that errors of the prediction can cause: its square and its dimension."""
    U, strengths, _ = np.linalg.svd(rows, full_matrices=False)
    U = U[:, strengths > _MIN_SINGULAR_VALUE]
    return float(np.sum((U.T @ innovation) ** 2)), U.shape[1]
