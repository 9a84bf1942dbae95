"""Store of a catalogue: a Parquet file that opens fast, as its rows are in the order of the spatial index."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pa_compute

from craternav_fg.body import Body
from craternav_fg.catalogs import checks
from craternav_fg.catalogs.bodies import StatedBody, resolve_body
from craternav_fg.catalogs.columns import all_or_none
from craternav_fg.catalogs.common_shift import CommonShift
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import InputError
from craternav_fg.tables import arrow, parquet
from factors.arrays import FloatArray

FORMAT = 1
SUFFIX = ".parquet"
_KEY = b"craternav_catalog"
_ID = "crater_id"
# Latitude and longitude are planetocentric, east-positive; the angle counts from east towards north.
_NUMBERS = ("latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m")
_SCHEMA = pa.schema(
    [
        parquet.filled(_ID, pa.string()),
        *(parquet.filled(name, pa.float64()) for name in _NUMBERS),
    ]
)
# Optional: standard deviations, by the name in `MapErrors` and in `CommonShift`; of each all or none. NaN
# stands for an unknown common shift.
_ERRORS = {"place_m": "sigma_place_m", "size_share": "sigma_size_share", "height_m": "sigma_height_m"}
_COMMON = {"place_m": "sigma_common_place_m", "height_m": "sigma_common_height_m"}
# Beside those of a common shift; older files do not have it, and their craters are of one source.
_SOURCE = "common_source"
# Slopes of the rims' planes, both or none.
_TILTS = ("plane_tilt_east_rad", "plane_tilt_north_rad")
# Present names of columns by the former ones.
_FORMER = {"sigma_size": "sigma_size_share"}
_OPTIONAL_SCHEMA = pa.schema(
    [
        *(parquet.filled(name, pa.float64()) for name in _TILTS),
        *(parquet.filled(name, pa.float64()) for name in (*_ERRORS.values(), *_COMMON.values())),
        parquet.filled(_SOURCE, pa.int64()),
    ]
)


def write_parquet(path: Path, catalog: Catalog, beside: Mapping[str, npt.ArrayLike] | None = None) -> None:
    """Write a catalogue; numbers read back exactly.

    Columns: crater_id; latitude_rad, longitude_rad; semi_major_m, semi_minor_m; angle_rad, from east towards
    north; height_m, of the rim above the sphere; plane_tilt_east_rad and plane_tilt_north_rad where not all
    planes are level; sigma_place_m, sigma_size_share and sigma_height_m where the catalogue states errors;
    sigma_common_place_m, sigma_common_height_m (NaN where unknown) and common_source where it states those of
    a common shift. Body, format, and whether the heights are known are in the file's
    metadata.

    Parameters
    ----------
    path : Path
    catalog : Catalog
    beside : mapping of str to array_like, shape (n,) or (n, k), optional
        Further columns, in the order of the catalogue, which `read_parquet` does not read; a second axis
        becomes a list in each row.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    order = catalog.index.order
    ordered = catalog.take(order)
    about = {"format": FORMAT, "body": ordered.body.name, "radius_m": float(ordered.body.radius_m)}
    about["has_heights"] = ordered.has_heights
    arrays = [pa.array(ordered.identifiers, pa.string())]
    arrays += [pa.array(getattr(ordered, name)) for name in _NUMBERS]
    more: dict[str, pa.Array] = {}
    if ordered.plane_tilt_rad is not None:
        more |= {name: pa.array(tilt) for name, tilt in zip(_TILTS, ordered.plane_tilt_rad.T, strict=True)}
    for stated, names in (
        (ordered.errors, _ERRORS),
        (ordered.common_shift, {**_COMMON, "source": _SOURCE}),
    ):
        if stated is not None:
            more |= {name: pa.array(getattr(stated, key)) for key, name in names.items()}
    more |= {name: pa.array(np.asarray(column)[order].tolist()) for name, column in (beside or {}).items()}
    fields = [*_SCHEMA, *(pa.field(name, column.type) for name, column in more.items())]
    schema = pa.schema(fields, metadata={_KEY: json.dumps(about).encode()})
    arrays += more.values()
    parquet.write_parquet(path, pa.Table.from_arrays(arrays, schema=schema))


