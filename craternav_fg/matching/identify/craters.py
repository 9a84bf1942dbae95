"""Craters of a catalogue as identification uses them: arrays for compiled code."""

from typing import NamedTuple

import numpy as np

from craternav_fg.catalogs.model import Catalog
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Step of the table of densities in the logarithm of the size; the table is interpolated.
_LOG_SIZE_STEP = 0.05


class Craters(NamedTuple):
    """The n craters of a catalogue, in its order; `Catalog.index` finds them by place and size."""

    centres: FloatArray
    """Rim centres in g, m, shape (n, 3)."""
    axes: FloatArray
    """Semi-axes a l1 and b l2 in g, m, shape (n, 2, 3)."""
    log_size: FloatArray
    """Natural logarithms of the geometric mean of the semi-axes in m, shape (n,)."""
    least_log_size: float
    """The smallest of them."""
    larger_per_sr: FloatArray
    """Number per steradian of craters above `least_log_size` + k `_LOG_SIZE_STEP`, shape (steps,)."""


def craters_of(catalog: Catalog) -> Craters:
    """Collect the craters of a catalogue.

    Parameters
    ----------
    catalog : Catalog
        At least one crater.

    Returns
    -------
    Craters
    """
    log_size = log_sizes(catalog)
    least, most = float(log_size.min()), float(log_size.max())
    steps = least + _LOG_SIZE_STEP * np.arange(int((most - least) / _LOG_SIZE_STEP) + 3)
    larger = (len(catalog) - np.searchsorted(np.sort(log_size), steps)) / (4.0 * np.pi)
    return Craters(
        np.ascontiguousarray(catalog.centres), np.ascontiguousarray(catalog.axes), log_size, least, larger
    )


def log_sizes(catalog: Catalog) -> FloatArray:
    """Compute the sizes of craters.

    Parameters
    ----------
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n,)
        Natural logarithms of the geometric mean of the semi-axes in m.
    """
    return np.asarray(0.5 * np.log(catalog.semi_major_m * catalog.semi_minor_m))


@njit(cache=True, error_model="numpy")
def density(craters: Craters, least: float, most: float) -> float:
    """Craters per steradian in an interval of sizes, averaged over the body.

    Parameters
    ----------
    craters : Craters
    least, most : float
        Natural logarithms of the geometric mean of the semi-axes in m.
    """
    last = craters.larger_per_sr.shape[0] - 1
    total = 0.0
    for k in range(2):
        x = ((least if k == 0 else most) - craters.least_log_size) / _LOG_SIZE_STEP
        value = 0.0
        if x <= 0.0:
            value = craters.larger_per_sr[0]
        elif x < last:
            i = int(x)
            value = craters.larger_per_sr[i]
            value += (x - i) * (craters.larger_per_sr[i + 1] - craters.larger_per_sr[i])
        total += value if k == 0 else -value
    return total
