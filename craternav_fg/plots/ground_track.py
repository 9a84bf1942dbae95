"""Downrange and crossrange along the ground track of a trajectory."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.body import Body
from factors.arrays import FloatArray

IntArray = npt.NDArray[np.intp]

# Motion below which a trajectory has no direction.
_VERTICAL_RAD = 1e-9


@dataclass(frozen=True)
class GroundTrack:
    """The great circle of a trajectory: downrange along it, crossrange to its left.

    Attributes
    ----------
    first, ahead, pole : ndarray, shape (3,)
        Unit vectors in g: to the first position, along the track there, and to the left of it.
    radius_km : float
        Radius of the body's sphere.
    """

    first: FloatArray
    ahead: FloatArray
    pole: FloatArray
    radius_km: float

    @classmethod
    def along(cls, gP: FloatArray, body: Body) -> "GroundTrack":
        """Lay the track along positions.

        Its pole is the mean normal of their motion: the ends alone would turn the track around beyond half a
        revolution.

        Parameters
        ----------
        gP : ndarray, shape (k, 3)
            In g, m, in the order of time.
        body : Body

        Returns
        -------
        GroundTrack
        """
        unit = gP / np.linalg.norm(gP, axis=1, keepdims=True)
        first = unit[0]
        pole = np.cross(unit[:-1], unit[1:]).sum(axis=0)
        pole -= (pole @ first) * first
        if np.linalg.norm(pole) < _VERTICAL_RAD:
            # A vertical descent has no direction: any will do.
            pole = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
        pole /= np.linalg.norm(pole)
        return cls(first, np.cross(pole, first), pole, body.radius_m / 1e3)

    def ranges_km(self, gP: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute downrange and crossrange of lines: of a trajectory, or of outlines.

        Parameters
        ----------
        gP : ndarray, shape (..., k, 3)
            Positions in g, m; neighbours along a line are less than half a revolution apart.

        Returns
        -------
        downrange_km, crossrange_km : ndarray, shape (..., k)
            Along the sphere, km. Downrange has no jump along a line, which begins within half a revolution of
            the first position.
        """
        unit = gP / np.linalg.norm(gP, axis=-1, keepdims=True)
        downrange = np.unwrap(np.arctan2(unit @ self.ahead, unit @ self.first), axis=-1)
        crossrange = np.arcsin(np.clip(unit @ self.pole, -1.0, 1.0))
        return self.radius_km * downrange, self.radius_km * crossrange

    def in_span(self, downrange_km: FloatArray, span_km: tuple[float, float]) -> tuple[IntArray, FloatArray]:
        """Find places in a span of downrange, in each revolution of the track.

        Parameters
        ----------
        downrange_km : ndarray, shape (n,)
            In any revolution.
        span_km : tuple of float
            First and last downrange.

        Returns
        -------
        rows : ndarray of int, shape (m,)
            Places; one may be passed several times.
        downrange_km : ndarray, shape (m,)
            Inside the span.
        """
        round_km = 2.0 * np.pi * self.radius_km
        left, right = span_km
        later = np.ceil((left - downrange_km) / round_km)
        repeats = np.arange(int((right - left) // round_km) + 1)
        all_km = downrange_km[:, None] + round_km * (later[:, None] + repeats)
        rows, columns = np.nonzero(all_km <= right)
        return rows, all_km[rows, columns]

    def angles_rad(self, directions: FloatArray, downrange_km: FloatArray) -> FloatArray:
        """Compute the angles of horizontal directions from the track.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors in g.
        downrange_km : ndarray, shape (n,)
            Where each holds, km.

        Returns
        -------
        ndarray, shape (n,)
            Towards its left, rad.
        """
        angle = downrange_km[:, None] / self.radius_km
        forward = np.cos(angle) * self.ahead - np.sin(angle) * self.first
        return np.arctan2(directions @ self.pole, np.einsum("ni,ni->n", directions, forward))
