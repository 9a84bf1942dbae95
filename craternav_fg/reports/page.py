"""A self-contained HTML page: text, tables, drawings and pictures in sections."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from craternav_fg.files import replacing
from craternav_fg.reports.svg import identifier


@dataclass(frozen=True)
class Text:
    """A paragraph; a `warning` is highlighted, and one of several lines can be folded."""

    kind: ClassVar[str] = "text"
    text: str
    warning: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, the key it is sorted by, and whether it is highlighted."""

    text: str
    key: float | str
    concern: bool = False


def number_cell(value: float | None, *, concern: bool = False) -> Cell:
    """Give a cell of a number with three digits, a dash for none."""
    if value is None or not math.isfinite(value):
        return Cell("–", float("inf"))
    text = f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return Cell(text, value, concern)


@dataclass(frozen=True)
class Table:
    """A table. A row that belongs to an estimator is hidden with it; others have an empty name."""

    kind: ClassVar[str] = "table"
    headings: Sequence[str]
    rows: Sequence[tuple[str, Sequence[Cell]]]
    caption: str = ""


@dataclass(frozen=True)
class Drawing:
    """A drawing as inline SVG, see `craternav_fg.reports.svg`."""

    kind: ClassVar[str] = "drawing"
    svg: Markup
    caption: str = ""


@dataclass(frozen=True)
class Choice:
    """Drawings of which one is shown at a time, with the labels of their buttons."""

    kind: ClassVar[str] = "choice"
    drawings: Sequence[tuple[str, Drawing]]


@dataclass(frozen=True)
class Pictures:
    """Pictures of which one is shown at a time: data URIs, each with its caption."""

    kind: ClassVar[str] = "pictures"
    pictures: Sequence[tuple[str, str]]
    caption: str = ""


Block = Text | Table | Drawing | Choice | Pictures


@dataclass(frozen=True)
class Section:
    """A section of a page; the menu links to its `identifier`."""

    identifier: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes
    ----------
    title, subtitle : str
    sections : sequence of Section
    series : sequence of (str, str)
        Name and colour of each estimator, which the reader can show and hide in all drawings and tables.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    series: Sequence[tuple[str, str]] = field(default_factory=tuple)


def write_page(page: Page, path: Path) -> None:
    """Write a page as one HTML file, whole or not at all.

    Parameters
    ----------
    page : Page
    path : Path

    Raises
    ------
    InputError
        When `path` is a folder or cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("craternav_fg.reports", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["identifier"] = identifier
    # The name of a folder need not be UTF-8.
    html = environment.get_template("page.html").render(page=page).encode("utf-8", "replace")
    with replacing(path) as temporary:
        temporary.write_bytes(html)
