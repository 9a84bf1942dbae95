"""The IMU's log; its error model is that of the IMU factor."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.imu import ImuNoise

__all__ = ["ImuLog", "ImuNoise"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class ImuLog:
    """Increments of an IMU, as rates: row k is the mean over the interval that ENDS at its stamp.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (n,)
        Strictly increasing. The first row's interval is taken as long as the second's.
    gyro : ndarray, shape (n, 3)
        Mean inertial angular velocity in b, rad/s.
    accelerometer : ndarray, shape (n, 3)
        Mean specific force in b, m/s^2, each instant's taken along the axes of that instant.
    """

    stamps_ns: IntArray
    gyro: FloatArray
    accelerometer: FloatArray

    def between(self, begin_ns: int, end_ns: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cut the log to an interval; a row that reaches over an end counts with its share of time.

        Parameters
        ----------
        begin_ns, end_ns : int
            The interval (begin, end].

        Returns
        -------
        dt_s : ndarray, shape (m,)
            Positive durations; they add up to the interval's.
        gyro, accelerometer : ndarray, shape (m, 3)

        Raises
        ------
        ValueError
            When the log does not cover the interval.
        """
        first = self.stamps_ns[0] - (self.stamps_ns[1] - self.stamps_ns[0])
        if not (first <= begin_ns < end_ns <= self.stamps_ns[-1]):
            raise ValueError(
                f"IMU log covers {first} to {self.stamps_ns[-1]} ns, asked for {begin_ns} to {end_ns}"
            )
        lo = int(np.searchsorted(self.stamps_ns, begin_ns, side="right"))
        hi = int(np.searchsorted(self.stamps_ns, end_ns, side="left"))
        edges = np.concatenate([[begin_ns], self.stamps_ns[lo:hi], [end_ns]])
        return np.diff(edges) * 1e-9, self.gyro[lo : hi + 1], self.accelerometer[lo : hi + 1]
