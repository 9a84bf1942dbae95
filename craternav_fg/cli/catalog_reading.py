"""How commands read a catalogue of any origin, and say what was skipped or assumed."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import (
    implausible_heights,
    rims_within,
    unknown_beyond,
    with_covered_heights,
)
from craternav_fg.catalogs.importing import ImportReport
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli.terminal import warn
from craternav_fg.errors import InputError


def body_of_radius(radius_m: float | None) -> Body | None:
    """Make a body without a name of which only the radius is given; None without one."""
    return None if radius_m is None else Body("", radius_m, 1.0, (0.0, 0.0, 0.0))


def read_any_catalog(path: Path, body_radius_m: float | None) -> tuple[Catalog, ImportReport]:
    """Read a catalogue of any origin, and warn of what was skipped or assumed.

    Parameters
    ----------
    path : Path
    body_radius_m : float or None
        Radius of its sphere, if it is given.

    Returns
    -------
    catalog : Catalog
    report : ImportReport
    """
    catalog, report = import_catalog(path, body_of_radius(body_radius_m))
    warn_of(path, report)
    return catalog, report


def with_model_heights(catalog: Catalog, dem: Path, unit_m: float) -> Catalog:
    """Take the heights of the rims from an elevation model, and warn of rims beyond it.

    Beyond the model, a catalogue's own heights stay; where it has none, they are stated to be unknown.

    Parameters
    ----------
    catalog : Catalog
    dem : Path
        GeoTIFF.
    unit_m : float
        Unit of its values.

    Returns
    -------
    Catalog

    Raises
    ------
    InputError
        When the model cannot be read or covers no crater, or its heights are implausible for the body.
    """
    model = read_dem(dem, unit_m, catalog.body.radius_m)
    beyond = int(np.count_nonzero(~rims_within(catalog, model)))
    if beyond == len(catalog):
        raise InputError(dem, f"expected ground of the {beyond:,} craters, found that of none")
    found = with_covered_heights(catalog, model)
    problem = implausible_heights(found)
    if problem is not None:
        raise InputError(dem, problem)
    if not beyond:
        return found
    kept = "keep the catalogue's heights" if catalog.has_heights else "are put on the sphere, heights unknown"
    warn(f"{dem}: {beyond:,} of {len(catalog):,} craters reach beyond it, and {kept}")
    return found if catalog.has_heights else unknown_beyond(found, model)


def warn_of(path: Path, report: ImportReport) -> None:
    """Warn of what was skipped in a catalogue, or assumed about it."""
    if report.skipped:
        warn(f"{path}: {'; '.join(skipped_lines(report))}")
    if not report.body_by:
        # Some commands have no option for the body: all read what is imported with one.
        warn(assumed_body(path, "craternav catalog import --body"))


def warn_of_lost_heights(paths: Sequence[Path], parts: Sequence[Catalog], joined: Catalog) -> None:
    """Warn when heights of some catalogues are lost, as others that were joined with them state none."""
    without = [str(path) for path, part in zip(paths, parts, strict=True) if not part.has_heights]
    if not joined.has_heights and len(without) < len(parts):
        warn(f"no heights of rims are written, as {', '.join(without)} states none: --dem sets those of all")


def warn_of_exact_rims(paths: Sequence[Path], parts: Sequence[Catalog]) -> None:
    """Warn when some of the catalogues that are joined state errors, and others do not."""
    without = [str(path) for path, part in zip(paths, parts, strict=True) if part.errors is None]
    if 0 < len(without) < len(parts):
        warn(
            f"{', '.join(without)} states no errors of rims: beside the others these rims count as exact; "
            "craternav catalog merge estimates their errors"
        )


def assumed_body(path: Path, what: str) -> str:
    """Say that a catalogue is assumed to be the Moon's, and what says otherwise."""
    return f"{path}: does not name its body, the Moon is assumed ({what} gives another)"


def skipped_lines(report: ImportReport) -> list[str]:
    """Return how many rows were skipped, by reason."""
    reasons = [row.reason.partition(", found ")[0] for row in report.skipped]
    lines = []
    for reason, count in Counter(reasons).most_common():
        first = report.skipped[reasons.index(reason)]
        rows = "1 row" if count == 1 else f"{count} rows"
        where = f"line {first.line}" if count == 1 else f"the first in line {first.line}"
        found = first.reason.partition(", found ")[2]
        lines.append(f"{rows} skipped: {reason}, {where}: found {found}")
    return lines
