"""Columns of crater catalogues: our names, and recognition of the names in third-party tables."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from craternav_fg.catalogs.bodies import BODY_RADIUS, is_body_column
from craternav_fg.errors import InputError

ID = "CRATER_ID"
LATITUDE = "LAT_ELLI_IMG"
LONGITUDE = "LON_ELLI_IMG"
MAJOR = "DIAM_ELLI_MAJOR_IMG"
MINOR = "DIAM_ELLI_MINOR_IMG"
ANGLE = "DIAM_ELLI_ANGLE_IMG"
HEIGHT = "RIM_HEIGHT_M"
# Slopes of the rim's plane, see `Catalog.plane_tilt_rad`.
TILTS = ("PLANE_TILT_EAST_DEG", "PLANE_TILT_NORTH_DEG")
# Standard deviations, by the name in `MapErrors`.
ERROR_COLUMNS = {
    "PLACE_SIGMA_M": "place_m",
    "SIZE_SIGMA_SHARE": "size_share",
    "RIM_HEIGHT_SIGMA_M": "height_m",
}
# Former names of these columns: tables with them are read.
FORMER = {"SIZE_SIGMA_SHARE": "SIZE_SIGMA"}
# Standard deviations of what a source's craters have in common, by the name in `CommonShift`.
COMMON_COLUMNS = {"COMMON_PLACE_SIGMA_M": "place_m", "COMMON_HEIGHT_SIGMA_M": "height_m"}
# Number of the source, an optional column beside them.
COMMON_SOURCE = "COMMON_SOURCE"
ELLIPSE = (LATITUDE, LONGITUDE, MAJOR, MINOR, ANGLE)
CIRCLE = ("LAT_CIRC_IMG", "LON_CIRC_IMG", "DIAM_CIRC_IMG")

# Names in catalogues of others, in lower case without punctuation.
_LATITUDES = (
    "lat", "latitude", "latdeg", "latn", "latitudedeg", "latitudedegree", "centerlat", "centerlatitude",
    "latitudecircleimage", "ycoord", "latndeg",
)  # fmt: skip
_LONGITUDES = (
    "lon", "long", "longitude", "londeg", "lone", "longitudedeg", "longitudedegree", "centerlon",
    "centerlongitude", "longitudecircleimage", "xcoord", "lonedeg",
)  # fmt: skip
_DIAMETERS = (
    "diam", "diamkm", "diameter", "diameterkm", "diamm", "diameterm", "diamcircleimage", "dkm",
)  # fmt: skip
_ANGULAR_RADII = ("radiusdeg", "rdeg")
_RADII = ("radius", "radiuskm", "radiusm", "rkm")
_IDENTIFIERS = ("craterid", "id", "identifier")
_WEST, _EAST = {"w", "west", "lonw"}, {"e", "east", "lone"}
# Words of a name that says radius, and that says another unit than km and m.
_RADIUS = {*_RADII, "radii", "r"}
_DEGREES = {"deg", "degree", "degrees"}
_OTHER_UNITS = {"mi", "mile", "miles", "ft", "feet", "px", "pixel", "pixels", "rad", "arcsec", *_DEGREES}
# Words of a name that says planetographic.
_GRAPHIC = {"planetographic", "graphic", "geodetic"}
# The USGS Gazetteer's column of what coordinates mean, such as "Planetographic, +West, 0 - 360".
_SYSTEM = ("coordinatesystem",)
# Column names that an error lists.
_MAX_LISTED = 30
# Letters of a column name that an error shows.
_MAX_NAME = 40
_METRES_PER = {"km": 1000.0, "m": 1.0}
_METRES = {"m", "metre", "metres", "meter", "meters", "diamm", "diameterm", "radiusm"}


@dataclass(frozen=True)
class ImportOptions:
    """Names of a catalogue's columns; columns that are not named are recognised.

    Attributes
    ----------
    latitude, longitude, diameter : str, optional
        Columns of a catalogue of circles, deg (longitude to the east). A column of sizes whose name says
        radius is read as radii.
    identifier : str, optional
        Column of unique names; without one craters are named by their line.
    unit : {"km", "m"}, optional
        Unit of the sizes; by default the one in the column's name, else km.
    west_longitudes : bool
        Whether longitudes are positive west.
    height : str, optional
        Column of the heights of the rims above the body's sphere, in km if its name says so, else in m; by
        default `RIM_HEIGHT_M`.
    """

    latitude: str | None = None
    longitude: str | None = None
    diameter: str | None = None
    identifier: str | None = None
    unit: str | None = None
    west_longitudes: bool = False
    height: str | None = None


@dataclass(frozen=True)
class Columns:
    """Columns of a table that are to be read.

    Attributes
    ----------
    ellipse : tuple of str
        Latitude, longitude, major and minor diameter, angle; empty for a catalogue of circles.
    circle : tuple of str
        Latitude, longitude, diameter; empty when the table has none beside the ellipse.
    identifier, height, body, body_radius : str or None
    size_m : float
        Diameter in m for a size of 1; for angular sizes, on a sphere of 1 m.
    angular : bool
        Whether sizes are angles at the body's centre.
    tilts : tuple of str
        `TILTS`, or empty.
    sigmas : tuple of str
        Those of `ERROR_COLUMNS`, or their former names, and of `COMMON_COLUMNS`, and `COMMON_SOURCE`.
    west : bool
        Whether longitudes are positive west.
    system : str or None
        Column that says what the coordinates are.
    """

    ellipse: tuple[str, ...]
    circle: tuple[str, ...]
    identifier: str | None
    height: str | None
    body: str | None
    body_radius: str | None
    size_m: float
    angular: bool = False
    tilts: tuple[str, ...] = ()
    sigmas: tuple[str, ...] = ()
    west: bool = False
    system: str | None = None

    @property
    def numbers(self) -> list[str]:
        """Columns to read as numbers."""
        others = [name for name in (self.height, self.body_radius) if name]
        return list(dict.fromkeys([*self.ellipse, *self.circle, *others, *self.tilts, *self.sigmas]))

    @property
    def texts(self) -> list[str]:
        """Columns to read as texts."""
        return [name for name in (self.identifier, self.body, self.system) if name]

    @property
    def height_m(self) -> float:
        """Metres in the unit of the heights, which the column's name says: km, or else m."""
        return _METRES_PER["km" if self.height is not None and "km" in _words(self.height) else "m"]

    @property
    def shown(self) -> str:
        """What the columns were recognised as, as words for messages."""
        names = self.ellipse or self.circle
        half = {1.0: "m", 2.0: "m of radius", 1000.0: "km", 2000.0: "km of radius"}
        unit = "deg of radius" if self.angular else half[self.size_m]
        sizes = " and ".join(names[2:4])
        positive = "west" if self.west else "east"
        height = f", height {self.height} ({'m' if self.height_m == 1.0 else 'km'})" if self.height else ""
        return f"latitude {names[0]}, longitude {names[1]} ({positive}), size {sizes} ({unit}){height}"


