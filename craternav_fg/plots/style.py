"""What all figures share: the look of each estimator's line, and how a figure is saved."""

import itertools
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

from craternav_fg.files import replacing
from factors.arrays import FloatArray

# Colours of Okabe and Ito, then three of Tol's, which most readers can tell apart. An estimator has the same
# colour in every figure.
COLOURS = {
    "smoother": "#0072B2",
    "gnc_smoother": "#F0E442",
    "self_calibrating_smoother": "#332288",
    "map_refining_smoother": "#882255",
    "online": "#56B4E9",
    "fixed_lag": "#CC79A7",
    "ekf": "#009E73",
    "ekf_paper": "#E69F00",
    "centre_smoother": "#D55E00",
    "dead_reckoning": "#7F7F7F",
}
# For lines of others; the first is Brewer's, the rest are Tol's.
_OTHER_COLOURS = ("#8C510A", "#117733", "#999933", "#44AA99", "#AA4499", "#661100")
_OTHER_LOOKS = tuple(itertools.product(("-", "--", "-.", ":"), _OTHER_COLOURS))
# These lines often coincide with that of the EKF or the smoother: dashed and on top, both remain visible.
_DASHED = frozenset({"online", "gnc_smoother"})
# Ends of the names of estimators with another measurement: the colour of the one without, in another dash.
_VARIANTS = {"_eq19": "-.", "_los": ":"}
# Least and largest numbers on a logarithmic axis that are readable without powers of ten.
_PLAIN = 1e-5, 1e6
# Of PNG files, as zlib counts: twice as fast as its default, and files of noisy images are 13 % larger.
_COMPRESSION = 2


def colour(name: str) -> str:
    """Colour of an estimator, the same in all figures; variants of an estimator share it."""
    return _look(name)[1]


def line_style(name: str) -> dict[str, Any]:
    """Colour, dash and drawing order of an estimator's line, the same in all figures."""
    return _style(*_look(name))


def line_styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the lines of the estimators of one figure: as `line_style`, but no two of others are alike.

    Parameters
    ----------
    names : iterable of str
        Names of estimators; one may occur several times.

    Returns
    -------
    dict of str to dict
        Keyword arguments of matplotlib's `plot`, by name.
    """
    looks: dict[str, tuple[str, str]] = {}
    for name in dict.fromkeys(names):
        look = _look(name)
        if _is_other(name):
            start = _OTHER_LOOKS.index(look)
            following = (*_OTHER_LOOKS[start:], *_OTHER_LOOKS[:start])
            look = next((one for one in following if one not in looks.values()), look)
        looks[name] = look
    return {name: _style(*look) for name, look in looks.items()}


def _style(dash: str, hue: str) -> dict[str, Any]:
    return {"color": hue, "ls": dash, "zorder": 2 if dash == "-" else 3}


def _is_other(name: str) -> bool:
    return _base_and_dash(name)[0] not in COLOURS


def _look(name: str) -> tuple[str, str]:
    """Dash and colour of a line; those of other estimators follow from the letters of their names."""
    if _is_other(name):
        return _OTHER_LOOKS[zlib.crc32(name.encode()) % len(_OTHER_LOOKS)]
    base, dash = _base_and_dash(name)
    return dash, COLOURS[base]


def _base_and_dash(name: str) -> tuple[str, str]:
    """Name of the estimator that gives the colour, and the dash of the line."""
    for end, dash in _VARIANTS.items():
        if name.endswith(end):
            return name.removesuffix(end), dash
    return name, "--" if name in _DASHED else "-"


def finish(axes: Axes) -> None:
    """Add a light grid, and let the lines run from one side to the other."""
    axes.grid(alpha=0.3)
    axes.margins(x=0.01)


def number_plainly(figure: Figure) -> None:
    """Write numbers on logarithmic axes in place of powers of ten, unless they reach beyond `_PLAIN`."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            if isinstance(axis.get_major_formatter(), LogFormatterSciNotation) and (
                low >= _PLAIN[0] and high <= _PLAIN[1]
            ):
                axis.set_major_formatter(_Plain())
                axis.set_minor_formatter(_Plain(labelOnlyBase=False))


class _Plain(LogFormatterSciNotation):
    """Labels the ticks that matplotlib would, by numbers."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def seconds_since_first(stamps_ns: npt.NDArray[np.int64]) -> FloatArray:
    """Return the times since the first stamp.

    Parameters
    ----------
    stamps_ns : ndarray of int, shape (k,)

    Returns
    -------
    ndarray, shape (k,)
        s.
    """
    return (stamps_ns - stamps_ns[0]) * 1e-9


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write a figure in the format that its name ends in, whole or not at all.

    Parameters
    ----------
    figure : Figure
    path : Path
        Its folder is made when missing.
    dpi : int
        Pixels per inch.

    Raises
    ------
    InputError
        When `path` is a folder or cannot be written.
    """
    number_plainly(figure)
    canvas = FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        if path.suffix == ".png":
            # `savefig` would draw it twice, first for its layout only, and give the same pixels.
            figure.set_dpi(dpi)
            canvas.print_png(temporary, pil_kwargs={"compress_level": _COMPRESSION})  # type: ignore[no-untyped-call]
        else:
            figure.savefig(temporary, dpi=dpi)
