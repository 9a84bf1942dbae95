"""Errors of a catalogue's craters: how far place, size and height of each rim may be off.

They are errors of the map: the same whenever a crater is seen. Independent craters have independent errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from factors.arrays import FloatArray, IntArray

# Degrees of freedom of Student's t distribution of rims on real ground against a published map: fitted by
# `craternav_fg.calibration.common_shift`.
CRATER_FREEDOM = 4.0


@dataclass(frozen=True)
class MapErrors:
    """Standard deviations of the rims of a catalogue, one value per crater; 0 for what is exact.

    Attributes
    ----------
    place_m : ndarray, shape (n,)
        Sigma of the centre, per axis along the ground, m.
    size_share : ndarray, shape (n,)
        Sigma of each semi-axis, as a share of itself: size and shape.
    height_m : ndarray, shape (n,)
        Sigma of the height of the rim's plane, m.
    """

    place_m: FloatArray
    size_share: FloatArray
    height_m: FloatArray

    @cached_property
    def exact(self) -> bool:
        """Whether all of them are zero."""
        return not any(getattr(self, field.name).any() for field in fields(self))

    @classmethod
    def zeros(cls, count: int) -> "MapErrors":
        """Make the errors of an exact catalogue.

        Parameters
        ----------
        count : int
            Number of craters.
        """
        return cls(np.zeros(count), np.zeros(count), np.zeros(count))

    def take(self, rows: IntArray) -> "MapErrors":
        """Select craters.

        Parameters
        ----------
        rows : ndarray of int, shape (k,)
        """
        return MapErrors(self.place_m[rows], self.size_share[rows], self.height_m[rows])

    def replaced(self, rows: IntArray, others: "MapErrors") -> "MapErrors":
        """Replace the errors of some craters.

        Parameters
        ----------
        rows : ndarray of int, shape (k,)
        others : MapErrors
            Map errors of k craters.
        """
        out = [getattr(self, field.name).copy() for field in fields(self)]
        for values, field in zip(out, fields(self), strict=True):
            values[rows] = getattr(others, field.name)
        return MapErrors(*out)

    @classmethod
    def joined(cls, parts: Sequence["MapErrors"]) -> "MapErrors":
        """Join the errors of several catalogues.

        Parameters
        ----------
        parts : sequence of MapErrors
            One or more.
        """
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def variances(self, radius_m: FloatArray) -> FloatArray:
        """Return the variances of ground errors in the order of `factors.kernels.rim_errors.ground_slopes`.

        Parameters
        ----------
        radius_m : ndarray, shape (n,)
            Mean radii of the rims.

        Returns
        -------
        ndarray, shape (n, 6)
            Shifts along both axes and the normal in radii, growth along l1, shear, growth along l2.
        """
        place2, height2, size2 = (
            (self.place_m / radius_m) ** 2,
            (self.height_m / radius_m) ** 2,
            self.size_share**2,
        )
        # The shear of independent errors of axes whose directions are arbitrary.
        return np.stack([place2, place2, height2, size2, 0.5 * size2, size2], axis=-1)
