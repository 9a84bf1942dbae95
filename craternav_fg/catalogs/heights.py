"""Heights of rims from an elevation model."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.dem import Dem
from craternav_fg.catalogs.model import Catalog

FloatArray = npt.NDArray[np.float64]

_POINTS = 24
# The highest and lowest ground even of small, irregular bodies lies within this part of the radius.
_MOST = 0.4


def implausible_heights(catalog: Catalog) -> str | None:
    """Say what is odd about the heights of rims on a body, None when nothing is."""
    low, high, radius_m = catalog.height_m.min(), catalog.height_m.max(), catalog.body.radius_m
    if max(-low, high) < _MOST * radius_m:
        return None
    heights = f"{low:.0f} to {high:.0f} m above a sphere of {radius_m:.9g} m"
    return f"rims would lie {heights}: wrong unit (--dem-unit-m)"


def with_rim_heights(catalog: Catalog, dem: Dem) -> Catalog:
    """Give a catalogue whose rims have the mean height of an elevation model along them.

    A model much coarser than a crater does not show its rim, only the ground it lies in.
    """
    gRl = catalog.gRl
    radius_m = catalog.body.radius_m
    total = np.zeros(len(catalog))
    for turn in np.linspace(0.0, 2.0 * np.pi, _POINTS, endpoint=False):
        # The rim's plane is level at the centre: a point of it lies in this direction from the body's.
        x = np.cos(turn) * catalog.semi_major_m / radius_m
        y = np.sin(turn) * catalog.semi_minor_m / radius_m
        point = gRl[:, :, 2] + x[:, None] * gRl[:, :, 0] + y[:, None] * gRl[:, :, 1]
        total += dem.heights_m(point / np.linalg.norm(point, axis=1, keepdims=True))
    return replace(catalog, height_m=total / _POINTS)
