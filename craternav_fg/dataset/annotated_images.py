"""Images in which people marked craters: NAC mosaics with boxes, HRSC tiles with circles. Not shipped."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from craternav_fg.tables import Column, read_table
from factors.arrays import FloatArray

_BOX = tuple(Column(name) for name in "XYWH")
_CIRCLE = tuple(Column(name) for name in ("x", "y", "diameter"))
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
        When a file of marks is missing, or is no table of finite numbers: names line and column.
    """
    for path in sorted((data / NAC).glob("*.png")):
        yield Annotated("nac", path, _boxes(path.with_suffix(".txt")))
    for path in sorted((data / HRSC).glob("tile*.pgm")):
        yield Annotated("hrsc", path, _circles(path.with_name(f"{path.stem.removeprefix('tile')}_gt.csv")))


def _boxes(path: Path) -> FloatArray:
    """Read boxes: columns X, Y of the upper left corner, W, H, px from 0 at the image's edge."""
    x, y, width, height = read_table(path, _BOX, others=True).numbers(*"XYWH").T
    return np.column_stack([x + 0.5 * width - 0.5, y + 0.5 * height - 0.5, 0.25 * (width + height)])


def _circles(path: Path) -> FloatArray:
    """Read circles: x, y, diameter, px."""
    return read_table(path, _CIRCLE, headed=False).numbers("x", "y", "diameter") * (1.0, 1.0, 0.5)
