"""Normalised innovations squared (NIS) of a filter, sensor by sensor.

An innovation is a measurement minus its prediction from earlier data. The innovations of a consistent filter
scatter as predicted. Unlike errors, they do not need the truth, and those of different frames are
independent, so that their sum has a sharp chi-square interval.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.filter_state import FilterState
from craternav_fg.estimators.instruments import IMU, RIMS, SUN, instruments
from craternav_fg.evaluation.consistency import mean_interval
from factors.arrays import FloatArray, IntArray

# In the order in which they are told, before the other sensors.
SENSORS = (IMU, RIMS, SUN)


@dataclass(frozen=True)
class Innovations:
    """Normalised innovations squared of a filter's run.

    Attributes
    ----------
    sensor : tuple of str, length n
        "rims": a rim's five innovations, or an arc's mean one; "sun": the tilt's one; "imu": the part of all
        innovations of a frame that errors of the predicted pose can cause, of at most six dimensions. The
        rest tells how far the frame's measurements agree with each other. Further sensors by their names,
        each sample by itself.
    stamps_ns : ndarray of int, shape (n,)
    nis : ndarray, shape (n,)
        NIS; its expectation is the dimension if prediction and measurement have the covariances that they
        claim.
    dimension : ndarray of int, shape (n,)
        0 for a sample that says nothing of the predicted state.
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
        """Return mean, interval and total dimension of each sensor that measured, for metrics.json."""
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
        return float(self.nis.sum() / self.dimension.sum()) if self.dimension.any() else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the mean with a probability of 95 % for a consistent filter."""
        return mean_interval(1, max(int(self.dimension.sum()), 1))


def innovations(
    problem: Problem, states: Sequence[FilterState], predictions: Sequence[FilterState] | None = None
) -> Innovations:
    """Innovations of the frames after the start's.

    Parameters
    ----------
    problem : Problem
    states : sequence of FilterState
        A filter's, at every frame, each from the data up to it: `DistributedEkf.states`,
        `OnlineSession.states`. From each the next frame is predicted by the IMU.
    predictions : sequence of FilterState, optional
        These predictions, at the frames after the start's, if the filter has kept them:
        `DistributedEkf.run`. On an orbit in a detailed gravity field they cost as much as the filter.

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
    every = instruments(problem)
    if predictions is None:
        predictions = [
            filter_state.propagate(state, problem, before.stamp_ns, frame.stamp_ns)
            for state, (before, frame) in zip(
                states[first:], itertools.pairwise(problem.frames[first:]), strict=False
            )
        ]
    for predicted, frame in zip(predictions, problem.frames[first + 1 :], strict=True):
        for one in every:
            for nis, size in one.nis(predicted, frame, problem):
                sensor.append(one.name)
                stamps.append(frame.stamp_ns)
                values.append(nis)
                sizes.append(size)
    return Innovations(
        tuple(sensor), np.array(stamps, dtype=np.int64), np.array(values), np.array(sizes, dtype=np.int64)
    )
