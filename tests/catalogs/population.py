"""Craters all over a body, as many as a real catalogue of small ones has: to try large catalogues on."""

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog


def power_law_population(
    rng: np.random.Generator,
    body: Body,
    count: int,
    diameters_m: tuple[float, float],
    *,
    power: float = 2.0,
    min_axis_ratio: float = 0.75,
) -> Catalog:
    """Draw craters evenly over a sphere.

    Parameters
    ----------
    rng : numpy.random.Generator
    body : Body
    count : int
    diameters_m : tuple of float
        Least and largest major diameter.
    power : float
        There are D^-power as many craters larger than D.
    min_axis_ratio : float
        The ratio of the axes lies evenly between this and 1.

    Returns
    -------
    Catalog
        With identifiers `S0000000`, ...; rims on the sphere.
    """
    least, largest = (diameter**-power for diameter in diameters_m)
    major_m = 0.5 * (least - rng.random(count) * (least - largest)) ** (-1.0 / power)
    return Catalog(
        identifiers=tuple(f"S{number:07d}" for number in range(count)),
        latitude_rad=np.arcsin(2.0 * rng.random(count) - 1.0),
        longitude_rad=2.0 * np.pi * rng.random(count),
        semi_major_m=major_m,
        semi_minor_m=major_m * (1.0 - (1.0 - min_axis_ratio) * rng.random(count)),
        angle_rad=np.pi * rng.random(count),
        height_m=np.zeros(count),
        body=body,
    )
