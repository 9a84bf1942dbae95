"""Rims of catalogue craters in an image, searched where a predicted pose puts them.

The prediction may be wrong by tens of pixels: one shift common to all rims is searched first, then the
predicted pose is corrected with the rims themselves, and only then is each rim judged by itself.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray as GreyImage
from craternav_fg.ellipse import pixel_chart, semi_minor_bound
from craternav_fg.frames import rotate_position_block
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimQuality, RimSet
from craternav_fg.photometry import level_ground
from craternav_fg.vision import crater_profile, edges
from craternav_fg.vision.arcs import judge
from craternav_fg.vision.ellipse_fit import FitFailure, FitOptions, RimFit, refine_rim
from craternav_fg.vision.error_model.correlated import correlated_roots
from craternav_fg.vision.grey import on_8_bit_scale
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.pose_correction import corrected_pose, squared_distance, variance_factor
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from craternav_fg.vision.sun import measure_sun_tilt
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ImageArray = npt.NDArray[np.float32]
# The first results of `edges.trace_rim`.
_Trace = tuple[FloatArray, FloatArray, FloatArray, int]

# Darker level ground, of 255, has no contrast to offer.
_MIN_BRIGHTNESS = 6.0
# The common shift needs no more rims than these.
_MAX_SEARCHED_RIMS = 60
_SEARCH_ANGLES_RAD: FloatArray = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False, dtype=np.float64)
# Fewer rims cannot prove a prediction wrong.
_MIN_LOST_RIMS = 3
# Outlines deviate from ellipses where they do by so many times what is expected before.
_IRREGULARITY_FACTOR = 10.0
# Steps across the rim are taken over this share of the radius to both sides.
_STEP_REACH_SHARE = 0.12


@dataclass(frozen=True)
class _Scene:
    """What is predicted of the rims of one frame: rows (n,) and quantities in pixels, without distortion."""

    rows: IntArray
    charts: FloatArray
    charts_px: FloatArray
    gain: FloatArray
    gain_px: FloatArray
    level: FloatArray
    jacobians: FloatArray
    noise: float

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, keep: IntArray) -> "_Scene":
        return _Scene(
            self.rows[keep], self.charts[keep], self.charts_px[keep], self.gain[keep], self.gain_px[keep],
            self.level[keep], self.jacobians[keep], self.noise,
        )  # fmt: skip


@dataclass(frozen=True)
class _Fitted:
    """Rims of a scene whose edges bear a fit: charts (n, 5), covariances and lasting parts as in `RimFit`."""

    scene: _Scene
    chart: FloatArray
    covariance: FloatArray
    systematic: FloatArray
    level: FloatArray
    quality: RimQuality

    def __len__(self) -> int:
        return len(self.chart)


@dataclass(frozen=True)
class _Result:
    """Measured rims, the pose they correct the prediction to, its covariance, how many rims were expected."""

    rims: RimSet
    gTb: FloatArray
    spread: FloatArray
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
        self._bias = crater_profile.crossing_table()

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
            Predicted pose of the lander.
        pose_covariance : ndarray, shape (6, 6)
            Of the prediction, positive definite: attitude error (rotation vector in b, rad), position
            error in g, m.
        sun_g : ndarray, shape (3,)
            Unit vector towards the sun in g.

        Returns
        -------
        FrameMeasurement
            Its rim set is empty, its sun None, when the image shows neither.
        """
        prior = rotate_position_block(pose_covariance, gTb[:3, :3].T)
        grey = on_8_bit_scale(image, self.camera)
        pixels = np.ascontiguousarray(grey, dtype=np.float32)
        levels = ReferenceBrightness(pixels, self.camera, self.catalog.body.radius_m, gTb, sun_g)
        result = self._attempt(pixels, gTb, prior, sun_g, levels)
        if 2 * len(result.rims) < result.expected and result.expected >= _MIN_LOST_RIMS:
            # The prediction may be worse than its covariance says; several rims must agree to that.
            lost_rad = 0.5 * self.options.max_shift_px / self.camera.focal_px
            wide = self._attempt(pixels, gTb, prior + np.diag([lost_rad**2] * 3 + [0.0] * 3), sun_g, levels)
            if len(wide.rims) >= max(len(result.rims) + 1, _MIN_LOST_RIMS, wide.expected // 2):
                result = wide
        attitude_rad = 0.0 if len(result.rims) >= _MIN_LOST_RIMS else np.sqrt(np.max(np.diag(prior)[:3]))
        craters = self.catalog.take(result.rims.craters)
        sun = measure_sun_tilt(
            grey, self.camera, self.catalog.body, result.gTb, sun_g, self.options.sun, attitude_rad, craters
        )
        arcs = self._arcs(pixels, result, sun_g, levels)
        return FrameMeasurement(stamp_ns, result.rims, sun, arcs)

    def _arcs(
        self, image: ImageArray, result: "_Result", sun_g: FloatArray, levels: ReferenceBrightness
    ) -> ArcSet:
        """Trace the rims that no ellipse was fitted to, where the pose of the others puts them."""
        opt = self.options
        # A few rims alone can be wrong together.
        if len(result.rims) < _MIN_LOST_RIMS:
            return ArcSet.empty()
        rows = np.setdiff1d(self._visible(result.gTb, -opt.arcs.margin_px), result.rims.craters)
        scene = self._predict(rows, result.gTb, sun_g, levels)
        predicted_px = _spread_px(self._motion(scene), result.spread) if len(scene) else np.empty(0)
        quality = result.rims.quality
        outline = 0.0 if quality is None else float(np.median(quality.outline_share))
        found: list[int] = []
        points: list[FloatArray] = []
        sigmas: list[FloatArray] = []
        lasting: list[float] = []
        for i in range(len(scene)):
            minor_px = _minor_px(scene, i)
            traced, ratio, _, tried = self._trace(image, scene, i, opt.second_reach)
            if len(traced) < opt.arcs.min_found_share * tried:
                continue
            lasting_px = (
                opt.correlated_errors.arc_px + np.hypot(opt.correlated_errors.arc_share, outline) * minor_px
            )
            arc = judge(
                traced,
                ratio,
                scene.charts_px[i],
                minor_px,
                float(lasting_px),
                float(predicted_px[i]),
                opt.arcs,
            )
            if arc is not None:
                found.append(i)
                points.append(self.camera.pinhole.normalised(arc[0]))
                sigmas.append(arc[1] / self.camera.focal_px)
                lasting.append(lasting_px / self.camera.focal_px)
        rows = scene.rows[np.array(found, dtype=np.int64)]
        return ArcSet(rows, tuple(points), tuple(sigmas), np.array(lasting))

    def _attempt(
        self,
        image: ImageArray,
        gTb: FloatArray,
        prior: FloatArray,
        sun_g: FloatArray,
        levels: ReferenceBrightness,
    ) -> "_Result":
        """Measure the rims, taking `prior`, the covariance of the body's right twist, at its word."""
        opt = self.options
        scene = self._predict(self._visible(gTb, opt.margin_px), gTb, sun_g, levels)
        if len(scene) == 0:
            return _Result(RimSet.empty(), gTb, prior, 0)
        motion = self._motion(scene)
        common = motion.mean(axis=0)
        radius_px = opt.shift_sigmas * float(_spread_px(common[None], prior)[0])
        own_px = _spread_px(motion - common, prior)
        pose = gTb
        if radius_px > 1.5 or np.max(own_px) > 0.6:
            pose = self._aligned(image, gTb, prior, sun_g, levels, common, min(radius_px, opt.max_shift_px))
            scene = self._predict(self._visible(pose, opt.margin_px), pose, sun_g, levels)
        if radius_px + opt.shift_sigmas * np.median(own_px) > opt.second_reach[0]:
            rough = self._fit_all(image, scene, opt.first_reach)
            if len(rough) > 0:
                residual = rough.chart - rough.scene.charts
                pose, _ = corrected_pose(gTb, prior, pose, rough.scene.jacobians, residual, rough.covariance)
                scene = self._predict(self._visible(pose, opt.margin_px), pose, sun_g, levels)
        expected = len(scene)
        fitted = self._fit_all(image, scene, opt.second_reach)
        if len(fitted) == 0:
            return _Result(RimSet.empty(), gTb, prior, expected)
        return self._judged(gTb, prior, pose, sun_g, fitted, expected)

    def _aligned(
        self,
        image: ImageArray,
        gTb: FloatArray,
        prior: FloatArray,
        sun_g: FloatArray,
        levels: ReferenceBrightness,
        common: FloatArray,
        radius_px: float,
    ) -> FloatArray:
        """Pose corrected by the rims' shifts: one of all, moving as `common` (2, 6), then each its own."""
        opt = self.options
        # Rims beyond the border may turn out to be within it.
        scene = self._predict(self._visible(gTb, -radius_px), gTb, sun_g, levels)
        motion = self._motion(scene)
        reach_px = np.minimum(opt.shift_sigmas * _spread_px(motion - common, prior) + 1.5, opt.max_shift_px)
        shift = self._common_shift(image, scene, radius_px)
        shifts = self._rim_shifts(image, scene, shift, reach_px)
        noise = np.tile(np.eye(2), (len(shifts), 1, 1))
        return corrected_pose(gTb, prior, gTb, motion, shifts, noise)[0]

    def _judged(
        self,
        gTb: FloatArray,
        prior: FloatArray,
        pose: FloatArray,
        sun_g: FloatArray,
        fitted: "_Fitted",
        expected: int,
    ) -> "_Result":
        """Gate fitted rims against the prediction and against the pose that they support together."""
        scene, chart, covariance = fitted.scene, fitted.chart, fitted.covariance
        centres, axes = self.catalog.centres[scene.rows], self.catalog.axes[scene.rows]
        residual, H = chart - scene.charts, scene.jacobians
        factor = 1.0
        for scaled in (False, True):
            pose, spread = corrected_pose(gTb, prior, pose, H, residual, covariance)
            best, H, visible = conic.chart_jacobian(pose, self.camera.bTc, centres, axes)
            residual = chart - best
            common2 = squared_distance(residual, covariance + H @ spread @ np.swapaxes(H, 1, 2))
            if not scaled:
                factor = variance_factor(common2, 5)
                covariance = covariance * factor
        first, H, seen = conic.chart_jacobian(gTb, self.camera.bTc, centres, axes)
        first[~seen] = np.inf
        prior2 = squared_distance(chart - first, covariance + H @ prior @ np.swapaxes(H, 1, 2))
        limit = chi2.ppf(self.options.gate_probability, 5)
        keep = visible & (common2 < limit) & (prior2 < limit * variance_factor(prior2, 5))
        rows, systematic = scene.rows[keep], factor * fitted.systematic[keep]
        covariance, level = covariance[keep], np.sqrt(factor) * fitted.level[keep]
        lasting = self.options.correlated_errors
        correlated, shared = correlated_roots(
            systematic, level, rows, pose, sun_g, self.camera, self.catalog, lasting
        )
        # What a crater keeps is part of it already, and the level that it shares.
        covariance = covariance + shared @ np.swapaxes(shared, 1, 2)
        covariance -= lasting.brightness_share * level[:, :, None] * level[:, None, :]
        covariance = covariance + lasting.excess_white_share * (factor - 1.0) * systematic
        quality = fitted.quality.take(keep)
        return _Result(
            RimSet(rows, chart[keep], covariance, quality, correlated, shared), pose, spread, expected
        )

    def _visible(self, gTb: FloatArray, margin_px: float) -> IntArray:
        least = self.options.min_semi_minor_px
        return self.catalog.visible(self.camera, gTb, min_semi_minor_px=least, margin_px=margin_px)[0]

    def _motion(self, scene: "_Scene") -> FloatArray:
        """Differentiate the rims' centres, px, for the body's right twist: (n, 2, 6)."""
        return np.array([[self.camera.fx_px], [self.camera.fy_px]]) * scene.jacobians[:, :2]

    def _predict(
        self, rows: IntArray, gTb: FloatArray, sun_g: FloatArray, levels: ReferenceBrightness
    ) -> "_Scene":
        """Predict rims from a pose; all of `rows` are taken to be visible."""
        centres = self.catalog.centres[rows]
        charts, H, seen = conic.chart_jacobian(gTb, self.camera.bTc, centres, self.catalog.axes[rows])
        rows, centres, charts, H = rows[seen], centres[seen], charts[seen], H[seen]
        gTc = self.camera.gTc(gTb)
        view = gTc[:3, 3] - centres
        view /= np.linalg.norm(view, axis=-1, keepdims=True)
        brightness, gain = level_ground(self.catalog.normals[rows], sun_g, view)
        centres_c = (centres - gTc[:3, 3]) @ gTc[:3, :3]
        points = centres_c[:, :2] / centres_c[:, 2:]
        gain_c = gain @ gTc[:3, :3]
        radius_m = np.sqrt(self.catalog.semi_major_m[rows] * self.catalog.semi_minor_m[rows])
        gain_px = (gain_c[:, :2] - points * gain_c[:, 2:]) * (radius_m / centres_c[:, 2])[:, None]
        gain_px *= [self.camera.fx_px, self.camera.fy_px]
        level = brightness * levels.ratio(points)
        lit = level > _MIN_BRIGHTNESS
        return _Scene(
            rows[lit], charts[lit], pixel_chart(charts[lit], self.camera), np.linalg.norm(gain[lit], axis=-1),
            np.ascontiguousarray(gain_px[lit]), level[lit], H[lit], levels.noise,
        )  # fmt: skip

    def _common_shift(self, image: ImageArray, scene: "_Scene", radius_px: float) -> FloatArray:
        """One shift (2,) of all rims, px: coarse to fine on sun-signed brightness steps."""
        minor = semi_minor_bound(scene.charts_px)
        order = np.argsort(-minor * np.linalg.norm(scene.gain_px, axis=-1), kind="stable")[
            :_MAX_SEARCHED_RIMS
        ]
        start = np.zeros(2)
        radius = radius_px
        for factor in (4, 2, 1):
            if factor > 1 and radius_px < 4.0 * factor:
                continue
            small = image
            if factor > 1:
                size = (image.shape[1] // factor, image.shape[0] // factor)
                whole = image[: size[1] * factor, : size[0] * factor]
                small = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
            charts = scene.charts_px[order].copy()
            charts[:, :2] = (charts[:, :2] + 0.5) / factor - 0.5
            charts[:, 2] -= np.log(factor)
            charts[:, 4] -= np.log(factor)
            lens = self.camera.lens.copy()
            lens[:2] /= factor
            lens[2:4] = (lens[2:4] + 0.5) / factor - 0.5
            best, _ = edges.search_shift(
                small, charts, scene.gain_px[order] / factor, scene.level[order], _SEARCH_ANGLES_RAD,
                start / factor, radius / factor, 1.0, _STEP_REACH_SHARE, 1.0, lens,
            )  # fmt: skip
            start = best * factor
            radius = 1.5 * factor
        return start

    def _rim_shifts(
        self, image: ImageArray, scene: "_Scene", shift: FloatArray, reach_px: FloatArray
    ) -> FloatArray:
        """Shift (n, 2) of each rim, px, about the common one."""
        out = np.empty((len(scene.rows), 2))
        for i in range(len(out)):
            one = slice(i, i + 1)
            half = float(semi_minor_bound(scene.charts_px[i])) / 2.0
            reach = min(reach_px[i], half)
            step = max(0.5, reach / 8.0)
            out[i], _ = edges.search_shift(
                image, scene.charts_px[one], scene.gain_px[one], scene.level[one], _SEARCH_ANGLES_RAD, shift,
                reach, step, _STEP_REACH_SHARE, 1.0, self.camera.lens,
            )  # fmt: skip
        return out

    def _trace(self, image: ImageArray, scene: "_Scene", i: int, reach: tuple[float, float]) -> _Trace:
        """Trace one rim of a scene."""
        opt = self.options
        minor_px = _minor_px(scene, i)
        return edges.trace_rim(
            image, scene.charts_px[i], scene.gain_px[i], scene.level[i], reach[0] + reach[1] * minor_px,
            opt.smooth_share, opt.smooth_px, self.camera.psf_sigma_px, opt.min_slope_contrast, opt.min_step,
            opt.step_sigmas * np.sqrt(2.0) * scene.noise / scene.level[i], _normals(minor_px), self._bias,
            crater_profile.BLUR_RADII, crater_profile.SLOPE_CONTRASTS, self.camera.lens,
        )[:4]  # fmt: skip

    def _fit(self, scene: "_Scene", i: int, trace: _Trace, options: FitOptions) -> RimFit | FitFailure:
        """Fit one rim of a scene to what `_trace` gave."""
        opt = self.options
        slope = opt.brightness_slope_per_px * _minor_px(scene, i)
        return refine_rim(
            trace[0], scene.charts_px[i], self.camera, options, trace[1], trace[2], opt.brightness_sigma,
            slope, scene.gain_px[i],
        )  # fmt: skip

    def _fit_all(self, image: ImageArray, scene: "_Scene", reach: tuple[float, float]) -> "_Fitted":
        """Fit those rims of a scene whose edges bear it."""
        opt = self.options
        found: list[int] = []
        fits: list[RimFit] = []
        traces: list[_Trace] = []
        for i in range(len(scene)):
            minor_px = _minor_px(scene, i)
            trace = self._trace(image, scene, i, reach)
            if trace[3] < 0.4 * _normals(minor_px) or len(trace[0]) < opt.min_found_share * trace[3]:
                continue
            fit = self._fit(scene, i, trace, opt.fit)
            if isinstance(fit, FitFailure) or fit.rms_px > opt.max_rms_px + opt.max_rms_share * minor_px:
                continue
            found.append(i)
            fits.append(fit)
            traces.append(trace)
        # One rim's points tell its outline's deviation poorly, and what seems an ellipse by chance is given
        # too much weight; the frame's other rims tell better.
        shares = np.array([fit.outline_share for fit in fits])
        if len(fits) and np.median(shares) > _IRREGULARITY_FACTOR * opt.fit.outline_share:
            usual2 = np.mean(shares**2)
            for k, i in enumerate(found):
                missing = np.sqrt(max(usual2 - shares[k] ** 2, 0.0))
                if missing > 0.0:
                    again = self._fit(scene, i, traces[k], replace(opt.fit, outline_share=float(missing)))
                    fits[k] = again if isinstance(again, RimFit) else fits[k]
        rows = np.array(found, dtype=np.int64)
        quality = RimQuality(
            scene.gain[rows],
            np.array([f.point_count for f in fits]) / np.array([trace[3] for trace in traces]),
            np.array([f.arc_share for f in fits]),
            np.array([f.rms_px for f in fits]),
            np.array([f.outline_share for f in fits]),
        )
        return _Fitted(
            scene.take(rows),
            np.array([f.chart for f in fits]).reshape(-1, 5),
            np.array([f.covariance for f in fits]).reshape(-1, 5, 5),
            np.array([f.systematic for f in fits]).reshape(-1, 5, 5),
            np.array([f.level for f in fits]).reshape(-1, 5),
            quality,
        )


def _minor_px(scene: _Scene, i: int) -> float:
    """Give the semi-minor axis of a rim, about."""
    return float(semi_minor_bound(scene.charts_px[i]))


def _normals(minor_px: float) -> int:
    """Give the number of normals about a rim."""
    return int(np.clip(2.0 * minor_px, 56, 160))


def _spread_px(motion: FloatArray, covariance: FloatArray) -> FloatArray:
    """Largest standard deviation (n,) of points that move by `motion` (n, 2, 6) with the pose."""
    return np.sqrt(np.linalg.eigvalsh(motion @ covariance @ np.swapaxes(motion, 1, 2))[:, -1])
