"""Blind detection: crater rims in an image without a pose, a catalogue or a camera model.

Candidates that look like a lit bowl (see `candidates`) vote for the direction towards the sun; in noise they
do not agree. Candidates lit from that direction are traced and fitted as if they had been predicted as
circles (see `edges` and `ellipse_fit`). The fit, the correlation and the number of edge points give each rim
a quality.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import axes_of_chart, mean_radius, points_on, semi_minor, whitened_points
from craternav_fg.errors import EstimationError
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import (
    Candidates,
    common_sun_angle,
    distinct,
    find_candidates,
    illuminated_from,
    local_sun_angles,
)
from craternav_fg.vision.edges import EdgeOptions, find_edge_points
from craternav_fg.vision.ellipse_fit import BrightnessUnknown, FitFailure, FitOptions, RimFit, refine_rim
from craternav_fg.vision.image_sampling import noise_level
from craternav_fg.vision.reference_brightness import MIN_REFERENCE_BRIGHTNESS

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]

# Fewer candidates may agree on a direction towards the sun by chance.
_MIN_VOTERS = 12
# Share of the votes for the most common direction on images without craters, the margin above it, over the
# root of the number of votes, that shows craters, and the margin that contradicts a given direction. On
# cratered ground the share is over a half.
SUN_VOTE_CHANCE_SHARE = 0.22
SUN_VOTE_MARGIN = 1.0
SUN_VOTE_CONTRADICTION_MARGIN = 2.0
# Largest difference, rad, of a given direction from the voted one that is no contradiction.
_MAX_SUN_ERROR_RAD = float(np.deg2rad(45.0))
# Standard deviation, in the image's longer sides, of the neighbourhood that shares a direction towards the
# sun.
_SUN_REACH_SHARE = 0.25
# Slope contrast of rendered craters over that of the canonical crater that correlates best with them.
CONTRAST_FACTOR = 1.3
# Candidates, the best ones, whose median gives the slope contrast of the image.
_CONTRAST_CANDIDATES = 20
# Rings of flat terrain around a crater, in radii, and the points on each.
_GROUND_RING_RADII = np.array([1.5, 1.75, 2.0])[:, None, None]
_RING_POINTS = 32
# Half lengths of the normals along which a rim is traced, first and second: px, share of the radius.
_NORMAL_REACHES = ((2.0, 0.35), (1.5, 0.14))
# Relative standard deviation of the reference brightness of a rim.
_BRIGHTNESS_SIGMA = 0.05
# Least share of the normals that have contrast and lie in the image, and of these that have an edge.
_MIN_TRIED_SHARE, _MIN_FOUND_SHARE = 0.3, 0.35
# Least semi-minor axis and largest shift of a rim, in radii of its candidate: another crater's rim beyond.
_MIN_MINOR_RADII, _MAX_SHIFT_RADII = 0.5, 0.6
# Two rims are the same crater if their centres are closer than this share of the smaller mean radius and the
# logarithms of their mean radii differ by less.
_SAME_CENTRE_SHARE, _SAME_LOG_RADIUS = 0.5, 0.4
# Logistic regression of correct and wrong fits on rendered ground (smooth, irregular and textured), on rough
# ground without craters and on noise: weights of the correlation, the share of normals that agree, the
# scatter in radii and the share of the rim that is covered; and the constant.
QUALITY_WEIGHTS, QUALITY_OFFSET = np.array([32.0, 6.5, -50.0, 6.9]), -30.4
# Least scatter in the regression, in radii: rendered rims are smoother than real ones.
QUALITY_MIN_SCATTER_RADII = 0.02


@dataclass(frozen=True)
class BlindOptions:
    """What is accepted as a crater.

    Attributes
    ----------
    min_radius_px : float
        Radius of the smallest craters searched, at least 4; rims below 10 are found less reliably.
    max_radius_share : float
        Radius of the largest craters, as a share of the image's shorter side.
    min_correlation : float
        Least correlation with the canonical crater.
    max_candidates : int
        Largest number of candidates that are traced, best first.
    max_sun_deviation_rad : float
        Candidates lit from farther than this from the common direction are rejected.
    psf_px : float
        Standard deviation of the point-spread function: its effect on the edge is removed.
    min_quality : float
        Least quality of a rim when enough candidates agree on the direction towards the sun.
    min_quality_sun_unknown : float
        The same when there are too few candidates to agree.
    fit : FitOptions
        Of the ellipse fit, with the systematic floor.

    Raises
    ------
    ValueError
        When `min_radius_px` is below 4.
    """

    min_radius_px: float = 8.0
    max_radius_share: float = 0.45
    min_correlation: float = 0.6
    max_candidates: int = 1000
    max_sun_deviation_rad: float = float(np.deg2rad(40.0))
    psf_px: float = 0.7
    min_quality: float = 0.5
    min_quality_sun_unknown: float = 0.95
    fit: FitOptions = field(default_factory=lambda: FitOptions(floor_px=0.05, outline_share=0.003))

    def __post_init__(self) -> None:
        if not self.min_radius_px >= 4.0:
            raise ValueError(f"expected min_radius_px of at least 4, found {self.min_radius_px}")


@dataclass(frozen=True)
class FittedCandidate:
    """The rim of a candidate, and what shows whether it is a crater's.

    Attributes
    ----------
    fit : RimFit
    evidence : ndarray, shape (4,)
        Correlation with the canonical crater, share of the normals that agree, scatter in radii, share of the
        rim that is covered.
    sun_angle_rad : float
        Direction towards the sun in the image at the rim, from x towards y.
    """

    fit: RimFit
    evidence: FloatArray
    sun_angle_rad: float

    @property
    def quality(self) -> float:
        """Approximate probability, on rendered ground, that it is a crater's rim."""
        return float(1.0 / (1.0 + np.exp(-(QUALITY_WEIGHTS @ self.evidence + QUALITY_OFFSET))))


