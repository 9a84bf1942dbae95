"""Direction towards the sun over time."""

from dataclasses import dataclass

import numpy as np

from craternav_fg import frames
from factors.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class SunVectors:
    """Direction towards the sun at some times.

    Attributes
    ----------
    stamps_ns : ndarray of int, shape (n,)
        Strictly increasing.
    vectors : ndarray, shape (n, 3)
        Unit vectors towards the sun, in g.
    """

    stamps_ns: IntArray
    vectors: FloatArray

    @classmethod
    def among_stars(
        cls, vector: FloatArray, begin_ns: int, stamps_ns: IntArray, spin_rad_s: tuple[float, float, float]
    ) -> "SunVectors":
        """Turn one direction with the spin of the body, which the sun does not follow.

        Parameters
        ----------
        vector : ndarray, shape (3,)
            Direction towards the sun at a stamp, in g, of any length.
        begin_ns : int
            That stamp.
        stamps_ns : ndarray of int, shape (n,)
            Stamps for which the direction is wanted.
        spin_rad_s : tuple of float
            Inertial angular velocity of g, in g.

        Returns
        -------
        SunVectors
            At these stamps.
        """
        seconds = 1e-9 * (stamps_ns - begin_ns)
        turn = frames.rotation_exp(-seconds[:, None] * np.array(spin_rad_s))
        return cls(stamps_ns, turn @ (vector / np.linalg.norm(vector)))

    def at(self, stamp_ns: int) -> FloatArray:
        """Interpolate the direction.

        Parameters
        ----------
        stamp_ns : int

        Returns
        -------
        ndarray, shape (3,)
            Unit vector towards the sun, in g; beyond the first or last stamp, that of the nearer one.
        """
        last = len(self.stamps_ns) - 1
        k = int(np.searchsorted(self.stamps_ns, stamp_ns, side="right")) - 1
        if k < 0 or k >= last:
            return self.vectors[min(max(k, 0), last)]
        share = (stamp_ns - self.stamps_ns[k]) / (self.stamps_ns[k + 1] - self.stamps_ns[k])
        between = (1.0 - share) * self.vectors[k] + share * self.vectors[k + 1]
        return np.asarray(between / np.linalg.norm(between))

    def departure_rad(self, begin_ns: int, end_ns: int, spin_rad_s: tuple[float, float, float]) -> float:
        """Angle by which the sun leaves its place among the stars, as seen from a body that spins.

        Parameters
        ----------
        begin_ns, end_ns : int
            Stamps.
        spin_rad_s : tuple of float
            Inertial angular velocity of g, in g.

        Returns
        -------
        float
            0 to pi; for a true sun, at most a degree a day.
        """
        begin = self.at(begin_ns)
        expected = SunVectors.among_stars(begin, begin_ns, np.array([end_ns]), spin_rad_s).vectors[0]
        found = self.at(end_ns)
        return float(np.arctan2(np.linalg.norm(np.cross(expected, found)), expected @ found))
