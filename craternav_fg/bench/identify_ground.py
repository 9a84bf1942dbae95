"""Identification without a prior position, in rendered images of real ground with a published catalogue."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import with_rim_heights
from craternav_fg.errors import InputError
from craternav_fg.matching.identify.from_image import identify_image
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.simulation.ground_views import GroundView, RealGround

SCENARIOS = ("gld100_highlands", "gld100_mare", "gld100_mixed")
CATALOG, HEIGHTS = "lu1319381.parquet", "gld100/gld100_16ppd_global.tif"
# Seed of the images.
_SEED = 1
# Limits of the groups of altitudes, m, and of the sun's elevation, deg.
_ALTITUDES_M, _SUN_DEG = (60e3, 90e3, 135e3, 200e3), (10.0, 30.0, 50.0, 70.0)
# Error of the position above which an answer is wrong, over the altitude.
WRONG_SHARE = 0.1


class Answer(NamedTuple):
    """What identification says of one image."""

    scenario: str
    altitude_m: float
    """Above the ground."""
    sun_deg: float
    """Elevation of the sun."""
    rims: int
    """Detected rims, those of the answer where there is one."""
    identified: bool
    """Whether there is an answer."""
    wrong: bool
    """Whether its position is off by more than `WRONG_SHARE` of the altitude."""
    error_m: float
    """Error of the position; NaN without an answer."""
    seconds: float
    """Duration of identification."""


def published_index(data: Path) -> TripleIndex:
    """Index the whole published catalogue, with heights from the coarse elevation model.

    Parameters
    ----------
    data : Path
        Folder of the public files.

    Returns
    -------
    TripleIndex

    Raises
    ------
    InputError
        When a file is missing.
    """
    for name in (CATALOG, HEIGHTS):
        if not (data / name).is_file():
            raise InputError(data / name, "not found; the documentation's page Real ground names the product")
    catalog, _ = import_catalog(data / CATALOG)
    return TripleIndex.build(with_rim_heights(catalog, read_dem(data / HEIGHTS, 1.0, catalog.body.radius_m)))


def answer(scenario: str, view: GroundView, camera: Camera, index: TripleIndex) -> Answer:
    """Detect rims in an image and identify them.

    Parameters
    ----------
    scenario : str
        Name.
    view : GroundView
    camera : Camera
    index : TripleIndex

    Returns
    -------
    Answer
    """
    rims, found = identify_image(view.image, camera, index)
    error_m = float(np.linalg.norm(found.gTb[:3, 3] - view.gTb[:3, 3])) if found.identified else np.nan
    return Answer(
        scenario,
        view.altitude_m,
        view.sun_deg,
        len(rims.ellipses_px),
        found.identified,
        found.identified and error_m > WRONG_SHARE * view.altitude_m,
        error_m,
        found.seconds,
    )


def run(data: Path, images: int, progress: Callable[[int, int], None]) -> list[Answer]:
    """Identify random images of the scenarios' ground.

    Parameters
    ----------
    data : Path
        Folder of the public files.
    images : int
        Number of all; the scenarios take turns.
    progress : callable
        Called with the number of images done and of all.

    Returns
    -------
    list of Answer

    Raises
    ------
    InputError
        When a file is missing.
    """
    index = published_index(data)
    grounds = [RealGround(name, data) for name in SCENARIOS]
    out = []
    for k in range(images):
        ground = grounds[k % len(grounds)]
        view = ground.view(np.random.default_rng([_SEED, k]))
        out.append(answer(SCENARIOS[k % len(grounds)], view, ground.camera, index))
        progress(k + 1, images)
    return out


class Group(NamedTuple):
    """Answers of some images; medians are NaN without any."""

    name: str
    images: int
    """Number of images."""
    answered: int
    """Of these identified."""
    wrong: int
    """Of these wrong."""
    rims: float
    """Median number of detected rims."""
    error_m: float
    """Median error of the position, of right answers."""
    seconds: float
    """Median duration of identification."""


def summaries(answers: list[Answer]) -> list[Group]:
    """Group answers by ground, altitude and elevation of the sun.

    Parameters
    ----------
    answers : list of Answer

    Returns
    -------
    list of Group
        Groups without images are left out; the last one is of all images.
    """
    groups = [(name, [one for one in answers if one.scenario == name]) for name in SCENARIOS]
    for low, high in pairwise(_ALTITUDES_M):
        name = f"{low / 1e3:.0f} to {high / 1e3:.0f} km"
        groups.append((name, [one for one in answers if low <= one.altitude_m < high]))
    for low, high in pairwise(_SUN_DEG):
        groups.append(
            (f"sun {low:.0f} to {high:.0f} deg", [one for one in answers if low <= one.sun_deg < high])
        )
    groups.append(("all", answers))
    return [_group(name, chosen) for name, chosen in groups if chosen]


def _group(name: str, answers: list[Answer]) -> Group:
    right = [one.error_m for one in answers if one.identified and not one.wrong]
    return Group(
        name,
        len(answers),
        sum(one.identified for one in answers),
        sum(one.wrong for one in answers),
        float(np.median([one.rims for one in answers])),
        float(np.median(right)) if right else float("nan"),
        float(np.median([one.seconds for one in answers])),
    )
