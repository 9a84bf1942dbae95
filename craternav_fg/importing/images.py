"""Plain grey images and the table of their times."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import InputError
from craternav_fg.tables import Column, read_table

FloatArray = npt.NDArray[np.float64]

_COLUMNS = (Column("filename", "text"), Column("utc", "text"))
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def stamp_of(utc: datetime) -> int:
    """Give the stamp of a time: UTC since 1970 without leap seconds.

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
        Stamp, ns, by file name.

    Raises
    ------
    InputError
        When the file is missing or wrong, or a name stands there twice.
    """
    table = read_table(path, _COLUMNS)
    out: dict[str, int] = {}
    for row, (name, utc) in enumerate(zip(table.columns["filename"], table.columns["utc"], strict=True)):
        if name in out:
            table.fail(row, "filename", f"expected each name once, found {name!r} again")
        try:
            out[name] = stamp_of(datetime.fromisoformat(utc))
        except ValueError:
            table.fail(row, "utc", f"expected a time as 1971-07-31T01:25:02.243, found {utc!r}")
    return out


def stamps_of(images: Sequence[Path], times: Path) -> list[int]:
    """Look up the times of images.

    Parameters
    ----------
    images : sequence of Path
    times : Path
        Table, see `read_times`.

    Returns
    -------
    list of int
        Stamps, ns.

    Raises
    ------
    InputError
        When the table has no time for one of them.
    """
    known = read_times(times)
    for path in images:
        if path.name not in known:
            raise InputError(times, f"expected a row for {path.name}, found {len(known)} others")
    return [known[path.name] for path in images]


def grey_images(paths: Sequence[Path], size_px: tuple[int, int] | None = None) -> Iterator[ImageArray]:
    """Read grey images one by one.

    Parameters
    ----------
    paths : sequence of Path
    size_px : (int, int), optional
        Width and height that all must have; by default those of the first.

    Yields
    ------
    ndarray of uint8 or uint16, shape (height, width)

    Raises
    ------
    InputError
        When an image cannot be read, is not grey, or is of another size or depth than the first.
    """
    first: tuple[Path, np.dtype[np.generic]] | None = None
    for path in paths:
        image = read_foreign_image(path)
        if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
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
        yield np.asarray(image)


def _kind(image: npt.NDArray[np.generic]) -> str:
    channels = 1 if image.ndim == 2 else image.shape[2]
    return f"{channels} channels of {image.dtype}"


def grey_levels(images: Sequence[FloatArray], bit_depth: int) -> list[ImageArray]:
    """Scale images of any values to grey levels, all by one line from the least to the largest value.

    Parameters
    ----------
    images : sequence of ndarray, shape (height, width)
        In any one unit; NaN where there is no value: becomes 0.
    bit_depth : int
        8, or up to 16.

    Returns
    -------
    list of ndarray of uint8 or uint16, shape (height, width)
        Grey levels.
    """
    least = min(float(np.nanmin(image)) for image in images)
    most = max(float(np.nanmax(image)) for image in images)
    scale = (2**bit_depth - 1) / (most - least) if most > least else 0.0
    levels = [np.nan_to_num(np.round((image - least) * scale)) for image in images]
    if bit_depth == 8:
        return [image.astype(np.uint8) for image in levels]
    return [image.astype(np.uint16) for image in levels]
