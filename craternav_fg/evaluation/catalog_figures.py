"""Figures of a crater catalogue: the whole body, or the surroundings of a place."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from craternav_fg import frames
from craternav_fg.catalog import Catalog

FloatArray = npt.NDArray[np.float64]

_INK = "#0072B2"
_GRID = (36, 72)
_MOST_DRAWN = 20_000
_LABELLED = 12


def draw_globe(catalog: Catalog) -> Figure:
    """Draw how many craters there are where, on an equal-area map, and how many of which size."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    ground, sizes = figure.subplots(1, 2, width_ratios=[2.4, 1.0])
    longitude = np.degrees(np.angle(np.exp(1j * catalog.longitude_rad)))
    radius_km = 1e-3 * catalog.body.radius_m
    counts, y, x = np.histogram2d(
        np.sin(catalog.latitude_rad), longitude, bins=_GRID, range=[[-1.0, 1.0], [-180.0, 180.0]]
    )
    # Equal cells in longitude and sine of latitude are equal areas.
    cell_km2 = 4.0 * np.pi * radius_km**2 / (_GRID[0] * _GRID[1])
    density = np.ma.masked_equal(counts, 0.0) * 1e4 / cell_km2
    lowest = 1e4 / cell_km2
    mesh = ground.pcolormesh(
        x, y, density, cmap="cividis", norm=LogNorm(lowest, max(float(density.max()), 2.0 * lowest))
    )
    figure.colorbar(mesh, ax=ground, label="craters per 10,000 km²", pad=0.01)
    latitudes = np.array([-60, -30, 0, 30, 60])
    ground.set_yticks(np.sin(np.radians(latitudes)), [f"{value:d}" for value in latitudes])
    ground.set_xticks(np.arange(-180, 181, 60))
    ground.set_xlabel("longitude (east), deg")
    ground.set_ylabel("latitude, deg (equal areas)")
    ground.set_title(
        f"{len(catalog):,} craters on {catalog.body.name or 'a body'} of {radius_km:,.1f} km radius"
    )
    _draw_sizes(sizes, catalog, 4.0 * np.pi * radius_km**2)
    return figure


def draw_region(catalog: Catalog, latitude_rad: float, longitude_rad: float, radius_m: float) -> Figure:
    """Draw the rims around a place, true to distance and direction from it, the largest with their names."""
    rows, _ = catalog.near(latitude_rad, longitude_rad, 1.5 * radius_m)
    rows = rows[np.argsort(-catalog.semi_major_m[rows], kind="stable")][:_MOST_DRAWN]
    enu = frames.east_north_up(np.array(latitude_rad), np.array(longitude_rad))
    part = catalog.take(rows)
    # Azimuthal equidistant: the angle from the place, in the direction in which a crater lies.
    local = part.normals @ enu
    flat = np.hypot(local[:, 0], local[:, 1])
    angle = np.arctan2(flat, local[:, 2])
    scale = 1e-3 * catalog.body.radius_m * np.divide(angle, flat, out=np.ones_like(flat), where=flat > 0.0)
    centres_km = scale[:, None] * local[:, :2]
    major = part.gRl[:, :, 0] @ enu
    figure = Figure(figsize=(7.5, 7.5), layout="constrained")
    axes = figure.subplots()
    axes.add_collection(
        EllipseCollection(
            2e-3 * part.semi_major_m, 2e-3 * part.semi_minor_m,
            np.degrees(np.arctan2(major[:, 1], major[:, 0])), units="xy", offsets=centres_km,
            offset_transform=axes.transData, facecolors="none", edgecolors=_INK, linewidths=0.7,
        )
    )  # fmt: skip
    reach_km = 1e-3 * radius_m
    inside = np.flatnonzero(np.all(np.abs(centres_km) < reach_km, axis=1))
    for k in inside[:_LABELLED].tolist():
        axes.annotate(part.identifiers[k], centres_km[k], ha="center", va="center", fontsize=7, clip_on=True)
    axes.plot(0.0, 0.0, "+", color="k", ms=8)
    axes.set_xlim(-reach_km, reach_km)
    axes.set_ylim(-reach_km, reach_km)
    axes.set_aspect("equal")
    axes.set_xlabel("east, km")
    axes.set_ylabel("north, km")
    axes.grid(alpha=0.3)
    latitude, longitude = np.degrees([latitude_rad, longitude_rad])
    shown = f", the largest {_MOST_DRAWN:,} drawn" if len(rows) == _MOST_DRAWN else ""
    axes.set_title(
        f"{len(inside):,} craters around latitude {latitude:.3f}, longitude {longitude:.3f} deg{shown}"
    )
    return figure


def _draw_sizes(axes: Axes, catalog: Catalog, area_km2: float) -> None:
    diameter_km = np.sort(2e-3 * np.sqrt(catalog.semi_major_m * catalog.semi_minor_m))
    larger = np.arange(len(diameter_km), 0, -1) * 1e6 / area_km2
    # So many points are enough for a curve.
    keep = np.unique(np.linspace(0, len(diameter_km) - 1, 2000).astype(int))
    axes.loglog(diameter_km[keep], larger[keep], color=_INK, lw=1.5, label="catalogue")
    middle = diameter_km[len(diameter_km) // 2]
    line = np.array([diameter_km[0], diameter_km[-1]])
    axes.loglog(
        line, larger[len(diameter_km) // 2] * (line / middle) ** -2.0, "--", color="0.6", label="power -2"
    )
    axes.set_xlabel("diameter, km")
    axes.set_ylabel("larger ones per million km²")
    axes.set_title("sizes")
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False)
