"""Images of any origin as what the front end expects: one channel, about 0 to 255, holes told apart."""

import cv2
import numpy as np
import numpy.typing as npt

ImageArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

SATURATED_BRIGHTNESS = 255.0
# Brighter than this, of 255, counts as saturated in `edges`.
_MAX_VALID_BRIGHTNESS = 249.0
# Weights of red, green and blue.
_RGB_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
# An image whose bright end is below the first is stretched until it is at the second.
_DIM_BRIGHTNESS, _STRETCHED_BRIGHTNESS = 100.0, 200.0
# Pixels that tell the dark and the bright end.
_MAX_SAMPLED_PIXELS = 40_000


def brightness(image: npt.NDArray[np.generic]) -> ImageArray:
    """Give an image's brightness.

    8-bit images stay as they are unless they are dim; others are scaled by their bright end. Colour is
    made grey, an alpha channel makes holes of what it hides.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, 1 to 4)
        Integers or floats; grey, grey and alpha, red-green-blue, or red-green-blue and alpha.

    Returns
    -------
    ndarray of float32, shape (H, W)
        0 to 255; 255 where saturated, NaN where there is no data.

    Raises
    ------
    ValueError
        When the array is no image.
    """
    raw = np.asarray(image)
    channels = raw.shape[2] if raw.ndim == 3 else 1
    if raw.ndim not in (2, 3) or raw.size == 0 or channels > 4 or raw.dtype.kind not in "biuf":
        raise ValueError(f"expected an image, found an array of {raw.dtype}, shape {raw.shape}")
    values = raw.reshape(*raw.shape[:2], channels).astype(np.float32)
    holes = ~np.isfinite(values).all(axis=2)
    if channels in (2, 4):
        holes |= values[..., -1] == 0.0
    out = values[..., :3] @ _RGB_WEIGHTS if channels >= 3 else values[..., 0]
    out = np.ascontiguousarray(np.where(holes, np.float32(np.nan), out))
    valid = out[~holes]
    if len(valid) == 0:
        return out
    low, high = (
        float(v) for v in np.percentile(valid[:: max(1, len(valid) // _MAX_SAMPLED_PIXELS)], [0.5, 99.5])
    )
    top = float(valid.max())
    # A plateau at the top is saturation, whatever the number of bits.
    saturated = out >= top if np.count_nonzero(valid == top) > max(4, 1e-4 * len(valid)) else out > np.inf
    if raw.dtype == np.uint8 and high >= _DIM_BRIGHTNESS:
        saturated &= out > _MAX_VALID_BRIGHTNESS
    else:
        base = min(low, 0.0)
        scale = _STRETCHED_BRIGHTNESS / (high - base) if high > base else 1.0
        out = np.clip((out - np.float32(base)) * np.float32(scale), 0.0, _MAX_VALID_BRIGHTNESS)
        if not high > low:
            saturated[:] = False
    out[saturated] = SATURATED_BRIGHTNESS
    return np.asarray(out, dtype=np.float32)


def filled(image: ImageArray) -> tuple[ImageArray, ImageArray]:
    """Fill the holes of an image.

    Returns
    -------
    everywhere : ndarray of float32, shape (H, W)
        With all holes filled by their wide surroundings.
    narrow : ndarray of float32, shape (H, W)
        With single missing pixels filled only; NaN in larger holes.
    """
    holes = np.isnan(image)
    if not holes.any():
        return image, image
    known = (~holes).astype(np.float32)
    values = np.where(holes, np.float32(0.0), image)
    narrow = image.copy()
    mass, mean = cv2.blur(known, (3, 3)), cv2.blur(values, (3, 3))
    small = holes & (mass > 0.5)
    narrow[small] = mean[small] / mass[small]
    everywhere = narrow.copy()
    for side in (33, 257):
        mass, mean = cv2.blur(known, (side, side)), cv2.blur(values, (side, side))
        near = np.isnan(everywhere) & (mass > 0.05)
        everywhere[near] = mean[near] / mass[near]
    rest = np.isnan(everywhere)
    if rest.any():
        everywhere[rest] = np.median(image[~holes]) if not holes.all() else 0.0
    return everywhere, narrow
