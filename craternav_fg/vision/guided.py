"""Guided front end: the rims of catalogue craters in an image, near where a predicted pose puts them.

The prediction may be wrong by tens of pixels. First a shift common to all rims is searched, then the
predicted pose is corrected with the rims themselves, and only then is each rim judged by itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray as GreyImage
from craternav_fg.ellipse import normalised_chart
from craternav_fg.frames import rotate_position_block
from craternav_fg.linalg import squared_distance
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimSet
from craternav_fg.vision.arcs import across_sigma, judge
from craternav_fg.vision.error_model.common_growth import common_growth, without_growth
from craternav_fg.vision.error_model.correlated import (
    arc_sigma_px,
    in_plane_slopes,
    map_covariance,
    radii_px,
    shared_of_arcs,
    split,
)
from craternav_fg.vision.error_model.frame_scatter import variance_factor
from craternav_fg.vision.error_model.shape_scatter import shape_variance_factors
from craternav_fg.vision.grey import on_8_bit_scale
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.pose_correction import corrected_pose
from craternav_fg.vision.predicted_rims import PredictedRims, predict_rims
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from craternav_fg.vision.reflectance import photometric_law
from craternav_fg.vision.repeated_search import recentred, searched_around
from craternav_fg.vision.rim_fitting import FittedRims, RimFitter
from craternav_fg.vision.shift_search import common_shift, own_shifts
from craternav_fg.vision.sun import measure_sun_tilt
from factors.arrays import FloatArray, ImageArray, IntArray
from factors.kernels import conic

# Fewer rims cannot prove a prediction wrong: two can be wrong together.
_MIN_AGREEING_RIMS = 3
# The common shift is searched if the predicted rims may be off by more than this, or move by more than this
# relative to one another, px: the edge search alone reaches smaller errors.
_MIN_SEARCHED_SHIFT_PX, _MIN_SEARCHED_DISTORTION_PX = 1.5, 0.6
# Standard deviation of a rim's searched shift, px: the step of its grid.
_SHIFT_SIGMA_PX = 1.0
# Largest half length of the searched normals, as a share of the semi-minor axis: beyond, walls and neighbours
# are nearer than the rim.
_MAX_REACH = 0.4
# Components of an ellipse chart.
_CHART_SIZE = 5


@dataclass(frozen=True)
class _Frame:
    """An image and what is predicted of it; `prior` (6, 6) is the covariance of the body's right twist."""

    pixels: ImageArray
    brightness: ReferenceBrightness
    gTb: FloatArray
    prior: FloatArray
    sun_g: FloatArray


@dataclass(frozen=True)
class _Result:
    """Measured rims, the corrected pose and its covariance (6, 6, right twist), and the rims expected."""

    rims: RimSet
    gTb: FloatArray
    covariance: FloatArray
    expected: int


