"""Brightness of images of any origin: one channel, 0 to 255, missing and saturated pixels marked."""

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.vision.image_sampling import SATURATED_BRIGHTNESS
from factors.arrays import BoolArray, ImageArray

# Brightness of saturated pixels, and the largest of others: safely below what counts as saturated.
_SATURATED_MARK = 255.0
_MAX_VALID_BRIGHTNESS = SATURATED_BRIGHTNESS - 1.0
# Weights of red, green and blue in the luma (ITU-R BT.601).
_RGB_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
# An 8-bit image is stretched if its bright end, the upper percentile below, is under the first of these;
# other images always are. The bright end is then at the second.
_DIM_BRIGHTNESS, _STRETCHED_BRIGHTNESS = 100.0, 200.0
_DARK_PERCENTILE, _BRIGHT_PERCENTILE = 0.5, 99.5
# Magnitude of a float from which it is no brightness: ISIS writes missing and saturated pixels as -3.4e38.
MAX_VALUE = 1e38
# Values that mark missing pixels in signed images without the file's saying so, and how many values from
# there on do: ISIS has five for missing and saturated pixels. Brightness begins by the share above them.
_VOIDS = {-9999.0: 1, -32768.0: 5, -32767.0: 4}
_VOID_MARGIN = 0.1
# Pixels sampled for the percentiles.
_MAX_SAMPLED_PIXELS = 40_000
# Pixels at the maximum, as a number and as a share of the image, above which they count as saturated.
_MIN_SATURATED_PIXELS, _MIN_SATURATED_SHARE = 4, 1e-4
# Holes are filled by the mean of windows of these sides, px, where more than the share of a window is known.
_SMALL_HOLE_PX, _MIN_KNOWN_SMALL = 3, 0.5
_FILL_WINDOWS_PX, _MIN_KNOWN_LARGE = (33, 257), 0.05


def brightness(image: npt.NDArray[np.generic]) -> ImageArray:
    """Compute an image's brightness.

    8-bit images stay as they are unless they are dim; others are scaled by their bright end. Colours become
    grey; transparent pixels become holes.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, 1 to 4)
        Integers or floats; grey, grey and alpha, RGB, or RGB and alpha.

    Returns
    -------
    ndarray of float32, shape (H, W)
        0 to 255; 255 where saturated, NaN where there is no data: where floats are 1e38 and more, or signed
        numbers -9999 or -32768 to -32764 and none is near.

    Raises
    ------
    ValueError
        When the array is no image.
    """
    raw = np.asarray(image)
    channels = raw.shape[2] if raw.ndim == 3 else 1
    if raw.ndim not in (2, 3) or raw.size == 0 or channels > 4 or raw.dtype.kind not in "biuf":
        raise ValueError(f"expected an image, found an array of {raw.dtype}, shape {raw.shape}")
    with np.errstate(over="ignore"):
        values = raw.reshape(*raw.shape[:2], channels).astype(np.float32)
    # NaN compares as false.
    holes: BoolArray = ~np.all(np.abs(values) < MAX_VALUE, axis=2)
    if channels in (2, 4):
        holes |= values[..., -1] == 0.0
    if raw.dtype.kind in "if":
        holes |= _void(values[..., : channels - (channels in (2, 4))], holes)
    out = values[..., :3] @ _RGB_WEIGHTS if channels >= 3 else values[..., 0]
    out = np.ascontiguousarray(np.where(holes, np.float32(np.nan), out))
    valid = out[~holes]
    if len(valid) == 0:
        return out
    sample = valid[:: max(1, len(valid) // _MAX_SAMPLED_PIXELS)]
    low, high = (float(v) for v in np.percentile(sample, [_DARK_PERCENTILE, _BRIGHT_PERCENTILE]))
    top = float(valid.max())
    # A plateau at the maximum is saturation, whatever the bit depth.
    plateau = max(_MIN_SATURATED_PIXELS, _MIN_SATURATED_SHARE * len(valid))
    saturated = out >= top if np.count_nonzero(valid == top) > plateau else out > np.inf
    if raw.dtype == np.uint8 and high >= _DIM_BRIGHTNESS:
        saturated &= out > _MAX_VALID_BRIGHTNESS
    else:
        base = min(low, 0.0)
        scale = _STRETCHED_BRIGHTNESS / (high - base) if high > base else 1.0
        out = np.clip((out - np.float32(base)) * np.float32(scale), 0.0, _MAX_VALID_BRIGHTNESS)
        if not high > low:
            saturated[:] = False
    out[saturated] = _SATURATED_MARK
    return np.asarray(out, dtype=np.float32)


def _void(values: npt.NDArray[np.float32], holes: BoolArray) -> BoolArray:
    """Find values that stand for no data, apart from all others."""
    lowest = float(np.min(values, initial=np.inf, where=~holes[..., None]))
    count = _VOIDS.get(lowest)
    if count is None:
        return np.zeros_like(holes)
    marked = (values < lowest + count).any(axis=2) & ~holes
    rest = ~(holes | marked)
    apart = np.min(values, initial=np.inf, where=rest[..., None]) > (1.0 - _VOID_MARGIN) * lowest
    return marked if apart else np.zeros_like(holes)


def filled(image: ImageArray) -> tuple[ImageArray, ImageArray]:
    """Fill the holes of an image.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.

    Returns
    -------
    everywhere : ndarray of float32, shape (H, W)
        All holes filled by the mean of their surroundings.
    narrow : ndarray of float32, shape (H, W)
        Only single missing pixels filled; NaN in larger holes.
    """
    holes = np.isnan(image)
    if not holes.any():
        return image, image
    known = (~holes).astype(np.float32)
    values = np.where(holes, np.float32(0.0), image)
    narrow = image.copy()
    mass, mean = (
        cv2.blur(known, (_SMALL_HOLE_PX, _SMALL_HOLE_PX)),
        cv2.blur(values, (_SMALL_HOLE_PX, _SMALL_HOLE_PX)),
    )
    small = holes & (mass > _MIN_KNOWN_SMALL)
    narrow[small] = mean[small] / mass[small]
    everywhere = narrow.copy()
    for side in _FILL_WINDOWS_PX:
        mass, mean = cv2.blur(known, (side, side)), cv2.blur(values, (side, side))
        near = np.isnan(everywhere) & (mass > _MIN_KNOWN_LARGE)
        everywhere[near] = mean[near] / mass[near]
    rest = np.isnan(everywhere)
    if rest.any():
        everywhere[rest] = np.median(image[~holes]) if not holes.all() else 0.0
    return everywhere, narrow