@dataclass(frozen=True)
class FoundRims:
    """Rims found in an image, best first.

    Attributes
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre x, y, semi-major and semi-minor axis, px, rotation of the major axis from x to y, rad, in
        (-pi/2, pi/2]. The middle of the first pixel is (0, 0).
    charts_px : ndarray, shape (n, 5)
        The same as ellipse charts in pixels.
    covariance_px : ndarray, shape (n, 5, 5)
        Of the charts.
    quality : ndarray, shape (n,)
        0 to 1: approximate probability, on rendered ground, that it is a crater's rim.
    local_sun_angles_rad : ndarray, shape (n,)
        Direction towards the sun in the image at each rim, from x towards y, as its shading and its
        neighbours' show it.
    sun_angle_rad : float
        The same of the whole image, found or given; NaN when the image does not show it.
    """

    ellipses_px: FloatArray
    charts_px: FloatArray
    covariance_px: FloatArray
    quality: FloatArray
    local_sun_angles_rad: FloatArray
    sun_angle_rad: float

    def __len__(self) -> int:
        return len(self.ellipses_px)


def find_rims(
    image: npt.NDArray[np.generic], sun_angle_rad: float | None = None, options: BlindOptions | None = None
) -> FoundRims:
    """Find crater rims.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        See `brightness.brightness`.
    sun_angle_rad : float, optional
        Direction towards the sun in the image, from x towards y; found in the image if not given.
    options : BlindOptions, optional

    Returns
    -------
    FoundRims
        Possibly none.

    Raises
    ------
    ValueError
        When the array is no image.
    EstimationError
        When the image's craters are clearly lit from elsewhere than `sun_angle_rad`, and have better rims
        under that direction.
    """
    options = options or BlindOptions()
    everywhere, pixels = filled(brightness(image))
    candidates = candidates_in(everywhere, options)
    if len(candidates) == 0:
        return gather([], [], [], sun_angle_rad if sun_angle_rad is not None else float("nan"))
    noise = noise_level(everywhere) if min(pixels.shape) > 2 else 0.0
    try:
        agreed, certain = agreed_sun_angle(candidates, sun_angle_rad)
    except EstimationError:
        # Candidates are no rims yet: those in one large shadow agree, too, and have none.
        assert sun_angle_rad is not None
        given = _rims_lit_from(pixels, candidates, float(sun_angle_rad), False, noise, options)
        other = _rims_lit_from(pixels, candidates, common_sun_angle(candidates)[0], True, noise, options)
        if given.quality.sum() < other.quality.sum():
            raise
        return given
    if not certain and len(candidates) >= _MIN_VOTERS:
        candidates = candidates.take(np.zeros(0, dtype=np.int64))
    return _rims_lit_from(pixels, candidates, agreed, certain, noise, options)


