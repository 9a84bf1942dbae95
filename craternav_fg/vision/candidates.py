"""Candidates in an image that look like a lit bowl, wherever the light comes from.

A bowl under oblique light is a dipole of brightness, dark towards the sun. The canonical crater (see
`crest`) under light along x and along y gives two templates; the image's correlations with them tell by
their length how much a place looks like a crater of the template's size, by their angle where the light
comes from. The image is correlated relative to its local level, at a resolution that makes craters of
each octave of sizes equally large.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.vision import crater_profile

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

# Radii of the templates at the resolution at which they are correlated; each octave of radii has its own.
TEMPLATE_RADII_PX = 6.0 * 2.0 ** (np.arange(4) / 4.0)
# The correlation is highest for a template smaller than the crater by this factor.
TEMPLATE_SIZE_FACTOR = 1.07
# The templates end at this many radii.
_TEMPLATE_REACH_RADII = 1.45
# Smallest relative contrast and, of 255, brightness step of a place: less is sensor noise on bare ground.
_MIN_RELATIVE_CONTRAST = 0.01
_MIN_BRIGHTNESS_STEP = 0.5
# The local level is a mean over about this many of the octave's largest radii.
_MEAN_WINDOW_RADII = 4.0
# Width of the votes for the light's direction.
_VOTE_WIDTH_RAD = float(np.deg2rad(30.0))
_MAX_VOTERS = 300


@dataclass(frozen=True)
class Candidates:
    """Candidates that look like craters, best first.

    Attributes
    ----------
    xy_px : ndarray, shape (n, 2)
    radius_px : ndarray, shape (n,)
    correlation : ndarray, shape (n,)
        With the canonical crater, 0 to 1.
    sun_angle_rad : ndarray, shape (n,)
        Direction in the image, from x towards y, from which each seems to be lit.
    gain : ndarray, shape (n,)
        Shading gain (see `photometry`) with which the canonical crater would look alike.
    """

    xy_px: FloatArray
    radius_px: FloatArray
    correlation: FloatArray
    sun_angle_rad: FloatArray
    gain: FloatArray

    def __len__(self) -> int:
        return len(self.radius_px)

    def take(self, rows: IntArray | npt.NDArray[np.bool_]) -> "Candidates":
        """Give some of them."""
        return Candidates(
            self.xy_px[rows], self.radius_px[rows], self.correlation[rows], self.sun_angle_rad[rows],
            self.gain[rows],
        )  # fmt: skip


def find_candidates(
    image: ImageArray, min_radius_px: float, max_radius_px: float, min_correlation: float
) -> Candidates:
    """Find places of craters of a range of radii.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    min_radius_px, max_radius_px : float
    min_correlation : float

    Returns
    -------
    Candidates
        Neighbours of the same size among them: see `distinct`.
    """
    found: list[FloatArray] = [np.empty((0, 6))]
    factor = min_radius_px / float(TEMPLATE_RADII_PX[0])
    small = image
    while factor * TEMPLATE_RADII_PX[0] < max_radius_px and min(image.shape) >= 2.0 * factor:
        size = (round(image.shape[1] / factor), round(image.shape[0] / factor))
        method = cv2.INTER_AREA if factor > 1.0 else cv2.INTER_CUBIC
        small = np.asarray(cv2.resize(small, size, interpolation=method), dtype=np.float32)
        scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
        for radius, row in _octave(small, min_correlation):
            row[:, :2] = (row[:, :2] + 0.5) * scale - 0.5
            row[:, 2] = TEMPLATE_SIZE_FACTOR * radius * factor
            found.append(row)
        factor *= 2.0
    all_of = np.concatenate(found)
    all_of = all_of[all_of[:, 2] < max_radius_px]
    # Of equally good ones the larger: there are fewer, and they say more.
    worth = all_of[:, 3] * (all_of[:, 2] / min_radius_px) ** 0.15
    all_of = all_of[np.argsort(-worth, kind="stable")]
    return Candidates(all_of[:, :2], *np.ascontiguousarray(all_of[:, 2:].T))


def distinct(places: Candidates, count: int) -> Candidates:
    """Give the first `count` places, without those beside an earlier one of about its size."""
    return places.take(_distinct(np.ascontiguousarray(places.xy_px), places.radius_px, count))


def common_sun_angle(places: Candidates) -> tuple[float, float]:
    """Direction from which most places seem to be lit, and the share of all votes for it."""
    weight = places.correlation**4
    voters = np.argsort(-weight, kind="stable")[:_MAX_VOTERS]
    angle, weight = places.sun_angle_rad[voters], weight[voters]
    off = _turn(angle[:, None] - angle[None])
    support = np.maximum(1.0 - np.abs(off) / _VOTE_WIDTH_RAD, 0.0) @ weight
    best = int(np.argmax(support))
    near = weight * (np.abs(off[best]) < _VOTE_WIDTH_RAD)
    common = angle[best] - float(off[best] @ near / near.sum())
    return float(_turn(np.array(common))), float(near.sum() / weight.sum())


def illuminated_from(
    places: Candidates, sun_angle_rad: float, max_deviation_rad: float
) -> npt.NDArray[np.bool_]:
    """Tell which places seem to be lit from about a direction."""
    return np.asarray(np.abs(_turn(places.sun_angle_rad - sun_angle_rad)) < max_deviation_rad)


def local_sun_angles(places: Candidates, reach_px: float) -> FloatArray:
    """Direction of the light at each place from its own dipole and its neighbours'."""
    step = places.xy_px[:, None] - places.xy_px[None]
    weight = np.exp(-0.5 * np.sum(step**2, axis=-1) / reach_px**2) * places.correlation**4
    x, y = weight @ np.cos(places.sun_angle_rad), weight @ np.sin(places.sun_angle_rad)
    return np.asarray(np.arctan2(y, x))


