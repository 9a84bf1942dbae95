"""Heights of rims from an elevation model, and a check of their unit."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.dem import Dem
from craternav_fg.catalogs.model import Catalog

FloatArray = npt.NDArray[np.float64]

# Points of a rim at which the elevation model is read.
_RIM_POINTS = 24
# Of these, so many count as independent: neighbours on a rim are high or low together.
_INDEPENDENT_POINTS = 4.0
# Largest height above or below the sphere, in radii: even small, irregular bodies keep within it.
_MAX_HEIGHT_RADII = 0.4


def implausible_heights(catalog: Catalog) -> str | None:
    """Detect heights of rims in a wrong unit.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    str or None
        The problem, None when there is none.
    """
    low, high, radius_m = catalog.height_m.min(), catalog.height_m.max(), catalog.body.radius_m
    if max(-low, high) < _MAX_HEIGHT_RADII * radius_m:
        return None
    heights = f"{low:.0f} to {high:.0f} m above a sphere of {radius_m:.9g} m"
    return f"rims would lie {heights}: wrong unit (--dem-unit-m)"


def chord_depths_m(catalog: Catalog) -> FloatArray:
    """Compute how far the planes of rims lie below the mean height of their points.

    Points of a rim are at about the same height above the sphere: seen from their plane, the ground between
    them bulges. It is 1 m for a radius of 2 km on the Moon, and 260 m for one of 30 km.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n,)
        At the centres of the planes, m.
    """
    radius_m = catalog.body.radius_m
    mean2 = 0.5 * (catalog.semi_major_m**2 + catalog.semi_minor_m**2)
    return np.asarray(radius_m - np.sqrt(np.maximum(radius_m**2 - mean2, 0.0)))


def with_rim_heights(catalog: Catalog, dem: Dem) -> Catalog:
    """Set the heights of rims' planes from the mean of an elevation model along the rims.

    A model much coarser than a crater does not resolve its rim: the height is then that of the surroundings.
    Where the catalogue states errors, those of the heights follow from the scatter along the rim.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem
        Elevation model of the catalogue's body.

    Returns
    -------
    Catalog
    """
    gRl = catalog.gRl
    radius_m = catalog.body.radius_m
    total, squares = np.zeros(len(catalog)), np.zeros(len(catalog))
    for turn in np.linspace(0.0, 2.0 * np.pi, _RIM_POINTS, endpoint=False):
        # Direction of a rim point from the body's centre: the rim's plane is level at its own centre.
        x = np.cos(turn) * catalog.semi_major_m / radius_m
        y = np.sin(turn) * catalog.semi_minor_m / radius_m
        point = gRl[:, :, 2] + x[:, None] * gRl[:, :, 0] + y[:, None] * gRl[:, :, 1]
        heights = dem.heights_m(point / np.linalg.norm(point, axis=1, keepdims=True))
        total += heights
        squares += heights**2
    mean_m = total / _RIM_POINTS
    errors = catalog.errors
    if errors is not None:
        scatter_m = np.sqrt(np.maximum(squares / _RIM_POINTS - mean_m**2, 0.0))
        errors = replace(errors, height_m=scatter_m / np.sqrt(_INDEPENDENT_POINTS))
    height_m = mean_m - chord_depths_m(catalog)
    return replace(catalog, height_m=height_m, errors=errors, has_heights=True)
