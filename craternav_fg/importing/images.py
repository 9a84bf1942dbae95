"""Grey images, plain or of PDS4 products, and their times: of a table or of the labels."""

import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import InputError
from craternav_fg.importing.leap_seconds import is_leap_second
from craternav_fg.importing.pds4 import is_label, read_pds4
from craternav_fg.tables import Column, read_table
from factors.arrays import FloatArray

_COLUMNS = (Column("filename", "text"), Column("utc", "text"))
# Decimals that datetime drops, of a time as it is written.
_NANOSECONDS = re.compile(r"[.,]\d{6}(\d{1,3})")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def stamp_of(utc: datetime) -> int:
    """Return the stamp of a time: UTC since 1970 without leap seconds.

    Parameters
    ----------
    utc : datetime
        Without a time zone it is taken for UTC.

    Returns
    -------
    int
        In ns.
    """
    since = (utc if utc.tzinfo is not None else utc.replace(tzinfo=UTC)) - _EPOCH
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def read_times(path: Path) -> dict[str, int]:
    """Read the times of images.

    Parameters
    ----------
    path : Path
        CSV with the columns filename and utc (ISO 8601).

    Returns
    -------
    dict of str to int
        Stamp, ns, by file name in composed characters.

    Raises
    ------
    InputError
        When the file is missing or wrong, or a name stands there twice.
    """
    table = read_table(path, _COLUMNS)
    out: dict[str, int] = {}
    names = map(_composed, table.columns["filename"])
    for row, (name, utc) in enumerate(zip(names, table.columns["utc"], strict=True)):
        if name in out:
            table.fail(row, "filename", f"expected each name once, found {name!r} again")
        try:
            out[name] = _stamp_of_text(utc)
        except ValueError:
            expected = "expected a time as 1971-07-31T01:25:02.243"
            if is_leap_second(utc):
                expected = "expected a time outside of leap seconds, of which there are no stamps"
            table.fail(row, "utc", f"{expected}, found {utc!r}")
    return out


def _stamp_of_text(utc: str) -> int:
    """Return the stamp, ns, of a time in ISO 8601; a `ValueError` for other text."""
    below = _NANOSECONDS.search(utc)
    return stamp_of(datetime.fromisoformat(utc)) + (int(f"{below[1]:0<3}") if below else 0)


def stamps_of(images: Sequence[Path], times: Path | None) -> list[int]:
    """Look up the times of images.

    Parameters
    ----------
    images : sequence of Path
    times : Path or None
        Table, see `read_times`; None where all images are PDS4 labels, which have their times.

    Returns
    -------
    list of int
        Stamps, ns.

    Raises
    ------
    InputError
        When the table, or the label, has no time for one of them.
    """
    if times is None:
        plain = next((path for path in images if not is_label(path)), None)
        if plain is not None:
            raise InputError(plain, "has no time of its own, as PDS4 labels have: give --times")
        return [stamp_of(read_pds4(path).middle()) for path in images]
    known = read_times(times)
    for path in images:
        if _composed(path.name) not in known:
            raise InputError(times, f"expected a row for {path.name}, found {len(known)} others")
    return [known[_composed(path.name)] for path in images]


def _composed(name: str) -> str:
    """Return a name in composed characters: file systems and editors write an umlaut as one or as two."""
    return unicodedata.normalize("NFC", name)


