"""Errors of a published map of circles, as an elevation model shows its rims.

`python -m craternav_fg.calibration catalogue_errors FOLDER` measures the rims of published craters on the
three crops of the elevation model in FOLDER. The shift of a crop is the median of its craters; what they
deviate from it by follows Student's t distribution, whose scale has a constant part and one that grows with
the radius.
"""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from scipy.optimize import minimize
from scipy.special import gammaln

from craternav_fg.calibration.crest_heights import CATALOG, COARSE, REGIONS
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.dem import Dem, read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import along_rims, chord_depths_m, rims_within
from craternav_fg.catalogs.map_errors import CRATER_FREEDOM
from craternav_fg.catalogs.model import Catalog
from craternav_fg.mapping.refine import refine_on_dem
from factors.arrays import FloatArray

# Limits of the radii in the table, m.
_RADII_M = (400.0, 700.0, 1e3, 2e3, 4e3, 10e3, 1e6)
# Normal distributions are those of so many degrees of freedom.
_NORMAL = 1e6
_MAD = 1.4826


class Differences(NamedTuple):
    """Measured rims of a crop minus those of the map.

    Attributes
    ----------
    radius_m : ndarray, shape (n,)
        Of the map.
    shift_m : ndarray, shape (n, 2)
        East and north.
    log_size : ndarray, shape (n,)
        Logarithm of the ratio of the mean radii.
    axis_ratio : ndarray, shape (n,)
        Semi-minor over semi-major axis of the measured rims.
    up_m : ndarray, shape (n,)
        Height of the crest over the mean of the coarse model along the rim.
    """

    radius_m: FloatArray
    shift_m: FloatArray
    log_size: FloatArray
    axis_ratio: FloatArray
    up_m: FloatArray


class PlaceErrors(NamedTuple):
    """Student's t distribution of places.

    Attributes
    ----------
    freedom : float
        Degrees of freedom.
    scale_m : float
        Constant part of the scale per axis.
    scale_share : float
        Part that grows with the radius, combined in quadrature.
    log_normal : float
        Natural logarithm of the likelihood of the best normal distribution over that of this one.
    """

    freedom: float
    scale_m: float
    scale_share: float
    log_normal: float

    def told(self, count: int) -> str:
        """Sentence on the distribution of a number of craters.

        Parameters
        ----------
        count : int

        Returns
        -------
        str
        """
        return (
            f"places of {count} craters, {self.freedom:.1f} degrees of freedom: scale {self.scale_m:.0f} m "
            f"and {self.scale_share:.3f} of the radius, a normal distribution is e^{self.log_normal:.0f} "
            "times as likely"
        )


def catalogue_errors(folder: Path) -> None:
    """Print the differences by size and crop, and the distributions of errors.

    Parameters
    ----------
    folder : Path
        Of the public files, see `Scenario.with_data`.
    """
    catalog, _ = import_catalog(folder / CATALOG, named_body("Moon", None))
    coarse, console = read_dem(folder / COARSE), Console(soft_wrap=True)
    crops = []
    for region in REGIONS:
        crops.append(differences(catalog, read_dem(folder / f"gld100/gld100_256ppd_{region}.tif"), coarse))
        one = crops[-1]
        east, north = np.median(one.shift_m, axis=0)
        console.print(
            f"{region}: {len(one.radius_m)} craters, east {east:.0f}, north {north:.0f}, "
            f"up {np.median(one.up_m):.0f} m"
        )
        for line in by_radius(one):
            console.print(f"  {line}")
    radius_m = np.concatenate([one.radius_m for one in crops])
    shifts_m = np.concatenate([one.shift_m - np.median(one.shift_m, axis=0) for one in crops])
    sizes = np.concatenate([one.log_size - np.median(one.log_size) for one in crops])
    for freedom in (None, CRATER_FREEDOM):
        places = place_errors(shifts_m, radius_m, freedom)
        size = size_error(sizes, places.freedom)
        console.print(f"{places.told(len(radius_m))}; sizes: scale {size:.3f}")


