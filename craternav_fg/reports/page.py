"""A self-contained HTML page: text, tables, charts and pictures in sections."""

import base64
import gzip
import importlib.resources
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from craternav_fg.files import replacing
from craternav_fg.reports.svg import identifier


@dataclass(frozen=True)
class Text:
    """A paragraph; a `warning` is highlighted. One of several lines, or with a `title`, is folded."""

    kind: ClassVar[str] = "text"
    text: str
    warning: bool = False
    title: str = ""


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, the key it is sorted by, and whether it is highlighted."""

    text: str
    key: float | str
    concern: bool = False


def number_cell(value: float | None, *, concern: bool = False) -> Cell:
    """Return a cell of a number with three digits, a dash for none."""
    if value is None or math.isnan(value):
        return Cell("–", float("inf"), concern)
    if math.isinf(value):
        return Cell("∞" if value > 0.0 else "-∞", value, concern)
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
class Chart:
    """An interactive chart.

    Attributes
    ----------
    identifier : str
        Unique in the page.
    spec : dict
        Traces (`data`) and `layout` of Plotly; `time`, whether the horizontal axis is the page's time; and
        `follow`, traces that are one point, and where it is at each time.
    height_px : int
    caption : str
    """

    kind: ClassVar[str] = "chart"
    identifier: str
    spec: dict[str, Any]
    height_px: int
    caption: str = ""


@dataclass(frozen=True)
class Picker:
    """A list from which the reader picks what a chart shows: the `picked` curves of its spec."""

    kind: ClassVar[str] = "picker"
    chart: str
    label: str
    choices: Sequence[str]


@dataclass(frozen=True)
class Choice:
    """Charts of which one is shown at a time, with the labels of their buttons."""

    kind: ClassVar[str] = "choice"
    charts: Sequence[tuple[str, Chart]]


@dataclass(frozen=True)
class Picture:
    """A picture: a data URI, its caption, and the index of its frame if it is one's."""

    uri: str
    caption: str
    frame: int | None = None


@dataclass(frozen=True)
class Pictures:
    """Pictures of which one is shown at a time: that of the page's time, or one that is chosen."""

    kind: ClassVar[str] = "pictures"
    pictures: Sequence[Picture]
    caption: str = ""


Block = Text | Table | Drawing | Chart | Picker | Choice | Pictures


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
        Name and colour of each estimator, which the reader can show and hide in all charts and tables.
    times_s : sequence of float
        Times of the frames, for the slider; empty without one.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    series: Sequence[tuple[str, str]] = field(default_factory=tuple)
    times_s: Sequence[float] = field(default_factory=tuple)

    @property
    def charts(self) -> Iterator[Chart]:
        """All charts."""
        for section in self.sections:
            for block in section.blocks:
                if isinstance(block, Chart):
                    yield block
                elif isinstance(block, Choice):
                    yield from (chart for _, chart in block.charts)


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
    specs = {chart.identifier: {"height": chart.height_px, **chart.spec} for chart in page.charts}
    data = {"charts": specs, "times": list(page.times_s)}
    plotly = _plotly() if specs else ""
    environment.filters["identifier"] = identifier
    html = environment.get_template("page.html").render(page=page, data=_json(data), plotly=plotly)
    with replacing(path) as temporary:
        # The name of a folder need not be UTF-8.
        temporary.write_bytes(html.encode("utf-8", "replace"))


def _json(data: Any) -> Markup:
    """Write data into a script element: no character of it can end the element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


@cache
def _plotly() -> str:
    """Return Plotly's program, compressed: the browser unpacks it, and a page has 2 MB less."""
    script = importlib.resources.files("plotly") / "package_data" / "plotly.min.js"
    return base64.b64encode(gzip.compress(script.read_bytes(), mtime=0)).decode("ascii")
