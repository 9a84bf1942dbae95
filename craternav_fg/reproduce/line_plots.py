"""Line plots of the reproduced figures: errors over altitude, deviation and descent."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator, StrMethodFormatter

from factors.arrays import FloatArray

# Inches.
_SIZE = (8.0, 5.0)
# A descent reaches an altitude when one of its frames is this near to it.
_PASSED_WITHIN_KM = 1.0
# Offset of neighbouring bars, as a share of the altitude step.
_BAR_OFFSET = 0.08


@dataclass(frozen=True)
class Series:
    """A method's errors over the altitude.

    Attributes
    ----------
    colour, marker, line : str
        In matplotlib's notation; line "" draws none.
    mean : ndarray, shape (k,)
        In the unit of the figure.
    low, high : ndarray, shape (k,), or None
        16 % and 84 % quantiles of the trials, in the same unit.
    """

    colour: str
    marker: str
    line: str
    mean: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None


def draw_deviation(
    tilts_deg: FloatArray, altitudes: FloatArray, values: FloatArray, pixel_deg: float
) -> Figure:
    """Draw fig. 2: deviation of the line of sight over the altitude, and the angle of a pixel.

    Parameters
    ----------
    tilts_deg : ndarray, shape (m,)
    altitudes : ndarray, shape (n,)
        In radii.
    values : ndarray, shape (m, n)
        Deviations, deg.
    pixel_deg : float

    Returns
    -------
    Figure
    """
    figure, axes = _axes()
    axes.axhline(pixel_deg, color="0.4", ls="--", lw=1.0)
    axes.annotate("one pixel", (altitudes.max(), pixel_deg), ha="right", va="bottom", color="0.3")
    _curves(axes, altitudes, values, tilts_deg)
    axes.set_ylabel("deviation of the line of sight, deg")
    return figure


def draw_centre_error(tilts_deg: FloatArray, altitudes: FloatArray, values: FloatArray) -> Figure:
    """Draw fig. 3: median position error over the altitude.

    Parameters
    ----------
    tilts_deg : ndarray, shape (m,)
    altitudes : ndarray, shape (n,)
        In radii.
    values : ndarray, shape (m, n)
        Errors in radii.

    Returns
    -------
    Figure
    """
    figure, axes = _axes()
    _curves(axes, altitudes, values, tilts_deg)
    axes.set_ylabel("position error (median), crater radii")
    return figure


def _curves(axes: Axes, altitudes: FloatArray, values: FloatArray, tilts_deg: FloatArray) -> None:
    for colour, tilt, value in zip(_shades(len(tilts_deg)), tilts_deg, values, strict=True):
        axes.plot(altitudes, value, "o-", color=colour, ms=4, lw=1.5, label=f"{tilt} deg")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(FixedLocator(list(altitudes)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("altitude, crater radii")
    axes.legend(title="angle of incidence", frameon=False)


def draw_error_over_deviation(altitudes: FloatArray, deviation: FloatArray, error: FloatArray) -> Figure:
    """Draw fig. 4: median position error over the deviation of the line of sight, a line per altitude.

    Parameters
    ----------
    altitudes : ndarray, shape (n,)
        In radii.
    deviation : ndarray, shape (m, n)
        By tilt and altitude, deg.
    error : ndarray, shape (m, n)
        In radii.

    Returns
    -------
    Figure
    """
    figure, axes = _axes()
    for j, (colour, altitude) in enumerate(zip(_shades(len(altitudes)), altitudes, strict=True)):
        axes.plot(deviation[:, j], error[:, j], "o-", color=colour, ms=4, lw=1.5, label=f"{altitude} r")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("deviation of the line of sight, deg")
    axes.set_ylabel("position error (median), crater radii")
    axes.legend(title="altitude", frameon=False)
    return figure


def draw_errors(
    altitudes_km: FloatArray,
    series: Mapping[str, Series],
    quantity: str,
    title: str,
    paper: Sequence[tuple[float, float, float]] = (),
) -> Figure:
    """Draw figs. 11 to 14: mean errors over the altitude.

    Parameters
    ----------
    altitudes_km : ndarray, shape (k,)
    series : mapping of str to Series
        By their names in the legend.
    quantity, title : str
    paper : sequence of tuple of float
        The paper's printed numbers: altitude, km, mean and standard deviation.

    Returns
    -------
    Figure
    """
    figure, axes = _axes()
    spread = altitudes_km[1] - altitudes_km[0] if len(altitudes_km) > 1 else 1.0
    with_bars = [name for name, s in series.items() if s.low is not None]
    for name, s in series.items():
        x = altitudes_km
        if s.low is not None and s.high is not None:
            # Bars of one altitude stand side by side.
            x = altitudes_km + _BAR_OFFSET * spread * (with_bars.index(name) - 0.5 * (len(with_bars) - 1))
            axes.vlines(x, s.low, s.high, color=s.colour, lw=1.2, alpha=0.6)
        axes.plot(x, s.mean, s.line, marker=s.marker, color=s.colour, ms=4.5, lw=1.5, label=name)
    if paper:
        x, mean, deviation = np.array(paper).T
        axes.plot(x, mean, "*", color="k", ms=12, zorder=5, label="paper (mean, 1 sigma)")
        axes.plot(x, mean + deviation, "_", color="k", ms=8, zorder=5)
        shown = deviation < mean
        axes.plot(x[shown], (mean - deviation)[shown], "_", color="k", ms=8, zorder=5)
    axes.set_yscale("log")
    if paper:
        bottom = axes.get_ylim()[0]
        # A lower end at or below zero is not on a logarithmic axis: the bar runs to the axis, without a cap.
        axes.vlines(
            x, np.where(shown, mean - deviation, bottom), mean + deviation, color="k", lw=1.2, zorder=5
        )
        axes.set_ylim(bottom=bottom)
    axes.set_xlabel("altitude, km")
    axes.set_ylabel(quantity)
    axes.set_title(title, fontsize=10)
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplots()
    axes.grid(alpha=0.3)
    return figure, axes


def _shades(count: int) -> FloatArray:
    """Colours from dark to light, for ordered curves."""
    return np.asarray(colormaps["viridis"](np.linspace(0.0, 0.88, count)))


@dataclass(frozen=True)
class Line:
    """An error over the altitude.

    Attributes
    ----------
    colour, style : str
    value : ndarray, shape (k,)
        In the unit of the figure.
    """

    colour: str
    style: str
    value: FloatArray


def draw_descent(
    altitude_km: FloatArray,
    lines: Mapping[str, Line],
    craters: FloatArray,
    quantity: str,
    title: str,
    paper: tuple[float, float, str] | None = None,
) -> Figure:
    """Draw figs. 15 to 18: errors over the altitude, falling to the right, and craters in view below.

    Parameters
    ----------
    altitude_km : ndarray, shape (k,)
    lines : mapping of str to Line
    craters : ndarray, shape (k,)
        Mean number in view.
    quantity, title : str
    paper : tuple, optional
        Altitude, km, value and name of the paper's printed number.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    for name, line in lines.items():
        axes.plot(altitude_km, line.value, line.style, color=line.colour, lw=1.4, label=name)
    # Drawn only where the descents pass: elsewhere it would lie outside the axes.
    if paper is not None and np.abs(altitude_km - paper[0]).min() < _PASSED_WITHIN_KM:
        axes.plot(paper[0], paper[1], "*", color="k", ms=12, zorder=5, label=paper[2], clip_on=False)
    axes.set_yscale("log")
    axes.set_ylabel(quantity)
    axes.set_title(title, fontsize=10)
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    below.plot(altitude_km, craters, color="0.3", lw=1.4)
    below.set_ylim(0.0, 1.1 * max(float(craters.max()), 1.0))
    below.set_ylabel("craters")
    below.set_xlabel("altitude, km")
    below.set_xlim(float(altitude_km.max()), float(altitude_km.min()))
    for one in (axes, below):
        one.grid(alpha=0.3)
    return figure
