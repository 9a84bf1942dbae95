"""Windows of an image of any size, read through rasterio."""

import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, check_input
from craternav_fg.vision.brightness import MAX_VALUE
from craternav_fg.vision.mosaic import Window
from factors.arrays import BoolArray

# Memory for blocks of the file, MB: windows are read once.
_CACHE_MB = 64
_MAX_BANDS = 4
# More pixels than any mosaic has; a damaged header may state them.
_MAX_PIXELS = 10**12


class Pixels(NamedTuple):
    """Pixels of a window.

    Attributes
    ----------
    values : ndarray, shape (h, w, 2 or 4)
        Grey levels or colours, and an opacity that is 0 where there are no data.
    known : ndarray of bool, shape (h, w)
        Where there are data: all pixels of the file that one stands for, if the file does not declare which
        of its floats are none (1e38 and more, as ISIS writes them).
    """

    values: npt.NDArray[np.generic]
    known: BoolArray


def _rasterio() -> Any:
    try:
        import rasterio
    except ImportError:
        raise CraternavError("mosaics need rasterio: pip install 'craternav_fg[geo]'") from None
    return rasterio


@lru_cache(maxsize=1)
def _opened(path: Path, _mtime_ns: int) -> Any:
    """Open an image; each process keeps the last one open."""
    rasterio = _rasterio()
    check_input(path, SizeLimit.BAG)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        try:
            raster = rasterio.open(path)
        except (rasterio.errors.RasterioError, UnicodeDecodeError) as error:
            # Texts of damaged coordinates need not be text.
            raise InputError(path, f"cannot be read as an image: {' '.join(str(error).split())}") from None
    kinds = {np.dtype(kind).kind if kind in np.sctypeDict else "other" for kind in raster.dtypes}
    if not 1 <= raster.count <= _MAX_BANDS or not kinds <= set("biuf"):
        found = f"{raster.count} of {', '.join(sorted(set(raster.dtypes)))}"
        raise InputError(path, f"expected one to {_MAX_BANDS} bands of numbers, found {found}")
    if raster.width * raster.height > _MAX_PIXELS:
        expected = f"expected at most {_MAX_PIXELS:.0e} pixels"
        raise InputError(path, f"{expected}, found {raster.width} x {raster.height}")
    return raster


def raster_size(path: Path) -> tuple[int, int]:
    """Return height and width of an image.

    Parameters
    ----------
    path : Path

    Returns
    -------
    tuple of int

    Raises
    ------
    CraternavError
        When rasterio is not installed.
    InputError
        When it cannot be read, or has more than four bands, other values than numbers, or 10^12 pixels.
    """
    raster = _opened(path, _changed(path))
    return int(raster.height), int(raster.width)


def read_window(path: Path, window: Window) -> Pixels:
    """Read the pixels of a window, reduced to its level by averaging.

    Parameters
    ----------
    path : Path
    window : Window

    Returns
    -------
    Pixels

    Raises
    ------
    CraternavError
        When rasterio is not installed.
    InputError
        When the image cannot be read there.
    """
    rasterio = _rasterio()
    raster = _opened(path, _changed(path))
    left, top, right, bottom = window.outer
    step = window.step
    part = rasterio.windows.Window(step * left, step * top, step * (right - left), step * (bottom - top))
    shape = bottom - top, right - left
    bands = [1, 2, 3] if raster.count >= 3 else [1]
    average = rasterio.enums.Resampling.average
    try:
        with rasterio.Env(GDAL_CACHEMAX=_CACHE_MB):
            values = raster.read(bands, window=part, out_shape=(len(bands), *shape), resampling=average)
            known = raster.dataset_mask(window=part, out_shape=shape) > 0
    except rasterio.errors.RasterioError as error:
        place = f"columns {step * left} to {step * right}, rows {step * top} to {step * bottom}"
        raise InputError(path, f"cannot be read, {place}: {' '.join(str(error).split())}") from None
    known = known & np.isfinite(values).all(axis=0)
    if values.dtype.kind == "f":
        # A special pixel that the file does not declare spoils the average of all pixels that one stands for.
        known &= (np.abs(values) < MAX_VALUE / step**2).all(axis=0)
    opacity = known.astype(values.dtype)
    return Pixels(np.moveaxis(np.concatenate([values, opacity[None]]), 0, -1), known)


def _changed(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except (OSError, ValueError):
        # The reason is told where it is opened.
        return 0
