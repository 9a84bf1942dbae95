"""Published catalogues as maps of real ground, and the craters below an elevation model's resolution."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from craternav_fg.body import Body
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import rims_within, with_rim_heights
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter
from craternav_fg.simulation.relief import Relief
from craternav_fg.simulation.scenario_tables import PublishedCraters
from factors.arrays import FloatArray

# Radius of the largest crater that an elevation model does not show, in its steps.
_UNRESOLVED_STEPS = 1.5
# Positions of the lander around which craters are taken, at most.
_TRACK_POINTS = 200


def published_craters(
    section: PublishedCraters, body: Body, track: FloatArray, heights_unit_m: float = 1.0
) -> Catalog:
    """Read the map of a descent.

    Parameters
    ----------
    section : PublishedCraters
    body : Body
    track : ndarray, shape (k, 3)
        Positions of the lander in g, m.
    heights_unit_m : float
        Unit of the elevation model of the rims' heights, m.

    Returns
    -------
    Catalog
        The catalogue's craters around the track, with heights and errors.

    Raises
    ------
    InputError
        When a file is wrong, the catalogue has no crater there, or the heights' model does not cover all.
    """
    path = Path(section.path)
    catalog, _ = import_catalog(path, body)
    rows = _around(catalog, body, track, section)
    if not len(rows):
        problem = f"expected craters of {section.min_diameter_m:g} m and more along the descent, found none"
        raise InputError(path, problem)
    catalog = catalog.take(rows)
    if catalog.errors is None:
        radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
        place_m = np.hypot(section.place_sigma_m, section.place_sigma_share * radius_m)
        size = np.full(len(catalog), section.size_sigma_share)
        shift = CommonShift.of_source(
            len(catalog), section.common_place_sigma_m, section.common_height_sigma_m
        )
        errors = MapErrors(place_m, size, np.zeros(len(catalog)))
        catalog = replace(catalog, errors=errors, common_shift=shift)
    if not catalog.has_heights and section.heights is not None:
        catalog = _with_heights(catalog, Path(section.heights), heights_unit_m)
    return catalog


def _with_heights(catalog: Catalog, path: Path, unit_m: float) -> Catalog:
    """Read the heights of the rims from an elevation model that must cover all of them."""
    dem = read_dem(path, unit_m, catalog.body.radius_m)
    beyond = int(np.count_nonzero(~rims_within(catalog, dem)))
    if beyond:
        problem = (
            f"expected heights of all {len(catalog)} craters along the descent, {beyond} reach beyond it"
        )
        raise InputError(path, problem)
    return with_rim_heights(catalog, dem)


def unresolved_craters(
    rng: np.random.Generator,
    section: PublishedCraters,
    body: Body,
    track: FloatArray,
    focal_px: float,
    relief: Relief,
) -> Catalog:
    """Draw the craters that are too small for the elevation model.

    Parameters
    ----------
    rng : Generator
    section : PublishedCraters
    body : Body
    track : ndarray, shape (k, 3)
        Positions of the lander in g, m.
    focal_px : float
        Focal length of the camera that sees them.
    relief : Relief
        With the elevation model.

    Returns
    -------
    Catalog
        See `random_clutter`.
    """
    assert relief.dem is not None
    options = CraterFieldOptions(
        density=section.density,
        focal_px=focal_px,
        reach_altitudes=section.reach_altitudes,
        clutter_px=section.detail_px,
    )
    largest_m = _UNRESOLVED_STEPS * relief.dem.step_rad * body.radius_m
    empty = Catalog(
        identifiers=(), latitude_rad=np.empty(0), longitude_rad=np.empty(0), semi_major_m=np.empty(0),
        semi_minor_m=np.empty(0), angle_rad=np.empty(0), height_m=np.empty(0), body=body,
    )  # fmt: skip
    low = body.altitude_m(track) * section.detail_px[0] / focal_px < largest_m
    if not low.any():
        return empty
    found = random_clutter(rng, body, track[low], options, empty)
    return found.take(np.flatnonzero(found.semi_major_m <= largest_m))


def _around(
    catalog: Catalog, body: Body, track: FloatArray, section: PublishedCraters
) -> npt.NDArray[np.int64]:
    """Rows of the craters that are large enough and within reach of the track."""
    large = np.flatnonzero(2.0 * catalog.semi_major_m >= section.min_diameter_m)
    tree = cKDTree(catalog.up[large])
    points = track[np.unique(np.linspace(0, len(track) - 1, min(len(track), _TRACK_POINTS)).astype(int))]
    angle = section.reach_altitudes * body.altitude_m(points) / body.radius_m
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    groups = tree.query_ball_point(directions, 2.0 * np.sin(0.5 * np.minimum(angle, np.pi)))
    near = np.unique(np.concatenate([np.asarray(group, dtype=np.int64) for group in groups]))
    return np.asarray(large[near], dtype=np.int64)
