"""Crater candidates: places in an image that look like a lit bowl, whatever the illumination direction.

A bowl under oblique light is a dipole of brightness, dark towards the sun. The canonical crater (see
`crater_profile`) under light along x and along y gives two templates. The length of the image's correlations
with them measures how much a place looks like a crater of the template's size; their angle gives the
direction towards the sun. The image is correlated relative to its local mean, at a resolution that makes
craters of each octave of sizes equally large.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from craternav_fg.vision import crater_profile
from craternav_fg.vision.disc_kernel import running_sums, share_of_variance
from factors.arrays import BoolArray, FloatArray, ImageArray, IntArray
from factors.kernels.compiled import njit

# Radii of the templates at the resolution of the correlation; each octave of radii has its own resolution.
TEMPLATE_RADII_PX = 6.0 * 2.0 ** (np.arange(4) / 4.0)
# Radius of a crater over that of the template that correlates best with it, on rendered ground; why it is
# kept: `craternav_fg.calibration.blind_detection`.
TEMPLATE_SIZE_FACTOR = 1.07
# Radius of a template's support, in radii of its crater.
TEMPLATE_REACH_RADII = 1.45
# Least relative contrast of a candidate and its least brightness step, of 255: less is sensor noise on bare
# ground.
MIN_RELATIVE_CONTRAST = 0.01
MIN_BRIGHTNESS_STEP = 0.5
# Width of the local mean, in the largest radii of the octave.
_MEAN_WINDOW_RADII = 4.0
# Exponent of the size in the order of candidates of the same correlation: larger craters are fewer and
# determine more.
_SIZE_EXPONENT = 0.15
# Peaks of the correlation are highest within this window, px at the resolution of the correlation.
_PEAK_WINDOW_PX = 7
# Two candidates are the same crater if their radii differ by less than these factors and their centres by
# less than this share of the larger radius.
_SAME_RADIUS_RATIO = (0.55, 1.8)
_SAME_CENTRE_SHARE = 0.5
# Votes for the direction towards the sun: half width of a vote, largest number of voters, and exponent of the
# correlation in their weight.
_VOTE_WIDTH_RAD = float(np.deg2rad(30.0))
MAX_VOTERS = 300
_VOTE_EXPONENT = 4


@dataclass(frozen=True)
class Candidates:
    """Crater candidates, best first.

    Attributes
    ----------
    xy_px : ndarray, shape (n, 2)
        Centres.
    radius_px : ndarray, shape (n,)
    correlation : ndarray, shape (n,)
        With the canonical crater, 0 to 1.
    sun_angle_rad : ndarray, shape (n,)
        Direction towards the sun in the image, from x towards y, as each candidate's shading shows it.
    slope_contrast : ndarray, shape (n,)
        Slope contrast (see `photometry`) with which the canonical crater would have the same contrast.
    """

    xy_px: FloatArray
    radius_px: FloatArray
    correlation: FloatArray
    sun_angle_rad: FloatArray
    slope_contrast: FloatArray

    def __len__(self) -> int:
        return len(self.radius_px)

    def take(self, rows: IntArray | BoolArray) -> "Candidates":
        """Select some candidates.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,), or of int, shape (k,)
            A mask or indices.
        """
        return Candidates(*(getattr(self, field.name)[rows] for field in fields(self)))


def find_candidates(
    image: ImageArray, min_radius_px: float, max_radius_px: float, min_correlation: float
) -> Candidates:
    """Find candidates of craters in a range of radii.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    min_radius_px, max_radius_px : float
    min_correlation : float
        Least correlation with the canonical crater.

    Returns
    -------
    Candidates
        The same crater may be among them several times, see `distinct`.
    """
    found: list[FloatArray] = [np.empty((0, 6))]
    factor = min_radius_px / float(TEMPLATE_RADII_PX[0])
    small = image
    # As many threads as OpenCV has, which workers on a core each set to one.
    with ThreadPoolExecutor(min(len(TEMPLATE_RADII_PX), max(cv2.getNumThreads(), 1))) as threads:
        while factor * TEMPLATE_RADII_PX[0] < max_radius_px and min(image.shape) >= 2.0 * factor:
            size = (round(image.shape[1] / factor), round(image.shape[0] / factor))
            method = cv2.INTER_AREA if factor > 1.0 else cv2.INTER_CUBIC
            small = np.asarray(cv2.resize(small, size, interpolation=method), dtype=np.float32)
            scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
            for radius, row in _octave(small, min_correlation, threads.map):
                row[:, :2] = (row[:, :2] + 0.5) * scale - 0.5
                row[:, 2] = TEMPLATE_SIZE_FACTOR * radius * factor
                found.append(row)
            factor *= 2.0
    all_of = np.concatenate(found)
    all_of = all_of[all_of[:, 2] < max_radius_px]
    worth = all_of[:, 3] * (all_of[:, 2] / min_radius_px) ** _SIZE_EXPONENT
    all_of = all_of[np.argsort(-worth, kind="stable")]
    return Candidates(all_of[:, :2], *np.ascontiguousarray(all_of[:, 2:].T))


def distinct(candidates: Candidates, count: int) -> Candidates:
    """Select the first `count` candidates, without those that are an earlier one again."""
    return candidates.take(distinct_circles(candidates.xy_px, candidates.radius_px, count))


def distinct_circles(xy_px: FloatArray, radius_px: FloatArray, count: int) -> IntArray:
    """Rows of the first `count` circles, without those that are an earlier one again.

    Parameters
    ----------
    xy_px : ndarray, shape (n, 2)
        Centres.
    radius_px : ndarray, shape (n,)
    count : int

    Returns
    -------
    ndarray of int, shape (k,)
    """
    return _distinct(np.ascontiguousarray(xy_px), np.ascontiguousarray(radius_px), count)


def common_sun_angle(candidates: Candidates) -> tuple[float, float]:
    """Find the direction towards the sun that most candidates agree on.

    Parameters
    ----------
    candidates : Candidates
        At least one.

    Returns
    -------
    sun_angle_rad : float
        Direction in the image, from x towards y.
    share : float
        Share of all votes for it.
    """
    weight = candidates.correlation**_VOTE_EXPONENT
    voters = np.argsort(-weight, kind="stable")[:MAX_VOTERS]
    angle, weight = candidates.sun_angle_rad[voters], weight[voters]
    off = _wrapped(angle[:, None] - angle[None])
    support = np.maximum(1.0 - np.abs(off) / _VOTE_WIDTH_RAD, 0.0) @ weight
    best = int(np.argmax(support))
    near = weight * (np.abs(off[best]) < _VOTE_WIDTH_RAD)
    common = angle[best] - float(off[best] @ near / near.sum())
    return float(_wrapped(np.array(common))), float(near.sum() / weight.sum())


def illuminated_from(candidates: Candidates, sun_angle_rad: float, max_deviation_rad: float) -> BoolArray:
    """Tell which candidates seem to be lit from about a direction.

    Parameters
    ----------
    candidates : Candidates
        Candidates for n craters.
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.
    max_deviation_rad : float
        Largest deviation from it.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    return np.asarray(np.abs(_wrapped(candidates.sun_angle_rad - sun_angle_rad)) < max_deviation_rad)


