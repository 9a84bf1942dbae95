"""Scores of blind detection on rendered ground: `python -m tests.vision.detection_scores` prints the table.

It is that of `docs/benchmarks.md`, of ten scenes of each kind.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace

from craternav_fg.reproduce.detection_accuracy import accuracy
from craternav_fg.simulation.scenes import HARD, IRREGULAR, Ground, scene
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.network_detect import find_rims_network

SCENES = 10
METHODS = {"network": find_rims_network, "template": find_rims}
GROUNDS = {
    "plain": (Ground(), {**METHODS, "canny": find_rims_canny}),
    "outlines 3 % off an ellipse": (IRREGULAR, METHODS),
    "overlapping craters, rough ground": (HARD, METHODS),
    "the same, outlines 3 % off": (replace(HARD, irregularity_share=IRREGULAR.irregularity_share), METHODS),
}


def rows() -> Iterator[str]:
    """Lines of the table."""
    for ground, (kind, methods) in GROUNDS.items():
        scenes = [scene(seed, kind) for seed in range(SCENES)]
        for method, detector in methods.items():
            found = accuracy(scenes, detector)
            errors = ", ".join(
                f"{found[f'{name}_px']:.2f}" for name in ("centre", "semi_major", "semi_minor")
            )
            scores = f"{found['recall']:.2f} | {found['precision']:.2f} | {errors}"
            yield f"| {ground} ({found['rims']:.0f} rims) | {method} | {scores} |"


if __name__ == "__main__":
    for row in rows():
        sys.stdout.write(f"{row}\n")
        sys.stdout.flush()
