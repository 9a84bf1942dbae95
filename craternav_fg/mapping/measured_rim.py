"""What is measured of one rim on an elevation model."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import ClassVar

import numpy as np

from factors.arrays import FloatArray

# Crests found from which catalogue and model can be said to disagree.
_MIN_CRESTS = 30
# Crests that are too far from the catalogue's craters, over those that are near, in a disagreement.
_FAR_SHARE = 0.4


class Outcome(StrEnum):
    """What has become of a crater."""

    REFINED = "refined"
    TOO_SMALL = "smaller than the model resolves"
    OUTSIDE = "not within the model"
    NO_CREST = "no crest all around"
    OTHER_CRATER = "the crest found is too far from the catalogue's"


@dataclass(frozen=True)
class MeasuredRim:
    """One rim on an elevation model.

    Attributes
    ----------
    chart_m : ndarray, shape (5,)
        Chart in the tangent plane at the catalogue's centre, east and north, m and logarithms.
    covariance : ndarray, shape (5, 5)
        Of the chart, m^2.
    height_m, height_sigma_m : float
        Mean height of the crest, and its standard deviation.
    tilt_rad : ndarray, shape (2,)
        Slope of the rim's plane towards east and north.
    scatter_m, depth_m, relief_m : float
        Deviation of the crest from that plane; height above the floor, and above the surroundings.
    """

    NUMBERS: ClassVar[int] = 37

    chart_m: FloatArray
    covariance: FloatArray
    height_m: float
    height_sigma_m: float
    tilt_rad: FloatArray
    scatter_m: float
    depth_m: float
    relief_m: float

    def numbers(self) -> FloatArray:
        """Return all numbers in the order of the attributes.

        Returns
        -------
        ndarray, shape (37,)
            m, rad and logarithms.
        """
        parts = [getattr(self, field.name) for field in fields(self)]
        return np.concatenate([np.ravel(part) for part in parts])

    @classmethod
    def of_numbers(cls, numbers: FloatArray) -> "MeasuredRim":
        """Make a rim of its numbers.

        Parameters
        ----------
        numbers : ndarray, shape (37,)
            See `numbers`: m, rad and logarithms.
        """
        height, sigma, *tilt = numbers[30:34].tolist()
        return cls(
            numbers[:5], numbers[5:30].reshape(5, 5), height, sigma, np.array(tilt), *numbers[34:37].tolist()
        )


# A rim, or why there is none.
Found = MeasuredRim | Outcome


def disagrees(outcomes: Sequence[Outcome]) -> bool:
    """Tell whether the catalogue's craters are elsewhere than those of the elevation model.

    Where both agree, a tenth as many crests are too far from the catalogue's craters as are near them (GLD100
    and LU1319381); where they are 1 km apart as many, and from 2 km on 0.7 to 2 times as many.

    Parameters
    ----------
    outcomes : sequence of Outcome

    Returns
    -------
    bool
    """
    far = outcomes.count(Outcome.OTHER_CRATER)
    near = outcomes.count(Outcome.REFINED)
    return far + near >= _MIN_CRESTS and far > _FAR_SHARE * near
