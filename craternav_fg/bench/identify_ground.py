"""Identification without a prior position, in rendered images of real ground with a published catalogue."""

from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import with_rim_heights
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.matching.identify.from_image import identify_image
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.simulation.ground_views import GroundView, RealGround
from factors.arrays import FloatArray

SCENARIOS = ("gld100_highlands", "gld100_mare", "gld100_mixed")
CATALOG, HEIGHTS = "lu1319381.parquet", "gld100/gld100_16ppd_global.tif"
# Limits of the groups of altitudes, m, and of the sun's elevation, deg.
_ALTITUDES_M, _SUN_DEG = (60e3, 90e3, 135e3, 200e3), (10.0, 30.0, 50.0, 70.0)
# Error of the position above which an answer is wrong, over the altitude.
WRONG_SHARE = 0.1
# Distance from each ground's middle within which the map has no craters when its region is removed.
REMOVED_DEG = 20.0


class Fault(StrEnum):
    """What makes images of which there is no right answer."""

    REMOVED = "removed"
    """The map has no craters within `REMOVED_DEG` of the ground."""
    MIRRORED = "mirrored"
    """Images are mirrored left to right."""


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
    """Whether its position is off by more than `WRONG_SHARE` of the altitude, or there is no right answer."""
    error_m: float
    """Error of the position; NaN without an answer."""
    seconds: float
    """Duration of identification."""


def published_catalog(data: Path) -> Catalog:
    """Read the whole published catalogue, with heights from the coarse elevation model.

    Parameters
    ----------
    data : Path
        Folder of the public files.

    Returns
    -------
    Catalog

    Raises
    ------
    InputError
        When a file is missing.
    """
    for name in (CATALOG, HEIGHTS):
        if not (data / name).is_file():
            raise InputError(data / name, "not found; the documentation's page Real ground names the product")
    catalog, _ = import_catalog(data / CATALOG)
    return with_rim_heights(catalog, read_dem(data / HEIGHTS, 1.0, catalog.body.radius_m))


def answer(
    scenario: str, view: GroundView, camera: Camera, index: TripleIndex, fault: Fault | None = None
) -> Answer:
    """Detect rims in an image and identify them.

    Parameters
    ----------
    scenario : str
        Name.
    view : GroundView
    camera : Camera
    index : TripleIndex
    fault : Fault, optional
        Fault of the image or the map: every answer is wrong then.

    Returns
    -------
    Answer
    """
    image = view.image
    if fault is Fault.MIRRORED:
        image, camera = image[:, ::-1].copy(), replace(camera, cx_px=camera.width_px - 1 - camera.cx_px)
    rims, found = identify_image(image, camera, index)
    error_m = float(np.linalg.norm(found.gTb[:3, 3] - view.gTb[:3, 3])) if found.identified else np.nan
    wrong = found.identified and (fault is not None or error_m > WRONG_SHARE * view.altitude_m)
    return Answer(
        scenario,
        view.altitude_m,
        view.sun_deg,
        len(rims.ellipses_px),
        found.identified,
        wrong,
        error_m,
        found.seconds,
    )


def run(
    data: Path,
    images: int,
    progress: Callable[[int, int], None],
    *,
    seed: int = 1,
    fault: Fault | None = None,
) -> list[Answer]:
    """Identify random images of the scenarios' ground.

    Parameters
    ----------
    data : Path
        Folder of the public files.
    images : int
        Number of all; the scenarios take turns.
    progress : callable
        Called with the number of images done and of all.
    seed : int
        Of the images.
    fault : Fault, optional
        Fault of the images or the map.

    Returns
    -------
    list of Answer

    Raises
    ------
    InputError
        When a file is missing.
    """
    catalog = published_catalog(data)
    grounds = [RealGround(name, data) for name in SCENARIOS]
    if fault is Fault.REMOVED:
        catalog = without_regions(catalog, np.array([ground.middle for ground in grounds]))
    index = TripleIndex.build(catalog)
    out = []
    for k in range(images):
        ground = grounds[k % len(grounds)]
        view = ground.view(np.random.default_rng([seed, k]))
        out.append(answer(SCENARIOS[k % len(grounds)], view, ground.camera, index, fault))
        progress(k + 1, images)
    return out


def without_regions(catalog: Catalog, middles: FloatArray) -> Catalog:
    """Leave out the craters within `REMOVED_DEG` of some places.

    Parameters
    ----------
    catalog : Catalog
    middles : ndarray, shape (k, 3)
        Unit vectors in g.

    Returns
    -------
    Catalog
    """
    up = catalog.centres / np.linalg.norm(catalog.centres, axis=1, keepdims=True)
    near = (up @ middles.T > np.cos(np.radians(REMOVED_DEG))).any(axis=1)
    return catalog.take(np.flatnonzero(~near))


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
