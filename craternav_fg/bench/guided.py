"""What it costs to measure catalogue rims from predicted poses, and how well that is done."""

import time

import numpy as np

from craternav_fg.reproduce.guided_accuracy import FAR, HELD_OUT, NEAR, accuracy, predicted, sun_tilts
from craternav_fg.simulation.scenes import IRREGULAR, Ground, Scene, scene
from craternav_fg.vision.guided import GuidedFrontEnd

REPETITIONS = 3


def guided_costs(images: int = 6) -> dict[str, float]:
    """Measure rims and tilts in held-out images.

    Parameters
    ----------
    images : int
        Of each kind, 1024 x 1024 px.

    Returns
    -------
    dict
        `rim_ms`, the processor time of guided measurement, sun tilt and all, over the rims it measures on
        plain ground; the figures of `accuracy` under the prefixes `guided_`, `guided_irregular_` (outlines
        3 % off their ellipses) and `guided_lost_` (predictions `FAR` off), and those of `sun_tilts` under
        `sun_nadir_` and `sun_oblique_`, 30 deg off it.
    """
    plain = [scene(HELD_OUT + k) for k in range(images)]
    irregular = [scene(HELD_OUT + 100 + k, IRREGULAR) for k in range(images)]
    cases = (("", plain, NEAR), ("irregular_", irregular, NEAR), ("lost_", plain, FAR))
    figures = {
        f"guided_{prefix}{name}": value
        for prefix, scenes, prior in cases
        for name, value in accuracy(scenes, prior).items()
    }
    for name, tilt_deg in (("nadir", 0.0), ("oblique", 30.0)):
        ground = Ground(tilt_deg=(tilt_deg, tilt_deg))
        for key, value in sun_tilts([scene(HELD_OUT + 200 + k, ground) for k in range(images)]).items():
            figures[f"sun_{name}_{key}"] = value
    return {"rim_ms": float(np.median([_rim_ms(one) for one in plain])), **figures}


def _rim_ms(one: Scene) -> float:
    """Processor time of one image over its rims: the shortest of a few, the others were disturbed."""
    gTb, covariance = predicted(one, NEAR, np.random.default_rng(0))
    front_end = GuidedFrontEnd(one.camera, one.catalog)
    durations = []
    for _ in range(REPETITIONS):
        began_s = time.process_time()
        frame = front_end.measure(one.image, 0, gTb, covariance, one.sun_g)
        durations.append(time.process_time() - began_s)
    return 1e3 * min(durations) / max(len(frame.rims), 1)
