"""Scores of blind detection on annotated real images, which are not shipped."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import InputError
from craternav_fg.evaluation.annotation import Matches, Scores, match_circles, scores
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import BlindOptions, find_rims
from craternav_fg.vision.learned import find_rims_learned

FloatArray = npt.NDArray[np.float64]

METHODS = {"learned": find_rims_learned, "template": find_rims, "canny": find_rims_canny}
# Radii above which scores are given, and the smallest searched: a rim of 8 px may be measured smaller.
RADII_PX = (12.0, 8.0)
SEARCHED_PX = 6.0
# The average precision and the calibration need unlikely craters, too.
LISTED_QUALITY = 0.05
# Where one row per image is that people marked.
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


class Row(NamedTuple):
    """Scores of one method on one kind of images, above one radius."""

    kind: str
    method: str
    min_radius_px: float
    scores: Scores


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


def run(data: Path, min_quality: float, progress: Callable[[int, int], None]) -> list[Row]:
    """Score all methods on the annotated images below a folder.

    Parameters
    ----------
    data : Path
    min_quality : float
        Least quality of a detection.
    progress : callable
        Called with the number of images done and of all.

    Returns
    -------
    list of Row

    Raises
    ------
    InputError
        When there is no annotated image.
    """
    images = list(annotated_images(data))
    if not images:
        raise InputError(data, f"expected annotated images in {NAC} or {HRSC}, found none")
    found: dict[tuple[str, str], list[Matches]] = {}
    for done, image in enumerate(images):
        pixels = read_foreign_image(image.path)
        for method, find in METHODS.items():
            # Rules have no probability below their own threshold.
            least = LISTED_QUALITY if method == "learned" else min_quality
            rims = find(pixels, None, BlindOptions(min_radius_px=SEARCHED_PX, min_quality=least))
            matches = match_circles(rims.ellipses_px, rims.quality, image.circles_px)
            found.setdefault((image.kind, method), []).append(matches)
        progress(done + 1, len(images))
    return [
        Row(kind, method, radius, scores(Matches.joined(parts), radius, min_quality))
        for (kind, method), parts in found.items()
        for radius in RADII_PX
    ]


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
