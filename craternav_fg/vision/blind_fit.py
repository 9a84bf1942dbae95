"""Rims traced and fitted in an image from ellipses near them, without a camera model or a pose.

The rim is traced and fitted as if it had been predicted (see `edges` and `ellipse_fit`), twice: the second
time from the first fit, along shorter normals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.vision.blind_kernel import Tracing, traced_rim
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.ellipse_fit import BrightnessUnknown, FitFailure, FitOptions, RimFit, refine_rim
from factors.arrays import FloatArray, ImageArray

# Tells from `BlindFit.evidence` whether a rim is of use.
Judge = Callable[[FloatArray], bool]

# Relative standard deviation of the reference brightness of a rim. Fitted by
# `craternav_fg.calibration.reference_brightness`.
BRIGHTNESS_SIGMA = 0.05
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
        sun = np.array([np.cos(sun_angle_rad), np.sin(sun_angle_rad)])
        ok, points, ratio, motion, tried, chart, minor, rms, kept, arc = traced_rim(
            self.pixels, start_px, sun, self._tracing
        )
        if not ok:
            return None
        # The evidence is that of an ellipse: an irregular outline would explain other edges away.
        scatter = max(rms / minor, MIN_SCATTER_RADII)
        evidence = np.array([kept / tried, scatter, arc])
        if worth is not None and not worth(evidence):
            return None
        brightness_unknown = BrightnessUnknown(motion, BRIGHTNESS_SIGMA)
        outlined = refine_rim(points, chart, self._camera, self.options, ratio, brightness_unknown)
        return None if isinstance(outlined, FitFailure) else BlindFit(outlined, evidence)

    @cached_property
    def _camera(self) -> Camera:
        """Camera whose normalised coordinates are pixels."""
        height, width = self.pixels.shape
        return Camera(width, height, 1.0, 1.0, 0.0, 0.0, psf_sigma_px=self.psf_px)

    @cached_property
    def _tracing(self) -> Tracing:
        edges, fit = EdgeOptions(), self.options
        return Tracing(
            self.contrast, edges.noise_step(self.noise), self.psf_px, edges.smoothing_share,
            edges.smoothing_px, edges.min_slope_contrast, edges.min_step_share,
            edges.crest_tables(self.psf_px), self._camera.lens, fit.min_points, fit.min_arc_share,
            fit.max_gap_rad, fit.max_sigma_share, fit.min_scatter_px, BRIGHTNESS_SIGMA,
        )  # fmt: skip
