"""Scores of blind detection on annotated real images, which are not shipped."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset.annotated_images import HRSC, NAC, annotated_images
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import InputError
from craternav_fg.evaluation.annotation import Matches, Scores, match_circles, scores
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.circle_shading import shaded
from craternav_fg.vision.detect import BlindOptions, find_rims
from craternav_fg.vision.network_detect import find_rims_network
from factors.arrays import FloatArray, IntArray

METHODS = {
    "network": find_rims_network,
    "template": find_rims,
    "canny": find_rims_canny,
}
_RULES = ("template", "canny")
# Radii above which scores are given: the first is the largest that the network was trained on. The smallest
# searched: a rim of 8 px may be measured smaller.
RADII_PX = (104.0, 12.0, 8.0)
SEARCHED_PX = 5.0
# The average precision and the calibration need unlikely craters, too.
LISTED_QUALITY = 0.05

# Wear of craters: thirds of each image's marked ones by the contrast of the shading inside them.
WEAR = ("high contrast", "middle contrast", "low contrast")


class Row(NamedTuple):
    """Scores of one method on one kind of images, above one radius."""

    kind: str
    method: str
    min_radius_px: float
    scores: Scores


class WornRow(NamedTuple):
    """Marked craters of one kind of images and one class of wear, and how one method finds them.

    Centre and radius are medians over those found: distance of the centres, radii, and logarithm of the
    radius over the marked one.
    """

    kind: str
    method: str
    wear: str
    marked: int
    recall: float
    centre_radii: float
    log_radius: float


class Result(NamedTuple):
    """Scores by size, and by wear."""

    rows: list[Row]
    worn: list[WornRow]


def run(data: Path, min_quality: float, progress: Callable[[int, int], None]) -> Result:
    """Score all methods on the annotated images below a folder.

    Parameters
    ----------
    data : Path
    min_quality : float
        Minimum quality of a detection.
    progress : callable
        Called with the number of images done and of all.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        When there is no annotated image.
    """
    images = list(annotated_images(data))
    if not images:
        raise InputError(data, f"expected annotated images in {NAC} or {HRSC}, found none")
    found: dict[tuple[str, str], list[Matches]] = {}
    wear: dict[str, list[IntArray]] = {}
    for done, image in enumerate(images):
        pixels = read_foreign_image(image.path)
        wear.setdefault(image.kind, []).append(wear_classes(pixels, image.circles_px))
        for method, find in METHODS.items():
            # Rules have no probability below their own threshold.
            least = min_quality if method in _RULES else LISTED_QUALITY
            rims = find(pixels, None, BlindOptions(min_radius_px=SEARCHED_PX, min_quality=least))
            matches = match_circles(rims.ellipses_px, rims.quality, image.circles_px)
            found.setdefault((image.kind, method), []).append(matches)
        progress(done + 1, len(images))
    joined = {case: Matches.joined(parts) for case, parts in found.items()}
    rows = [
        Row(kind, method, radius, scores(matches, radius, min_quality))
        for (kind, method), matches in joined.items()
        for radius in RADII_PX
    ]
    worn = [
        _worn(case, name, matches, np.concatenate(wear[case[0]]) == k, min_quality)
        for case, matches in joined.items()
        for k, name in enumerate(WEAR)
    ]
    return Result(rows, worn)


def wear_classes(pixels: npt.NDArray[np.generic], circles_px: FloatArray) -> IntArray:
    """Divide marked craters by wear.

    Parameters
    ----------
    pixels : ndarray, shape (H, W) or (H, W, channels)
        The image.
    circles_px : ndarray, shape (m, 3)
        What people marked in the image: centre x, y and radius.

    Returns
    -------
    ndarray of int, shape (m,)
        Row of `WEAR`; -1 of craters below the smallest of `RADII_PX`.
    """
    out = np.full(len(circles_px), -1)
    (large,) = np.nonzero(circles_px[:, 2] >= min(RADII_PX))
    contrast = shaded(filled(brightness(pixels))[0], circles_px[large]).slope_contrast
    out[large[np.argsort(-contrast, kind="stable")]] = np.arange(len(large)) * len(WEAR) // max(len(large), 1)
    return out


def _worn(
    case: tuple[str, str], wear: str, matches: Matches, of_class: npt.NDArray[np.bool_], min_quality: float
) -> WornRow:
    """Return the scores of the marked craters of a class."""
    detection = matches.found_by[of_class]
    sure = detection[(detection >= 0) & (matches.quality[detection] >= min_quality)]
    marked_px = matches.marked_radius_px[sure]
    values = np.stack(
        [matches.centre_error_px[sure] / marked_px, np.log(matches.radius_px[sure] / marked_px)]
    )
    centre, size = np.median(values, axis=1).tolist() if len(sure) else (float("nan"), float("nan"))
    return WornRow(*case, wear, len(detection), len(sure) / max(len(detection), 1), centre, size)
