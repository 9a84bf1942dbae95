"""Log of the IMU, and the noise of its error model, which the IMU factor shares."""

from dataclasses import dataclass

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.imu_noise import ImuNoise

__all__ = ["ImuLog", "ImuNoise", "ImuRows"]

# Durations (m,), s; angular velocities and specific forces (m, 3) of rows, see `ImuLog.between`.
ImuRows = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class ImuLog:
    """Log of an IMU: row k is the mean over the interval that ends at its stamp.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (n,)
        Strictly increasing. The first interval is assumed to be as long as the second.
    gyro_rad_s : ndarray, shape (n, 3)
        Mean inertial angular velocity in b, rad/s.
    accelerometer_m_s2 : ndarray, shape (n, 3)
        Mean specific force, m/s^2: of its components along the axes of b as they turn during the interval.
    """

    stamps_ns: IntArray
    gyro_rad_s: FloatArray
    accelerometer_m_s2: FloatArray

    @classmethod
    def constant(cls, begin_ns: int, end_ns: int, rate_rad_s: tuple[float, float, float]) -> "ImuLog":
        """Make the log of a lander without an IMU: a constant angular velocity, and no force.

        Parameters
        ----------
        begin_ns, end_ns : int
            What it covers.
        rate_rad_s : tuple of float
            Angular velocity in b.

        Returns
        -------
        ImuLog
        """
        half_ns = max((end_ns - begin_ns + 1) // 2, 1)
        stamps = np.array([begin_ns + half_ns, begin_ns + 2 * half_ns], dtype=np.int64)
        return cls(stamps, np.array([rate_rad_s, rate_rad_s], dtype=np.float64), np.zeros((2, 3)))

    def between(self, begin_ns: int, end_ns: int) -> ImuRows:
        """Cut the log to an interval. A row that extends beyond an end counts for its part inside.

        Parameters
        ----------
        begin_ns, end_ns : int
            The interval (begin, end].

        Returns
        -------
        dt_s : ndarray, shape (m,)
            Positive durations, which add up to that of the interval.
        gyro, accelerometer : ndarray, shape (m, 3)
            As in the log: in b, rad/s and m/s^2.

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
        lo = int(self.stamps_ns.searchsorted(begin_ns, side="right"))
        hi = int(self.stamps_ns.searchsorted(end_ns, side="left"))
        edges = np.empty(hi - lo + 2, dtype=np.int64)
        edges[0], edges[1:-1], edges[-1] = begin_ns, self.stamps_ns[lo:hi], end_ns
        dt_s = (edges[1:] - edges[:-1]).astype(np.float64) * 1e-9
        return dt_s, self.gyro_rad_s[lo : hi + 1], self.accelerometer_m_s2[lo : hi + 1]

    def row_s(self, stamp_ns: int) -> float:
        """Duration of the row that holds a stamp, s: the last row's after the log, the first one's before it.

        Parameters
        ----------
        stamp_ns : int
        """
        row = min(max(int(self.stamps_ns.searchsorted(stamp_ns)), 1), len(self.stamps_ns) - 1)
        return 1e-9 * float(self.stamps_ns[row] - self.stamps_ns[row - 1])
