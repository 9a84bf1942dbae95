"""How well and how fast craters are found without a prior, on rendered ground whose rims are known."""

import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from craternav_fg.evaluation.detection import match
from craternav_fg.simulation.scenes import HARD, LEAST_PX, Scene, scene
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import FoundRims, find_rims

Detector = Callable[[npt.NDArray[np.uint8]], FoundRims]

REPETITIONS = 3


def accuracy(scenes: list[Scene], detector: Detector) -> dict[str, float]:
    """Recall, precision and mean absolute errors, px, over all scenes.

    A detection below `LEAST_PX` that matches nothing does not count: uncatalogued craters are as small.
    """
    hits, missed, false = 0, 0, 0
    errors = []
    for one in scenes:
        found = detector(one.image).ellipses_px
        result = match(found, one.ellipses_px, one.wanted, found[:, 3] >= LEAST_PX)
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


def detect_ms(images: int = 6) -> dict[str, float]:
    """Measure both detectors on plain ground, and the better one on hard ground.

    Parameters
    ----------
    images : int
        Of each kind, 1024 x 1024 px.

    Returns
    -------
    dict
        `detect_ms`, the median duration on plain ground, and the figures of `accuracy` under the prefixes
        `detect_`, `detect_hard_` and `detect_canny_`.
    """
    plain = [scene(seed) for seed in range(images)]
    hard = [scene(seed, HARD) for seed in range(images)]
    cases = (("", plain, find_rims), ("hard_", hard, find_rims), ("canny_", plain, find_rims_canny))
    figures = {
        f"detect_{prefix}{name}": value
        for prefix, scenes, detector in cases
        for name, value in accuracy(scenes, detector).items()
    }
    return {"detect_ms": float(np.median([_duration_ms(one.image) for one in plain])), **figures}


def _duration_ms(image: npt.NDArray[np.uint8]) -> float:
    """Duration of one detection: the shortest of a few, the others were disturbed."""
    durations = []
    for _ in range(REPETITIONS):
        began_s = time.perf_counter()
        find_rims(image)
        durations.append(time.perf_counter() - began_s)
    return 1e3 * min(durations)
