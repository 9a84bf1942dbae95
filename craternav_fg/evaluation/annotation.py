"""Scores of detected craters against circles that people marked."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray, IntArray

# A detection is a marked crater if its centre is within half a radius and 1 px, its radius within a factor.
CENTRE_SHARE, CENTRE_PX, SIZE_FACTOR = 0.5, 1.0, 1.6
# Bins of the reliability diagram.
_BINS = 10


@dataclass(frozen=True)
class Matches:
    """Detections of some images, and the marked craters that they are.

    Attributes
    ----------
    quality : ndarray, shape (n,)
        Probabilities of the detections.
    radius_px : ndarray, shape (n,)
        Radii of the detections.
    marked_radius_px : ndarray, shape (n,)
        Radii of the marked craters; NaN for a detection that is none.
    centre_error_px : ndarray, shape (n,)
        Distance of the centres; NaN likewise.
    all_marked_px : ndarray, shape (m,)
        Radii of all marked craters.
    found_by : ndarray of int, shape (m,)
        Row of the detection of each marked crater; -1 where there is none.
    """

    quality: FloatArray
    radius_px: FloatArray
    marked_radius_px: FloatArray
    centre_error_px: FloatArray
    all_marked_px: FloatArray
    found_by: IntArray

    @classmethod
    def joined(cls, parts: "list[Matches]") -> "Matches":
        """Put the matches of several images together."""
        names = ("quality", "radius_px", "marked_radius_px", "centre_error_px", "all_marked_px")
        before = np.cumsum([0, *(len(part.quality) for part in parts[:-1])])
        found_by = [
            np.where(part.found_by >= 0, part.found_by + first, -1)
            for part, first in zip(parts, before, strict=True)
        ]
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(**joined, found_by=np.concatenate(found_by))


@dataclass(frozen=True)
class Scores:
    """Scores of detections above a radius.

    Attributes
    ----------
    recall, precision, f1 : float
    average_precision : float
        Area below precision over recall.
    recall_at_90 : float
        Largest recall at a precision of at least 0.9.
    centre_radii, log_radius : float
        Median distance of the centres, in radii, and median logarithm of the radius over the marked one.
    calibration_error : float
        Mean difference of quality and share of right detections, over bins of quality.
    """

    recall: float
    precision: float
    f1: float
    average_precision: float
    recall_at_90: float
    centre_radii: float
    log_radius: float
    calibration_error: float


def match_circles(ellipses_px: FloatArray, quality: FloatArray, circles_px: FloatArray) -> Matches:
    """Match the detections of an image with the circles that people marked, the best first.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre x, y, semi-axes and rotation (rad), px.
    quality : ndarray, shape (n,)
        Probabilities.
    circles_px : ndarray, shape (m, 3)
        What people marked in the image: centre x, y and radius.

    Returns
    -------
    Matches
        In the order of falling quality.
    """
    order = np.argsort(-quality, kind="stable")
    radius = np.sqrt(ellipses_px[order, 2] * ellipses_px[order, 3])
    marked, error = np.full(len(order), np.nan), np.full(len(order), np.nan)
    found_by = np.full(len(circles_px), -1)
    for k, row in enumerate(order):
        off = np.hypot(*(circles_px[:, :2] - ellipses_px[row, :2]).T)
        size = np.abs(np.log(circles_px[:, 2] / radius[k]))
        (open_,) = np.nonzero(
            (found_by < 0)
            & (off < CENTRE_SHARE * circles_px[:, 2] + CENTRE_PX)
            & (size < np.log(SIZE_FACTOR))
        )
        if len(open_):
            best = open_[int(np.argmin(off[open_] / circles_px[open_, 2] + size[open_]))]
            found_by[best] = k
            marked[k], error[k] = circles_px[best, 2], off[best]
    return Matches(quality[order], radius, marked, error, circles_px[:, 2], found_by)


def scores(matches: Matches, min_radius_px: float, min_quality: float) -> Scores:
    """Compute the scores of the craters above a radius.

    Recall counts marked craters above the radius. Precision counts detections above it: one of a marked
    crater of any size is right, one that nobody marked is wrong, crater or not.

    Parameters
    ----------
    matches : Matches
    min_radius_px : float
    min_quality : float
        Minimum quality of a detection; the average precision counts all.

    Returns
    -------
    Scores
    """
    order = np.argsort(-matches.quality, kind="stable")
    right = np.isfinite(matches.marked_radius_px[order])
    large = matches.radius_px[order] >= min_radius_px
    wanted = max(int(np.sum(matches.all_marked_px >= min_radius_px)), 1)
    found = np.cumsum(matches.marked_radius_px[order] >= min_radius_px) / wanted
    sure = np.cumsum(right & large) / np.maximum(np.cumsum(large), 1)
    area = float(np.sum(np.diff(np.concatenate([[0.0], found])) * sure)) if len(found) else 0.0
    at_90 = float(np.max(found[sure >= 0.9], initial=0.0))
    last = int(np.sum(matches.quality >= min_quality)) - 1
    recall, precision = (float(found[last]), float(sure[last])) if last >= 0 else (0.0, float("nan"))
    both = matches.quality >= min_quality
    both &= matches.marked_radius_px >= min_radius_px
    centre = matches.centre_error_px[both] / matches.marked_radius_px[both]
    size = np.log(matches.radius_px[both] / matches.marked_radius_px[both])
    return Scores(
        recall, precision, 2.0 * recall * precision / max(recall + precision, 1e-300), area, at_90,
        float(np.median(centre)) if len(centre) else float("nan"),
        float(np.median(size)) if len(size) else float("nan"),
        _calibration_error(matches.quality[order][large], right[large]),
    )  # fmt: skip


def _calibration_error(quality: FloatArray, right: npt.NDArray[np.bool_]) -> float:
    """Mean difference of probability and share of right ones, over bins of the probability."""
    if not len(quality):
        return float("nan")
    bins = np.minimum((_BINS * quality).astype(np.int64), _BINS - 1)
    off = [abs(np.sum(quality[bins == k]) - np.sum(right[bins == k])) for k in range(_BINS)]
    return float(np.sum(off) / len(quality))
