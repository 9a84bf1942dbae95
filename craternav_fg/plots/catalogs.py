"""Figures of a crater catalogue: the whole body, or the surroundings of a place."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.checks import overlaps
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import CraternavError
from factors.arrays import FloatArray

IntArray = npt.NDArray[np.intp]

# Okabe and Ito's colours.
_INK, _CROSSING, _DUPLICATE = "#0072B2", "#E69F00", "#D55E00"
# Cells of the density map, in latitude and longitude: 5 deg of longitude each.
_DENSITY_CELLS = (36, 72)
# A map of the body draws this many craters as rims at the most, more of them as their density.
_MAX_RIMS_ON_GLOBE = 3000
# A map of a region draws at the most so many rims, the largest: more take seconds and merge into one another.
_MAX_RIMS_IN_REGION = 20_000
# Of those the largest have their names written, in this size.
_MAX_LABELS, _LABEL_PT = 15, 7.0
# Width of a letter and distance of two lines, of the size of the letters.
_LETTER, _LINE = 0.62, 1.4
# Points that draw a rim.
_RIM_POINTS = 48
# Points that draw the curve of sizes.
_CURVE_POINTS = 2000


def draw_globe(catalog: Catalog) -> Figure:
    """Draw where the craters are, on an equal-area map, and the cumulative distribution of their sizes.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    Figure

    Raises
    ------
    CraternavError
        When the catalogue is empty.
    """
    if not len(catalog):
        raise CraternavError("expected craters to draw, found an empty catalogue")
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    ground, sizes = figure.subplots(1, 2, width_ratios=[2.4, 1.0])
    if len(catalog) < _MAX_RIMS_ON_GLOBE:
        _draw_rims(ground, catalog)
    else:
        _draw_density(figure, ground, catalog)
    latitudes = np.array([-90, -60, -30, 0, 30, 60, 90])
    ground.set_yticks(np.sin(np.radians(latitudes)), [f"{value:d}" for value in latitudes])
    ground.set_xticks(np.arange(-180, 181, 60))
    ground.set_xlim(-180.0, 180.0)
    ground.set_ylim(-1.0, 1.0)
    ground.set_xlabel("longitude (east), deg")
    ground.set_ylabel("latitude, deg (equal areas)")
    ground.set_title(f"{len(catalog):,} craters of {_named(catalog.body)}")
    _draw_sizes(sizes, catalog)
    return figure


def draw_region(catalog: Catalog, latitude_rad: float, longitude_rad: float, radius_m: float) -> Figure:
    """Draw the rims around a place, true to distance and direction from it, the largest with their names.

    Parameters
    ----------
    catalog : Catalog
    latitude_rad, longitude_rad : float
        Coordinates of the place.
    radius_m : float
        From the place to the border.

    Returns
    -------
    Figure
    """
    reach_km = 1e-3 * radius_m
    enu = frames.east_north_up(np.array(latitude_rad), np.array(longitude_rad))
    # The corners are within 1.5 times the distance of the border.
    largest_m = float(catalog.semi_major_m.max(initial=0.0))
    rows, _ = catalog.near(latitude_rad, longitude_rad, 1.5 * radius_m + largest_m)
    centres_km = _from_place_km(catalog, rows, enu)
    beyond_km = np.linalg.norm(np.maximum(np.abs(centres_km) - reach_km, 0.0), axis=1)
    reaching = beyond_km < 1e-3 * catalog.semi_major_m[rows]
    rows, centres_km = rows[reaching], centres_km[reaching]
    count = len(rows)
    order = np.argsort(-catalog.semi_major_m[rows], kind="stable")[:_MAX_RIMS_IN_REGION]
    part, centres_km = catalog.take(rows[order]), centres_km[order]
    major = part.gRl[:, :, 0] @ enu
    colours, key = _colours(part)
    figure = Figure(figsize=(7.5, 7.8), layout="constrained")
    axes = figure.subplots()
    axes.add_collection(
        EllipseCollection(
            2e-3 * part.semi_major_m, 2e-3 * part.semi_minor_m,
            np.degrees(np.arctan2(major[:, 1], major[:, 0])), units="xy", offsets=centres_km,
            offset_transform=axes.transData, facecolors="none", edgecolors=colours, linewidths=0.8,
        )
    )  # fmt: skip
    inside = np.flatnonzero(np.all(np.abs(centres_km) < reach_km, axis=1))
    _name_rims(axes, part, centres_km, inside, reach_km)
    axes.plot(0.0, 0.0, "+", color="k", ms=9)
    axes.set_xlim(-reach_km, reach_km)
    axes.set_ylim(-reach_km, reach_km)
    axes.set_aspect("equal")
    axes.set_xlabel("east, km")
    axes.set_ylabel("north, km")
    axes.grid(alpha=0.3)
    if key:
        axes.legend(handles=key, loc="upper right", fontsize=8, framealpha=0.9)
    if not count:
        axes.text(0.0, 0.1 * reach_km, "the catalogue has no crater here", ha="center", color="0.4")
    latitude, longitude = np.degrees([latitude_rad, longitude_rad])
    shown = f", the largest {len(part):,} drawn" if len(part) < count else ""
    craters = "crater" if count == 1 else "craters"
    axes.set_title(
        f"{count:,} {craters} around latitude {latitude:.3f}, longitude {longitude:.3f} deg{shown}\n"
        f"{_named(catalog.body)}",
        fontsize=11,
    )
    return figure


def _from_place_km(catalog: Catalog, rows: IntArray, enu: FloatArray) -> FloatArray:
    """Project centres (n, 2) azimuthally equidistant: the angle from the place, in a crater's direction."""
    local = frames.up(catalog.latitude_rad[rows], catalog.longitude_rad[rows]) @ enu
    flat = np.hypot(local[:, 0], local[:, 1])
    angle = np.arctan2(flat, local[:, 2])
    scale = 1e-3 * catalog.body.radius_m * np.divide(angle, flat, out=np.ones_like(flat), where=flat > 0.0)
    return np.asarray(scale[:, None] * local[:, :2])


