"""Crater rims in an image of which hardly anything is known: no pose, not even the sun's tilt.

A bowl under oblique light is a dipole of brightness, dark towards the sun. Two templates, the dipole
along x and along y, correlate with any such dipole: the length of the two correlations tells how much
a place looks like a crater of the template's size, their angle where the sun is. The rims of the
places found are then traced and fitted as if they had been predicted, from a circle.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.vision import crest
from craternav_fg.vision.ellipse_fit import FitFailure, FitOptions, RimFit, refine_rim
from craternav_fg.vision.grey import GreyArray

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]


@dataclass(frozen=True)
class DetectOptions:
    """What is taken for a crater.

    Attributes
    ----------
    min_radius_px, max_radius_share : float
        Radii searched: from min_radius_px to max_radius_share of the image's shorter side.
    min_correlation : float
        Least correlation with the canonical crater.
    max_candidates : int
        Of more places, the best are looked at; large ones are preferred.
    max_sun_deviation_rad : float
        A dipole that points further away from the common direction is none of a crater's.
    min_found_share : float
        Least share of a rim's normals with an edge.
    max_rms_px, max_rms_share : float
        Largest scatter of a rim's edge points: max_rms_px + max_rms_share b.
    floor_px, floor_share : float
        Systematic standard deviation of a rim, much larger than for navigation: here a wrong rim
        must not outweigh a right one.
    """

    min_radius_px: float = 8.0
    max_radius_share: float = 0.16
    min_correlation: float = 0.6
    max_candidates: int = 120
    max_sun_deviation_rad: float = float(np.deg2rad(40.0))
    min_found_share: float = 0.45
    max_rms_px: float = 1.0
    max_rms_share: float = 0.04
    floor_px: float = 0.5
    floor_share: float = 0.02


@dataclass(frozen=True)
class Detections:
    """Rims found in an image, largest first.

    Attributes
    ----------
    charts_px : ndarray, shape (n, 5)
        Ellipse charts in pixels.
    charts, covariance : ndarray, shape (n, 5) and (n, 5, 5)
        The same in normalised coordinates, and what they may be wrong by.
    sunward_rad : ndarray, shape (n,)
        Direction in the image, from x towards y, in which each crater's wall is darkest.
    """

    charts_px: FloatArray
    charts: FloatArray
    covariance: FloatArray
    sunward_rad: FloatArray

    def __len__(self) -> int:
        return len(self.charts)


# Radii of the templates at the resolution at which they are correlated; each octave of radii has its own.
_TEMPLATE_RADII_PX = 6.0 * 2.0 ** (np.arange(4) / 4.0)
# The correlation is highest for a template smaller than the crater by this factor.
_SIZE_BIAS = 1.07
# The templates end at this many radii.
_SUPPORT = 1.45
# Half length of the normals along which a rim is traced, one after the other: pixels, share of the radius.
_REACHES = ((2.0, 0.35), (1.5, 0.15))
# Normals are searched where at least this part of the sun's slope lies across the rim, and an edge has at
# least this step of brightness for each unit of slope.
_MIN_SLOPE = 0.2
_MIN_STEP = 0.02
# Darker level ground, of 255, has no contrast to offer.
_DARK = 6.0


def detect_rims(
    image: GreyArray, camera: Camera, gain: float, options: DetectOptions | None = None
) -> Detections:
    """Find rims without a prediction.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels up to 255.
    camera : Camera
        Without distortion.
    gain : float
        Length of the shading gain of level ground (see `photometry`), about the cotangent of the
        sun's elevation: how strongly slopes show.
    options : DetectOptions, optional

    Returns
    -------
    Detections
        Possibly none.
    """
    options = options or DetectOptions()
    smooth = np.ascontiguousarray(image, dtype=np.float32)
    places = _places(smooth, options)
    if len(places) == 0:
        return _gather([], [], [], [])
    places = _distinct(_lit_alike(places, options), options.max_candidates)
    fit_options = FitOptions(floor_px=options.floor_px, floor_share=options.floor_share)
    charts_px: list[FloatArray] = []
    charts: list[FloatArray] = []
    covariance: list[FloatArray] = []
    sunward: list[float] = []
    for x, y, radius, _, angle in places:
        level = _level(smooth, x, y, radius)
        if level < _DARK:
            continue
        chart_px = np.array([x, y, np.log(radius), 0.0, np.log(radius)])
        fit: RimFit | FitFailure = FitFailure.TOO_FEW_POINTS
        for reach_px, reach_share in _REACHES:
            size = float(np.exp(0.5 * (chart_px[2] + chart_px[4])))
            points, tried = _edge_points(
                smooth, chart_px, float(angle), gain, level, reach_px + reach_share * size
            )
            if len(points) < options.min_found_share * tried:
                fit = FitFailure.TOO_FEW_POINTS
                break
            fit = refine_rim(points, chart_px, camera, fit_options, np.ones(len(points)))
            if isinstance(fit, FitFailure):
                break
            chart_px = fit.chart_px
        if isinstance(fit, FitFailure):
            continue
        minor = np.sqrt(_eigenvalues(fit.chart_px)[0])
        moved = np.hypot(fit.chart_px[0] - x, fit.chart_px[1] - y)
        if fit.rms_px > options.max_rms_px + options.max_rms_share * minor or moved > 0.6 * radius:
            continue
        if any(_same(fit.chart_px, other) for other in charts_px):
            continue
        charts_px.append(fit.chart_px)
        charts.append(fit.chart)
        covariance.append(fit.covariance)
        sunward.append(float(angle))
    return _gather(charts_px, charts, covariance, sunward)


def _gather(
    charts_px: list[FloatArray], charts: list[FloatArray], covariance: list[FloatArray], sunward: list[float]
) -> Detections:
    all_px = np.array(charts_px).reshape(-1, 5)
    order = np.argsort(-(all_px[:, 2] + all_px[:, 4]), kind="stable")
    return Detections(
        all_px[order],
        np.array(charts).reshape(-1, 5)[order],
        np.array(covariance).reshape(-1, 5, 5)[order],
        np.array(sunward).reshape(-1)[order],
    )


def _places(image: ImageArray, options: DetectOptions) -> FloatArray:
    """Candidates (n, 5): x, y, radius, px; correlation; direction towards the sun. Best first."""
    found: list[FloatArray] = []
    largest = options.max_radius_share * min(image.shape)
    factor = max(options.min_radius_px / float(_TEMPLATE_RADII_PX[0]), 1.0)
    while factor * _TEMPLATE_RADII_PX[0] < largest:
        small = _reduced(image, factor)
        scale_x, scale_y = image.shape[1] / small.shape[1], image.shape[0] / small.shape[0]
        maps = [_correlations(small, radius) for radius in _TEMPLATE_RADII_PX]
        for radius, (cx, cy) in zip(_TEMPLATE_RADII_PX, maps, strict=True):
            strength = np.sqrt(cx * cx + cy * cy)
            peaks = cv2.dilate(strength, np.ones((7, 7), np.uint8)) <= strength
            rows, columns = np.nonzero(peaks & (strength > options.min_correlation))
            found.append(
                np.stack(
                    [
                        (columns + 0.5) * scale_x - 0.5,
                        (rows + 0.5) * scale_y - 0.5,
                        np.full(len(rows), _SIZE_BIAS * radius * factor),
                        strength[rows, columns],
                        np.arctan2(cy[rows, columns], cx[rows, columns]),
                    ],
                    axis=-1,
                )
            )
        factor *= 2.0
    places = np.concatenate(found) if found else np.empty((0, 5))
    places = places[places[:, 2] < largest]
    # Large craters say more about the pose than small ones, and there are fewer of them.
    worth = places[:, 3] * (places[:, 2] / options.min_radius_px) ** 0.15
    return places[np.argsort(-worth, kind="stable")]


def _distinct(places: FloatArray, count: int) -> FloatArray:
    """Return the first `count` candidates, those left out that are an earlier one's neighbours."""
    kept: list[FloatArray] = []
    for place in places:
        apart = all(
            np.hypot(place[0] - k[0], place[1] - k[1]) > 0.5 * max(place[2], k[2])
            or not 0.55 < place[2] / k[2] < 1.8
            for k in kept
        )
        if apart:
            kept.append(place)
        if len(kept) >= count:
            break
    return np.array(kept).reshape(-1, 5)