def differences(catalog: Catalog, fine: Dem, coarse: Dem) -> Differences:
    """Measure the rims of a catalogue on a model, and compare them with the catalogue.

    Parameters
    ----------
    catalog : Catalog
        Circles.
    fine, coarse : Dem
        On which rims are measured, and to which heights refer.

    Returns
    -------
    Differences
    """
    part = catalog.take(np.flatnonzero(rims_within(catalog, fine)))
    rims = refine_on_dem(part, fine)
    rows = np.flatnonzero(rims.refined)
    found = rims.catalog.take(rows)
    return Differences(
        radius_m=np.sqrt(part.semi_major_m * part.semi_minor_m)[rows],
        shift_m=rims.shift_m[rows],
        log_size=rims.log_size[rows],
        axis_ratio=found.semi_minor_m / found.semi_major_m,
        up_m=found.height_m + chord_depths_m(found) - along_rims(found, coarse)[0],
    )


def by_radius(found: Differences) -> list[str]:
    """Medians and spreads (1.48 median absolute deviations) by radius, as lines of text.

    Parameters
    ----------
    found : Differences

    Returns
    -------
    list of str
    """
    lines = []
    for low, high in pairwise(_RADII_M):
        rows = np.flatnonzero((found.radius_m >= low) & (found.radius_m < high))
        if not len(rows):
            continue
        values = np.column_stack([found.shift_m, np.exp(found.log_size)])[rows]
        middle = np.median(values, axis=0)
        spread = _MAD * np.median(np.abs(values - middle), axis=0)
        lines.append(
            f"{low / 1e3:g} to {high / 1e3:g} km: {len(rows)} craters, "
            f"east {middle[0]:.0f} ± {spread[0]:.0f} m, north {middle[1]:.0f} ± {spread[1]:.0f} m, "
            f"size {middle[2]:.2f} ± {spread[2]:.2f}, "
            f"axis ratio {np.median(found.axis_ratio[rows]):.2f}"
        )
    return lines


def place_errors(shifts_m: FloatArray, radius_m: FloatArray, freedom: float | None = None) -> PlaceErrors:
    """Fit Student's t distribution to places by maximum likelihood.

    Parameters
    ----------
    shifts_m : ndarray, shape (n, 2)
        Relative to the common shift of the crop.
    radius_m : ndarray, shape (n,)
    freedom : float, optional
        Degrees of freedom, fitted as well by default.

    Returns
    -------
    PlaceErrors
    """
    squares = np.sum(shifts_m**2, axis=1)

    def cost(logarithms: FloatArray, given: float | None) -> float:
        scale_m, share, *free = np.exp(logarithms).tolist()
        return _cost(squares, scale_m**2 + (share * radius_m) ** 2, free[0] if given is None else given, 2)

    start = np.log([90.0, 0.05, 4.0])
    found, least = _least(lambda x: cost(x, freedom), start if freedom is None else start[:2])
    _, normal = _least(lambda x: cost(x, _NORMAL), start[:2])
    scale_m, share, *free = np.exp(found).tolist()
    return PlaceErrors(free[0] if freedom is None else freedom, scale_m, share, least - normal)


def size_error(log_sizes: FloatArray, freedom: float) -> float:
    """Fit the scale of Student's t distribution of sizes by maximum likelihood.

    Parameters
    ----------
    log_sizes : ndarray, shape (n,)
        Logarithms of the ratios of sizes to those of the map, relative to the common one of the crop.
    freedom : float
        Degrees of freedom.

    Returns
    -------
    float
        As a share.
    """
    scale, _ = _least(
        lambda x: _cost(log_sizes**2, np.full(len(log_sizes), np.exp(2.0 * x[0])), freedom, 1), np.log([0.1])
    )
    return float(np.exp(scale[0]))


def _least(cost: Callable[[FloatArray], float], start: FloatArray) -> tuple[FloatArray, float]:
    """Place and value of a minimum."""
    found = minimize(cost, start, method="Nelder-Mead", tol=1e-5)
    return np.asarray(found.x), float(found.fun)


def _cost(squares: FloatArray, scale2: FloatArray, freedom: float, dimension: int) -> float:
    """Negative logarithm of the likelihood of vectors by their squared norms, up to a constant."""
    constant = (
        gammaln(0.5 * (freedom + dimension)) - gammaln(0.5 * freedom) - 0.5 * dimension * np.log(freedom)
    )
    tails = 0.5 * (freedom + dimension) * np.log1p(squares / (freedom * scale2))
    return float(np.sum(tails + 0.5 * dimension * np.log(scale2)) - len(squares) * constant)