def _named(body: Body) -> str:
    name = {"": "a body", "Moon": "the Moon"}.get(body.name, body.name)
    return f"{name}, sphere of {1e-3 * body.radius_m:,.6g} km"


def _draw_density(figure: Figure, axes: Axes, catalog: Catalog) -> None:
    """Draw the number of craters per area."""
    area_km2 = 4e-6 * np.pi * catalog.body.radius_m**2
    longitude = np.degrees(np.angle(np.exp(1j * catalog.longitude_rad)))
    counts, y, x = np.histogram2d(
        np.sin(catalog.latitude_rad), longitude, bins=_DENSITY_CELLS, range=[[-1.0, 1.0], [-180.0, 180.0]]
    )
    # Equal cells in longitude and sine of latitude are equal areas.
    per_cell = 1e4 * _DENSITY_CELLS[0] * _DENSITY_CELLS[1] / area_km2
    density = np.ma.masked_equal(counts, 0.0) * per_cell
    norm = LogNorm(per_cell, max(float(density.max()), 2.0 * per_cell))
    mesh = axes.pcolormesh(x, y, density, cmap="cividis", norm=norm)
    bar = figure.colorbar(mesh, ax=axes, label="craters per 10,000 km² (white: none)", pad=0.01)
    _plain_ticks(bar.ax.yaxis)


