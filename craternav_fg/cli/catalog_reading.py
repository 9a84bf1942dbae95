"""What commands that take a catalogue share: reading it, and saying what became of it."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from craternav_fg.body import Body
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.importing import ImportReport
from craternav_fg.catalogs.model import Catalog
from craternav_fg.cli.terminal import err

CatalogBodyOption = Annotated[
    float | None,
    typer.Option(
        "--body-radius-m",
        min=1.0,
        help="Of the catalogue's sphere.",
        show_default="as the file tells, else the Moon's",
    ),
]


def read_any_catalog(path: Path, body_radius_m: float | None) -> tuple[Catalog, ImportReport]:
    """Read a catalogue of any origin, with a warning about what was left out or taken for granted."""
    body = None if body_radius_m is None else Body("", body_radius_m, 1.0, (0.0, 0.0, 0.0))
    catalog, report = import_catalog(path, body)
    warn_of(path, report)
    return catalog, report


def warn_of(path: Path, report: ImportReport) -> None:
    """Warn about what was left out of a catalogue, or taken for granted."""
    if report.skipped:
        warn(f"{path}: {'; '.join(skipped_lines(report))}")
    if not report.body_by:
        warn(assumed_body(path, "--body-radius-m"))


def assumed_body(path: Path, option: str) -> str:
    """Say that a catalogue is taken for the Moon's."""
    return f"{path}: nothing tells of which body it is: taken for the Moon's ({option})"


def skipped_lines(report: ImportReport) -> list[str]:
    """Say how many rows were left out, by what is wrong with them."""
    reasons = [row.reason.partition(", found ")[0] for row in report.skipped]
    said = []
    for reason, count in Counter(reasons).most_common():
        first = report.skipped[reasons.index(reason)]
        rows = "1 row" if count == 1 else f"{count} rows"
        where = f"line {first.line}" if count == 1 else f"the first in line {first.line}"
        found = first.reason.partition(", found ")[2]
        said.append(f"{rows} left out: {reason}, {where}: found {found}")
    return said


def warn(text: str) -> None:
    """Print a warning, on one line."""
    err.print(f"craternav: warning: {text}", style="yellow", highlight=False, markup=False, soft_wrap=True)
