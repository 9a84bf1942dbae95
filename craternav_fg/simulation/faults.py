"""What the data set of a hard case does not tell: errors of the map, the mounting and the matches."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.simulation.scenario_file import FaultsSection

FloatArray = npt.NDArray[np.float64]


def perturb_map(catalog: Catalog, faults: FaultsSection, rng: np.random.Generator) -> Catalog:
    """Draw the catalogue as a map has it, of craters as they are.

    Parameters
    ----------
    catalog : Catalog
        True places, sizes and heights.
    faults : FaultsSection
    rng : Generator

    Returns
    -------
    Catalog
        The same craters under the same names.
    """
    n = len(catalog)
    east, north, height = rng.standard_normal((3, n)) * catalog.semi_major_m
    distance_m = catalog.body.radius_m + catalog.height_m
    sizes = np.exp(faults.map_size * rng.standard_normal((2, n)))
    axes = np.stack([catalog.semi_major_m, catalog.semi_minor_m]) * sizes
    # A nearly round crater may change which of its axes is the longer one.
    turned = axes[0] < axes[1]
    return replace(
        catalog,
        latitude_rad=catalog.latitude_rad + faults.map_place * north / distance_m,
        longitude_rad=catalog.longitude_rad
        + faults.map_place * east / (distance_m * np.cos(catalog.latitude_rad)),
        height_m=catalog.height_m + faults.map_height * height,
        semi_major_m=axes.max(axis=0),
        semi_minor_m=axes.min(axis=0),
        angle_rad=catalog.angle_rad + 0.5 * np.pi * turned,
    )


def swap_matches(
    frame: FrameMeasurement, catalog: Catalog, faults: FaultsSection, rng: np.random.Generator
) -> FrameMeasurement:
    """Give some of a frame's rims the names of other craters, and take its sun tilt away.

    Wrong names go round among the rims that get one; a single one gets that of the nearest crater that is
    not in the frame. A name is never there twice: what claims the same crater twice gives itself away.

    Parameters
    ----------
    frame : FrameMeasurement
    catalog : Catalog
        Of more craters than a frame has, when matches are to be wrong.
    faults : FaultsSection
    rng : Generator
    """
    craters = frame.rims.craters.copy()
    wrong = np.flatnonzero(rng.random(len(craters)) < faults.wrong_matches)
    if len(wrong) == 1:
        away = np.linalg.norm(catalog.centres - catalog.centres[craters[wrong[0]]], axis=1)
        away[frame.rims.craters] = np.inf
        craters[wrong] = np.argmin(away)
    else:
        rng.shuffle(wrong)
        craters[wrong] = craters[np.roll(wrong, 1)]
    rims = replace(frame.rims, craters=craters)
    return replace(frame, rims=rims, sun=None if faults.without_sun else frame.sun)


def perturb_mounting(camera: Camera, faults: FaultsSection, rng: np.random.Generator) -> Camera:
    """Give the camera with the mounting that the data set believes in."""
    axis = rng.standard_normal(3)
    turn = frames.rotation_exp(math.radians(faults.mounting_deg) * axis / np.linalg.norm(axis))
    bTc = camera.bTc.copy()
    bTc[:3, :3] = bTc[:3, :3] @ turn
    return replace(camera, bTc=bTc)


def without_craters(frame: FrameMeasurement, faults: FaultsSection) -> FrameMeasurement:
    """Take the rims and the sun tilt out of a frame inside a stretch without craters.

    Parameters
    ----------
    frame : FrameMeasurement
    faults : FaultsSection

    Returns
    -------
    FrameMeasurement
    """
    seconds = 1e-9 * frame.stamp_ns
    if any(begin <= seconds < end for begin, end in faults.craterless_s):
        return FrameMeasurement(frame.stamp_ns, RimSet.empty(), None)
    return frame