def local_sun_angles(candidates: Candidates, reach_px: float, xy_px: FloatArray | None = None) -> FloatArray:
    """Estimate the direction towards the sun at places from the shading of candidates around them.

    Parameters
    ----------
    candidates : Candidates
        At least one.
    reach_px : float
        Standard deviation of the Gaussian weights of the candidates.
    xy_px : ndarray, shape (n, 2), optional
        The places; the candidates' own if not given.

    Returns
    -------
    ndarray, shape (n,)
        From x towards y, rad.
    """
    step = (candidates.xy_px if xy_px is None else xy_px)[:, None] - candidates.xy_px[None]
    weight = np.exp(-0.5 * np.sum(step**2, axis=-1) / reach_px**2) * candidates.correlation**_VOTE_EXPONENT
    x, y = weight @ np.cos(candidates.sun_angle_rad), weight @ np.sin(candidates.sun_angle_rad)
    return np.asarray(np.arctan2(y, x))


def _wrapped(angle: FloatArray) -> FloatArray:
    """Angles from -pi to pi."""
    return np.asarray(np.pi - np.remainder(np.pi - angle, 2.0 * np.pi))


class _Template(NamedTuple):
    """The canonical crater of one radius.

    Attributes
    ----------
    along_x, along_y : ndarray of float32, shape (k, k)
        Kernels of the slope contrast.
    half_widths : ndarray of int, shape (n,)
        Half widths of the rows of its support, see `disc_kernel`.
    rms : float
        Root mean square of the dipole at contrast 1.
    """

    along_x: ImageArray
    along_y: ImageArray
    half_widths: IntArray
    rms: float


