"""Heights of rims from an elevation model, and a check of their unit."""

from dataclasses import replace

import numpy as np

from craternav_fg.catalogs.common_shift import CommonShift, unknown_height_sigma_m
from craternav_fg.catalogs.dem import Dem
from craternav_fg.catalogs.model import Catalog
from factors.arrays import BoolArray, FloatArray

# Points of a rim at which the elevation model is read.
_RIM_POINTS = 24
# And those at which it is asked whether it covers the rim.
_COVERED_POINTS = 8
# Of these, so many count as independent: neighbours on a rim are high or low together.
_INDEPENDENT_POINTS = 4.0
# A coarse model smooths a rim crest away. The crest stands this share of the radius above what the model
# shows, with this standard deviation, where the model shows nothing of the crater; both fall by 1/e over a
# radius of so many steps. Fitted by `craternav_fg.calibration.crest_heights` to rims that `mapping.refine`
# measured on GLD100 at 256 px/deg, against the same at 16 px/deg; craters of 0.5 to 20 km radius in three
# regions.
CREST_SHARE, CREST_SIGMA_SHARE, CREST_STEPS = 0.021, 0.014, 5.0
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


def rims_within(catalog: Catalog, dem: Dem) -> BoolArray:
    """Tell which rims lie on an elevation model as a whole: beyond it, it would be continued.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    inside = dem.covers(catalog.up)
    for turn in np.linspace(0.0, 2.0 * np.pi, _COVERED_POINTS, endpoint=False):
        inside &= dem.covers(_rim_directions(catalog, turn))
    return inside


def _rim_directions(catalog: Catalog, turn: float) -> FloatArray:
    """Directions of a point of each rim from the body's centre, shape (n, 3)."""
    gRl, radius_m = catalog.gRl, catalog.body.radius_m
    x = np.cos(turn) * catalog.semi_major_m / radius_m
    y = np.sin(turn) * catalog.semi_minor_m / radius_m
    point = catalog.up + x[:, None] * gRl[:, :, 0] + y[:, None] * gRl[:, :, 1]
    return np.asarray(point / np.linalg.norm(point, axis=1, keepdims=True))


def with_rim_heights(catalog: Catalog, dem: Dem) -> Catalog:
    """Set the heights of rims' planes from the mean of an elevation model along the rims.

    A model coarser than a crater smooths its crest away; the height lost on average is added. Where the
    catalogue states errors, those of the heights follow from the scatter about a plane through the rim and
    from that of the lost height.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem
        Elevation model of the catalogue's body, which must cover all rims: see `rims_within`.

    Returns
    -------
    Catalog
    """
    mean_m, sigma_m = along_rims(catalog, dem)
    rim_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    smoothed_m = rim_m * np.exp(-rim_m / (CREST_STEPS * dem.step_rad * catalog.body.radius_m))
    errors = catalog.errors
    if errors is not None:
        errors = replace(errors, height_m=np.hypot(sigma_m, CREST_SIGMA_SHARE * smoothed_m))
    height_m = mean_m + CREST_SHARE * smoothed_m - chord_depths_m(catalog)
    return replace(catalog, height_m=height_m, errors=errors, has_heights=True)


def along_rims(catalog: Catalog, dem: Dem) -> tuple[FloatArray, FloatArray]:
    """Read the mean heights of an elevation model along rims.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem
        Which must cover all rims.

    Returns
    -------
    mean_m, sigma_m : ndarray, shape (n,)
        Means, and their standard deviations by the scatter about a plane through the rim.
    """
    total, squares, tilt = np.zeros(len(catalog)), np.zeros(len(catalog)), np.zeros((len(catalog), 2))
    for turn in np.linspace(0.0, 2.0 * np.pi, _RIM_POINTS, endpoint=False):
        heights = dem.heights_m(_rim_directions(catalog, turn))
        total += heights
        squares += heights**2
        tilt += heights[:, None] * (np.cos(turn), np.sin(turn))
    mean_m = total / _RIM_POINTS
    # The slope of the ground leaves the mean as it is.
    of_slope = 2.0 * np.sum((tilt / _RIM_POINTS) ** 2, axis=1)
    rest = np.maximum(squares / _RIM_POINTS - mean_m**2 - of_slope, 0.0)
    return mean_m, np.sqrt(rest / _INDEPENDENT_POINTS)


def with_covered_heights(catalog: Catalog, dem: Dem) -> Catalog:
    """Read the heights of the rims within an elevation model from it; the others keep theirs.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem

    Returns
    -------
    Catalog
        The same one when the model covers none of its rims as a whole.
    """
    inside = rims_within(catalog, dem)
    if not inside.any():
        return catalog
    found = with_rim_heights(catalog, dem)
    errors = found.errors
    if errors is not None and catalog.errors is not None:
        errors = replace(errors, height_m=np.where(inside, errors.height_m, catalog.errors.height_m))
    return replace(found, height_m=np.where(inside, found.height_m, catalog.height_m), errors=errors)


def unknown_beyond(catalog: Catalog, dem: Dem) -> Catalog:
    """State how unknown the heights beyond an elevation model are: the rims there lie on the sphere.

    Parameters
    ----------
    catalog : Catalog
        With heights from `with_covered_heights`, and none before.
    dem : Dem

    Returns
    -------
    Catalog
        With a common shift of the rims beyond the model.
    """
    inside = rims_within(catalog, dem)
    if inside.all():
        return catalog
    # The model may cover a plain only.
    unknown_m = max(
        float(np.sqrt(np.mean(catalog.height_m[inside] ** 2))),
        unknown_height_sigma_m(catalog.body.radius_m),
    )
    shift = catalog.common_shift or CommonShift.unknown(len(catalog))
    return replace(catalog, common_shift=replace(shift, height_m=np.where(inside, shift.height_m, unknown_m)))
