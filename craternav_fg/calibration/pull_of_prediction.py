"""How far a rim follows the place where the map predicts it, on real ground with a published map.

`python -m craternav_fg.calibration pull_of_prediction FOLDER` renders descents over the crops of the
elevation model in FOLDER and measures the rims of their images twice: with the published map, and with one
whose craters are moved at random by the errors that it states. The image is the same, so a measured rim must
not follow its prediction.
"""

import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from craternav_fg.calibration.common_shift import SCENARIOS
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.guided_options import GuidedOptions
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Standard deviations of the poses that guide the front end: only the map is off.
_ATTITUDE_RAD, _POSITION_M = 2e-4, 50.0
_FRAME_STEP = 4


class View(NamedTuple):
    """An image and how it was taken.

    Attributes
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    """

    image: ImageArray
    gTb: FloatArray
    sun_g: FloatArray


class Pull(NamedTuple):
    """Motion of measured rims over that of the predicted ones.

    Attributes
    ----------
    slope : float
        By least squares over the rims that both maps find: 0 for independent measurements.
    rims : int
        Number of these.
    """

    slope: float
    rims: int


def moved_at_random(catalog: Catalog, rng: np.random.Generator) -> Catalog:
    """Move the craters of a catalogue by the errors that it states.

    Parameters
    ----------
    catalog : Catalog
        With errors.
    rng : numpy.random.Generator

    Returns
    -------
    Catalog

    Raises
    ------
    ValueError
        Without errors.
    """
    if catalog.errors is None:
        raise ValueError("catalog: expected stated errors, found none")
    east, north = catalog.errors.place_m / catalog.body.radius_m * rng.standard_normal((2, len(catalog)))
    return replace(
        catalog,
        latitude_rad=catalog.latitude_rad + north,
        longitude_rad=catalog.longitude_rad + east / np.cos(catalog.latitude_rad),
    )


def pull(
    views: Iterable[View], camera: Camera, maps: tuple[Catalog, Catalog], options: GuidedOptions
) -> Pull:
    """Measure how far rims follow their predicted places.

    Parameters
    ----------
    views : iterable of View
        The poses are those from which the images were taken.
    camera : Camera
    maps : tuple of Catalog
        Two of the same craters, in the same order.
    options : GuidedOptions

    Returns
    -------
    Pull

    Raises
    ------
    ValueError
        When the two maps find no rim in common.
    """
    front_ends = [GuidedFrontEnd(camera, catalog, options) for catalog in maps]
    covariance = np.diag(np.repeat([_ATTITUDE_RAD, _POSITION_M], 3) ** 2)
    seen, predicted = [np.empty((0, 2))], [np.empty((0, 2))]
    for view in views:
        one, other = (
            front_end.measure(view.image, 0, view.gTb, covariance, view.sun_g).rims
            for front_end in front_ends
        )
        rows, i, j = np.intersect1d(one.craters, other.craters, return_indices=True)
        here, there = (project_rims(view.gTb, camera.bTc, c.centres[rows], c.axes[rows])[0] for c in maps)
        seen.append((other.chart[j] - one.chart[i])[:, :2])
        predicted.append((there - here)[:, :2])
    y, x = np.concatenate(seen), np.concatenate(predicted)
    if not len(x):
        raise ValueError("expected rims that both maps find, found none")
    return Pull(float(np.sum(x * y) / np.sum(x * x)), len(x))


def pull_of_prediction(folder: Path) -> None:
    """Print the pull over each crop, without and with rims searched again around their ellipses.

    Parameters
    ----------
    folder : Path
        Of the public files, see `Scenario.with_data`.

    Raises
    ------
    ValueError
        Without ground truth.
    """
    console = Console()
    for name in SCENARIOS:
        with tempfile.TemporaryDirectory() as place:
            case = load_scenario(name).with_data(folder)
            console.print(name)
            of_data_set(Dataset.open(simulate(case, Path(place) / "d", trial=0)), console)


def of_data_set(data: Dataset, console: Console) -> None:
    """Print the pull in every fourth image of a data set.

    Parameters
    ----------
    data : Dataset
        With images, ground truth, and a catalogue that states errors.
    console : rich.console.Console

    Raises
    ------
    ValueError
        Without ground truth.
    """
    truth = data.truth_at(data.stamps_ns)
    if truth is None:
        raise ValueError(f"{data.path}: expected ground truth, found none")
    views = [
        View(data.image(k), truth.gTb[k], data.sun.at(int(data.stamps_ns[k])))
        for k in range(0, len(data), _FRAME_STEP)
    ]
    maps = data.catalog, moved_at_random(data.catalog, np.random.default_rng(0))
    usual = GuidedOptions()
    for how, options in (
        ("once", replace(usual, recentrings=0)),
        (f"again, {usual.recentrings} times", replace(usual, searches=1)),
        (f"from {usual.searches} places", usual),
    ):
        found = pull(views, data.camera, maps, options)
        console.print(f"searched {how}: pull {found.slope:.2f} of {found.rims} rims")