def candidates_in(image: ImageArray, options: BlindOptions) -> Candidates:
    """Find the distinct crater candidates of an image.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    options : BlindOptions

    Returns
    -------
    Candidates
        Possibly none.
    """
    largest = options.max_radius_share * min(image.shape)
    found = find_candidates(image, options.min_radius_px, largest, options.min_correlation)
    return distinct(found, options.max_candidates)


def _rims_lit_from(
    pixels: ImageArray,
    candidates: Candidates,
    sun_angle_rad: float,
    certain: bool,
    noise: float,
    options: BlindOptions,
) -> FoundRims:
    """Fit the rims of those candidates that seem to be lit from about a direction."""
    least = options.min_quality if certain else max(options.min_quality_sun_unknown, options.min_quality)
    fitted = fit_candidates(pixels, candidates, sun_angle_rad, noise, options)
    good = [rim for rim in fitted if rim.quality >= least]
    quality, at_rims = [rim.quality for rim in good], [rim.sun_angle_rad for rim in good]
    return gather([rim.fit for rim in good], quality, at_rims, sun_angle_rad)


def fit_candidates(
    pixels: ImageArray, candidates: Candidates, sun_angle_rad: float, noise: float, options: BlindOptions
) -> list[FittedCandidate]:
    """Fit the rims of the candidates that seem to be lit from about a direction, whatever their quality.

    Parameters
    ----------
    pixels : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    candidates : Candidates
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.
    noise : float
        Standard deviation of the pixels' noise, see `image_sampling.noise_level`.
    options : BlindOptions

    Returns
    -------
    list of FittedCandidate
        Of the candidates that have a rim.
    """
    candidates = candidates.take(illuminated_from(candidates, sun_angle_rad, options.max_sun_deviation_rad))
    if len(candidates) == 0:
        return []
    sun_angles = local_sun_angles(candidates, _SUN_REACH_SHARE * max(pixels.shape))
    contrast = CONTRAST_FACTOR * float(np.median(candidates.slope_contrast[:_CONTRAST_CANDIDATES]))
    height, width = pixels.shape
    camera = Camera(width, height, 1.0, 1.0, 0.0, 0.0, psf_sigma_px=options.psf_px)
    every = (
        _fit_candidate(pixels, candidates, k, float(sun_angles[k]), contrast, noise, camera, options)
        for k in range(len(candidates))
    )
    return [rim for rim in every if rim is not None]


def agreed_sun_angle(candidates: Candidates, sun_angle_rad: float | None) -> tuple[float, bool]:
    """Find the direction towards the sun, and whether the candidates show one.

    Parameters
    ----------
    candidates : Candidates
        At least one.
    sun_angle_rad : float, optional
        What is known of the direction, in the image, from x towards y.

    Returns
    -------
    sun_angle_rad : float
        The given direction, or else the most common one.
    certain : bool
        Whether enough candidates agree on it.

    Raises
    ------
    EstimationError
        When many candidates agree on another direction than `sun_angle_rad`.
    """
    common, share = common_sun_angle(candidates)
    enough = len(candidates) >= _MIN_VOTERS
    excess = (share - SUN_VOTE_CHANCE_SHARE) * np.sqrt(len(candidates))
    certain = bool(enough and excess > SUN_VOTE_MARGIN)
    if sun_angle_rad is None:
        return common, certain
    off = abs(float(np.angle(np.exp(1j * (common - sun_angle_rad)))))
    if off < _MAX_SUN_ERROR_RAD:
        return float(sun_angle_rad), certain
    if certain and excess > SUN_VOTE_CONTRADICTION_MARGIN:
        seen, given = (float(np.rad2deg(a)) % 360.0 for a in (common, sun_angle_rad))
        raise EstimationError(
            f"the sun is given at {given:.0f} deg in the image, but the craters are lit from {seen:.0f} deg"
        )
    return float(sun_angle_rad), False


