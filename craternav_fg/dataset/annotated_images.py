"""Images in which people marked craters: NAC mosaics with boxes, HRSC tiles with circles. Not shipped."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.errors import InputError

FloatArray = npt.NDArray[np.float64]

# Folders of the kinds of images.
NAC, HRSC = "annotated/nac", "annotated/hrsc"


class Annotated(NamedTuple):
    """An annotated image.

    Attributes
    ----------
    kind : str
        Kind of the images: they are scored together.
    path : Path
    circles_px : ndarray, shape (n, 3)
        What people marked in the image: centre x, y and radius.
    """

    kind: str
    path: Path
    circles_px: FloatArray


def annotated_images(data: Path) -> Iterator[Annotated]:
    """Find the annotated images below a folder: NAC mosaics with boxes, HRSC tiles with circles.

    Parameters
    ----------
    data : Path
        Has `annotated/nac/*.png` with `*.txt` beside, or `annotated/hrsc/tile*.pgm` with `*_gt.csv`.

    Yields
    ------
    Annotated

    Raises
    ------
    InputError
        When a file of circles is missing or has other columns.
    """
    for path in sorted((data / NAC).glob("*.png")):
        yield Annotated("nac", path, _boxes(path.with_suffix(".txt")))
    for path in sorted((data / HRSC).glob("tile*.pgm")):
        yield Annotated("hrsc", path, _circles(path.with_name(f"{path.stem.removeprefix('tile')}_gt.csv")))


def _boxes(path: Path) -> FloatArray:
    """Read boxes: columns X, Y of the upper left corner, W, H, px from 0 at the image's edge."""
    rows = _rows(path, header=True)
    x, y, width, height = rows[:, 1:5].T
    return np.column_stack([x + 0.5 * width - 0.5, y + 0.5 * height - 0.5, 0.25 * (width + height)])


def _circles(path: Path) -> FloatArray:
    """Read circles: x, y, diameter, px."""
    return _rows(path, header=False)[:, :3] * (1.0, 1.0, 0.5)


def _rows(path: Path, *, header: bool) -> FloatArray:
    if not path.is_file():
        raise InputError(path, "file is missing")
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[int(header) :]
    try:
        values = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise InputError(path, f"expected numbers: {error}") from None
    if values.ndim != 2 or values.shape[1] < (5 if header else 3):
        raise InputError(path, "expected columns of places and sizes")
    return values
