"""Where one position is from another, in words that show a map in another frame: degrees and metres."""

import numpy as np

from craternav_fg import frames
from factors.arrays import FloatArray

# Farther than this, km are easier to read.
_MOST_METRES = 1e4


def displacement(before: FloatArray, after: FloatArray) -> str:
    """Describe where a position is from another.

    A catalogue in another frame moves a descent by the same angles everywhere.

    Parameters
    ----------
    before, after : ndarray, shape (3,)
        In g, m.

    Returns
    -------
    str
        Distance, degrees of longitude and latitude, and height.
    """
    latitude, longitude = np.degrees([frames.latitude_longitude(P) for P in (before, after)]).T
    east = (longitude[1] - longitude[0] + 180.0) % 360.0 - 180.0
    north = latitude[1] - latitude[0]
    up = float(np.linalg.norm(after) - np.linalg.norm(before))
    sides = (
        f"{abs(east):.3f} deg of longitude to the {'east' if east >= 0.0 else 'west'}",
        f"{abs(north):.3f} deg of latitude to the {'north' if north >= 0.0 else 'south'}",
        f"{_length(abs(up))} {'higher' if up >= 0.0 else 'lower'}",
    )
    return f"{_length(float(np.linalg.norm(after - before)))} from it ({', '.join(sides)})"


def _length(metres: float) -> str:
    return f"{1e-3 * metres:.3g} km" if metres > _MOST_METRES else f"{metres:.0f} m"