def recognise(path: Path, names: Sequence[str], options: ImportOptions, line: int = 1) -> Columns:
    """Recognise the columns of a table.

    Parameters
    ----------
    path : Path
        Named in errors.
    names : sequence of str
        Names in the header.
    options : ImportOptions
    line : int
        Line of the header.

    Returns
    -------
    Columns

    Raises
    ------
    InputError
        When a named column is not there, when one is missing (the error lists what was found), when
        longitudes count to the west without `options` saying so or the other way round, when latitudes are
        planetographic, or when sizes are in other units than km, m, or degrees of radius.
    """
    tilts = all_or_none(path, names, TILTS, line)
    sigmas = [
        name for ours in (ERROR_COLUMNS, COMMON_COLUMNS) for name in all_or_none(path, names, ours, line)
    ]
    if COMMON_SOURCE in names and sigmas[-1:] == list(COMMON_COLUMNS)[-1:]:
        sigmas.append(COMMON_SOURCE)
    rims = _rims(path, names, options, line)
    return replace(
        rims,
        tilts=tuple(tilts),
        sigmas=tuple(sigmas),
        west=options.west_longitudes,
        system=_one_of(names, _SYSTEM),
    )


def all_or_none(path: Path, names: Sequence[str], ours: Iterable[str], line: int | None = None) -> list[str]:
    """Find columns of ours that belong together.

    Parameters
    ----------
    path : Path
        Named in errors.
    names : sequence of str
        Names in the table.
    ours : iterable of str
        Present names; their former names are found, too.
    line : int, optional
        Line of the header.

    Returns
    -------
    list of str
        All of them as the table names them, or none.

    Raises
    ------
    InputError
        When some are missing, or one stands there by both names.
    """
    written: dict[str, str] = {}
    for name in ours:
        either = [one for one in dict.fromkeys((name, FORMER.get(name, name))) if one in names]
        if len(either) > 1:
            problem = f"is the former name of {name}, which is given, too"
            raise InputError(path, problem, line=line, column=either[1])
        written |= dict.fromkeys(either, name)
    for name in ours if written else ():
        if name not in written.values():
            problem = f"expected this column beside {next(iter(written))}"
            raise InputError(path, problem, line=line, column=name)
    return list(written)


