"""Heights of crests that a coarse elevation model smooths away.

`python -m craternav_fg.calibration crest_heights FOLDER` measures the rims of published craters on the three
crops of the elevation model in FOLDER, and reads the heights of the same rims from the coarse model of the
whole Moon. The difference is taken to be normal: its mean, and its standard deviation beside the scatter
along the rim, are shares of the radius that fall exponentially with it.

The standard errors follow from the scatter between the three regions. In the highlands, rims of 3 km and
more lose less than the shipped constants say, by 25 to 45 m; in the maria, those of 1.4 to 3 km lose more, by
3 to 19 m.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from craternav_fg.calibration.likelihood import Parameter, estimate
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.dem import Dem, read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import (
    CREST_SHARE,
    CREST_SIGMA_SHARE,
    CREST_STEPS,
    along_rims,
    chord_depths_m,
    rims_within,
)
from craternav_fg.catalogs.model import Catalog
from craternav_fg.mapping.refine import RefinedRims, refine_on_dem
from factors.arrays import FloatArray

CATALOG, COARSE = "lu1319381.parquet", "gld100/gld100_16ppd_global.tif"
REGIONS = ("southern_highlands", "imbrium_copernicus", "posidonius")
_RADII_M = (500.0, 20e3)


class LostHeights(NamedTuple):
    """Rims of a region on a fine model and on a coarse one.

    Attributes
    ----------
    radius_m : ndarray, shape (n,)
        Of the rims that the fine model shows.
    lost_m : ndarray, shape (n,)
        Height of the crest above the mean of the coarse model along the rim.
    scatter_m : ndarray, shape (n,)
        Standard deviation of that mean, by the scatter along the rim.
    """

    radius_m: FloatArray
    lost_m: FloatArray
    scatter_m: FloatArray


def crest_heights(folder: Path) -> None:
    """Print the constants of `catalogs.heights` as shipped and as regenerated.

    Parameters
    ----------
    folder : Path
        Of the public files, see `Scenario.with_data`.
    """
    body = named_body("Moon", None)
    catalog, _ = import_catalog(folder / CATALOG, body)
    coarse = read_dem(folder / COARSE)
    fine = [read_dem(folder / f"gld100/gld100_256ppd_{region}.tif") for region in REGIONS]
    regions = [lost_heights(catalog, one, coarse) for one in fine]
    console = Console()
    for one in fitted(regions, coarse.step_rad * body.radius_m):
        regenerated = f"{one.value:.3g} ± {one.error:.2g}, {one.verdict}"
        console.print(f"{one.name}: {one.shipped:.3g}, regenerated {regenerated}")


def measured_rims(catalog: Catalog, dem: Dem) -> RefinedRims:
    """Measure the rims of a catalogue that an elevation model of the Moon shows well.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem

    Returns
    -------
    RefinedRims
        Of the craters with a radius of 0.5 to 20 km that lie on the model.
    """
    low_m, high_m = _RADII_M
    radius_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    rows = np.flatnonzero((radius_m > low_m) & (radius_m < high_m) & rims_within(catalog, dem))
    return refine_on_dem(catalog.take(rows), dem)


def lost_heights(catalog: Catalog, fine: Dem, coarse: Dem) -> LostHeights:
    """Compare the heights of crests with those that a coarse model gives for the same rims.

    Parameters
    ----------
    catalog : Catalog
    fine, coarse : Dem

    Returns
    -------
    LostHeights
    """
    rims = measured_rims(catalog, fine)
    found = rims.catalog.take(np.flatnonzero(rims.refined))
    mean_m, scatter_m = along_rims(found, coarse)
    lost_m = found.height_m + chord_depths_m(found) - mean_m
    return LostHeights(np.sqrt(found.semi_major_m * found.semi_minor_m), lost_m, scatter_m)


def fitted(regions: Sequence[LostHeights], step_m: float) -> list[Regenerated]:
    """Fit the constants of `catalogs.heights`.

    Parameters
    ----------
    regions : sequence of LostHeights
        Two or more.
    step_m : float
        Step of the coarse model.

    Returns
    -------
    list of Regenerated
    """

    def cost(one: LostHeights, share: float, sigma_share: float, steps: float) -> float:
        smoothed_m = one.radius_m * np.exp(-one.radius_m / (steps * step_m))
        variance = one.scatter_m**2 + (sigma_share * smoothed_m) ** 2
        return float(0.5 * np.sum(np.log(variance) + (one.lost_m - share * smoothed_m) ** 2 / variance))

    shipped = {"CREST_SHARE": CREST_SHARE, "CREST_SIGMA_SHARE": CREST_SIGMA_SHARE, "CREST_STEPS": CREST_STEPS}
    values, errors = estimate(
        lambda of: np.array([cost(one, *of) for one in regions]), [Parameter(one) for one in shipped.values()]
    )
    return [
        Regenerated(f"heights.{name}", value, float(found), float(error))
        for (name, value), found, error in zip(shipped.items(), values, errors, strict=True)
    ]
