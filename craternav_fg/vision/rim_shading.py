"""What is expected of the brightness around a rim: reference, its gradient, and how slopes change it."""

from typing import NamedTuple

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Least second-order change of brightness with slope: less has no effect on a crossing.
_LEAST_CURVATURE = 1e-3
# Least reference brightness at a rim point over that at the rim's centre.
_DARKEST = 0.4


class RimShading(NamedTuple):
    """What the photometric law and the image as a whole let expect of the brightness around a rim.

    Attributes
    ----------
    reference : float
        Reference brightness at the centre: that of locally flat terrain, 0 to 255.
    gradient : ndarray, shape (2,)
        Its change along the image as a share of it, 1/px.
    contrast_px : ndarray, shape (2,)
        Slope contrast c in the image, per pixel of crater radius.
    curvature_px : ndarray, shape (2, 2)
        Second-order change K of brightness in the image, per square pixel of crater radius: ground that rises
        outward with slope s at a rim point with image normal n and support distance h is brighter by the
        share -(c . n / h) s + (n . K n / h^2) s^2.
    """

    reference: float
    gradient: FloatArray
    contrast_px: FloatArray
    curvature_px: FloatArray


@njit(cache=True, error_model="numpy")
def contrast_across(contrast_px: FloatArray, q: FloatArray) -> float:
    """Compute the slope contrast across the rim at a rim point.

    Parameters
    ----------
    contrast_px : ndarray, shape (2,)
        See `RimShading`.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    return -(contrast_px[0] * q[2] + contrast_px[1] * q[3]) / q[4]


@njit(cache=True, error_model="numpy")
def curvature_across(curvature_px: FloatArray, q: FloatArray) -> float:
    """Compute the second-order change of brightness with slope across the rim at a rim point; not zero.

    Parameters
    ----------
    curvature_px : ndarray, shape (2, 2)
        See `RimShading`.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    of_x = curvature_px[0, 0] * q[2] + curvature_px[0, 1] * q[3]
    of_y = curvature_px[1, 0] * q[2] + curvature_px[1, 1] * q[3]
    value = (q[2] * of_x + q[3] * of_y) / (q[4] * q[4])
    return value if np.abs(value) > _LEAST_CURVATURE else -_LEAST_CURVATURE


@njit(cache=True, error_model="numpy")
def reference_along(gradient: FloatArray, chart_px: FloatArray, q: FloatArray) -> float:
    """Compute the reference brightness at a rim point over that at the rim's centre.

    Parameters
    ----------
    gradient : ndarray, shape (2,)
        See `RimShading`.
    chart_px : ndarray, shape (5,)
        The rim, px.
    q : ndarray, shape (6,)
        See `rim_geometry.rim_point`.
    """
    ratio = 1.0 + gradient[0] * (q[0] - chart_px[0]) + gradient[1] * (q[1] - chart_px[1])
    return max(ratio, _DARKEST)
