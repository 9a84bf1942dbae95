"""Images of any format and depth, which are not part of a data set."""

import struct
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from craternav_fg.errors import InputError
from craternav_fg.files import SizeLimit, open_input

# Detection in a larger image takes more than two gigabytes.
MAX_PIXELS = 25_000_000
# Modes of Pillow that are read as they are; others, such as a palette or CMYK, are converted to colour.
_PLAIN = ("1", "L", "LA", "I", "I;16", "I;16B", "I;16L", "F", "RGB", "RGBA")
# The tag of EXIF that says how an image is to be turned and mirrored; 1 if not at all.
_ORIENTATION = 0x0112
# The tag of GDAL that says which value marks missing pixels, as text.
_NO_DATA = 42113
# What Pillow raises on damaged files besides its own errors: its readers trust what the tags say.
_DAMAGED = (ArithmeticError, EOFError, LookupError, OSError, SyntaxError, TypeError, ValueError, struct.error)


class TooManyPixelsError(InputError):
    """An image is too large to be read as one array."""


def read_foreign_image(path: Path, *, opacity: bool = False) -> npt.NDArray[np.generic]:
    """Read an image file: PNG, TIFF, JPEG or another format that Pillow knows.

    Parameters
    ----------
    path : Path
        The first image is read when the others are of another size, as thumbnails are.
    opacity : bool
        Add an opacity to an image without one, 0 where all channels have the value that a TIFF declares to
        mark missing pixels, else 1.

    Returns
    -------
    ndarray, shape (H, W) or (H, W, channels)
        Grey levels or colours, with the type that the file has.

    Raises
    ------
    InputError
        When the file is missing, not an image, or damaged, holds several images of one size, or asks by an
        EXIF orientation to be shown turned: intrinsics may be of either.
    TooManyPixelsError
        When it is too large.
    """
    try:
        with open_input(path, SizeLimit.IMAGE) as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(stream) as image:
                width, height = image.size
                if width * height > MAX_PIXELS:
                    raise TooManyPixelsError(
                        path, f"{width} x {height} px are more than {MAX_PIXELS // 10**6} million: crop it"
                    )
                orientation = image.getexif().get(_ORIENTATION, 1)
                if orientation != 1:
                    problem = f"expected pixels as they are shown, found an EXIF orientation of {orientation}"
                    raise InputError(path, f"{problem}: turn the pixels, or remove the tag")
                count = _stacked(image)
                if count > 1:
                    raise InputError(path, f"expected one image, found {count}: save each as a file")
                mode = "RGBA" if image.mode == "P" and "transparency" in image.info else "RGB"
                pixels = np.asarray(image if image.mode in _PLAIN else image.convert(mode))
                return _with_opacity(image, pixels) if opacity else pixels
    except Image.DecompressionBombError as error:
        raise TooManyPixelsError(path, f"more than {MAX_PIXELS // 10**6} million pixels: crop it") from error
    except UnidentifiedImageError as error:
        # Pillow's text names a Python object.
        raise InputError(path, "cannot be read as an image: unknown format") from error
    except _DAMAGED as error:
        raise InputError(path, f"cannot be read as an image: {error}") from error


def _with_opacity(image: Image.Image, pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """Add an opacity to pixels whose file declares which value marks missing ones, and has such."""
    try:
        void = float(getattr(image, "tag_v2", {}).get(_NO_DATA, "nan"))
    except (TypeError, ValueError):
        return pixels
    layers = pixels.reshape(*pixels.shape[:2], -1)
    if layers.shape[2] not in (1, 3) or pixels.dtype.kind not in "uif":
        return pixels
    # Compared in the type of the pixels, as a float of Python is: 1e-8 in float32 is not 1e-8 in float64.
    with np.errstate(over="ignore"):
        missing = (layers == void).all(axis=2, keepdims=True)
    return np.concatenate([layers, (~missing).astype(pixels.dtype)], axis=2) if missing.any() else pixels


def _stacked(image: Image.Image) -> int:
    """Count the images of a file, 1 when the second is of another size; the first remains the current one."""
    size = image.size
    try:
        count = int(getattr(image, "n_frames", 1))
        if count > 1:
            image.seek(1)
            count = count if image.size == size else 1
    except _DAMAGED:
        # What follows is no image that Pillow knows, as a mask.
        count = 1
    image.seek(0)
    return count