def gather(
    fits: list[RimFit], quality: list[float], local_sun_angles_rad: list[float], sun_angle_rad: float
) -> FoundRims:
    """Put rims together, best first, without those that are a better one again.

    Parameters
    ----------
    fits : list of RimFit
    quality, local_sun_angles_rad : list of float
        Of each rim, see `FoundRims`.
    sun_angle_rad : float
        Of the image.
    """
    order = np.argsort(-np.array(quality), kind="stable")
    charts = np.array([fits[i].chart_px for i in order]).reshape(-1, 5)
    ellipses = axes_of_chart(charts)
    size = np.sqrt(ellipses[:, 2] * ellipses[:, 3])
    kept: list[int] = []
    for i in range(len(charts)):
        distance = np.hypot(*(ellipses[kept, :2] - ellipses[i, :2]).T)
        apart = distance > _SAME_CENTRE_SHARE * np.minimum(size[kept], size[i])
        unlike = np.abs(np.log(size[kept] / size[i])) > _SAME_LOG_RADIUS
        if np.all(apart | unlike):
            kept.append(i)
    rows = [int(order[i]) for i in kept]
    covariance = np.array([fits[i].covariance for i in rows]).reshape(-1, 5, 5)
    of_rims = np.array([quality, local_sun_angles_rad]).reshape(2, -1)[:, rows]
    return FoundRims(ellipses[kept], charts[kept], covariance, of_rims[0], of_rims[1], sun_angle_rad)


def _fit_candidate(
    image: ImageArray,
    candidates: Candidates,
    k: int,
    sun_angle_rad: float,
    contrast: float,
    noise: float,
    camera: Camera,
    options: BlindOptions,
) -> FittedCandidate | None:
    """Fit the rim of a candidate, from a circle; None when there is no rim."""
    radius = float(candidates.radius_px[k])
    chart = np.array([*candidates.xy_px[k], np.log(radius), 0.0, np.log(radius)])
    direction = np.array([np.cos(sun_angle_rad), np.sin(sun_angle_rad)])
    fit: RimFit | FitFailure = FitFailure.NO_ELLIPSE
    as_ellipse = replace(options.fit, outline_share=0.0)
    for reach_px, reach_share in _NORMAL_REACHES:
        size = float(mean_radius(chart))
        reference = ring_brightness(image, chart)
        if not reference > MIN_REFERENCE_BRIGHTNESS:
            return None
        # The crater's radius towards the sun, in the image.
        contrast_px = contrast / np.hypot(*whitened_points(chart[:2] + direction, chart)) * direction
        edges = find_edge_points(
            image, camera, chart, contrast_px, reference, size, reach_px + reach_share * size, noise,
            EdgeOptions(),
        )  # fmt: skip
        if edges.tried < _MIN_TRIED_SHARE * edges.normals or len(edges) < _MIN_FOUND_SHARE * edges.tried:
            return None
        brightness_unknown = BrightnessUnknown(edges.motion, _BRIGHTNESS_SIGMA)
        fit = refine_rim(edges.points_px, chart, camera, as_ellipse, edges.sigma_ratio, brightness_unknown)
        if isinstance(fit, FitFailure):
            return None
        chart = fit.chart_px
    assert isinstance(fit, RimFit)
    # The quality is that of an ellipse: an irregular outline would explain other edges away.
    outlined = refine_rim(edges.points_px, chart, camera, options.fit, edges.sigma_ratio, brightness_unknown)
    if isinstance(outlined, FitFailure):
        return None
    minor = float(semi_minor(chart))
    moved = float(np.hypot(*(chart[:2] - candidates.xy_px[k])))
    if minor < _MIN_MINOR_RADII * radius or moved > _MAX_SHIFT_RADII * radius:
        return None
    scatter = max(fit.rms_px / minor, QUALITY_MIN_SCATTER_RADII)
    agreeing = fit.point_count / edges.tried
    evidence = np.array([candidates.correlation[k], agreeing, scatter, fit.arc_share])
    return FittedCandidate(outlined, evidence, sun_angle_rad)


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
    centre = chart_px[:2]
    rings = centre + _GROUND_RING_RADII * (points_on(chart_px, _RING_POINTS) - centre)
    columns, rows = np.rint(rings).astype(np.int64).reshape(-1, 2).T
    inside = (columns >= 0) & (rows >= 0) & (columns < image.shape[1]) & (rows < image.shape[0])
    values = image[rows[inside], columns[inside]]
    values = np.sort(values[np.isfinite(values)])
    return float(values[len(values) // 2]) if len(values) > 0 else 0.0
