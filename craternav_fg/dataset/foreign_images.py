"""Images from anywhere, in whatever format and depth: read as they are, not as part of a data set."""

import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from craternav_fg.errors import InputError

# Larger ones need more than two gigabytes.
MAX_PIXELS = 25_000_000
# Other modes, such as a palette or CMYK, are made colour first.
_PLAIN = ("1", "L", "LA", "I", "I;16", "I;16B", "I;16L", "F", "RGB", "RGBA")


def read_foreign_image(path: Path) -> npt.NDArray[np.generic]:
    """Read an image file: PNG, TIFF, JPEG and whatever else Pillow knows, the first one of several.

    Returns
    -------
    ndarray, shape (H, W) or (H, W, channels)
        With the file's own type.

    Raises
    ------
    InputError
        When it is missing, no image, damaged or too large.
    """
    if not path.is_file():
        raise InputError(
            path, "expected an image file, found " + ("a folder" if path.is_dir() else "nothing")
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                width, height = image.size
                if width * height > MAX_PIXELS:
                    raise InputError(
                        path, f"{width} x {height} px are more than {MAX_PIXELS // 10**6} million: crop it"
                    )
                mode = "RGBA" if image.mode == "P" and "transparency" in image.info else "RGB"
                return np.asarray(image if image.mode in _PLAIN else image.convert(mode))
    except Image.DecompressionBombError as error:
        raise InputError(path, f"more than {MAX_PIXELS // 10**6} million pixels: crop it") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(path, f"cannot be read as an image: {error}") from error
