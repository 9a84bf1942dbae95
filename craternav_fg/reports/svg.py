"""matplotlib figures as SVG in a page, with curves that its buttons show and hide."""

import hashlib
import io
import re
from collections.abc import Iterable

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from craternav_fg.plots.style import number_plainly

# So narrow that the letters of a drawing have the size of the text, also on a telephone.
WIDTH_IN = 5.0
# matplotlib gives the parts of every figure the same identifiers; in a page each may occur once.
_NAME = re.compile(r"[a-z0-9-]+")
_NAMES = re.compile(r'(\bid="|xlink:href="#|url\(#)')


def identifier(name: str) -> str:
    """Return a name's identifier in a page: letters and digits, whatever the name is.

    Names come from files: as part of an attribute or a selector they could end it and begin a script.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
    """
    return hashlib.blake2b(name.encode("utf-8", "replace"), digest_size=6).hexdigest()


def inline_svg(figure: Figure, name: str) -> Markup:
    """Return a figure as an `<svg>` element that fills the width of the page.

    Parameters
    ----------
    figure : Figure
    name : str
        Name of the drawing, unique in the page: the identifiers of its parts begin with it. Lower-case
        letters, digits and hyphens.

    Returns
    -------
    Markup
        Begins with `<svg`. The same figure gives the same text.

    Raises
    ------
    ValueError
        When the name has other characters.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"expected lower-case letters, digits and hyphens, found {name!r}")
    out = io.StringIO()
    # Text stays text: it can be searched and read aloud, and is a tenth as long as outlines.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "font.family": "sans-serif"}):
        number_plainly(figure)
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = _NAMES.sub(lambda found: f"{found[0]}{name}-", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    return Markup(svg)


def mark(axes: Iterable[Axes], names: Iterable[str]) -> None:
    """Mark the lines whose label begins with the name of a series, so that the page can hide them.

    Parameters
    ----------
    axes : iterable of Axes
    names : iterable of str
        Names of the series. A label may continue after the name: `smoother (mean 6.1)`.
    """
    known = list(names)
    for number, line in enumerate(line for panel in axes for line in panel.get_lines()):
        label = str(line.get_label())
        # The longest, as a name may begin with another one.
        found = [name for name in known if label == name or label.startswith(f"{name} (")]
        if found:
            line.set_gid(f"series--{identifier(max(found, key=len))}--{number}")