def _reduced(image: ImageArray, factor: float) -> ImageArray:
    size = (round(image.shape[1] / factor), round(image.shape[0] / factor))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _correlations(image: ImageArray, radius: float) -> tuple[ImageArray, ImageArray]:
    """Normalised correlations with the dipoles along x and y of a crater of some radius, px."""
    half = int(np.ceil(_SUPPORT * radius))
    x, y = np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0))
    rho = np.hypot(x, y) / radius
    inside = rho < _SUPPORT
    profile = np.where(
        inside, crest.slopes(np.clip(rho, 0.02, _SUPPORT)) / np.maximum(rho * radius, 0.5), 0.0
    )
    disc = (inside / np.count_nonzero(inside)).astype(np.float32)
    mean = cv2.filter2D(image, cv2.CV_32F, disc, borderType=cv2.BORDER_REFLECT)
    square = cv2.filter2D(image * image, cv2.CV_32F, disc, borderType=cv2.BORDER_REFLECT)
    # The floor keeps sensor noise on bare ground from looking like anything.
    spread = np.sqrt(np.maximum(square - mean * mean, 0.0) + (0.01 * mean) ** 2 + 0.25)
    out = []
    for dipole in (-profile * x, -profile * y):
        kernel = (dipole / np.sqrt(np.sum(dipole**2) * np.count_nonzero(inside))).astype(np.float32)
        out.append(cv2.filter2D(image, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT) / spread)
    return out[0], out[1]


def _lit_alike(places: FloatArray, options: DetectOptions) -> FloatArray:
    """Return the candidates whose dipoles agree with the direction that most of them share."""
    angle, weight = places[:, 4], places[:, 3] ** 4
    voters = np.argsort(-weight, kind="stable")[:300]
    off = np.abs(np.angle(np.exp(1j * (angle[voters, None] - angle[None, voters]))))
    support = (np.maximum(1.0 - off / np.deg2rad(30.0), 0.0) * weight[None, voters]).sum(axis=1)
    common = angle[voters[int(np.argmax(support))]]
    near = np.abs(np.angle(np.exp(1j * (angle - common)))) < options.max_sun_deviation_rad
    return places[near]


