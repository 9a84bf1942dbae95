"""Scores of blind detection on rendered ground: `python -m tests.vision.detection_scores` prints the table.

It is that of network and template in `docs/benchmarks.md`.
"""

import sys
from collections.abc import Iterator

from craternav_fg.reproduce.detection_accuracy import accuracy
from craternav_fg.simulation.scenes import HARD, IRREGULAR, Ground, scene
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.network_detect import find_rims_network

# Kinds of ground, and numbers of scenes.
GROUNDS = {
    "plain": (Ground(), 10),
    "outlines 3 % off an ellipse": (IRREGULAR, 4),
    "overlapping craters, rough ground": (HARD, 10),
}
METHODS = {"network": find_rims_network, "template": find_rims}


def rows() -> Iterator[str]:
    """Lines of the table."""
    for ground, (kind, count) in GROUNDS.items():
        scenes = [scene(seed, kind) for seed in range(count)]
        for method, detector in METHODS.items():
            found = accuracy(scenes, detector)
            errors = ", ".join(
                f"{found[f'{name}_px']:.2f}" for name in ("centre", "semi_major", "semi_minor")
            )
            yield f"| {ground} | {method} | {found['recall']:.2f} | {found['precision']:.2f} | {errors} |"


if __name__ == "__main__":
    for row in rows():
        sys.stdout.write(f"{row}\n")
        sys.stdout.flush()
