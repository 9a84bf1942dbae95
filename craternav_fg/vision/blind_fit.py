"""Rims traced and fitted in an image from ellipses near them, without a camera model or a pose.

The rim is traced and fitted as if it had been predicted (see `edges` and `ellipse_fit`), twice: the second
time from the first fit, along shorter normals.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import (
    mean_radius,
    points_on,
    semi_minor,
    unwhitened_points,
    whitened_points,
)
from craternav_fg.vision.edges import EdgeOptions, find_edge_points
from craternav_fg.vision.ellipse_fit import BrightnessUnknown, FitFailure, FitOptions, RimFit, refine_rim
from craternav_fg.vision.reference_brightness import MIN_REFERENCE_BRIGHTNESS

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]
# Tells from `BlindFit.evidence` whether a rim is of use.
Judge = Callable[[FloatArray], bool]

# Rings of flat terrain around a crater, in radii, and the points on each.
_GROUND_RING_RADII, _RING_POINTS = (1.5, 1.75, 2.0), 32
_GROUND_RINGS = np.concatenate(
    [radius * points_on(np.zeros(5), _RING_POINTS) for radius in _GROUND_RING_RADII]
)
# Half lengths of the normals along which a rim is traced, first and second: px, share of the radius.
_NORMAL_REACHES = ((2.0, 0.35), (1.5, 0.14))
# Relative standard deviation of the reference brightness of a rim. Fitted by
# `craternav_fg.calibration.reference_brightness`.
BRIGHTNESS_SIGMA = 0.05
# Minimum share of the normals that have contrast and lie in the image, and of these that have an edge.
_MIN_TRIED_SHARE, _MIN_FOUND_SHARE = 0.3, 0.35
# Minimum semi-minor axis and largest shift of a rim, in radii of its start: another crater's rim beyond.
_MIN_MINOR_RADII, _MAX_SHIFT_RADII = 0.5, 0.6
# Minimum scatter that counts, in radii: rendered rims are smoother than real ones.
MIN_SCATTER_RADII = 0.02


@dataclass(frozen=True)
class BlindFit:
    """A rim that was traced, and how well.

    Attributes
    ----------
    fit : RimFit
    evidence : ndarray, shape (3,)
        In the image, dimensionless: share of the normals that agree, scatter in radii, share of the rim
        that is covered.
    """

    fit: RimFit
    evidence: FloatArray


@dataclass(frozen=True)
class BlindFitter:
    """What all rims of an image are traced with.

    Attributes
    ----------
    pixels : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    contrast : float
        Slope contrast, see `photometry`.
    noise : float
        Standard deviation of the pixels' noise, see `image_sampling.noise_level`.
    psf_px : float
        Standard deviation of the point-spread function.
    options : FitOptions
    """

    pixels: ImageArray
    contrast: float
    noise: float
    psf_px: float
    options: FitOptions

    def fit(
        self,
        start_px: FloatArray,
        sun_angle_rad: float,
        worth: Judge | None = None,
    ) -> BlindFit | None:
        """Trace and fit a rim.

        Parameters
        ----------
        start_px : ndarray, shape (5,)
            Ellipse near it, chart in pixels.
        sun_angle_rad : float
            Direction towards the sun in the image, from x towards y.
        worth : callable, optional
            Tells from `BlindFit.evidence` whether the rim is of use: the last fit, of an irregular
            outline, takes as long as all before it.

        Returns
        -------
        BlindFit or None
            None where no rim can be traced, or it is of no use.
        """
        height, width = self.pixels.shape
        camera = Camera(width, height, 1.0, 1.0, 0.0, 0.0, psf_sigma_px=self.psf_px)
        chart = start_px
        direction = np.array([np.cos(sun_angle_rad), np.sin(sun_angle_rad)])
        fit: RimFit | FitFailure = FitFailure.NO_ELLIPSE
        as_ellipse = replace(self.options, outline_share=0.0)
        for reach_px, reach_share in _NORMAL_REACHES:
            size = float(mean_radius(chart))
            reference = ring_brightness(self.pixels, chart)
            if not reference > MIN_REFERENCE_BRIGHTNESS:
                return None
            # The crater's radius towards the sun, in the image.
            contrast_px = self.contrast / np.hypot(*whitened_points(chart[:2] + direction, chart)) * direction
            edges = find_edge_points(
                self.pixels, camera, chart, contrast_px, reference, size, reach_px + reach_share * size,
                self.noise, EdgeOptions(),
            )  # fmt: skip
            if edges.tried < _MIN_TRIED_SHARE * edges.normals or len(edges) < _MIN_FOUND_SHARE * edges.tried:
                return None
            brightness_unknown = BrightnessUnknown(edges.motion, BRIGHTNESS_SIGMA)
            fit = refine_rim(
                edges.points_px, chart, camera, as_ellipse, edges.sigma_ratio, brightness_unknown
            )
            if isinstance(fit, FitFailure):
                return None
            chart = fit.chart_px
        assert isinstance(fit, RimFit)
        minor, radius = float(semi_minor(chart)), float(mean_radius(start_px))
        moved = float(np.hypot(*(chart[:2] - start_px[:2])))
        if minor < _MIN_MINOR_RADII * radius or moved > _MAX_SHIFT_RADII * radius:
            return None
        # The evidence is that of an ellipse: an irregular outline would explain other edges away.
        scatter = max(fit.rms_px / minor, MIN_SCATTER_RADII)
        evidence = np.array([fit.point_count / edges.tried, scatter, fit.arc_share])
        if worth is not None and not worth(evidence):
            return None
        outlined = refine_rim(
            edges.points_px, chart, camera, self.options, edges.sigma_ratio, brightness_unknown
        )
        return None if isinstance(outlined, FitFailure) else BlindFit(outlined, evidence)


def ring_brightness(image: ImageArray, chart_px: FloatArray) -> float:
    """Estimate the brightness of the terrain around a rim: the median of rings.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    chart_px : ndarray, shape (5,)
        Chart of the rim in pixels.

    Returns
    -------
    float
        0 where the image has none of the rings.
    """
    columns, rows = np.rint(unwhitened_points(_GROUND_RINGS, chart_px)).astype(np.int64).T
    inside = (columns >= 0) & (rows >= 0) & (columns < image.shape[1]) & (rows < image.shape[0])
    values = image[rows[inside], columns[inside]]
    values = np.sort(values[np.isfinite(values)])
    return float(values[len(values) // 2]) if len(values) > 0 else 0.0