def grey_images(
    paths: Sequence[Path], size_px: tuple[int, int] | None = None, bit_depth: int | None = None
) -> Iterator[ImageArray]:
    """Read grey images one by one.

    Parameters
    ----------
    paths : sequence of Path
        Image files, or labels of PDS4 products.
    size_px : (int, int), optional
        Width and height that all must have; by default those of the first.
    bit_depth : int, optional
        Bits of the camera's grey levels, 8 to 16, which all images must fit; by default those of the first.
        PDS4 images of other numbers than grey levels are scaled to them, all alike.

    Yields
    ------
    ndarray of uint8 or uint16, shape (height, width)

    Raises
    ------
    InputError
        When an image cannot be read, is not grey, is of another size or depth than the first, or has
        grey levels that the camera cannot have.
    """
    first: tuple[Path, np.dtype[np.generic]] | None = None
    extent: tuple[float, float] | None = None
    for path in paths:
        image = _read(path)
        grey = image.dtype in (np.uint8, np.uint16) or (is_label(path) and image.dtype == np.float64)
        if image.ndim != 2 or not grey:
            raise InputError(path, f"expected a grey image of 8 or 16 bits, found {_kind(image)}")
        found = image.shape[1], image.shape[0]
        if size_px is None:
            size_px = found
        if found != size_px:
            expected = f"{size_px[0]} x {size_px[1]}"
            of = "as the camera has" if first is None else f"as {first[0]}"
            raise InputError(path, f"expected {expected} px, {of}, found {found[0]} x {found[1]}")
        if first is not None and image.dtype != first[1]:
            raise InputError(path, f"expected {first[1]} pixels as {first[0]}, found {image.dtype}")
        first = first or (path, image.dtype)
        if image.dtype == np.float64:
            extent = extent or _extent((path, _read(path)) for path in paths)
            yield _scaled(image, extent, bit_depth or 16)
        else:
            yield _fitting(path, np.asarray(image), bit_depth)


def _read(path: Path) -> npt.NDArray[np.generic]:
    return read_pds4(path).pixels() if is_label(path) else read_foreign_image(path)


def _fitting(path: Path, image: ImageArray, bit_depth: int | None) -> ImageArray:
    """Refuse grey levels that the camera cannot have."""
    depth, largest = 8 * image.dtype.itemsize, int(image.max())
    if bit_depth is not None and (depth != (8 if bit_depth == 8 else 16) or largest >= 2**bit_depth):
        problem = f"expected grey levels of {bit_depth} bits, as the camera's bit_depth says"
        raise InputError(path, f"{problem}, found a {depth}-bit image with levels up to {largest}")
    return image


def _extent(images: Iterable[tuple[Path, npt.NDArray[np.generic]]]) -> tuple[float, float]:
    """Smallest and largest value of all images."""
    ends = []
    for path, image in images:
        values = np.asarray(image, dtype=np.float64)
        if np.isnan(values).all():
            raise InputError(path, "expected values, found none but special constants")
        ends.append((float(np.nanmin(values)), float(np.nanmax(values))))
    return min(least for least, _ in ends), max(most for _, most in ends)


def _kind(image: npt.NDArray[np.generic]) -> str:
    channels = 1 if image.ndim == 2 else image.shape[2]
    return f"{channels} channels of {image.dtype}"


def grey_levels(paths: Sequence[Path], images: Sequence[FloatArray], bit_depth: int) -> list[ImageArray]:
    """Scale images of any values to grey levels, all by one line from the smallest to the largest value.

    Parameters
    ----------
    paths : sequence of Path
        Where they come from.
    images : sequence of ndarray, shape (height, width)
        In any one unit; NaN where there is no value: becomes 0.
    bit_depth : int
        8, or up to 16.

    Returns
    -------
    list of ndarray of uint8 or uint16, shape (height, width)
        Grey levels.

    Raises
    ------
    InputError
        When an image has no value.
    """
    extent = _extent(zip(paths, images, strict=True))
    return [_scaled(image, extent, bit_depth) for image in images]


def _scaled(image: npt.NDArray[np.generic], extent: tuple[float, float], bit_depth: int) -> ImageArray:
    least, most = extent
    scale = (2**bit_depth - 1) / (most - least) if most > least else 0.0
    levels = np.nan_to_num(np.round((image.astype(np.float64) - least) * scale))
    return levels.astype(np.uint8) if bit_depth == 8 else levels.astype(np.uint16)
