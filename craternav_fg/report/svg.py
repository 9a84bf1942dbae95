"""matplotlib figures as SVG within a page, with curves that its buttons show and hide."""

import io
import re
from collections.abc import Iterable

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Narrow, with the letters' size of the text: a telephone shows a drawing as it is.
WIDTH_IN = 5.0
# matplotlib's names of parts are the same in every figure; in one page each may occur once.
_NAMES = re.compile(r'(\bid="|xlink:href="#|url\(#)')


def inline_svg(figure: Figure, name: str) -> Markup:
    """Give a figure as an `<svg>` element that takes the width it is given.

    Parameters
    ----------
    figure : Figure
    name : str
        Of the drawing, unlike all others' in the page: the identifiers of its parts begin with it.

    Returns
    -------
    Markup
        From `<svg` on. The same figure gives the same text.
    """
    out = io.StringIO()
    # Text as text: it can be searched and read aloud, and takes a tenth of the room of outlines.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "font.family": "sans-serif"}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = _NAMES.sub(lambda found: f"{found[0]}{name}-", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    return Markup(svg)


def mark(axes: Iterable[Axes], names: Iterable[str]) -> None:
    """Mark the lines that bear a series' name as label, so that the page can hide them.

    A label may go on after the name: `smoother (mean 6.1)`.
    """
    known = list(names)
    for number, line in enumerate(line for panel in axes for line in panel.get_lines()):
        name = str(line.get_label()).split(" ")[0]
        if name in known:
            line.set_gid(f"series--{name}--{number}")
