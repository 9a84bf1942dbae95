"""Consistency: whether errors are as large as the covariances predict, over trials, altitudes and sensors."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from factors.arrays import FloatArray

# Of the intervals in which consistent estimators lie.
INTERVAL_PROBABILITY = 0.95


@dataclass(frozen=True)
class Anees:
    """Average normalised estimation error squared (ANEES) of some trials in a bin of altitude.

    Attributes
    ----------
    highest_m, lowest_m : float
        Altitudes of the bin.
    mean : float
        The dimension (6 for a pose) when the estimator is consistent, above it when the covariances are too
        small.
    low, high : float
        Interval of the mean with a probability of 95 % if it is: a chi-square interval of the number of
        trials. Errors of neighbouring frames are correlated, so the frames of a trial count as one, which
        makes the interval wide.
    trials, frames : int
        In the bin; frames of each trial.
    """

    highest_m: float
    lowest_m: float
    mean: float
    low: float
    high: float
    trials: int
    frames: int

    @property
    def consistent(self) -> bool:
        """Whether the mean is inside the interval."""
        return self.low <= self.mean <= self.high


def mean_interval(
    dimension: int, count: int, probability: float = INTERVAL_PROBABILITY
) -> tuple[float, float]:
    """Interval of the mean of independent chi-squares.

    Parameters
    ----------
    dimension : int
        Degrees of freedom of each.
    count : int
        Number of them.
    probability : float
        Probability of the interval.

    Returns
    -------
    low, high : float
    """
    tail = 0.5 * (1.0 - probability)
    freedom = dimension * count
    return float(chdtri(freedom, 1.0 - tail) / count), float(chdtri(freedom, tail) / count)


def anees_by_altitude(
    nees: FloatArray, altitude_m: FloatArray, edges_m: Sequence[float], dimension: int = 6
) -> list[Anees]:
    """ANEES in bins of altitude.

    Parameters
    ----------
    nees : ndarray, shape (trials, k)
        Normalised estimation errors squared of each trial's frames, without a unit.
    altitude_m : ndarray, shape (k,)
        Altitudes of the frames.
    edges_m : sequence of float
        Falling altitudes; a frame is in the bin whose lower edge it is not below. Empty bins are left out.
    dimension : int
        Dimension of the errors.

    Returns
    -------
    list of Anees
    """
    bins = []
    for high_m, low_m in itertools.pairwise(edges_m):
        inside = (altitude_m < high_m) & (altitude_m >= low_m)
        if inside.any():
            mean = float(nees[:, inside].mean())
            interval = mean_interval(dimension, len(nees))
            bins.append(Anees(high_m, low_m, mean, *interval, len(nees), int(inside.sum())))
    return bins


def rms(errors: FloatArray) -> FloatArray:
    """Root mean square norm of errors over trials.

    Parameters
    ----------
    errors : ndarray, shape (trials, k, d)
        In any unit and frame.

    Returns
    -------
    ndarray, shape (k,)
        In the same unit.
    """
    return np.asarray(np.sqrt(np.mean(np.sum(errors**2, axis=-1), axis=0)))


def over_altitude(values: FloatArray, altitude_m: FloatArray) -> float:
    """Average values over the altitude, each frame weighted by the altitude interval it stands for.

    Where the altitude neither only falls nor only rises, or does not change, over the frames: intervals that
    are passed twice say nothing of the time spent there.

    Parameters
    ----------
    values : ndarray, shape (k,)
        In any unit.
    altitude_m : ndarray, shape (k,)

    Returns
    -------
    float
        In the same unit.
    """
    steps_m = np.diff(altitude_m)
    monotonic = bool(np.all(steps_m <= 0.0) or np.all(steps_m >= 0.0))
    if not monotonic or not steps_m.any():
        return float(np.mean(values))
    return float(np.average(values, weights=np.abs(np.gradient(altitude_m))))
