"""Faults that a data set does not state: errors of the map, of the mounting and of the matches."""

import math
from dataclasses import replace

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.simulation.scenario_tables import FaultsSection


def perturb_map(catalog: Catalog, faults: FaultsSection, rng: np.random.Generator) -> Catalog:
    """Return the catalogue of a map with errors of positions, sizes and heights.

    Parameters
    ----------
    catalog : Catalog
        True positions, sizes and heights.
    faults : FaultsSection
    rng : Generator

    Returns
    -------
    Catalog
        The same craters under the same names.
    """
    n = len(catalog)
    *place, height = rng.standard_normal((3, n)) * catalog.semi_major_m
    latitude_rad, longitude_rad = catalog.latitude_rad, catalog.longitude_rad
    if faults.map_place_share:
        enu = frames.east_north_up(latitude_rad, longitude_rad)
        shift = faults.map_place_share * np.stack(place) / (catalog.body.radius_m + catalog.height_m)
        # In space: near a pole, metres are no fixed angles of longitude.
        moved = enu[:, :, 2] + np.einsum("nij,jn->ni", enu[:, :, :2], shift)
        latitude_rad, longitude_rad = frames.latitude_longitude(moved)
    sizes = np.exp(faults.map_size_share * rng.standard_normal((2, n)))
    axes = np.stack([catalog.semi_major_m, catalog.semi_minor_m]) * sizes
    # In a nearly round crater the minor axis may become the longer one.
    turned = axes[0] < axes[1]
    return replace(
        catalog,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        height_m=catalog.height_m + faults.map_height_share * height,
        semi_major_m=axes.max(axis=0),
        semi_minor_m=axes.min(axis=0),
        angle_rad=catalog.angle_rad + 0.5 * np.pi * turned,
    )


def swap_matches(
    frame: FrameMeasurement, catalog: Catalog, faults: FaultsSection, rng: np.random.Generator
) -> FrameMeasurement:
    """Match some of a frame's rims with other craters, and drop its sun tilt if the faults say so.

    The wrongly matched rims exchange their craters; a single one is matched with the nearest crater that is
    not in the frame. No crater is matched twice, which would be easy to detect.

    Parameters
    ----------
    frame : FrameMeasurement
    catalog : Catalog
        With more craters than the frame.
    faults : FaultsSection
    rng : Generator

    Returns
    -------
    FrameMeasurement
    """
    craters = frame.rims.craters.copy()
    wrong = np.flatnonzero(rng.random(len(craters)) < faults.wrong_match_share)
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
    """Return the camera with the wrong mounting that the data set states."""
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
