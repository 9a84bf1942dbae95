"""Ellipses fitted to the edge points of predicted rims, with their errors and their quality."""

import math
from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.measurements import RimQuality
from craternav_fg.vision.edges import EdgePoints, find_edge_points, level_around
from craternav_fg.vision.ellipse_fit import BrightnessUnknown, FitFailure, FitOptions, RimFit, refine_rim
from craternav_fg.vision.error_model.outline import unseen_deviation
from craternav_fg.vision.error_model.systematic import RimErrors
from craternav_fg.vision.ground_level import common_share, own_share, smooth_share
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.predicted_rims import PredictedRims
from craternav_fg.vision.robust_scale import median
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Minimum share of a rim's normals that have contrast and lie in the image.
_MIN_TRIED_SHARE = 0.4
# The edge of a rim is searched again if the level of the ground moves it by more than this, px, and the new
# points are taken if they are at least this share of the first ones.
_MIN_MOVED_PX, _MIN_KEPT_SHARE = 1.0, 0.9


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
    scatter : float
        Relative standard deviation of the ground's brightness, see `ReferenceBrightness`.
    camera : Camera
    options : GuidedOptions
    """

    def __init__(
        self, image: ImageArray, noise: float, scatter: float, camera: Camera, options: GuidedOptions
    ) -> None:
        self._image = image
        self._noise = noise
        self._scatter = scatter
        self._camera = camera
        self._options = options

    def trace(
        self,
        rims: PredictedRims,
        i: int,
        reach_px: float,
        ground: FloatArray | None = None,
        *,
        thorough: bool = False,
    ) -> EdgePoints:
        """Find the edge points of one rim.

        Parameters
        ----------
        rims : PredictedRims
        i : int
            Index of the rim.
        reach_px : float
            Half length of the searched normals.
        ground : ndarray, shape (5,), optional
            See `find_edge_points`.
        thorough : bool
            See `find_edge_points`.
        """
        minor_px = rims.smallest_radius_px(i)
        return find_edge_points(
            self._image,
            self._camera,
            rims.charts_px[i],
            rims.shading(i),
            minor_px,
            reach_px,
            self._noise,
            self._options.edges,
            ground,
            thorough=thorough,
        )

    def fit(
        self,
        rims: PredictedRims,
        reach_px: FloatArray,
        min_found_share: float | None = None,
        *,
        rough: bool = False,
    ) -> FittedRims:
        """Fit the rims that have enough edge points.

        Parameters
        ----------
        rims : PredictedRims
        reach_px : ndarray, shape (n,)
            See `trace`.
        min_found_share : float, optional
            Minimum share of the searched normals with an edge; that of the options if not given.
        rough : bool
            Whether to search edges only at the reference brightness, and not at the level that the ground
            has around the rim: where ellipses to correct a pose with are enough, and where rims are searched
            again anyway.

        Returns
        -------
        FittedRims
            Possibly empty.
        """
        opt = self._options
        least = opt.min_found_share if min_found_share is None else min_found_share
        enough: list[tuple[int, EdgePoints]] = []
        for i in range(len(rims)):
            traced = self.trace(rims, i, float(reach_px[i]), thorough=not rough)
            if traced.tried < _MIN_TRIED_SHARE * traced.normals:
                continue
            if len(traced) < least * traced.tried:
                continue
            enough.append((i, traced))
        found, fits, edges = self._fit_all(rims, enough, rough=rough)
        if not rough:
            found, fits, edges = self._fit_again(rims, reach_px, enough, (found, fits, edges))
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

    def _fit_all(
        self, rims: PredictedRims, crossings: list[tuple[int, EdgePoints]], *, rough: bool
    ) -> tuple[list[int], list[RimFit], list[EdgePoints]]:
        """Fit rims to their edge points, moved to the level of the ground: indices, fits, moved points."""
        opt = self._options
        common = _common_share(crossings)
        found: list[int] = []
        fits: list[RimFit] = []
        edges: list[EdgePoints] = []
        for i, crossing in crossings:
            share = own_share(crossing.evidence, common)
            traced = crossing.at_level(share if rough else smooth_share(share))
            fit = self._fit_one(rims, i, traced, opt.fit)
            largest_px = opt.max_rms_px + opt.max_rms_share * rims.smallest_radius_px(i)
            if isinstance(fit, FitFailure) or fit.rms_px > largest_px:
                continue
            found.append(i)
            fits.append(fit)
            edges.append(traced)
        return found, fits, edges

    def _fit_again(
        self,
        rims: PredictedRims,
        reach_px: FloatArray,
        crossings: list[tuple[int, EdgePoints]],
        first: tuple[list[int], list[RimFit], list[EdgePoints]],
    ) -> tuple[list[int], list[RimFit], list[EdgePoints]]:
        """Search the edges of fitted rims at the level of the ground around them, and fit those again."""
        by_rim = dict(crossings)
        common = _common_share(crossings)
        again: list[tuple[int, EdgePoints]] = []
        for i, fit in zip(first[0], first[1], strict=True):
            level = smooth_share(own_share(by_rim[i].evidence, common)) * level_around(
                self._image, self._camera, fit.chart_px, rims.shading(i), rims.smallest_radius_px(i),
                self._options.edges,
            )  # fmt: skip
            moved_px = np.abs(level).sum() * float(median(np.linalg.norm(by_rim[i].motion, axis=1)))
            if moved_px > _MIN_MOVED_PX:
                traced = self.trace(rims, i, float(reach_px[i]), level, thorough=True)
                if len(traced) >= _MIN_KEPT_SHARE * len(by_rim[i]):
                    by_rim[i] = traced
                    again.append((i, traced))
        if not again:
            return first
        second = self._fit_all(rims, [(i, by_rim[i]) for i in first[0]], rough=False)
        missing = set(first[0]) - set(second[0])
        both = [one for one in zip(*first, strict=True) if one[0] in missing]
        both += list(zip(*second, strict=True))
        both.sort(key=lambda one: one[0])
        return [one[0] for one in both], [one[1] for one in both], [one[2] for one in both]

    def _fit_one(
        self, rims: PredictedRims, i: int, edges: EdgePoints, options: FitOptions
    ) -> RimFit | FitFailure:
        opt = self._options
        slope_sigma = opt.brightness_slope_per_px * rims.smallest_radius_px(i)
        brightness = BrightnessUnknown(
            edges.motion, opt.brightness_sigma_share, slope_sigma, rims.contrast_px[i], self._floor_px(edges)
        )
        return refine_rim(
            edges.points_px, rims.charts_px[i], self._camera, options, edges.sigma_ratio, brightness
        )

    def _floor_px(self, edges: EdgePoints) -> float:
        """Error of a rim from the level of the ground at it, which is as uncertain as it varies."""
        opt = self._options
        if len(edges) == 0:
            return 0.0
        scatter, length = _scatter_and_length(edges.level, edges.motion)
        return length * math.hypot(opt.level_scatter_share * self._scatter, opt.level_rim_share * scatter)


@njit(cache=True, error_model="numpy")
def _scatter_and_length(level: FloatArray, motion: FloatArray) -> tuple[float, float]:
    """Compute the standard deviation of levels (n,) and the median length of motions (n, 2)."""
    length: float = np.median(np.hypot(motion[:, 0], motion[:, 1]))
    return float(np.std(level)), length


def _common_share(crossings: list[tuple[int, EdgePoints]]) -> float:
    return common_share(np.array([edges.evidence for _, edges in crossings]).reshape(-1, 2))
