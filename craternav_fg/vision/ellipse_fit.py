"""An ellipse through edge points: its chart, and the errors of that.

Pixels are those of `Camera.pinhole`: with a lens that distorts, edge points are undistorted before the fit.

The fit starts from the approximate-mean-square ellipse (`cv2.fitEllipseAMS`) and minimises the points'
distances to the ellipse by Gauss-Newton under a redescending loss. It runs in the chart of pixel coordinates;
an anisotropic scale turns that chart into the one of normalised coordinates, component by component.

The distance is f = sqrt((x - m)' S^-1 (x - m)) - 1 over its gradient: exact for circles. The usual Sampson
distance, of f^2 + 2 f, falls short by e^2 / 2R for an error e and a radius R, and shrinks small ellipses. The
remaining, second-order bias of the estimating equation is subtracted (`ellipse_bias`). Errors are taken to
lie along the normals, as they do for edges searched along normals. Points that also err along the rim, such
as points clicked by hand, lie outside it by sigma^2 / 2R more, which their distances do not show.

Outlines of real craters are not ellipses. Where edge points are missing, an ellipse fitted as if they were
goes astray by far more than the points scatter. So harmonics of the outline may be estimated beside the
ellipse, with a prior variance that the points' misfit gives: the unseen part of the rim is then as uncertain
as the seen part deviates.

A wrong reference brightness moves all edge points of a rim together (see `edges`). It is estimated beside the
ellipse, too (`BrightnessUnknown`); the more irregular the outline, the less that estimate is trusted.
"""

from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_axes, normalised_chart, pixel_chart
from craternav_fg.vision import ellipse_kernel
from craternav_fg.vision.error_model.systematic import RimErrors, floor_covariance
from factors.arrays import FloatArray


@dataclass(frozen=True)
class FitOptions:
    """How an ellipse is fitted to edge points, and which errors it has beside their scatter.

    Attributes
    ----------
    min_points : int
        Minimum number of points, and of points that the robust loss keeps.
    min_arc_share : float
        Minimum share of the rim that the points must cover; ellipse fits to less than a third are useless.
    max_gap_rad : float
        Longest step between neighbouring points that counts as covered.
    max_sigma_share : float
        Largest standard deviation of an axis, relative to it; the points do not determine the ellipse above
        it.
    min_scatter_px : float
        Lower bound of the points' standard deviation: keeps perfect points from an infinite weight.
    floor_px, floor_share : float
        Systematic floor, the standard deviation of centre, semi-axes and rotation: floor_px + floor_share b.
        That of guided rims follows from the ground instead, see `GuidedOptions.level_scatter_share`.
    outline_share : float
        Expected root mean square deviation of a rim from an ellipse, in radii. How much the rim deviates is
        then estimated, and is uncertainty of its unseen parts; fewer than 25 points give fewer harmonics of
        it. 0: rims are ellipses.
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
class BrightnessUnknown:
    """Error of the reference brightness, an unknown that moves all edge points of a rim.

    Attributes
    ----------
    motion : ndarray, shape (n, 2)
        Motion of the points, px, per relative error of the brightness.
    sigma : float
        Prior standard deviation of the relative error.
    slope_sigma : float
        Prior standard deviation of its change from the rim's centre to the rim, in each of two directions; 0:
        the error is the same all around.
    sun_px : ndarray, shape (2,), optional
        Direction towards the sun in the image, of any length; needed with a slope. In this direction the
        slope has the effect of a change of size, so it is not estimated and only adds to the covariance.
    floor_px : float
        Standard deviation of centre, semi-axes and rotation, px, from what it leaves out: brightness that
        varies around the rim.
    """

    motion: FloatArray
    sigma: float
    slope_sigma: float = 0.0
    sun_px: FloatArray | None = None
    floor_px: float = 0.0


@dataclass(frozen=True)
class RimFit:
    """An ellipse fitted to edge points.

    Attributes
    ----------
    chart : ndarray, shape (5,)
        Ellipse chart in normalised image coordinates, bias removed.
    errors : RimErrors
        Errors of the chart.
    chart_px : ndarray, shape (5,)
        The same ellipse as a chart in pixels.
    rms_px : float
        Root mean square of the points' distances under the robust weights.
    point_count : int
        Points that the robust loss kept.
    arc_share : float
        Share of the rim that they cover.
    outline_share : float
        Estimated root mean square deviation of the rim from an ellipse, in radii; 0 when it is taken for one.
    """

    chart: FloatArray
    errors: RimErrors
    chart_px: FloatArray
    rms_px: float
    point_count: int
    arc_share: float
    outline_share: float

    @property
    def covariance(self) -> FloatArray:
        """Covariance (5, 5) of the chart."""
        return self.errors.covariance


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
        Edge points, px. In their order along the rim, errors that neighbours share enlarge the covariance.
    camera : Camera
        Turns pixels into normalised coordinates.
    options : FitOptions, optional
    sigma_ratio : ndarray, shape (n,), optional
        Standard deviations of the points relative to one another; equal if not given.

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
    points_px: FloatArray,
    start_px: FloatArray,
    camera: Camera,
    options: FitOptions,
    sigma_ratio: FloatArray,
    brightness: BrightnessUnknown | None = None,
) -> RimFit | FitFailure:
    """Fit an ellipse to edge points from a given start.

    Parameters
    ----------
    points_px : ndarray, shape (n, 2)
        Edge points, see `fit_rim`.
    start_px : ndarray, shape (5,)
        Chart in pixels.
    camera : Camera
        Turns pixels into normalised coordinates.
    options : FitOptions
    sigma_ratio : ndarray, shape (n,)
        Standard deviations of the points relative to one another.
    brightness : BrightnessUnknown, optional
        Unknown that is estimated beside the ellipse.

    Returns
    -------
    RimFit or FitFailure
        The failure when the points do not determine an ellipse.
    """
    if len(points_px) < options.min_points:
        return FitFailure.TOO_FEW_POINTS
    if brightness is None:
        brightness = BrightnessUnknown(np.zeros_like(points_px), 1.0)
    ok, y, cov, of_outline, root, rms, kept, arc, outline = ellipse_kernel.fit(
        points_px, sigma_ratio, brightness.motion, brightness.sigma, brightness.slope_sigma,
        np.zeros(2) if brightness.sun_px is None else brightness.sun_px, start_px, options.min_scatter_px,
        options.max_gap_rad, options.outline_share,
    )  # fmt: skip
    if not ok or np.sqrt(max(cov[2, 2], cov[4, 4])) > options.max_sigma_share:
        return FitFailure.NO_ELLIPSE
    if kept < options.min_points:
        return FitFailure.TOO_FEW_POINTS
    if arc < options.min_arc_share:
        return FitFailure.SHORT_ARC
    chart, scale = normalised_chart(y, camera)
    units = np.outer(scale, scale)
    of_chart = pixel_chart(chart, camera)
    floor = floor_covariance(of_chart, options.floor_px, options.floor_share)
    floor = floor + floor_covariance(of_chart, brightness.floor_px, 0.0)
    errors = RimErrors.of_fit((cov - of_outline) * units, of_outline * units, root * scale, floor * units)
    return RimFit(chart, errors, y, rms, kept, arc, outline)
