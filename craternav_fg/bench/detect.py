"""Speed and accuracy of blind detection, in rendered images whose rims are known."""

import time
from functools import partial

import numpy as np

from craternav_fg.bench.timing import shortest_ms
from craternav_fg.reproduce.detection_accuracy import accuracy
from craternav_fg.simulation.scenes import HARD, scene
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.network_detect import find_rims_network


def detect_ms(images: int = 6) -> dict[str, float]:
    """Measure detection on plain terrain and on overlapping craters in rough terrain, and other methods.

    Parameters
    ----------
    images : int
        Number of each kind, 1024 x 1024 px.

    Returns
    -------
    dict of str to float
        `detect_ms`, the median duration on plain terrain, and the figures of
        `craternav_fg.reproduce.detection_accuracy.accuracy` under the prefixes `detect_`, `detect_hard_`,
        `detect_template_hard_` and `detect_canny_`.
    """
    plain = [scene(seed) for seed in range(images)]
    hard = [scene(seed, HARD) for seed in range(images)]
    cases = (
        ("", plain, find_rims_network),
        ("hard_", hard, find_rims_network),
        ("template_hard_", hard, find_rims),
        ("canny_", plain, find_rims_canny),
    )
    figures = {
        f"detect_{prefix}{name}": value
        for prefix, scenes, detector in cases
        for name, value in accuracy(scenes, detector).items()
    }
    durations = [shortest_ms(partial(find_rims_network, one.image), time.perf_counter) for one in plain]
    return {"detect_ms": float(np.median(durations)), **figures}