def _rims(path: Path, names: Sequence[str], options: ImportOptions, line: int) -> Columns:
    """Recognise the columns of the rims."""
    given = (options.latitude, options.longitude, options.diameter)
    for name in (*given, options.identifier, options.height):
        if name is not None and name not in names:
            raise InputError(path, f"expected this column, found {_listed(names)}", line=line, column=name)
    if options.height is not None and "depth" in _words(options.height):
        problem = "expected heights of the rims above the body's sphere, this column's name says depth"
        raise InputError(path, problem, line=line, column=options.height)
    written = {name.upper(): name for name in names}
    identifier = options.identifier or _one_of(names, _IDENTIFIERS)
    others = (
        identifier, options.height or written.get(HEIGHT),
        next((name for name in names if is_body_column(name)), None),
        written.get(BODY_RADIUS),
    )  # fmt: skip
    unit = None if options.unit is None else _METRES_PER[options.unit]
    circle = tuple(written[name] for name in CIRCLE if name in written)
    circle = circle if len(circle) == len(CIRCLE) else ()
    if not any(given) and MAJOR in written:
        missing = [name for name in ELLIPSE if name not in written]
        if missing:
            raise InputError(
                path,
                f"expected this column beside {MAJOR}, found {_listed(names)}",
                line=line,
                column=missing[0],
            )
        return Columns(tuple(written[name] for name in ELLIPSE), circle, *others, unit or 1000.0)
    if not any(given) and circle:
        return Columns((), circle, *others, unit or 1000.0)
    where = path, names, line
    latitude = _column(*where, "latitude", options.latitude, _LATITUDES)
    longitude = _column(*where, "longitude", options.longitude, _LONGITUDES)
    if _GRAPHIC & _words(latitude):
        problem = (
            "expected planetocentric latitudes, this column's name says planetographic: convert them; on a "
            "sphere they are the same: rename it"
        )
        raise InputError(path, problem, line=line, column=latitude)
    if options.west_longitudes and _EAST & _words(longitude):
        problem = "expected longitudes positive west, as --west-longitudes says, this column's name says east"
        raise InputError(path, problem, line=line, column=longitude)
    if not options.west_longitudes and _WEST & _words(longitude):
        problem = (
            "expected longitudes positive east, this column's name says positive west: --west-longitudes?"
        )
        raise InputError(path, problem, line=line, column=longitude)
    size = _column(*where, "diameter", options.diameter, (*_DIAMETERS, *_ANGULAR_RADII, *_RADII))
    circle = (latitude, longitude, size)
    radius = _RADIUS & {*_words(size), _plain(size)}
    other = _OTHER_UNITS & _words(size)
    if _plain(size) in _ANGULAR_RADII or (radius and other and other <= _DEGREES and unit is None):
        return Columns((), circle, *others, 2.0 * float(np.radians(1.0)), angular=True)
    if other and unit is None:
        problem = f"expected sizes in km or m, this column's name says {min(other)}: convert them (--unit)"
        raise InputError(path, problem, line=line, column=size)
    size_m = unit or _METRES_PER[_unit_in(size)]
    return Columns((), circle, *others, 2.0 * size_m if radius else size_m)


def _column(
    path: Path, names: Sequence[str], line: int, what: str, given: str | None, known: Sequence[str]
) -> str:
    name = given or _one_of(names, known)
    if name is not None:
        return name
    if sum(_is_number(name) for name in names) > 0.5 * len(names):
        problem = f"expected column names in the first line, found numbers: {_listed(names)}"
    else:
        way = f"craternav catalog import --{what}"
        problem = f"no column of a {what} was recognised among {_listed(names)}: name it ({way})"
    raise InputError(path, problem, line=line)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _one_of(names: Sequence[str], known: Sequence[str]) -> str | None:
    """Find the column whose name comes first in a list of known ones."""
    plain = [_plain(name) for name in names]
    return next((names[plain.index(name)] for name in known if name in plain), None)


def _words(name: str) -> set[str]:
    return set(re.split(r"[^a-z]+", name.lower()))


def _unit_in(name: str) -> str:
    return "m" if _METRES & _words(name) else "km"


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(
        name if len(name) <= _MAX_NAME else f"{name[:_MAX_NAME]}..." for name in names[:_MAX_LISTED]
    )
    return f"{shown} and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else shown