class GuidedFrontEnd:
    """Measures catalogue rims and the sun's tilt in images, guided by predicted poses.

    Parameters
    ----------
    camera : Camera
    catalog : Catalog
    options : GuidedOptions, optional
    """

    def __init__(self, camera: Camera, catalog: Catalog, options: GuidedOptions | None = None) -> None:
        self.camera = camera
        self.catalog = catalog
        self.options = options or GuidedOptions()

    def measure(
        self,
        image: GreyImage,
        stamp_ns: int,
        gTb: FloatArray,
        pose_covariance: FloatArray,
        sun_g: FloatArray,
    ) -> FrameMeasurement:
        """Measure one image.

        Parameters
        ----------
        image : ndarray of uint8 or uint16, shape (H, W)
        stamp_ns : int
            Time of exposure.
        gTb : ndarray, shape (4, 4)
            Predicted pose of the body in g.
        pose_covariance : ndarray, shape (6, 6)
            Covariance of the prediction, positive definite: attitude error (rotation vector in b, rad),
            position error in g, m.
        sun_g : ndarray, shape (3,)
            Unit vector towards the sun in g.

        Returns
        -------
        FrameMeasurement
            Its rim set is empty and its sun None when the image shows neither.
        """
        prior = rotate_position_block(pose_covariance, gTb[:3, :3].T)
        pixels = np.ascontiguousarray(on_8_bit_scale(image, self.camera), dtype=np.float32)
        brightness = ReferenceBrightness(pixels, self.camera, self.catalog.body.radius_m, gTb, sun_g)
        frame = _Frame(pixels, brightness, gTb, prior, sun_g)
        fitter = RimFitter(pixels, brightness.noise, brightness.scatter, self.camera, self.options)
        result = self._attempt(frame, fitter)
        if 2 * len(result.rims) < result.expected and result.expected >= _MIN_AGREEING_RIMS:
            # The prediction may be worse than its covariance claims; several rims must agree on that.
            lost_rad = 0.5 * self.options.max_shift_px / self.camera.focal_px
            wider = prior + np.diag([lost_rad**2] * 3 + [0.0] * 3)
            wide = self._attempt(replace(frame, prior=wider), fitter)
            if len(wide.rims) >= max(len(result.rims) + 1, _MIN_AGREEING_RIMS, wide.expected // 2):
                result = wide
        attitude_rad = 0.0 if len(result.rims) >= _MIN_AGREEING_RIMS else np.sqrt(np.max(np.diag(prior)[:3]))
        craters = self.catalog.take(result.rims.craters)
        sun = measure_sun_tilt(
            pixels, self.camera, self.catalog.body, result.gTb, sun_g, self.options.sun, attitude_rad, craters
        )
        return FrameMeasurement(stamp_ns, result.rims, sun, self._arcs(frame, fitter, result))

    def _attempt(self, frame: _Frame, fitter: RimFitter) -> _Result:
        """Measure the rims, taking the covariance of the prediction at its word."""
        opt = self.options
        rims = self._predict(frame, frame.gTb, opt.margin_px)
        if len(rims) == 0:
            return _Result(RimSet.empty(), frame.gTb, frame.prior, 0)
        motion = rims.motion_px(self.camera)
        common = motion.mean(axis=0)
        radius_px = opt.shift_sigmas * float(_largest_sigma(common[None], frame.prior)[0])
        own_px = _largest_sigma(motion - common, frame.prior)
        pose = frame.gTb
        if radius_px > _MIN_SEARCHED_SHIFT_PX or np.max(own_px) > _MIN_SEARCHED_DISTORTION_PX:
            pose = self._aligned(frame, common, min(radius_px, opt.max_shift_px))
            rims = self._predict(frame, pose, opt.margin_px)
        if radius_px + opt.shift_sigmas * np.median(own_px) > opt.second_reach_px:
            rough = fitter.fit(rims, rims.reach_px(opt.first_reach_px, opt.first_reach_share), rough=True)
            if len(rough) > 0:
                residual = rough.charts - rough.predicted.charts
                H = rough.predicted.jacobians
                covariance = rough.errors.covariance + self._of_map(rough.predicted.rows, pose)
                pose, _ = corrected_pose(frame.gTb, frame.prior, pose, H, residual, covariance)
                rims = self._predict(frame, pose, opt.margin_px)
        law = photometric_law(frame.pixels, self.camera, rims, opt.edges)
        frame = replace(frame, brightness=frame.brightness.under(law))
        rims = self._predict(frame, pose, opt.margin_px)
        fitted = self._fitted(fitter, rims, pose)
        if len(fitted) == 0:
            return _Result(RimSet.empty(), frame.gTb, frame.prior, len(rims))
        return self._judged(frame, pose, fitted, len(rims))

    def _aligned(self, frame: _Frame, common: FloatArray, radius_px: float) -> FloatArray:
        """Correct the pose (4, 4) by a common shift of the rims, moving as `common` (2, 6), and own ones.

        Rims beyond the border are searched as well: they may turn out to be in the image.
        """
        opt = self.options
        rims = self._predict(frame, frame.gTb, -radius_px)
        motion = rims.motion_px(self.camera)
        own_px = opt.shift_sigmas * _largest_sigma(motion - common, frame.prior)
        reach_px = np.minimum(own_px + _MIN_SEARCHED_SHIFT_PX, opt.max_shift_px)
        shift = common_shift(frame.pixels, rims, self.camera.lens, radius_px)
        shifts = own_shifts(frame.pixels, rims, self.camera.lens, shift, reach_px)
        seen = np.isfinite(shifts).all(axis=1)
        if not seen.any():
            return frame.gTb
        covariance = np.tile(_SHIFT_SIGMA_PX**2 * np.eye(2), (int(np.count_nonzero(seen)), 1, 1))
        return corrected_pose(frame.gTb, frame.prior, frame.gTb, motion[seen], shifts[seen], covariance)[0]

    def _judged(self, frame: _Frame, pose: FloatArray, fitted: FittedRims, expected: int) -> _Result:
        """Gate fitted rims against the prediction and against the pose that they support together."""
        rows, charts, errors = fitted.predicted.rows, fitted.charts, fitted.errors
        centres, axes = self.catalog.centres[rows], self.catalog.axes[rows]
        residual, H = charts - fitted.predicted.charts, fitted.predicted.jacobians
        of_map = self._of_map(rows, pose)
        factor = 1.0
        for scaled in (False, True):
            whole = errors.covariance + of_map
            pose, spread = corrected_pose(frame.gTb, frame.prior, pose, H, residual, whole)
            best, H, visible = conic.chart_jacobian(pose, self.camera.bTc, centres, axes)
            residual = charts - best
            common2 = squared_distance(residual, whole + H @ spread @ np.swapaxes(H, 1, 2))
            if not scaled:
                factor = variance_factor(common2, _CHART_SIZE)
                errors = errors.scaled(factor)
        first, H, seen = conic.chart_jacobian(frame.gTb, self.camera.bTc, centres, axes)
        first[~seen] = np.inf
        predicted = errors.covariance + of_map + H @ frame.prior @ np.swapaxes(H, 1, 2)
        prior2 = squared_distance(charts - first, predicted)
        limit = chdtri(_CHART_SIZE, 1.0 - self.options.gate_probability)
        keep = visible & (common2 < limit) & (prior2 < limit * variance_factor(prior2, _CHART_SIZE))
        # Of half a rim the ellipse errs two or three times as much as of more, now and then by far more. It
        # counts by its edge points where other rims are enough for a pose.
        more = keep & (fitted.quality.arc_share >= self.options.full_arc_share)
        keep = more if np.count_nonzero(more) >= _MIN_AGREEING_RIMS else keep
        rows = rows[keep]
        parts = split(
            errors.take(keep), factor, rows, pose, frame.sun_g, self.camera, self.catalog,
            self.options.correlated_errors,
        )  # fmt: skip
        covariance, *kept = parts
        rims = RimSet(rows, charts[keep], covariance, fitted.quality.take(keep), *kept)
        if not (self.catalog.errors is None or self.catalog.errors.exact):
            slopes = in_plane_slopes(rows, pose, self.camera, self.catalog)
            factors = shape_variance_factors(residual[keep], covariance, slopes)
            stated = self.catalog.errors.take(rows).variances(np.ones(len(rows))).any(axis=1)
            rims = rims.scaled(np.where(stated, factors, 1.0))
        return _Result(rims, pose, spread, expected)

    def _arcs(self, frame: _Frame, fitter: RimFitter, result: _Result) -> ArcSet:
        """Trace the rims that no ellipse was fitted to, where the pose of the others puts them."""
        opt = self.options
        # The pose of fewer rims is not confirmed.
        if len(result.rims) < _MIN_AGREEING_RIMS:
            return ArcSet.empty()
        others = np.setdiff1d(self._visible(result.gTb, -opt.arcs.margin_px), result.rims.craters)
        rims = self._predict_rows(others, frame, result.gTb)
        predicted_px = (
            _largest_sigma(rims.motion_px(self.camera), result.covariance) if len(rims) else np.empty(0)
        )
        quality = result.rims.quality
        outline = 0.0 if quality is None else float(np.median(quality.outline_share))
        found: list[int] = []
        points: list[FloatArray] = []
        sigmas: list[FloatArray] = []
        correlated: list[float] = []
        reach_px = rims.reach_px(opt.second_reach_px, opt.second_reach_share)
        scale = normalised_chart(rims.charts_px, self.camera)[1]
        of_map_px = self._of_map(rims.rows, result.gTb) / np.outer(scale, scale)
        growth = common_growth(
            result.rims, result.gTb, frame.gTb, frame.prior, self.camera, self.catalog
        ).shares(radii_px(rims.rows, result.gTb, self.camera, self.catalog))
        for i in range(len(rims)):
            edges = fitter.trace(rims, i, float(reach_px[i]))
            if len(edges) < opt.arcs.min_found_share * edges.tried:
                continue
            minor_px = rims.smallest_radius_px(i)
            edges = replace(
                edges, points_px=without_growth(edges.points_px, rims.charts_px[i, :2], growth[0][i])
            )
            parts_px = (
                arc_sigma_px(minor_px, outline, opt.correlated_errors),
                across_sigma(edges.points_px, rims.charts_px[i], of_map_px[i]),
                growth[1][i] * minor_px,
            )
            correlated_px = float(np.linalg.norm(parts_px))
            arc = judge(
                edges, rims.charts_px[i], minor_px, correlated_px, float(predicted_px[i]), opt.arcs
            )  # fmt: skip
            if arc is not None:
                found.append(i)
                points.append(self.camera.pinhole.normalised(arc[0]))
                sigmas.append(arc[1] / self.camera.focal_px)
                correlated.append(correlated_px / self.camera.focal_px)
        rows = rims.rows[np.array(found, dtype=np.int64)]
        shared = shared_of_arcs(
            rows, result.gTb, frame.sun_g, self.camera, self.catalog, opt.correlated_errors
        )
        return ArcSet(rows, tuple(points), tuple(sigmas), np.array(correlated), shared)

    def _fitted(self, fitter: RimFitter, rims: PredictedRims, gTb: FloatArray) -> FittedRims:
        """Fit rims; where the map states errors, until they do not depend on where they were searched.

        Of several edges the search favours those near the prediction. Rims would then confirm the prediction
        that found them, and the estimators be too sure of it.
        """
        opt = self.options
        fitted = self._found(fitter, rims, gTb)
        if self.catalog.errors is None:
            return fitted
        if self.catalog.errors.exact or opt.recentrings == 0:
            return recentred(fitter, fitted, self.camera, opt)
        place_px = self._place_px(fitted.predicted.rows, gTb)
        return searched_around(fitter, fitted, place_px, self.camera, opt)

    def _found(self, fitter: RimFitter, rims: PredictedRims, gTb: FloatArray) -> FittedRims:
        """Fit rims; those that are not where the map has them are searched as far as its errors allow."""
        opt = self.options
        reach_px = rims.reach_px(opt.second_reach_px, opt.second_reach_share)
        # In a descent over real ground, whose map states errors, a second search at the level of the ground
        # made poses worse: those rims are searched again around themselves instead.
        fitted = fitter.fit(rims, reach_px, rough=self.catalog.errors is not None)
        if self.catalog.errors is None or len(fitted) == len(rims):
            return fitted
        missing = ~np.isin(rims.rows, fitted.predicted.rows)
        place_px = self._place_px(rims.rows[missing], gTb)
        covariance = self._of_map(rims.rows[missing], gTb)
        minor_px = rims.smallest_radii_px()[missing]
        size_px = minor_px * np.sqrt(covariance[:, 2, 2])
        wider_px = reach_px[missing] + opt.map_error_sigmas * np.hypot(place_px, size_px)
        reach_px[missing] = np.minimum(wider_px, np.maximum(reach_px[missing], _MAX_REACH * minor_px))
        return fitter.fit(rims, reach_px, rough=True)

    def _place_px(self, rows: IntArray, gTb: FloatArray) -> FloatArray:
        """Compute the standard deviations (n,) of places on the map, px, in the direction of the largest."""
        covariance = self._of_map(rows, gTb)[:, :2, :2]
        return np.asarray(self.camera.focal_px * np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]))

    def _of_map(self, rows: IntArray, gTb: FloatArray) -> FloatArray:
        """Covariance (n, 5, 5) of charts from the catalogue's errors."""
        return map_covariance(rows, gTb, self.camera, self.catalog, self.options.correlated_errors)

    def _visible(self, gTb: FloatArray, margin_px: float) -> IntArray:
        least = self.options.min_semi_minor_px
        return self.catalog.visible(self.camera, gTb, min_semi_minor_px=least, margin_px=margin_px)[0]

    def _predict(self, frame: _Frame, gTb: FloatArray, margin_px: float) -> PredictedRims:
        """Predict the rims that are whole in the image seen from a pose, `margin_px` from its border."""
        return self._predict_rows(self._visible(gTb, margin_px), frame, gTb)

    def _predict_rows(self, rows: IntArray, frame: _Frame, gTb: FloatArray) -> PredictedRims:
        """Predict the rims of some craters, in the order of their places.

        Sums are then the same to the last bit, in whatever order the catalogue has its craters: a pose that
        differs by rounding may decide about a rim at a threshold.
        """
        at = self.catalog.latitude_rad[rows], self.catalog.longitude_rad[rows]
        rows = rows[np.lexsort(at)]
        return predict_rims(rows, self.camera, self.catalog, gTb, frame.sun_g, frame.brightness)


def _largest_sigma(motion: FloatArray, covariance: FloatArray) -> FloatArray:
    """Largest standard deviations (n,) of points that move by `motion` (n, 2, 6) with the pose."""
    return np.sqrt(np.linalg.eigvalsh(motion @ covariance @ np.swapaxes(motion, 1, 2))[:, -1])
