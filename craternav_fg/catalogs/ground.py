"""Height of the ground between the craters of a catalogue."""

from collections.abc import Callable

import numpy as np

from craternav_fg.catalogs.model import Catalog
from factors.arrays import FloatArray

# Craters that tell the height of a place, and how fast their weight falls with the distance.
NEIGHBOURS = 8
POWER = 2.0


def ground_heights(catalog: Catalog) -> Callable[[FloatArray], float]:
    """Interpolate the rims' heights by inverse distance.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    callable
        Height above the body's sphere, m, at a position (3,) in g; 0 when all rims lie on the sphere.
    """
    if not np.any(catalog.height_m):
        return lambda _: 0.0
    # Imported here: most commands that read a catalogue do not ask for the ground between its craters.
    from scipy.spatial import KDTree

    tree = KDTree(catalog.up)
    count = min(NEIGHBOURS, len(catalog))

    def height_m(gP: FloatArray) -> float:
        distance, rows = tree.query(gP / np.linalg.norm(gP), k=count)
        weights = (np.atleast_1d(distance) + 1e-12) ** -POWER
        return float(weights @ catalog.height_m[np.atleast_1d(rows)] / weights.sum())

    return height_m