def read_parquet(path: Path, body: Body | None) -> Catalog:
    """Read a catalogue that `write_parquet` wrote.

    Parameters
    ----------
    path : Path
    body : Body or None
        Must have the radius of the catalogue's body; None for that body, without gravity and spin.

    Returns
    -------
    Catalog

    Raises
    ------
    InputError
        When the file is not such a store or of another body, or a value is out of range.
    """
    about = _metadata(path)
    body, _ = resolve_body(path, body, _stated(path, about))
    table = parquet.read_parquet(
        path, _SCHEMA, optional=_OPTIONAL_SCHEMA, renamed=_FORMER, other_columns=True
    )
    if not len(table):
        raise InputError(path, "expected at least one crater, found none")
    if pa_compute.count_distinct(table[_ID]).as_py() != len(table):
        raise InputError(path, "expected each identifier once, found one again", column=_ID)
    values = {name: arrow.numbers(table[name]) for name in _NUMBERS}
    _check(path, values, body)
    errors = _sigmas(path, table, _ERRORS)
    # Older files do not say, and have heights.
    has_heights = about.get("has_heights") is not False
    return Catalog(
        identifiers=tuple(table[_ID].to_pylist()), body=body, has_heights=has_heights, sphere_stated=True,
        errors=None if errors is None else MapErrors(**errors),
        common_shift=_common_shift(path, table), plane_tilt_rad=_tilts(path, table), **values,
    )  # fmt: skip


def is_store(path: Path) -> bool:
    """Return whether a Parquet file was written by `write_parquet`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool

    Raises
    ------
    InputError
        When it cannot be opened, or is no Parquet file.
    """
    return parquet.read_parquet_metadata(path, _KEY) is not None


def _tilts(path: Path, table: pa.Table) -> FloatArray | None:
    columns = []
    for name in all_or_none(path, table.column_names, _TILTS):
        tilt = arrow.numbers(table[name])
        problem = checks.tilt_fault(np.degrees(tilt))
        if problem is not None:
            raise InputError(path, f"{problem[1]} in row {problem[0] + 1}", column=name)
        columns.append(tilt)
    return np.stack(columns, axis=-1) if columns else None


def _common_shift(path: Path, table: pa.Table) -> CommonShift | None:
    sigmas = _sigmas(path, table, _COMMON, may_be_nan=True)
    if sigmas is None:
        return None
    source = np.zeros(len(table), dtype=np.int64)
    if _SOURCE in table.column_names:
        source = np.asarray(table[_SOURCE].to_numpy(), dtype=np.int64)
    return CommonShift(**sigmas, source=source)


def _sigmas(
    path: Path, table: pa.Table, names: Mapping[str, str], *, may_be_nan: bool = False
) -> dict[str, FloatArray] | None:
    """Read columns of standard deviations, None when the file has none of them."""
    if not all_or_none(path, table.column_names, names.values()):
        return None
    found = {}
    for key, name in names.items():
        values = arrow.numbers(table[name])
        good = (values >= 0.0) & (values < np.inf)
        if not (good | np.isnan(values) if may_be_nan else good).all():
            raise InputError(path, "expected finite numbers of 0 or more", column=name)
        found[key] = values
    return found


def _metadata(path: Path) -> dict[str, object]:
    """Read what the metadata say of the catalogue."""
    try:
        about = json.loads(parquet.read_parquet_metadata(path, _KEY) or b"")
    except (ValueError, RecursionError):
        about = None
    if not isinstance(about, dict):
        raise _no_store(path)
    return about


def _stated(path: Path, about: dict[str, object]) -> StatedBody:
    """Read which body the metadata name."""
    try:
        radius_m = float(str(about["radius_m"]))
        stated = StatedBody(str(about["body"]), radius_m, True, "its metadata say", "radius_m")
    except (KeyError, ValueError):
        raise _no_store(path) from None
    if about.get("format") != FORMAT:
        raise InputError(path, f"expected format {FORMAT}, found {about.get('format')}: import it again")
    return stated


def _no_store(path: Path) -> InputError:
    return InputError(
        path, "expected a catalogue that `craternav catalog import` wrote: body and format are missing"
    )


def _check(path: Path, values: dict[str, FloatArray], body: Body) -> None:
    latitude, longitude, major, minor, angle, height = (values[name] for name in _NUMBERS)
    half, turn = 0.5 * np.pi, 2.0 * np.pi
    tests = [
        ("latitude_rad", np.abs(latitude) <= half + 1e-9, latitude, "-pi/2 to pi/2"),
        ("longitude_rad", np.abs(longitude) <= turn + 1e-9, longitude, "-2 pi to 2 pi"),
        ("semi_major_m", (major > 0.0) & (major < body.radius_m), major, f"0 to {body.radius_m:g}"),
        ("semi_minor_m", (minor > 0.0) & (minor <= major), minor, "more than 0, at most semi_major_m"),
        ("angle_rad", np.isfinite(angle), angle, "a finite number"),
        ("height_m", (height > -body.radius_m) & (height < np.inf), height, "a rim above the body's centre"),
    ]
    for name, good, found, expected in tests:
        if not good.all():
            row = int(np.flatnonzero(~good)[0])
            raise InputError(path, f"expected {expected}, found {found[row]:g} in row {row + 1}", column=name)
