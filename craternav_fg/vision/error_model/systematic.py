"""Systematic error of one fitted rim: what more edge points would not average out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from craternav_fg.ellipse import axes_covariance, moments_kernel, semi_axes_kernel
from factors.arrays import BoolArray, FloatArray
from factors.kernels.compiled import njit


@dataclass(frozen=True)
class RimErrors:
    """Error of one rim's chart, or of n rims' charts, in normalised image coordinates.

    Attributes
    ----------
    covariance : ndarray, shape (..., 5, 5)
        Covariance of the whole error.
    systematic : ndarray, shape (..., 5, 5)
        Covariance of the part that is about the same in every image of the rim.
    brightness_root : ndarray, shape (..., 5)
        Root v of the part v v' of `systematic` that comes from the unknown reference brightness: it moves
        rims along the illumination direction.
    """

    covariance: FloatArray
    systematic: FloatArray
    brightness_root: FloatArray

    @classmethod
    def of_fit(
        cls, points: FloatArray, outline: FloatArray, brightness_root: FloatArray, floor: FloatArray
    ) -> "RimErrors":
        """Add up the errors of one fitted rim.

        Parameters
        ----------
        points : ndarray, shape (5, 5)
            Covariance from the scatter of the edge points.
        outline : ndarray, shape (5, 5)
            Covariance from the outline's deviation from an ellipse and the slope of the reference brightness.
        brightness_root : ndarray, shape (5,)
            Standard deviation, with sign, from a biased estimate of the reference brightness.
        floor : ndarray, shape (5, 5)
            Covariance from the systematic floor.
        """
        systematic = outline + floor + np.outer(brightness_root, brightness_root)
        return cls(points + systematic, systematic, brightness_root)

    @classmethod
    def stack(cls, errors: Sequence["RimErrors"]) -> "RimErrors":
        """Put the errors of n single rims together, possibly none."""
        return cls(
            np.array([e.covariance for e in errors]).reshape(-1, 5, 5),
            np.array([e.systematic for e in errors]).reshape(-1, 5, 5),
            np.array([e.brightness_root for e in errors]).reshape(-1, 5),
        )

    def take(self, rows: BoolArray) -> "RimErrors":
        """Select the errors of some rims.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,)
        """
        return RimErrors(self.covariance[rows], self.systematic[rows], self.brightness_root[rows])

    def scaled(self, factor: float) -> "RimErrors":
        """Multiply all variances by a factor."""
        return RimErrors(
            factor * self.covariance, factor * self.systematic, np.sqrt(factor) * self.brightness_root
        )


@njit(cache=True, error_model="numpy")
def floor_covariance(y: FloatArray, floor_px: float, floor_share: float) -> FloatArray:
    """Compute the covariance of a chart from a systematic error of centre, semi-axes and rotation.

    Each has the standard deviation floor_px + floor_share b, b the semi-minor axis; see
    `ellipse.axes_covariance`.

    Parameters
    ----------
    y : ndarray, shape (5,)
        Chart in pixels.
    floor_px : float
        Constant part of the standard deviation, px.
    floor_share : float
        Part of the standard deviation proportional to the semi-minor axis.

    Returns
    -------
    ndarray, shape (5, 5)
        Covariance of the chart in pixels.
    """
    sxx, sxy, syy = moments_kernel(y[2], y[3], y[4])
    _, minor_px = semi_axes_kernel(sxx, sxy, syy, np.exp(y[2] + y[4]))
    return axes_covariance(y, floor_px + floor_share * minor_px)