def _draw_rims(axes: Axes, catalog: Catalog) -> None:
    """Draw rims on the map of the body, those that cross its border on both sides."""
    turn = np.linspace(0.0, 2.0 * np.pi, _RIM_POINTS, endpoint=False)[:, None]
    centres, along = catalog.centres[:, None], catalog.axes[:, None]
    points = centres + np.cos(turn) * along[:, :, 0] + np.sin(turn) * along[:, :, 1]
    latitude, longitude = frames.latitude_longitude(points)
    middle = np.angle(np.exp(1j * catalog.longitude_rad))[:, None]
    longitude = np.degrees(middle + np.angle(np.exp(1j * (longitude - middle))))
    rims = np.stack([longitude, np.sin(latitude)], axis=-1)
    west, east = longitude.min(axis=1) < -180.0, longitude.max(axis=1) > 180.0
    rims = np.concatenate([rims, rims[west] + [360.0, 0.0], rims[east] - [360.0, 0.0]])
    # A rim around a pole is no closed line on this map.
    closed = np.ptp(rims[:, :, 0], axis=1) < 180.0
    axes.add_collection(
        PolyCollection(list(rims[closed]), facecolors="none", edgecolors=_INK, linewidths=0.8)
    )
    axes.grid(alpha=0.3)


def _colours(part: Catalog) -> tuple[npt.NDArray[np.str_], list[Line2D]]:
    """Colours (n,) of rims that cross others or are probably duplicates, and the legend's entries."""
    meets = overlaps(part)
    colours = np.full(len(part), _INK)
    colours[meets.crossings.ravel()] = _CROSSING
    colours[meets.duplicates.ravel()] = _DUPLICATE
    key = []
    for colour, label in ((_CROSSING, "crossing rims"), (_DUPLICATE, "probable duplicates")):
        count = int(np.count_nonzero(colours == colour))
        if count:
            key.append(Line2D([], [], color=colour, label=f"{label} ({count:,})"))
    return colours, key


def _name_rims(
    axes: Axes, part: Catalog, centres_km: FloatArray, inside: npt.NDArray[np.intp], reach_km: float
) -> None:
    """Write names below the largest rims, where there is room."""
    km_per_pt = 2.0 * reach_km / (72.0 * 6.5)
    taken: list[tuple[float, float, float]] = []
    for k in inside.tolist():
        if len(taken) == _MAX_LABELS:
            break
        name = part.identifiers[k]
        half = 0.5 * _LETTER * _LABEL_PT * km_per_pt * len(name)
        x = float(centres_km[k, 0])
        y = float(centres_km[k, 1]) - 1e-3 * float(part.semi_major_m[k]) - _LABEL_PT * km_per_pt
        if abs(x) + half > reach_km or abs(y) > reach_km - _LABEL_PT * km_per_pt:
            continue
        line = _LINE * _LABEL_PT * km_per_pt
        if any(abs(x - u) < half + other and abs(y - v) < line for u, v, other in taken):
            continue
        taken.append((x, y, half))
        axes.text(
            x, y, name, ha="center", va="center", fontsize=_LABEL_PT, color="0.2",
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip


def _draw_sizes(axes: Axes, catalog: Catalog) -> None:
    """Draw how many craters are larger than a diameter, beside the power law of slope -2.

    Not per area: a catalogue does not say which ground was searched.
    """
    diameter_km = np.sort(2e-3 * np.sqrt(catalog.semi_major_m * catalog.semi_minor_m))
    number = np.arange(len(diameter_km), 0, -1)
    keep = np.unique(np.linspace(0, len(diameter_km) - 1, _CURVE_POINTS).astype(int))
    x, n = diameter_km[keep], number[keep]
    root = np.sqrt(n)
    axes.fill_between(x, np.maximum(n - root, 0.3), n + root, color=_INK, alpha=0.25, lw=0.0)
    axes.loglog(x, n, color=_INK, lw=1.5, label="catalogue, ±√n")
    middle = len(diameter_km) // 2
    line = np.array([diameter_km[0], diameter_km[-1]])
    power = number[middle] * (line / diameter_km[middle]) ** -2.0
    axes.loglog(line, power, "--", color="0.6", label="slope -2")
    axes.set_xlabel("diameter, km")
    axes.set_ylabel("larger craters")
    axes.set_title("cumulative sizes")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    _plain_ticks(axes.xaxis)


def _plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers, also when it is short."""
    low, high = axis.get_view_interval()
    short = high < 50.0 * low
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator() if short else LogLocator(subs="auto"))
    axis.set_minor_formatter(NullFormatter())
