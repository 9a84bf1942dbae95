"""What the level of the ground leaves unknown of rims in the second world: python -m tests.foreign.rim_floor.

For all heights of the sun together, as `craternav_fg.calibration.rim_floor` does it for our own renders. It
takes ten minutes.
"""

import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from craternav_fg import frames
from craternav_fg.calibration.rim_floor import level_shares
from craternav_fg.calibration.single_rims import SingleRims, fitted_alone
from craternav_fg.dataset import Dataset
from tests.foreign.files import write
from tests.foreign.worlds import KINDS, draw_world

SUNS_DEG = (25.0, 40.0, 55.0, 68.0)
SEEDS = (11, 12)
_FRAMES = 6
say = Console(width=200, highlight=False, markup=False).print
# Of the predictions: half a pixel, and as much in position.
_ATTITUDE_SIGMA_RAD, _POSITION_SIGMA_M = 1e-3, 5.0


def rims_of(data: Dataset, rng: np.random.Generator) -> list[SingleRims]:
    """Fit the rims of a data set's images from predictions that are a little off."""
    assert data.truth is not None
    images = []
    for k, stamp in enumerate(data.stamps_ns.tolist()):
        true = data.truth.gTb[k]
        off = np.repeat([_ATTITUDE_SIGMA_RAD, _POSITION_SIGMA_M], 3) * rng.standard_normal(6)
        predicted = frames.pose(true[:3, :3] @ frames.rotation_exp(off[:3]), true[:3, 3] + off[3:])
        sun = data.sun.at(stamp)
        images.append(fitted_alone(data.image(k), data.camera, data.catalog, (predicted, true), sun))
    return [one for one in images if len(one.error)]


def main() -> None:
    """Print both shares as shipped and as fitted."""
    descents = []
    for kind in KINDS:
        for seed in SEEDS:
            for sun_deg in SUNS_DEG:
                world = draw_world(seed, kind, frames=_FRAMES, sun_deg=sun_deg)
                with tempfile.TemporaryDirectory() as folder:
                    data = Dataset.open(write(world, Path(folder) / "data", seed))
                    descents.append(rims_of(data, np.random.default_rng([seed, 1])))
    for one in level_shares([images for images in descents if images]):
        say(f"{one.name}: shipped {one.shipped:g}, fitted {one.value:.3f} +- {one.error:.3f}")


if __name__ == "__main__":
    main()
