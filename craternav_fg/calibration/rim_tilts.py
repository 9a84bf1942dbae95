"""Slopes of rims' planes on the Moon, which catalogues do not state.

`python -m craternav_fg.calibration rim_tilts FOLDER` measures the rims of published craters on the three
crops of the elevation model in FOLDER. The shipped constant is the root mean square over the regions of the
standard deviation of both slopes, by the median of their sizes: the steepest tenth lie on walls and scarps,
and would double it. Maria have half of what highlands have, whatever the radius.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from craternav_fg.calibration.crest_heights import CATALOG, REGIONS, measured_rims
from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.dem import Dem, read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.model import Catalog
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions
from craternav_fg.vision.robust_scale import MAD_TO_SIGMA
from factors.arrays import FloatArray


def rim_tilts(folder: Path) -> None:
    """Print `CorrelatedErrorOptions.map_tilt_rad` as shipped and as regenerated.

    Parameters
    ----------
    folder : Path
        Of the public files, see `Scenario.with_data`.
    """
    catalog, _ = import_catalog(folder / CATALOG, named_body("Moon", None))
    console, sigmas = Console(), []
    for region in REGIONS:
        tilts_rad = measured_tilts(catalog, read_dem(folder / f"gld100/gld100_256ppd_{region}.tif"))
        sigmas.append(robust_sigma(tilts_rad))
        console.print(f"{region}: {len(tilts_rad)} rims, {sigmas[-1]:.4f} rad per axis")
    one = usual_tilt(sigmas)
    regenerated = f"{one.value:.3g} ± {one.error:.2g}, {one.verdict}"
    console.print(f"{one.name}: {one.shipped:.3g}, regenerated {regenerated}")


def measured_tilts(catalog: Catalog, dem: Dem) -> FloatArray:
    """Measure the slopes of the planes of a catalogue's rims on an elevation model.

    Parameters
    ----------
    catalog : Catalog
    dem : Dem

    Returns
    -------
    ndarray, shape (n, 2)
        Towards east and north, rad, of the rims that are found.
    """
    rims = measured_rims(catalog, dem)
    return np.asarray(rims.tilt_rad[rims.refined])


def robust_sigma(tilts_rad: FloatArray) -> float:
    """Compute the standard deviation of slopes by the median of their sizes.

    Parameters
    ----------
    tilts_rad : ndarray, shape (n, 2)

    Returns
    -------
    float
        rad.
    """
    return float(MAD_TO_SIGMA * np.median(np.abs(tilts_rad)))


def usual_tilt(sigmas_rad: Sequence[float]) -> Regenerated:
    """Pool the standard deviations of regions.

    Parameters
    ----------
    sigmas_rad : sequence of float
        Two or more, rad.

    Returns
    -------
    Regenerated
    """
    squares = np.square(sigmas_rad)
    value = float(np.sqrt(squares.mean()))
    error = float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2.0 * value))
    return Regenerated(
        "CorrelatedErrorOptions.map_tilt_rad, rad", CorrelatedErrorOptions().map_tilt_rad, value, error
    )
