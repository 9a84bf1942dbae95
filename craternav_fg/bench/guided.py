"""Cost and accuracy of measuring catalogue rims and sun tilts from predicted poses."""

import numpy as np

from craternav_fg.bench.timing import shortest_ms
from craternav_fg.reproduce.guided_accuracy import (
    HELD_OUT_SEED,
    LARGE_ERROR,
    USUAL_ERROR,
    accuracy,
    predicted,
    sun_tilts,
)
from craternav_fg.simulation.scenes import IRREGULAR, Ground, Scene, scene
from craternav_fg.vision.guided import GuidedFrontEnd


def guided_costs(images: int = 6) -> dict[str, float]:
    """Measure rims and sun tilts in images that were not used for set-up.

    Parameters
    ----------
    images : int
        Number of each kind, 1024 x 1024 px.

    Returns
    -------
    dict of str to float
        `rim_ms`, the processor time of guided measurement, with the sun tilt, per rim measured on plain
        terrain; the figures of `accuracy` under the prefixes `guided_`, `guided_irregular_` (outlines 3 %
        off their ellipses) and `guided_lost_` (predictions with the errors `LARGE_ERROR`), and those of
        `sun_tilts` under `sun_nadir_` and `sun_oblique_` (30 deg off nadir).
    """
    plain = [scene(HELD_OUT_SEED + k) for k in range(images)]
    irregular = [scene(HELD_OUT_SEED + 100 + k, IRREGULAR) for k in range(images)]
    cases = (("", plain, USUAL_ERROR), ("irregular_", irregular, USUAL_ERROR), ("lost_", plain, LARGE_ERROR))
    figures = {
        f"guided_{prefix}{name}": value
        for prefix, scenes, error in cases
        for name, value in accuracy(scenes, error).items()
    }
    for name, tilt_deg in (("nadir", 0.0), ("oblique", 30.0)):
        ground = Ground(tilt_deg=(tilt_deg, tilt_deg))
        for key, value in sun_tilts([scene(HELD_OUT_SEED + 200 + k, ground) for k in range(images)]).items():
            figures[f"sun_{name}_{key}"] = value
    return {"rim_ms": float(np.median([_rim_ms(one) for one in plain])), **figures}


def _rim_ms(one: Scene) -> float:
    """Processor time of one image per rim: the shortest of a few, as other programs disturb the rest."""
    gTb, covariance = predicted(one, USUAL_ERROR, np.random.default_rng(0))
    front_end = GuidedFrontEnd(one.camera, one.catalog)
    counts = []

    def measure() -> None:
        counts.append(len(front_end.measure(one.image, 0, gTb, covariance, one.sun_g).rims))

    return shortest_ms(measure) / max(counts[0], 1)
