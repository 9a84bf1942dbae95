"""Where the front end's errors come from: one property of the ground is left out, all else stays the same.

`python -m tests.foreign.left_out [KIND...]` prints the errors of rims whose predictions are nearly right.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from craternav_fg.dataset import Dataset
from craternav_fg.vision.guided import GuidedFrontEnd
from tests.foreign.files import write
from tests.foreign.rim_errors import RimErrors, errors_of_frame
from tests.foreign.worlds import KINDS, World, draw_world

PROPERTIES = ("roughness", "rolling", "outline", "albedo")
# Attitude, rad, and position, m.
_PREDICTED = np.diag(np.repeat([1e-3, 5.0], 3) ** 2)
say = Console(width=200, highlight=False, markup=False).print


def errors_of(world: World, data: Dataset) -> RimErrors:
    """Errors of all rims of a descent, with the true poses as predictions."""
    front_end = GuidedFrontEnd(data.camera, data.catalog)
    assert data.truth is not None
    parts = []
    for k, stamp in enumerate(data.stamps_ns.tolist()):
        sun = data.sun.at(stamp)
        found = front_end.measure(data.image(k), stamp, data.truth.gTb[k], _PREDICTED, sun)
        parts.append(errors_of_frame(world, k, found.rims))
    return RimErrors.joined(parts)


def without(kind: str, left_out: str | None, seeds: int = 5) -> list[RimErrors]:
    """Errors by descent over ground of a kind of which one property is left out."""
    ground = KINDS[kind] if left_out is None else replace(KINDS[kind], **{left_out: 0.0})
    out = []
    for seed in range(1, seeds + 1):
        world = draw_world(seed, kind, ground=ground)
        with tempfile.TemporaryDirectory() as folder:
            out.append(errors_of(world, Dataset.open(write(world, Path(folder) / "data", seed))))
    return out


if __name__ == "__main__":
    for name in sys.argv[1:] or ("rough", "patchy"):
        for one in (None, *PROPERTIES):
            descents = without(name, one)
            bias = [100.0 * errors.size.mean() for errors in descents]
            figures = RimErrors.joined(descents).summary()
            told = " ".join(f"{key} {value:.3f}" for key, value in figures.items())
            scatter = np.std(bias, ddof=1) / np.sqrt(len(bias))
            title = f"{name} {'whole' if one is None else 'without ' + one}"
            say(f"{title:26} {told}  bias of descents ± {scatter:.2f}")
