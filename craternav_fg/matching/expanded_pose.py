"""What a search for a pose has found and tried, see `gate_search`."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from factors.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class ExpandedPose:
    """A pose with the rims that it explains.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body.
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b.
    rims, craters : ndarray of int, shape (k,)
        Rows of the matched rims, and of their craters among those of the search.
    distances2, second_distances2 : ndarray, shape (k,)
        Squared Mahalanobis distances of the matches, and of the next best one of rim or crater, without unit;
        inf far beyond the gate.
    score : float
        Sum over the matches of the gate less the squared distance.
    """

    gTb: FloatArray
    covariance: FloatArray
    rims: IntArray
    craters: IntArray
    distances2: FloatArray
    second_distances2: FloatArray
    score: float

    def matches(self, rims: IntArray, craters: IntArray) -> bool:
        """Return whether it explains just some rims by just some craters.

        Parameters
        ----------
        rims, craters : ndarray of int, shape (m,)
            Rows of the rims, and of the crater of each among those of the search.

        Returns
        -------
        bool
        """
        return np.array_equal(self.rims, rims) and np.array_equal(self.craters, craters)


class Tried(NamedTuple):
    """What a search has tried, from which follows how many poses chance makes.

    Attributes
    ----------
    allowed : ndarray of int, shape (h, 4)
        Pairs of rim and crater, twice, that the prediction allows.
    solved : ndarray of int, shape (t, 4)
        Those of them that gave a pose so far.
    possible_rims : int
        Number of rims that some crater in reach could be.
    """

    allowed: IntArray
    solved: IntArray
    possible_rims: int
