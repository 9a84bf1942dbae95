"""How many neighbouring images of a descent err alike, of rims that are measured from known poses.

`python -m craternav_fg.calibration posed_images FOLDER` renders descents over the crops of the elevation
model in FOLDER, which differ in what the model does not show, and measures each crater in each descent from
the true poses. A crater's means differ from descent to descent as much as images of one descent, divided by
the number of views: images_per_view is what makes the mean squared difference as large as expected.
"""

import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.optimize import brentq

from craternav_fg.calibration.common_shift import SCENARIOS
from craternav_fg.dataset import Dataset
from craternav_fg.mapping.posed_images import Seen, errors_in_images, moments
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from factors.arrays import FloatArray

_TRIALS = (7, 8, 9)
_RANGE = (0.5, 20.0)


def images_per_view(descents: list[list[Seen]]) -> float:
    """Fit the number of images whose errors are one and the same.

    Parameters
    ----------
    descents : list of list of dict of int to ndarray, shape (n, 5)
        Errors of craters, see `mapping.posed_images.map_errors_of_rims`, of several descents over each of
        several grounds.

    Returns
    -------
    float
        Within 0.5 to 20.
    """

    def excess(size: float) -> float:
        squares = np.concatenate([_normalised(seen, size) for seen in descents])
        # No crater is in so many images.
        return float(np.mean(squares)) - 1.0 if len(squares) else -1.0

    low, high = _RANGE
    if excess(low) < 0.0:
        return low
    return high if excess(high) > 0.0 else float(brentq(excess, low, high, xtol=0.01))


def _normalised(descents: list[Seen], size: float) -> FloatArray:
    """Squared differences of craters' means between descents, over their variances (n, 5)."""
    out: list[FloatArray] = []
    found = [(seen, *moments(seen, size)) for seen in descents]
    for (one, mean, variance), (other, again, spread) in combinations(found, 2):
        for row in variance.keys() & spread.keys():
            expected = size * (variance[row] / len(one[row]) + spread[row] / len(other[row]))
            out.append((mean[row] - again[row]) ** 2 / expected)
    return np.array(out).reshape(-1, 5)


def posed_images(folder: Path) -> None:
    """Render the descents, fit, and print the number of images.

    Parameters
    ----------
    folder : Path
        With the files that the scenarios name.
    """
    console = Console()
    every: list[list[Seen]] = []
    for name in SCENARIOS:
        case = load_scenario(name).with_data(folder)
        with tempfile.TemporaryDirectory() as work:
            images = [Dataset.open(simulate(case, Path(work) / f"{trial}", trial=trial)) for trial in _TRIALS]
            every.append([errors_in_images(one.catalog, [one]) for one in images])
        console.print(
            f"{name}: {len(every[-1][0])} craters, {images_per_view(every[-1:]):.1f} images per view"
        )
    console.print(f"images_per_view = {images_per_view(every):.1f}")