def _turn(angle: FloatArray) -> FloatArray:
    return np.asarray(np.angle(np.exp(1j * angle)))


@lru_cache(maxsize=8)
def _templates(index: int) -> tuple[ImageArray, ImageArray, ImageArray, float]:
    """Kernels of the gain under light along x and along y, of the mean, and the dipole's rms at gain 1."""
    radius = float(TEMPLATE_RADII_PX[index])
    half = int(np.ceil(_TEMPLATE_REACH_RADII * TEMPLATE_RADII_PX[-1]))
    x, y = np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0))
    rho = np.hypot(x, y) / radius
    inside = rho < _TEMPLATE_REACH_RADII
    slope = crater_profile.slopes(np.clip(rho, 0.02, _TEMPLATE_REACH_RADII))
    profile = np.where(inside, slope / np.maximum(rho * radius, 0.5), 0.0)
    square = float(np.sum((profile * x) ** 2))
    count = np.count_nonzero(inside)
    dipoles = [(-profile * axis / square).astype(np.float32) for axis in (x, y)]
    return dipoles[0], dipoles[1], (inside / count).astype(np.float32), float(np.sqrt(square / count))


@lru_cache(maxsize=32)
def _spectra(index: int, rows: int, columns: int) -> tuple[ImageArray, ...]:
    """Spectra of the templates, laid out so that a product's transform starts at their middle."""
    out = []
    for kernel in _templates(index)[:3]:
        padded = np.zeros((rows, columns), np.float32)
        padded[: kernel.shape[0], : kernel.shape[1]] = kernel
        half = kernel.shape[0] // 2
        out.append(cv2.dft(np.roll(padded, (-half, -half), axis=(0, 1))))
    return tuple(np.asarray(spectrum, dtype=np.float32) for spectrum in out)


def _octave(image: ImageArray, min_correlation: float) -> list[tuple[float, FloatArray]]:
    """For each template's radius: rows of x, y, nothing yet, correlation, light, gain of the peaks."""
    reach = _MEAN_WINDOW_RADII * float(TEMPLATE_RADII_PX[-1])
    side = (2 * int(reach / 2.0) + 1,) * 2
    level = cv2.blur(cv2.blur(image, side), side).astype(np.float32)
    least = np.maximum(level, np.float32(_MIN_BRIGHTNESS_STEP / _MIN_RELATIVE_CONTRAST))
    relative = (image - level) / least
    pad = int(np.ceil(_TEMPLATE_REACH_RADII * TEMPLATE_RADII_PX[-1]))
    rows, columns = (cv2.getOptimalDFTSize(n + 2 * pad) for n in image.shape)
    border = (pad, rows - image.shape[0] - pad, pad, columns - image.shape[1] - pad)
    spectra = []
    for values in (relative, relative * relative):
        padded = cv2.copyMakeBorder(values, *border, cv2.BORDER_REFLECT)
        spectra.append(np.asarray(cv2.dft(padded), dtype=np.float32))

    def filtered(spectrum: ImageArray, kernel: ImageArray) -> ImageArray:
        # Correlation, not convolution: the kernel's spectrum is conjugated.
        product = cv2.mulSpectrums(spectrum, kernel, 0, conjB=True)
        values = cv2.dft(product, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
        return np.asarray(
            values[pad : pad + image.shape[0], pad : pad + image.shape[1]], dtype=np.float32
        )  # fmt: skip

    out = []
    for index, radius in enumerate(TEMPLATE_RADII_PX):
        along_x, along_y, disc = _spectra(index, rows, columns)
        gx, gy = filtered(spectra[0], along_x), filtered(spectra[0], along_y)
        mean, square = filtered(spectra[0], disc), filtered(spectra[1], disc)
        rms2 = np.maximum(square - mean * mean, 0.0) + np.float32(2.0 * _MIN_RELATIVE_CONTRAST**2)
        gain2 = gx * gx + gy * gy
        share2 = gain2 / rms2
        unit = np.float32(_templates(index)[3])
        top = cv2.dilate(share2, np.ones((7, 7), np.uint8))
        least2 = np.float32((min_correlation / unit) ** 2)
        y, x = np.nonzero((share2 >= top) & (share2 > least2))
        row = np.zeros((len(x), 6))
        row[:, 0], row[:, 1] = x, y
        row[:, 3] = np.minimum(unit * np.sqrt(share2[y, x]), 1.0)
        row[:, 4] = np.arctan2(gy[y, x], gx[y, x])
        row[:, 5] = np.sqrt(gain2[y, x])
        out.append((float(radius), row))
    return out


@njit(cache=True, error_model="numpy")
def _distinct(xy: FloatArray, radius: FloatArray, count: int) -> IntArray:
    kept = np.empty(min(count, len(radius)), np.int64)
    number = 0
    for i in range(len(radius)):
        if number == len(kept):
            break
        apart = True
        for k in kept[:number]:
            ratio = radius[i] / radius[k]
            near = 0.5 * max(radius[i], radius[k])
            dx, dy = xy[i, 0] - xy[k, 0], xy[i, 1] - xy[k, 1]
            if 0.55 < ratio < 1.8 and dx * dx + dy * dy <= near * near:
                apart = False
                break
        if apart:
            kept[number] = i
            number += 1
    return kept[:number]
