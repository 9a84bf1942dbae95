"""Which columns of a crater catalogue say what."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from craternav_fg.errors import InputError

ID = "CRATER_ID"
LATITUDE = "LAT_ELLI_IMG"
LONGITUDE = "LON_ELLI_IMG"
MAJOR = "DIAM_ELLI_MAJOR_IMG"
MINOR = "DIAM_ELLI_MINOR_IMG"
ANGLE = "DIAM_ELLI_ANGLE_IMG"
HEIGHT = "RIM_HEIGHT_M"
ELLIPSE = (LATITUDE, LONGITUDE, MAJOR, MINOR, ANGLE)
CIRCLE = ("LAT_CIRC_IMG", "LON_CIRC_IMG", "DIAM_CIRC_IMG")

# Names that others give, without case, signs and units; the unit of a size is looked for in the whole name.
_LATITUDES = ("lat", "latitude", "latdeg", "latn", "latitudedeg", "centerlat", "centerlatitude", "ycoord")
_LONGITUDES = (
    "lon", "long", "longitude", "londeg", "lone", "longitudedeg", "centerlon", "centerlongitude", "xcoord",
)  # fmt: skip
_DIAMETERS = ("diam", "diamkm", "diameter", "diameterkm", "diamm", "diameterm", "dkm")
_RADII = ("radiusdeg", "rdeg")
_IDENTIFIERS = ("craterid", "id", "identifier")
_METRES_PER = {"km": 1000.0, "m": 1.0}


@dataclass(frozen=True)
class ImportOptions:
    """What the columns of a catalogue are called; what is not given is recognised.

    Attributes
    ----------
    latitude, longitude, diameter : str, optional
        Columns of a catalogue of circles, deg (longitude to the east).
    identifier : str, optional
        Column of unique names; craters are numbered when there is none.
    unit : {"km", "m"}, optional
        Of the diameters.  Taken from the column's name when not given, km when that does not tell.
    """

    latitude: str | None = None
    longitude: str | None = None
    diameter: str | None = None
    identifier: str | None = None
    unit: str | None = None


@dataclass(frozen=True)
class Columns:
    """Columns that were recognised.

    Attributes
    ----------
    ellipse : tuple of str
        Latitude, longitude, major and minor diameter, angle; empty for a catalogue of circles.
    circle : tuple of str
        Latitude, longitude, diameter; empty when there is none beside the ellipse.
    identifier, height : str or None
    size_m : float
        Metres that a unit of the diameters means.
    """

    ellipse: tuple[str, ...]
    circle: tuple[str, ...]
    identifier: str | None
    height: str | None
    size_m: float


def recognise(path: Path, names: Sequence[str], options: ImportOptions, radius_m: float) -> Columns:
    """Find out which columns of a table are needed.

    Parameters
    ----------
    path : Path
        Named in errors.
    names : sequence of str
        The header.
    options : ImportOptions
    radius_m : float
        Of the body: some give a crater's radius as an angle at its centre.

    Raises
    ------
    InputError
        When a column that was named is not there, or one is missing; it lists what was found.
    """
    given = (options.latitude, options.longitude, options.diameter)
    for name in (*given, options.identifier):
        if name is not None and name not in names:
            raise InputError(path, f"expected this column, found {_listed(names)}", line=1, column=name)
    identifier = options.identifier or _one_of(names, _IDENTIFIERS)
    height = HEIGHT if HEIGHT in names else None
    unit = None if options.unit is None else _METRES_PER[options.unit]
    if not any(given) and MAJOR in names:
        missing = [name for name in ELLIPSE if name not in names]
        if missing:
            raise InputError(
                path,
                f"expected this column beside {MAJOR}, found {_listed(names)}",
                line=1,
                column=missing[0],
            )
        circle = CIRCLE if all(name in names for name in CIRCLE) else ()
        return Columns(ELLIPSE, circle, identifier, height, unit or 1000.0)
    if not any(given) and all(name in names for name in CIRCLE):
        return Columns((), CIRCLE, identifier, height, unit or 1000.0)
    latitude = _column(path, names, "latitude", options.latitude, _LATITUDES)
    longitude = _column(path, names, "longitude", options.longitude, _LONGITUDES)
    diameter = _column(path, names, "diameter", options.diameter, (*_DIAMETERS, *_RADII))
    if options.diameter is None and _plain(diameter) in _RADII:
        unit = 2.0 * float(np.radians(radius_m))
    elif unit is None:
        unit = _METRES_PER[_unit_in(diameter)]
    return Columns((), (latitude, longitude, diameter), identifier, height, unit)


def _column(path: Path, names: Sequence[str], what: str, given: str | None, known: Sequence[str]) -> str:
    name = given or _one_of(names, known)
    if name is None:
        problem = f"no column of a {what} was recognised among {_listed(names)}: name it (--{what})"
        raise InputError(path, problem, line=1)
    return name


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _one_of(names: Sequence[str], known: Sequence[str]) -> str | None:
    """Find the column whose name comes first among known ones."""
    plain = [_plain(name) for name in names]
    return next((names[plain.index(name)] for name in known if name in plain), None)


def _unit_in(name: str) -> str:
    words = re.split(r"[^a-z]+", name.lower())
    return "m" if "m" in words else "km"


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:30])
    return f"{shown} and {len(names) - 30} more" if len(names) > 30 else shown