@lru_cache(maxsize=8)
def _template(index: int) -> _Template:
    radius = float(TEMPLATE_RADII_PX[index])
    half = int(np.ceil(TEMPLATE_REACH_RADII * TEMPLATE_RADII_PX[-1]))
    x, y = np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0))
    rho = np.hypot(x, y) / radius
    inside = rho < TEMPLATE_REACH_RADII
    slope = crater_profile.slopes(np.clip(rho, 0.02, TEMPLATE_REACH_RADII))
    profile = np.where(inside, slope / np.maximum(rho * radius, 0.5), 0.0)
    square = float(np.sum((profile * x) ** 2))
    along_x, along_y = ((-profile * axis / square).astype(np.float32) for axis in (x, y))
    in_rows = np.count_nonzero(inside, axis=1)
    return _Template(along_x, along_y, in_rows[in_rows > 0] // 2, float(np.sqrt(square / inside.sum())))


@lru_cache(maxsize=32)
def _spectra(index: int, rows: int, columns: int) -> tuple[ImageArray, ...]:
    """Spectra of the templates, laid out so that the transform of a product starts at their middle."""
    out = []
    for kernel in _template(index)[:2]:
        padded = np.zeros((rows, columns), np.float32)
        # The transform back does not divide by the number of pixels.
        padded[: kernel.shape[0], : kernel.shape[1]] = kernel / np.float32(rows * columns)
        half = kernel.shape[0] // 2
        out.append(cv2.dft(np.roll(padded, (-half, -half), axis=(0, 1))))
    return tuple(np.asarray(spectrum, dtype=np.float32) for spectrum in out)


def _octave(
    image: ImageArray, min_correlation: float, each: Callable[..., Iterable[FloatArray]]
) -> list[tuple[float, FloatArray]]:
    """Correlate an image with the templates of one octave; `each` maps a function over them.

    Returns each template's radius, px, with rows (n, 6) of its peaks: x, y, 0 (for the radius), correlation,
    sun angle, slope contrast.
    """
    reach = _MEAN_WINDOW_RADII * float(TEMPLATE_RADII_PX[-1])
    side = (2 * int(reach / 2.0) + 1,) * 2
    mean_level = cv2.blur(cv2.blur(image, side), side).astype(np.float32)
    least = np.maximum(mean_level, np.float32(MIN_BRIGHTNESS_STEP / MIN_RELATIVE_CONTRAST))
    relative = (image - mean_level) / least
    pad = int(np.ceil(TEMPLATE_REACH_RADII * TEMPLATE_RADII_PX[-1]))
    height, width = image.shape
    rows, columns = (cv2.getOptimalDFTSize(n + 2 * pad) for n in image.shape)
    border = (pad, rows - height - pad, pad, columns - width - pad)
    padded = np.asarray(cv2.copyMakeBorder(relative, *border, cv2.BORDER_REFLECT), dtype=np.float32)
    spectrum = cv2.dft(padded)
    sums = running_sums(padded[: height + 2 * pad, : width + 2 * pad])

    def filtered(kernel: ImageArray) -> ImageArray:
        # Correlation, not convolution: the kernel's spectrum is conjugated.
        product = cv2.mulSpectrums(spectrum, kernel, 0, conjB=True)
        values = cv2.dft(product, flags=cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT)
        return np.asarray(values[pad : pad + height, pad : pad + width], dtype=np.float32)

    def peaks(index: int) -> FloatArray:
        gx, gy = (filtered(kernel) for kernel in _spectra(index, rows, columns))
        *_, half_widths, rms = _template(index)
        share2 = share_of_variance(sums, half_widths, gx, gy, np.float32(2.0 * MIN_RELATIVE_CONTRAST**2))
        unit = np.float32(rms)
        top = cv2.dilate(share2, np.ones((_PEAK_WINDOW_PX, _PEAK_WINDOW_PX), np.uint8))
        # Few places correlate at all: only there are peaks looked for.
        enough = np.flatnonzero(share2 > np.float32((min_correlation / unit) ** 2))
        enough = enough[share2.ravel()[enough] >= top.ravel()[enough]]
        y, x = np.divmod(enough, share2.shape[1])
        row = np.zeros((len(x), 6))
        row[:, 0], row[:, 1] = x, y
        row[:, 3] = np.minimum(unit * np.sqrt(share2[y, x]), 1.0)
        row[:, 4] = np.arctan2(gy[y, x], gx[y, x])
        row[:, 5] = np.sqrt(gx[y, x] ** 2 + gy[y, x] ** 2)
        return row

    return list(zip(TEMPLATE_RADII_PX.tolist(), each(peaks, range(len(TEMPLATE_RADII_PX))), strict=True))


@njit(cache=True, error_model="numpy")
def _distinct(xy: FloatArray, radius: FloatArray, count: int) -> IntArray:
    kept = np.empty(min(count, len(radius)), np.int64)
    taken = 0
    for i in range(len(radius)):
        if taken == len(kept):
            break
        apart = True
        for k in kept[:taken]:
            ratio = radius[i] / radius[k]
            near = _SAME_CENTRE_SHARE * max(radius[i], radius[k])
            dx, dy = xy[i, 0] - xy[k, 0], xy[i, 1] - xy[k, 1]
            if _SAME_RADIUS_RATIO[0] < ratio < _SAME_RADIUS_RATIO[1] and dx * dx + dy * dy <= near * near:
                apart = False
                break
        if apart:
            kept[taken] = i
            taken += 1
    return kept[:taken]