def _level(image: ImageArray, x: float, y: float, radius: float) -> float:
    """Brightness of the ground around a crater: the median of a ring."""
    turns = 2.0 * np.pi * np.arange(24) / 24.0
    rings = radius * np.array([1.5, 1.75, 2.0])[:, None]
    columns = np.rint(x + rings * np.cos(turns)).astype(np.int64).ravel()
    rows = np.rint(y + rings * np.sin(turns)).astype(np.int64).ravel()
    inside = (columns >= 0) & (rows >= 0) & (columns < image.shape[1]) & (rows < image.shape[0])
    return float(np.median(image[rows[inside], columns[inside]])) if np.any(inside) else 0.0


def _edge_points(
    image: ImageArray, chart_px: FloatArray, sunward: float, gain: float, level: float, reach_px: float
) -> tuple[FloatArray, int]:
    """Where the brightness crosses that of level ground near a rim: points (k, 2), normals searched.

    Of several crossings on a normal it is the one with the largest step to both sides.
    """
    size = float(np.exp(0.5 * (chart_px[2] + chart_px[4])))
    turn = 2.0 * np.pi * (np.arange(int(np.clip(2.0 * size, 48, 120))) + 0.5)
    turn /= len(turn)
    ea, es, shear = np.exp(chart_px[2]), np.exp(chart_px[4]), chart_px[3]
    x = chart_px[0] + ea * np.cos(turn)
    y = chart_px[1] + shear * ea * np.cos(turn) + es * np.sin(turn)
    normal = np.stack([np.cos(turn) / ea - shear * np.sin(turn) / es, np.sin(turn) / es], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    slope = -(normal @ [np.cos(sunward), np.sin(sunward)])
    keep = np.abs(slope) > _MIN_SLOPE
    x, y, normal, slope = x[keep], y[keep], normal[keep], slope[keep]
    step = max(0.5, 0.02 * size)
    side = max(2, round(0.12 * size / step))
    ends = round(reach_px / step) + side
    t = step * np.arange(-ends, ends + 1)
    columns = x[:, None] + t * normal[:, :1]
    rows = y[:, None] + t * normal[:, 1:]
    height, width = image.shape
    inside = (
        (columns.min(axis=1) >= 0)
        & (rows.min(axis=1) >= 0)
        & (columns.max(axis=1) <= width - 1)
        & (rows.max(axis=1) <= height - 1)
    )
    if not np.any(inside):
        return np.empty((0, 2)), 0
    columns, rows, slope = columns[inside], rows[inside], slope[inside]
    profile = cv2.remap(image, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR)
    profile = cv2.GaussianBlur(profile, (0, 0), sigmaX=max(1.0, 0.02 * size / step), sigmaY=1e-3)
    excess = np.sign(slope)[:, None] * (profile.astype(np.float64) / level - 1.0)
    total = np.concatenate([np.zeros((len(excess), 1)), np.cumsum(excess, axis=1)], axis=1)
    # Sample i and i + 1 lie to the two sides of crossing i; the outermost ones have no full sides.
    i = np.arange(side, 2 * ends - side)
    contrast = (2.0 * total[:, i + 1] - total[:, i + 1 - side] - total[:, i + 1 + side]) / side
    before, after = excess[:, i], excess[:, i + 1]
    crosses = (before > 0.0) & (after <= 0.0) & (contrast > _MIN_STEP * gain * np.abs(slope)[:, None])
    # The nearer of two equal ones.
    score = np.where(crosses, contrast * np.exp(-0.5 * (t[i] / reach_px) ** 2), 0.0)
    best = np.argmax(score, axis=1)
    line = np.arange(len(best))
    found = score[line, best] > 0.0
    line, best = line[found], best[found]
    place = i[best] + before[line, best] / (before[line, best] - after[line, best])
    share = (place - i[best])[:, None]
    corner = np.stack([columns[line, i[best]], rows[line, i[best]]], axis=-1)
    following = np.stack([columns[line, i[best] + 1], rows[line, i[best] + 1]], axis=-1)
    return corner + share * (following - corner), len(slope)


def _eigenvalues(chart_px: FloatArray) -> FloatArray:
    """Squares of the semi-axes, px, ascending."""
    sxx = np.exp(2.0 * chart_px[2])
    sxy = chart_px[3] * sxx
    return np.asarray(np.linalg.eigvalsh([[sxx, sxy], [sxy, np.exp(2.0 * chart_px[4]) + chart_px[3] * sxy]]))


def _same(one: FloatArray, other: FloatArray) -> bool:
    size = np.exp(0.5 * min(one[2] + one[4], other[2] + other[4]))
    ratio = 0.5 * abs(one[2] + one[4] - other[2] - other[4])
    return bool(np.hypot(one[0] - other[0], one[1] - other[1]) < 0.5 * size and ratio < 0.4)
