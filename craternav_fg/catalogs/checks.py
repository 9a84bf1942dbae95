"""What can be wrong with a catalogue: values out of range, wrong units, another body; rims that meet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.catalog import Catalog
from craternav_fg.catalogs.columns import HEIGHT

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

# For each row at fault, the column and what is wrong with it.
Faults = dict[int, tuple[str, str]]

# The Moon's craters of 5 km and up cover two thirds of it; equilibrium keeps any body from far more.
_MOST_COVER = 5.0
# Kilometres taken for metres leave no crater larger than this share of a body's radius.
_LEAST_OF_A_GLOBE = 2e-3
_ENOUGH_TO_TELL = 1000
# Two entries this alike, in size and place, are taken for one crater.
_ALIKE = 0.1


@dataclass(frozen=True)
class Overlaps:
    """Craters that meet others.

    Attributes
    ----------
    crossed : ndarray of bool, shape (n,)
        Whose rim crosses another's.
    twins : ndarray of int, shape (k, 2)
        Pairs of rows that are probably one crater, entered twice.
    """

    crossed: BoolArray
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
    crossed, twins = catalog.index.overlaps(_ALIKE)
    return Overlaps(crossed, twins)


def implausible_sizes(
    latitude_deg: FloatArray, longitude_deg: FloatArray, diameter_m: FloatArray, radius_m: float
) -> str | None:
    """Say what is odd about sizes (n,) on a body of some radius, None when nothing is.

    Units and bodies are mixed up easily, and a single crater does not show it: together they would cover the
    body many times over, or, known all over it, be grains.
    """
    if not len(diameter_m):
        return None
    cover = float(np.sum((diameter_m / radius_m) ** 2)) / 16.0
    largest = float(np.max(diameter_m))
    if cover > _MOST_COVER:
        return (
            f"the craters would cover a body of radius {radius_m:g} m {cover:.3g} times over, the largest of "
            f"{largest:g} m: wrong unit (km, m), or another body"
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
            "wrong unit (km, m), or another body"
        )
    return None
