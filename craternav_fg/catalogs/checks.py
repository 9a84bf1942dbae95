"""What can be wrong with a catalogue: values out of range, wrong units, another body; rims that meet."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.columns import HEIGHT
from craternav_fg.catalogs.model import Catalog
from craternav_fg.tables import Column, write_table

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# For each row at fault, the column and what is wrong with it.
Faults = dict[int, tuple[str, str]]

# The Moon's craters of 5 km and up cover two thirds of it; equilibrium keeps any ground from far more.
_MOST_COVER = 5.0
# Cells of equal area on the body, in sine of latitude and longitude.
_CELLS = (36, 72)
# Latitudes beyond the poles in so many rows, or in most of few, are longitudes.
_SWAPPED, _FEW = 0.2, 20
# Kilometres taken for metres leave no crater larger than this share of a body's radius.
_LEAST_OF_A_GLOBE = 2e-3
_ENOUGH_TO_TELL = 1000
# Two entries this alike, in size and place, are taken for one crater.
_ALIKE = 0.1
_PAIR_COLUMNS = (
    Column("kind", "text"), Column("crater_id", "text"), Column("other_id", "text"),
    Column("diameter_km"), Column("other_diameter_km"), Column("distance_km"),
)  # fmt: skip


@dataclass(frozen=True)
class Overlaps:
    """Craters that meet others.

    Attributes
    ----------
    crossings : ndarray of int, shape (m, 2)
        Pairs of rows whose rims cross, the larger crater first.
    twins : ndarray of int, shape (k, 2)
        Pairs of rows that are probably one crater, entered twice.
    """

    crossings: IntArray
    twins: IntArray


def row_faults(values: Sequence[FloatArray], names: Sequence[str], radius_m: float) -> Faults:
    """Find rows that are no rim on a body.

    Parameters
    ----------
    values : sequence of ndarray, shape (n,)
        Latitude, longitude (deg), major and minor diameter (m), angle (deg), height (m).
    names : sequence of str
        Columns of the first five, or of latitude, longitude and diameter for circles.
    radius_m : float
        Of the body.
    """
    latitude, longitude, major, minor, angle, height = values
    names = names if len(names) == 5 else (*names, names[2], names[2])
    major_km, minor_km, largest_km = 1e-3 * major, 1e-3 * minor, 2e-3 * radius_m
    tests = [
        (names[0], np.abs(latitude) <= 90.0, "expected -90 to 90 deg", latitude),
        (names[1], (longitude >= -180.0) & (longitude <= 360.0), "expected -180 to 360 deg", longitude),
        (names[4], np.abs(angle) <= 360.0, "expected -360 to 360 deg", angle),
        (names[2], (major > 0.0) & (major_km < largest_km), f"expected 0 to {largest_km:g} km", major_km),
        (names[3], minor > 0.0, "expected a positive diameter", minor_km),
        (names[3], minor <= major, "expected at most the major diameter", minor_km),
        (HEIGHT, height > -radius_m, "expected a rim above the body's centre", height),
    ]
    faults: Faults = {}
    for column, good, expected, found in tests:
        for row in np.flatnonzero(~good).tolist():
            shown = "none" if np.isnan(found[row]) else f"{found[row]:g}"
            faults.setdefault(row, (column, f"{expected}, found {shown}"))
    return faults


def identifier_faults(identifiers: Sequence[str | None], name: str) -> Faults:
    """Find rows without an identifier, or with one that was there before."""
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
    """Find rims that cross, taken for circles, and craters that were probably entered twice."""
    return Overlaps(*catalog.index.overlaps(_ALIKE))


def write_pairs(path: Path, catalog: Catalog, meets: Overlaps) -> None:
    """Write the pairs of craters that meet as CSV: twins first, then crossing rims."""
    pairs = np.concatenate([meets.twins, meets.crossings])
    kinds = ["twin"] * len(meets.twins) + ["crossing"] * len(meets.crossings)
    data: list[Any] = [kinds]
    data += [[catalog.identifiers[row] for row in side] for side in pairs.T.tolist()]
    data += [2e-3 * catalog.semi_major_m[side] for side in pairs.T]
    data.append(1e-3 * catalog.distance_m(pairs[:, 0], pairs[:, 1]))
    write_table(path, _PAIR_COLUMNS, data)


def swapped(
    latitude_deg: FloatArray, longitude_deg: FloatArray, longitude_name: str
) -> tuple[int, str] | None:
    """Say when latitudes (n,) are longitudes: a row and what is wrong with it; None when they are not."""
    beyond = np.abs(latitude_deg) > 90.0
    enough = _SWAPPED if len(beyond) >= _FEW else 0.5
    if np.count_nonzero(beyond) <= enough * len(beyond):
        return None
    if np.nanmax(np.abs(longitude_deg), initial=0.0) > 90.0:
        return None
    row = int(np.flatnonzero(beyond)[0])
    found = f"expected -90 to 90 deg, found {latitude_deg[row]:g}, and in {longitude_name} no more than 90"
    return row, f"{found}: latitude and longitude are swapped"


def implausible_sizes(
    latitude_deg: FloatArray, longitude_deg: FloatArray, diameter_m: FloatArray, radius_m: float
) -> str | None:
    """Say what is odd about sizes (n,) on a body of some radius, None when nothing is.

    Units and bodies are mixed up easily, and a single crater does not show it: together they would cover the
    ground many times over, or, known all over the body, be grains.
    """
    if not len(diameter_m):
        return None
    cover = _cover(latitude_deg, longitude_deg, diameter_m, radius_m)
    largest = float(np.max(diameter_m))
    if cover > _MOST_COVER:
        return (
            f"the craters would cover a body of radius {radius_m:g} m {cover:.3g} times over where they lie, "
            f"the largest of {largest:g} m: wrong unit (km, m; deg, rad), or another body"
        )
    if len(diameter_m) < _ENOUGH_TO_TELL or largest > _LEAST_OF_A_GLOBE * radius_m:
        return None
    octants = np.bincount(
        4 * (latitude_deg > 0.0) + (np.mod(longitude_deg, 360.0) // 90.0).astype(np.int64).clip(0, 3),
        minlength=8,
    )
    if octants.min() > 0.02 * len(diameter_m):
        return (
            f"craters all over a body of radius {radius_m:g} m, and the largest of {largest:g} m: "
            f"{wrong_unit(radius_m)}"
        )
    return None


def wrong_unit(radius_m: float) -> str:
    """Say what can be wrong with sizes that make no sense on a body."""
    return f"wrong unit (km, m) of the sizes or of the body's radius, {radius_m:.9g} m, or another body"


def _cover(
    latitude_deg: FloatArray, longitude_deg: FloatArray, diameter_m: FloatArray, radius_m: float
) -> float:
    """How many times over craters cover the ground about themselves; larger ones than a cell, the body."""
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
