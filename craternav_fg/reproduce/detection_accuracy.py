"""Accuracy of blind detection in rendered scenes: recall, precision and errors of the rims."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from craternav_fg.evaluation.detection import match
from craternav_fg.simulation.scenes import MIN_SEMI_MINOR_PX, Scene
from craternav_fg.vision.detect import FoundRims

Detector = Callable[[npt.NDArray[np.uint8]], FoundRims]


def accuracy(scenes: Sequence[Scene], detector: Detector) -> dict[str, float]:
    """Recall, precision and mean absolute errors over all scenes.

    Ellipses whose rim was not traced are left out: they claim no accuracy of pixels. An unmatched detection
    below `MIN_SEMI_MINOR_PX` does not count as false: craters outside the catalogue are as small.

    Parameters
    ----------
    scenes : sequence of Scene
    detector : callable
        Gives the rims of an image.

    Returns
    -------
    dict of str to float
        `rims`, the number of rims that should be found; `recall`; `precision`; `centre_px`,
        `semi_major_px` and `semi_minor_px`.
    """
    hits, missed, false = 0, 0, 0
    errors = []
    for one in scenes:
        rims = detector(one.image)
        found = rims.ellipses_px[rims.traced]
        result = match(found, one.ellipses_px, one.wanted, found[:, 3] >= MIN_SEMI_MINOR_PX)
        hits += len(result.centre_px)
        missed += len(result.missed)
        false += len(result.false)
        errors.append(np.stack([result.centre_px, result.semi_major_px, result.semi_minor_px]))
    centre, major, minor = np.abs(np.concatenate(errors, axis=1)).mean(axis=1)
    return {
        "rims": hits + missed,
        "recall": hits / max(hits + missed, 1),
        "precision": hits / max(hits + false, 1),
        "centre_px": float(centre),
        "semi_major_px": float(major),
        "semi_minor_px": float(minor),
    }
