"""Craters that a catalogue has twice, as one that was merged from several tables may."""

import numpy as np

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from factors.arrays import IntArray

# Two entries are one crater if their centres are closer than this share of the smaller mean radius and the
# logarithms of their mean radii differ by less: no two rims on the ground are so alike.
SAME_SHARE = 0.1


def repeated_craters(catalog: Catalog) -> IntArray:
    """Find entries of craters that an earlier entry has already.

    Their rims are the same ones in an image: they would count twice, and be doubtful matches of each other.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    ndarray of int, shape (k,)
        Rows, increasing.
    """
    # Every command that reads a data set would import it: a tenth of a second.
    from scipy.spatial import cKDTree

    size_m = np.sqrt(catalog.semi_major_m * catalog.semi_minor_m)
    places = frames.up(catalog.latitude_rad, catalog.longitude_rad)
    tree = cKDTree(places)
    reach = SAME_SHARE * size_m / catalog.body.radius_m
    # Nearly all craters are alone within their reach.
    some = np.flatnonzero(tree.query_ball_point(places, reach, return_length=True, workers=-1) > 1)
    repeated = np.zeros(len(catalog), dtype=np.bool_)
    for row, near in zip(some.tolist(), tree.query_ball_point(places[some], reach[some]), strict=True):
        others = np.array(near)
        alike = np.abs(np.log(size_m[others] / size_m[row])) < SAME_SHARE
        # The reach of the smaller one of two counts.
        apart = np.linalg.norm(places[others] - places[row], axis=1)
        pairs = others[alike & (apart < np.minimum(reach[others], reach[row]))]
        first = int(pairs.min(initial=row))
        for later in (*pairs.tolist(), row):
            repeated[later] |= later > first
    return np.flatnonzero(repeated)
