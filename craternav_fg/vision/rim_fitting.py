"""Ellipses fitted to the edge points of predicted rims, with their errors and their quality."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.measurements import RimQuality
from craternav_fg.vision.edges import EdgePoints, find_edge_points
from craternav_fg.vision.ellipse_fit import BrightnessUnknown, FitFailure, FitOptions, RimFit, refine_rim
from craternav_fg.vision.error_model.outline import unseen_deviation
from craternav_fg.vision.error_model.systematic import RimErrors
from craternav_fg.vision.ground_level import common_share, own_share
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.predicted_rims import PredictedRims

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]

# Minimum share of a rim's normals that have contrast and lie in the image.
_MIN_TRIED_SHARE = 0.4


@dataclass(frozen=True)
class FittedRims:
    """Predicted rims that were found.

    Attributes
    ----------
    predicted : PredictedRims
        Predictions of n rims.
    charts : ndarray, shape (n, 5)
        Measured ellipse charts in normalised image coordinates.
    errors : RimErrors
        Errors of the charts.
    quality : RimQuality
    """

    predicted: PredictedRims
    charts: FloatArray
    errors: RimErrors
    quality: RimQuality

    def __len__(self) -> int:
        return len(self.charts)


class RimFitter:
    """Fits the rims of one image.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    noise : float
        Standard deviation of the pixel noise.
    camera : Camera
    options : GuidedOptions
    """

    def __init__(self, image: ImageArray, noise: float, camera: Camera, options: GuidedOptions) -> None:
        self._image = image
        self._noise = noise
        self._camera = camera
        self._options = options

    def trace(self, rims: PredictedRims, i: int, reach_px: float) -> EdgePoints:
        """Find the edge points of one rim.

        Parameters
        ----------
        rims : PredictedRims
        i : int
            Index of the rim.
        reach_px : float
            Half length of the searched normals.
        """
        minor_px = rims.smallest_radius_px(i)
        return find_edge_points(
            self._image,
            self._camera,
            rims.charts_px[i],
            rims.contrast_px[i],
            rims.reference[i],
            minor_px,
            reach_px,
            self._noise,
            self._options.edges,
        )

    def fit(
        self, rims: PredictedRims, reach_px: FloatArray, min_found_share: float | None = None
    ) -> FittedRims:
        """Fit the rims that have enough edge points.

        Parameters
        ----------
        rims : PredictedRims
        reach_px : ndarray, shape (n,)
            See `trace`.
        min_found_share : float, optional
            Minimum share of the searched normals with an edge; that of the options if not given.

        Returns
        -------
        FittedRims
            Possibly empty.
        """
        opt = self._options
        least = opt.min_found_share if min_found_share is None else min_found_share
        found: list[int] = []
        fits: list[RimFit] = []
        edges: list[EdgePoints] = []
        enough: list[tuple[int, EdgePoints]] = []
        for i in range(len(rims)):
            traced = self.trace(rims, i, float(reach_px[i]))
            if traced.tried < _MIN_TRIED_SHARE * traced.normals:
                continue
            if len(traced) < least * traced.tried:
                continue
            enough.append((i, traced))
        common = common_share(np.array([traced.evidence for _, traced in enough]).reshape(-1, 2))
        for i, crossings in enough:
            minor_px = rims.smallest_radius_px(i)
            traced = crossings.at_level(own_share(crossings.evidence, common))
            fit = self._fit_one(rims, i, traced, opt.fit)
            if isinstance(fit, FitFailure) or fit.rms_px > opt.max_rms_px + opt.max_rms_share * minor_px:
                continue
            found.append(i)
            fits.append(fit)
            edges.append(traced)
        unseen = unseen_deviation(np.array([fit.outline_share for fit in fits]), opt.fit.outline_share)
        for k in np.flatnonzero(unseen > 0.0).tolist():
            options = replace(opt.fit, outline_share=float(unseen[k]))
            again = self._fit_one(rims, found[k], edges[k], options)
            fits[k] = again if isinstance(again, RimFit) else fits[k]
        rows = np.array(found, dtype=np.int64)
        quality = RimQuality(
            rims.slope_contrast[rows],
            np.array([f.point_count for f in fits]) / np.array([traced.tried for traced in edges]),
            np.array([f.arc_share for f in fits]),
            np.array([f.rms_px for f in fits]),
            np.array([f.outline_share for f in fits]),
        )
        charts = np.array([f.chart for f in fits]).reshape(-1, 5)
        return FittedRims(rims.take(rows), charts, RimErrors.stack([f.errors for f in fits]), quality)

    def _fit_one(
        self, rims: PredictedRims, i: int, edges: EdgePoints, options: FitOptions
    ) -> RimFit | FitFailure:
        opt = self._options
        slope_sigma = opt.brightness_slope_per_px * rims.smallest_radius_px(i)
        brightness = BrightnessUnknown(edges.motion, opt.brightness_sigma, slope_sigma, rims.contrast_px[i])
        return refine_rim(
            edges.points_px, rims.charts_px[i], self._camera, options, edges.sigma_ratio, brightness
        )
