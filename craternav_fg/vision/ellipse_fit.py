"""An ellipse through edge points, in the ellipse chart, with its covariance.

Pixels are those of `Camera.pinhole`: edge points of a lens that distorts are undistorted before, not the
ellipse's parameters afterwards.

The fit starts from the approximate-mean-square fit (`cv2.fitEllipseAMS`) and minimises the points'
distances to the ellipse by Gauss-Newton under a redescending loss. It runs in the chart of pixel
coordinates; an anisotropic scale turns that chart into the one of normalised coordinates, component
by component.

The distance is that of f = sqrt((x - m)' S^-1 (x - m)) - 1, divided by its gradient: exact for
circles. The usual Sampson distance, of f^2 + 2 f, falls short by e^2 / 2R and shrinks small ellipses.
What bias is left is the second-order one of the estimating equation, and is subtracted; errors are
taken to lie along the normals, as they do for edges searched along normals. Points that also err along the
rim, such as clicked ones, lie outside it by sigma^2 / 2R more, which their distances cannot tell.

Real outlines are no ellipses, and where the points leave gaps an ellipse fitted as if they were goes astray
by far more than their scatter. So harmonics of the outline may be estimated beside the ellipse, as unknowns
whose variance the points' misfit tells: what is not seen of the rim is then as uncertain as what is seen
deviates. What the points tell of the unknown that moves them all, in their differences, is believed the less.
"""

from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.camera import Camera
from craternav_fg.ellipse import (
    axes_covariance,
    chart_of_axes,
    moments_kernel,
    normalised_chart,
    pixel_chart,
    semi_axes_kernel,
)
from craternav_fg.vision import ellipse_kernel

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FitOptions:
    """How an ellipse is fitted to edge points, and what is known beside the points' scatter.

    Attributes
    ----------
    min_points : int
        Fewer points (or fewer that the robust loss leaves) are no fit.
    min_arc_share : float
        Shortest part of the rim, of 1, that the points must cover; no fit is of use under a third.
    max_gap_rad : float
        Longest step between neighbouring points that still counts as covered.
    max_sigma_share : float
        Largest standard deviation of an axis, relative to it: above, the points do not determine it.
    min_scatter_px : float
        Lower bound of the points' standard deviation: keeps perfect points from an infinite weight.
    floor_px, floor_share : float
        Systematic floor on centre, semi-axes and rotation: floor_px + floor_share b.
    outline_share : float
        Expected root mean square of a rim's deviation from an ellipse, in radii. How much a rim deviates is
        estimated beside the ellipse, and is uncertainty of those parts of it that are not seen; 0: rims are
        ellipses.
    """

    min_points: int = 16
    min_arc_share: float = 0.36
    max_gap_rad: float = 0.45
    max_sigma_share: float = 0.1
    min_scatter_px: float = 0.03
    floor_px: float = 0.025
    floor_share: float = 0.001
    outline_share: float = 0.0


@dataclass(frozen=True)
class RimFit:
    """An ellipse fitted to edge points.

    Attributes
    ----------
    chart : ndarray, shape (5,)
        Ellipse chart in normalised image coordinates, bias removed.
    covariance : ndarray, shape (5, 5)
        Of the chart: the points' scatter, what moves them together, the outline's deviation from an ellipse
        and the systematic floor.
    systematic : ndarray, shape (5, 5)
        The last two of these, the lever's slope and `level`: about the same error in every image of the rim.
    level : ndarray, shape (5,)
        Root of the part that is from the lever's unknown, as far as the points are not believed about it.
    chart_px : ndarray, shape (5,)
        The same ellipse's chart in pixel coordinates.
    rms_px : float
        Of the points' distances, under the robust weights.
    point_count : int
        Points that the robust loss kept.
    arc_share : float
        Part of the rim they cover.
    outline_share : float
        Root mean square of the rim's deviation from an ellipse, in radii, as the points tell it; 0 when it is
        taken for one.
    """

    chart: FloatArray
    covariance: FloatArray
    systematic: FloatArray
    level: FloatArray
    chart_px: FloatArray
    rms_px: float
    point_count: int
    arc_share: float
    outline_share: float


class FitFailure(Enum):
    """Why points gave no ellipse."""

    TOO_FEW_POINTS = "too few points"
    SHORT_ARC = "the points cover too little of the rim"
    NO_ELLIPSE = "the points do not determine an ellipse"


