"""Checks of a catalogue: values out of range, wrong units, swapped columns, overlapping rims."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg.catalogs.columns import HEIGHT
from craternav_fg.catalogs.model import Catalog
from craternav_fg.tables import Column, write_table
from factors.arrays import FloatArray, IntArray

# For each row at fault, its column and what is wrong with it.
Faults = dict[int, tuple[str, str]]

# Craters cannot cover the ground more often than this: those of 5 km and more cover two thirds of the Moon
# (Robbins 2018), and new craters erase old ones long before this (equilibrium).
_MAX_COVERAGE = 5.0
# Steepest plane of a rim, deg: beyond it, hardly a camera sees the rim, and its slopes are ill-defined.
MAX_TILT_DEG = 80.0
# Cells of equal area in which the coverage is counted: rows in sine of latitude, columns in longitude.
_CELLS = (36, 72)
# Fewer craters may all lie on the sphere.
_MIN_HEIGHTS = 10
# Median height over the body's radius above which heights are distances from its centre.
_MAX_MEDIAN_HEIGHT = 0.5
# Share of rows with latitudes beyond the poles from which the columns are taken to be swapped; in tables of
# fewer rows, half of them.
_SWAPPED_SHARE, _SWAPPED_MIN_ROWS = 0.2, 20
# A catalogue of this many craters, this share of them in each octant of the body, is global. The largest
# crater of a global catalogue has at least this radius in body radii: kilometres taken for metres have not.
_GLOBAL_MIN_CRATERS, _GLOBAL_OCTANT_SHARE, _GLOBAL_LARGEST_RADII = 1000, 0.02, 1e-3
# Two entries are one crater when their radii and places differ by less than this, in radii of the smaller.
_DUPLICATE_TOLERANCE = 0.1
_PAIR_COLUMNS = (
    Column("kind", "text"), Column("crater_id", "text"), Column("other_id", "text"),
    Column("diameter_km"), Column("other_diameter_km"), Column("distance_km"),
)  # fmt: skip


@dataclass(frozen=True)
class Overlaps:
    """Pairs of craters that overlap.

    Attributes
    ----------
    crossings : ndarray of int, shape (m, 2)
        Rows whose rims cross, the larger crater first.
    duplicates : ndarray of int, shape (k, 2)
        Rows that are probably one crater entered twice, the larger first.
    """

    crossings: IntArray
    duplicates: IntArray


def row_faults(
    values: Sequence[FloatArray], names: Sequence[str], radius_m: float, height_name: str = HEIGHT
) -> Faults:
    """Find rows whose values no rim on a body can have.

    Parameters
    ----------
    values : sequence of ndarray, shape (n,)
        Latitude, longitude (deg), major and minor diameter (m), angle (deg), height (m).
    names : sequence of str
        Names of the first five columns, or of latitude, longitude and diameter for a catalogue of circles.
    radius_m : float
        Radius of the body.
    height_name : str
        Name of the column of heights.

    Returns
    -------
    dict of int to (str, str)
        Column and problem of each row at fault.
    """
    latitude, longitude, major, minor, angle, height = values
    names = names if len(names) == 5 else (*names, names[2], names[2])
    major_km, minor_km, largest_km = 1e-3 * major, 1e-3 * minor, 2e-3 * radius_m
    tests = [
        (names[0], np.abs(latitude) <= 90.0, "expected -90 to 90 deg", latitude),
        (names[1], (longitude >= -360.0) & (longitude <= 540.0), "expected -360 to 540 deg", longitude),
        (names[4], np.abs(angle) <= 360.0, "expected -360 to 360 deg", angle),
        (names[2], (major > 0.0) & (major_km < largest_km), f"expected 0 to {largest_km:g} km", major_km),
        (names[3], minor > 0.0, "expected a positive diameter", minor_km),
        (names[3], minor <= major, "expected at most the major diameter", minor_km),
        (height_name, height > -radius_m, "expected a rim above the body's centre", height),
    ]
    faults: Faults = {}
    for column, good, expected, found in tests:
        for row in np.flatnonzero(~good).tolist():
            shown = "none" if np.isnan(found[row]) else f"{found[row]:g}"
            faults.setdefault(row, (column, f"{expected}, found {shown}"))
    return faults


def wrapped_deg(longitude: FloatArray) -> FloatArray:
    """Wrap longitudes that are outside -180 to 360 deg, as in tables of -360 to 0 or of 180 to 540 deg.

    Parameters
    ----------
    longitude : ndarray, shape (n,)
        deg.

    Returns
    -------
    ndarray, shape (n,)
        deg.
    """
    usual = (longitude >= -180.0) & (longitude <= 360.0)
    return np.where(usual, longitude, np.mod(longitude, 360.0))


def tilt_fault(tilts_deg: FloatArray) -> tuple[int, str] | None:
    """Find the first slope that no rim's plane has.

    Parameters
    ----------
    tilts_deg : ndarray, shape (n,)
        Slopes towards east or north, deg.

    Returns
    -------
    (int, str) or None
        Row, and what is wrong with it.
    """
    wrong = np.flatnonzero(~(np.abs(tilts_deg) <= MAX_TILT_DEG))
    if not len(wrong):
        return None
    found = tilts_deg[wrong[0]]
    shown = "none" if np.isnan(found) else f"{found:g}"
    return int(wrong[0]), f"expected a slope of at most {MAX_TILT_DEG:g} deg, found {shown}"


def identifier_faults(identifiers: Sequence[str | None], name: str) -> Faults:
    """Find rows without an identifier, or with that of an earlier row.

    Parameters
    ----------
    identifiers : sequence of str or None
    name : str
        Name of their column.

    Returns
    -------
    dict of int to (str, str)
        Column and problem of each row at fault.
    """
    faults: Faults = {}
    if len(set(identifiers)) == len(identifiers) and all(identifiers):
        return faults
    seen: set[str] = set()
    for row, identifier in enumerate(identifiers):
        if not identifier:
            faults[row] = (name, "expected an identifier, found none")
            continue
        if identifier in seen:
            faults[row] = (name, f"expected each identifier once, found {identifier!r} again")
        seen.add(identifier)
    return faults


def overlaps(catalog: Catalog) -> Overlaps:
    """Find rims that cross, taken for circles, and craters that were probably entered twice.

    Parameters
    ----------
    catalog : Catalog
    """
    return Overlaps(*catalog.index.overlaps(_DUPLICATE_TOLERANCE))


def write_pairs(path: Path, catalog: Catalog, found: Overlaps) -> None:
    """Write pairs of craters that overlap as CSV: duplicates first, then crossing rims.

    Parameters
    ----------
    path : Path
    catalog : Catalog
    found : Overlaps
        Overlaps of the catalogue.
    """
    pairs = np.concatenate([found.duplicates, found.crossings])
    kinds = ["duplicate"] * len(found.duplicates) + ["crossing"] * len(found.crossings)
    data: list[Any] = [kinds]
    data += [[catalog.identifiers[row] for row in side] for side in pairs.T.tolist()]
    data += [2e-3 * catalog.semi_major_m[side] for side in pairs.T]
    data.append(1e-3 * catalog.distance_m(pairs[:, 0], pairs[:, 1]))
    write_table(path, _PAIR_COLUMNS, data)


def swapped(
    latitude_deg: FloatArray, longitude_deg: FloatArray, longitude_name: str
) -> tuple[int, str] | None:
    """Detect swapped columns of latitude and longitude.

    Parameters
    ----------
    latitude_deg, longitude_deg : ndarray, shape (n,)
        As the table calls them.
    longitude_name : str
        Column of the longitudes.

    Returns
    -------
    (int, str) or None
        First row with a latitude beyond a pole, and the problem; None when the columns are not swapped.
    """
    beyond = np.abs(latitude_deg) > 90.0
    enough = _SWAPPED_SHARE if len(beyond) >= _SWAPPED_MIN_ROWS else 0.5
    if np.count_nonzero(beyond) <= enough * len(beyond):
        return None
    if np.nanmax(np.abs(longitude_deg), initial=0.0) > 90.0:
        return None
    row = int(np.flatnonzero(beyond)[0])
    found = f"expected -90 to 90 deg, found {latitude_deg[row]:g}, and in {longitude_name} no more than 90"
    return row, f"{found}: latitude and longitude are swapped"


def heights_are_stated(height_m: FloatArray, *, with_errors: bool) -> bool:
    """Tell heights from a column that was filled with zeros.

    Parameters
    ----------
    height_m : ndarray, shape (n,)
    with_errors : bool
        Whether standard deviations are stated, of each or in common: then zeros are heights.

    Returns
    -------
    bool
        True also for a few craters, which may lie on the sphere.
    """
    return with_errors or len(height_m) < _MIN_HEIGHTS or bool(np.any(height_m))


def distances_for_heights(height_m: FloatArray, radius_m: float) -> str | None:
    """Detect distances from the body's centre in place of heights above its sphere.

    Parameters
    ----------
    height_m : ndarray, shape (n,)
    radius_m : float
        Radius of the body.

    Returns
    -------
    str or None
        The problem; None when they may be heights.
    """
    middle_m = float(np.median(height_m))
    if not middle_m > _MAX_MEDIAN_HEIGHT * radius_m:
        return None
    return (
        f"expected heights above the sphere of {radius_m:g} m, found a median of {middle_m:g} m: are they "
        "distances from the body's centre?"
    )


def implausible_sizes(
    latitude_deg: FloatArray, longitude_deg: FloatArray, diameter_m: FloatArray, radius_m: float
) -> str | None:
    """Detect sizes in a wrong unit, or of craters on another body.

    A single crater does not show it. Too large, the craters would together cover the ground many times over;
    too small, a global catalogue would know grains only.

    Parameters
    ----------
    latitude_deg, longitude_deg : ndarray, shape (n,)
        Coordinates of the rims' centres.
    diameter_m : ndarray, shape (n,)
        Major diameters.
    radius_m : float
        Radius of the body.

    Returns
    -------
    str or None
        The problem, None when there is none.
    """
    if not len(diameter_m):
        return None
    cover = _cover(latitude_deg, longitude_deg, diameter_m, radius_m)
    largest = float(np.max(diameter_m))
    if cover > _MAX_COVERAGE:
        return (
            f"the craters would cover a body of radius {radius_m:g} m {cover:.3g} times over where they lie, "
            f"the largest of {largest:g} m: wrong unit (km, m; deg, rad), or another body"
        )
    if len(diameter_m) < _GLOBAL_MIN_CRATERS or largest > 2.0 * _GLOBAL_LARGEST_RADII * radius_m:
        return None
    octants = np.bincount(
        4 * (latitude_deg > 0.0) + (np.mod(longitude_deg, 360.0) // 90.0).astype(np.int64).clip(0, 3),
        minlength=8,
    )
    if octants.min() > _GLOBAL_OCTANT_SHARE * len(diameter_m):
        return (
            f"craters all over a body of radius {radius_m:g} m, and the largest of {largest:g} m: "
            f"{wrong_unit(radius_m)}"
        )
    return None


def wrong_unit(radius_m: float) -> str:
    """Name what may be wrong with sizes that make no sense on a body.

    Parameters
    ----------
    radius_m : float
        Radius of the body.
    """
    return f"wrong unit (km, m) of the sizes or of the body's radius, {radius_m:.9g} m, or another body"


def _cover(
    latitude_deg: FloatArray, longitude_deg: FloatArray, diameter_m: FloatArray, radius_m: float
) -> float:
    """How many times over craters cover the ground: small ones in their cells, larger ones on the body."""
    rows, turns = _CELLS
    cell_m2 = 4.0 * np.pi * radius_m**2 / (rows * turns)
    area_m2 = 0.25 * np.pi * diameter_m**2
    large = area_m2 > cell_m2
    total = float(np.sum(area_m2[large])) / (4.0 * np.pi * radius_m**2)
    row = (0.5 * rows * (1.0 + np.sin(np.radians(latitude_deg)))).astype(np.int64).clip(0, rows - 1)
    column = (np.mod(longitude_deg, 360.0) * turns / 360.0).astype(np.int64).clip(0, turns - 1)
    cell = (turns * row + column)[~large]
    if not len(cell):
        return total
    covered = np.bincount(cell, area_m2[~large]) / cell_m2
    return total + float(np.mean(covered[cell]))
