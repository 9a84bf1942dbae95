"""Crater rims in an image of which nothing is known: no pose, no catalogue, no camera.

Candidates that look like a lit bowl (see `places`) agree on where the light comes from, which tells a
cratered image from noise. Those that agree are traced and fitted as if they had been predicted (see
`edges` and `ellipse_fit`), from circles, and judged by what the fit says of them.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import axes_of_chart, mean_radius, points_on, semi_minor, whiten_kernel
from craternav_fg.errors import EstimationError
from craternav_fg.vision import crater_profile, edges
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import (
    Candidates,
    common_sun_angle,
    distinct,
    find_candidates,
    illuminated_from,
    local_sun_angles,
)
from craternav_fg.vision.ellipse_fit import FitFailure, FitOptions, RimFit, refine_rim

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]


@dataclass(frozen=True)
class BlindOptions:
    """What is taken for a crater.

    Attributes
    ----------
    min_radius_px : float
        Radius of the smallest craters searched, at least 4; below 10 rims are found less surely.
    max_radius_share : float
        Radius of the largest, as a share of the image's shorter side.
    min_correlation : float
        Least correlation with the canonical crater.
    max_candidates : int
        Of more places that look like craters the best are looked at.
    max_sun_deviation_rad : float
        A place lit from further away than this from the common direction is none.
    psf_px : float
        Standard deviation of the point-spread function: its effect on the edge is removed.
    min_quality : float
        Least quality of a rim when enough places agree on the light.
    min_quality_sun_unknown : float
        The same when there are too few places to agree on anything.
    fit : FitOptions
        Of the ellipse fit, with the systematic floor.
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
        0 to 1: how surely each is a crater's rim, about its probability on rendered ground.
    local_sun_angles_rad : ndarray, shape (n,)
        Direction in the image, from x towards y, from which the light comes at each, as its walls and its
        neighbours' show.
    sun_angle_rad : float
        The same of the whole image, found or given; NaN when the image leaves it open.
    """

    ellipses_px: FloatArray
    charts_px: FloatArray
    covariance_px: FloatArray
    quality: FloatArray
    local_sun_angles_rad: FloatArray
    sun_angle_rad: float

    def __len__(self) -> int:
        return len(self.ellipses_px)


# Fewer places cannot tell a common light from chance.
_MIN_VOTERS = 12
# Share of the votes for the common light: over a half on cratered ground, this by chance, and so much more
# over the root of their number; to contradict what is known of the light it must be surer.
SUN_VOTE_CHANCE_SHARE, SUN_VOTE_MARGIN, SUN_VOTE_CONTRADICTION_MARGIN = 0.22, 1.0, 2.0
# The light is taken to be the same over this share of the image.
_SUN_REACH_SHARE = 0.25
# The rendered craters' gain is this much above that of the canonical crater that looks like them.
CONTRAST_FACTOR = 1.3
# The best places tell the gain.
_CONTRAST_CANDIDATES = 20
# Darker level ground, of 255, has no contrast to offer.
_MIN_BRIGHTNESS = 6.0
# Level ground around a crater: rings of these radii.
_GROUND_RING_RADII = np.array([1.5, 1.75, 2.0])[:, None, None]
_RING_POINTS = 32
# Half length of the normals along which a rim is traced, one after the other: pixels, share of the radius.
_NORMAL_REACHES = ((2.0, 0.35), (1.5, 0.14))
# Smoothing along the normals: share of the radius, pixels.
_SMOOTHING = (0.02, 0.4)
# Least gain of a searched normal; least step of an edge for a gain of 1, and in standard deviations of noise.
_MIN_SLOPE_CONTRAST, _MIN_STEP, _STEP_SIGMAS = 0.12, 0.02, 3.0
# Relative standard deviation of the level ground's brightness.
_BRIGHTNESS_SIGMA = 0.05
# Least share of the normals inside the image and with gain, and of those with an edge.
_MIN_TRIED_SHARE, _MIN_FOUND_SHARE = 0.3, 0.35
# Rim further from its place than this share of the radius is another's.
_MAX_SHIFT_RADII = 0.6
# Logistic regression of right and wrong fits on rendered ground (smooth, irregular and textured), on rough
# ground without craters and on noise: weights of correlation, share of the normals that agree, scatter in
# radii, share of the rim covered.
QUALITY_WEIGHTS, QUALITY_OFFSET = np.array([32.0, 6.5, -50.0, 6.9]), -30.4
# Smoother rims are no better, real ones are rough.
QUALITY_MIN_SCATTER_RADII = 0.02


def find_rims(
    image: npt.NDArray[np.generic], sun_angle_rad: float | None = None, options: BlindOptions | None = None
) -> FoundRims:
    """Find crater rims.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        See `brightness`.
    sun_angle_rad : float, optional
        Direction in the image, from x towards y, from which the light comes; found in the image if not
        given.
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
        When the image's craters are clearly lit from elsewhere than `sun_angle_rad`, and have the better rims
        under that light.
    """
    options = options or BlindOptions()
    everywhere, pixels = filled(brightness(image))
    largest = options.max_radius_share * min(pixels.shape)
    places = find_candidates(everywhere, options.min_radius_px, largest, options.min_correlation)
    places = distinct(places, options.max_candidates)
    if len(places) == 0:
        return gather([], [], [], sun_angle_rad if sun_angle_rad is not None else float("nan"))
    noise = edges.noise_level(everywhere) if min(pixels.shape) > 2 else 0.0
    try:
        light, certain = agreed_sun_angle(places, sun_angle_rad)
    except EstimationError:
        # Candidates are no rims yet: those within one large shadow agree, too, and have none.
        assert sun_angle_rad is not None
        given = _found(pixels, places, float(sun_angle_rad), False, noise, options)
        other = _found(pixels, places, common_sun_angle(places)[0], True, noise, options)
        if given.quality.sum() < other.quality.sum():
            raise
        return given
    if not certain and len(places) >= _MIN_VOTERS:
        places = places.take(np.zeros(0, dtype=np.int64))
    return _found(pixels, places, light, certain, noise, options)


def _found(
    pixels: ImageArray,
    places: Candidates,
    sun_angle_rad: float,
    certain: bool,
    noise: float,
    options: BlindOptions,
) -> FoundRims:
    """Rims at those places that seem to be lit from about a direction."""
    least = options.min_quality if certain else max(options.min_quality_sun_unknown, options.min_quality)
    places = places.take(illuminated_from(places, sun_angle_rad, options.max_sun_deviation_rad))
    if len(places) == 0:
        return gather([], [], [], sun_angle_rad)
    lights = local_sun_angles(places, _SUN_REACH_SHARE * max(pixels.shape))
    gain = CONTRAST_FACTOR * float(np.median(places.gain[:_CONTRAST_CANDIDATES]))
    camera = Camera(pixels.shape[1], pixels.shape[0], 1.0, 1.0, 0.0, 0.0)
    fits: list[RimFit] = []
    quality: list[float] = []
    at_rims: list[float] = []
    for k in range(len(places)):
        fit = _trace(pixels, places, k, float(lights[k]), gain, noise, camera, options)
        if fit is not None and fit[1] >= least:
            fits.append(fit[0])
            quality.append(fit[1])
            at_rims.append(float(lights[k]))
    return gather(fits, quality, at_rims, sun_angle_rad)


def agreed_sun_angle(places: Candidates, sun_angle_rad: float | None) -> tuple[float, bool]:
    """Direction of the light, rad, and whether the places show one.

    Parameters
    ----------
    places : Candidates
        At least one.
    sun_angle_rad : float, optional
        What is known of it.

    Raises
    ------
    EstimationError
        When many places agree on another direction than `sun_angle_rad`.
    """
    common, share = common_sun_angle(places)
    enough = len(places) >= _MIN_VOTERS
    excess = (share - SUN_VOTE_CHANCE_SHARE) * np.sqrt(len(places))
    certain = bool(enough and excess > SUN_VOTE_MARGIN)
    if sun_angle_rad is None:
        return common, certain
    off = abs(float(np.angle(np.exp(1j * (common - sun_angle_rad)))))
    if off < np.deg2rad(45.0):
        return float(sun_angle_rad), certain
    if certain and excess > SUN_VOTE_CONTRADICTION_MARGIN:
        seen, given = (float(np.rad2deg(a)) % 360.0 for a in (common, sun_angle_rad))
        raise EstimationError(
            f"the light is said to come from {given:.0f} deg, the craters are lit from {seen:.0f} deg"
        )
    return float(sun_angle_rad), False


def gather(
    fits: list[RimFit], quality: list[float], local_sun_angles_rad: list[float], sun_angle_rad: float
) -> FoundRims:
    """Put rims together, best first, those left out that are a better one's again."""
    order = np.argsort(-np.array(quality), kind="stable")
    charts = np.array([fits[i].chart_px for i in order]).reshape(-1, 5)
    ellipses = axes_of_chart(charts)
    size = np.sqrt(ellipses[:, 2] * ellipses[:, 3])
    kept: list[int] = []
    for i in range(len(charts)):
        apart = np.hypot(*(ellipses[kept, :2] - ellipses[i, :2]).T) > 0.5 * np.minimum(size[kept], size[i])
        unlike = np.abs(np.log(size[kept] / size[i])) > 0.4
        if np.all(apart | unlike):
            kept.append(i)
    rows = [int(order[i]) for i in kept]
    covariance = np.array([fits[i].covariance for i in rows]).reshape(-1, 5, 5)
    of_rims = np.array([quality, local_sun_angles_rad]).reshape(2, -1)[:, rows]
    return FoundRims(ellipses[kept], charts[kept], covariance, of_rims[0], of_rims[1], sun_angle_rad)