def fit_rim(
    points_px: FloatArray,
    camera: Camera,
    options: FitOptions | None = None,
    sigma_ratio: FloatArray | None = None,
) -> RimFit | FitFailure:
    """Fit an ellipse to edge points.

    Parameters
    ----------
    points_px : ndarray, shape (n, 2)
        Edge points, pixels. If they follow the rim, errors that neighbours share are noticed.
    camera : Camera
        Turns pixels into normalised coordinates.
    options : FitOptions, optional
    sigma_ratio : ndarray, shape (n,), optional
        The points' standard deviations relative to one another; equal if not given.

    Returns
    -------
    RimFit or FitFailure
        The failure when the points do not determine an ellipse.
    """
    options = options or FitOptions()
    points = np.ascontiguousarray(points_px, dtype=np.float64)
    if len(points) < options.min_points:
        return FitFailure.TOO_FEW_POINTS
    ratio = (
        np.ones(len(points)) if sigma_ratio is None else np.ascontiguousarray(sigma_ratio, dtype=np.float64)
    )
    (cx, cy), (axis1, axis2), angle_deg = cv2.fitEllipseAMS(points.astype(np.float32))
    if not (min(axis1, axis2) > 0.0 and np.all(np.isfinite([cx, cy, axis1, axis2, angle_deg]))):
        return FitFailure.NO_ELLIPSE
    start = chart_of_axes([cx, cy, 0.5 * axis1, 0.5 * axis2, np.deg2rad(angle_deg)])
    return refine_rim(points, start, camera, options, ratio)


def refine_rim(
    points: FloatArray,
    start_px: FloatArray,
    camera: Camera,
    options: FitOptions,
    sigma_ratio: FloatArray,
    lever: FloatArray | None = None,
    lever_sigma: float = 1.0,
    lever_slope: float = 0.0,
    toward: FloatArray | None = None,
) -> RimFit | FitFailure:
    """Fit as `fit_rim`, from a given start and with an unknown that moves all points.

    Parameters
    ----------
    points, camera, options, sigma_ratio
        As in `fit_rim`.
    start_px : ndarray, shape (5,)
        Chart in pixel coordinates.
    lever : ndarray, shape (n, 2), optional
        Motion of the points, px, per unit of an unknown that is estimated beside the ellipse.
    lever_sigma : float
        Prior standard deviation of that unknown, about 0.
    lever_slope : float
        That of its change from the rim's centre to the rim, in each of two directions; 0: it is the same all
        round.
    toward : ndarray, shape (2,), optional
        The one of these directions, px, in which the slope cannot be told from the rim's size: it is
        uncertainty only.
    """
    if len(points) < options.min_points:
        return FitFailure.TOO_FEW_POINTS
    still = np.zeros_like(points)
    ok, y, cov, of_outline, level, rms, kept, arc, outline = ellipse_kernel.fit(
        points, sigma_ratio, still if lever is None else lever, lever_sigma, lever_slope,
        np.zeros(2) if toward is None else toward, start_px, options.min_scatter_px, options.max_gap_rad,
        options.outline_share,
    )  # fmt: skip
    if not ok or np.sqrt(max(cov[2, 2], cov[4, 4])) > options.max_sigma_share:
        return FitFailure.NO_ELLIPSE
    if kept < options.min_points:
        return FitFailure.TOO_FEW_POINTS
    if arc < options.min_arc_share:
        return FitFailure.SHORT_ARC
    chart, scale = normalised_chart(y, camera)
    units = np.outer(scale, scale)
    level = level * scale
    systematic = of_outline * units + systematic_covariance(chart, camera, options) + np.outer(level, level)
    covariance = (cov - of_outline) * units + systematic
    return RimFit(chart, covariance, systematic, level, y, rms, kept, arc, outline)


def systematic_covariance(chart: FloatArray, camera: Camera, options: FitOptions) -> FloatArray:
    """Covariance (5, 5) of a chart (5,), in normalised coordinates, from the systematic floor alone."""
    _, scale = normalised_chart(chart, camera)
    floor = floor_covariance(pixel_chart(chart, camera), options.floor_px, options.floor_share)
    return np.asarray(floor * np.outer(scale, scale))


@njit(cache=True, error_model="numpy")
def floor_covariance(y: FloatArray, floor_px: float, floor_share: float) -> FloatArray:
    """Compute the covariance of a chart from a systematic error of centre, semi-axes and rotation.

    Parameters
    ----------
    y : ndarray, shape (5,)
        Chart in pixels.
    floor_px, floor_share : float
        The error's standard deviation is floor_px + floor_share b, see `ellipse.axes_covariance`.

    Returns
    -------
    ndarray, shape (5, 5)
        Covariance of the chart in pixels.
    """
    sxx, sxy, syy = moments_kernel(y[2], y[3], y[4])
    _, minor_px = semi_axes_kernel(sxx, sxy, syy, np.exp(y[2] + y[4]))
    return axes_covariance(y, floor_px + floor_share * minor_px)