def _trace(
    image: ImageArray,
    places: Candidates,
    k: int,
    sun_angle_rad: float,
    gain: float,
    noise: float,
    camera: Camera,
    options: BlindOptions,
) -> tuple[RimFit, float] | None:
    """Fit the rim at a place, from a circle, and its quality; None when there is none."""
    radius = float(places.radius_px[k])
    chart = np.array([*places.xy_px[k], np.log(radius), 0.0, np.log(radius)])
    direction = np.array([np.cos(sun_angle_rad), np.sin(sun_angle_rad)])
    fit: RimFit | FitFailure = FitFailure.NO_ELLIPSE
    tried = 0
    ellipse = replace(options.fit, outline_share=0.0)
    for reach_px, reach_share in _NORMAL_REACHES:
        size = float(mean_radius(chart))
        level = ring_level(image, chart)
        if not level > _MIN_BRIGHTNESS:
            return None
        # The crater's radius towards the light, in the image.
        u, v = whiten_kernel(*(chart[:2] + direction), *chart)
        count = int(np.clip(2.0 * size, 56, 160))
        points, ratio, lever, tried, _ = edges.trace_rim(
            image, chart, gain / float(np.hypot(u, v)) * direction, level, reach_px + reach_share * size,
            *_SMOOTHING, options.psf_px, _MIN_SLOPE_CONTRAST, _MIN_STEP,
            _STEP_SIGMAS * np.sqrt(2.0) * noise / level, count, crater_profile.crossing_table(),
            crater_profile.BLUR_RADII, crater_profile.SLOPE_CONTRASTS, camera.lens,
        )  # fmt: skip
        if tried < _MIN_TRIED_SHARE * count or len(points) < _MIN_FOUND_SHARE * tried:
            return None
        fit = refine_rim(points, chart, camera, ellipse, ratio, lever, _BRIGHTNESS_SIGMA)
        if isinstance(fit, FitFailure):
            return None
        chart = fit.chart_px
    assert isinstance(fit, RimFit)
    # The quality is that of an ellipse, the outline would explain other edges away.
    outlined = refine_rim(points, chart, camera, options.fit, ratio, lever, _BRIGHTNESS_SIGMA)
    if isinstance(outlined, FitFailure):
        return None
    minor = float(semi_minor(chart))
    moved = float(np.hypot(*(chart[:2] - places.xy_px[k])))
    if minor < 0.5 * radius or moved > _MAX_SHIFT_RADII * radius:
        return None
    scatter = max(fit.rms_px / minor, QUALITY_MIN_SCATTER_RADII)
    evidence = np.array([places.correlation[k], fit.point_count / tried, scatter, fit.arc_share])
    return outlined, float(1.0 / (1.0 + np.exp(-(QUALITY_WEIGHTS @ evidence + QUALITY_OFFSET))))


def ring_level(image: ImageArray, chart_px: FloatArray) -> float:
    """Brightness of the ground around a rim: the median of rings; 0 where the image has none of them."""
    centre = chart_px[:2]
    rings = centre + _GROUND_RING_RADII * (points_on(chart_px, _RING_POINTS) - centre)
    columns, rows = np.rint(rings).astype(np.int64).reshape(-1, 2).T
    inside = (columns >= 0) & (rows >= 0) & (columns < image.shape[1]) & (rows < image.shape[0])
    values = image[rows[inside], columns[inside]]
    values = np.sort(values[np.isfinite(values)])
    return float(values[len(values) // 2]) if len(values) > 0 else 0.0
