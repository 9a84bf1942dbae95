"""Deviation of crater outlines from ellipses, as the rims of one frame show it together."""

import numpy as np

from factors.arrays import FloatArray

# A frame's outlines count as irregular if their median deviation is this many times the expected one: with
# the 0.03 % of `GuidedOptions`, above 0.3 % of the radius. On rendered ground the median is 0.03 % with
# elliptic outlines, up to 0.12 % where craters overlap, and 0.6 to 0.9 % with outlines 1 % off an ellipse.
IRREGULARITY_FACTOR = 10.0


def unseen_deviation(shares: FloatArray, expected_share: float) -> FloatArray:
    """Estimate how much of each outline's deviation its own edge points do not show.

    One rim's points determine its deviation poorly, and a rim that looks elliptic by chance would get too
    much weight. Where the frame's outlines are irregular, each rim is expected to deviate as much as the
    frame's root mean square.

    Parameters
    ----------
    shares : ndarray, shape (n,)
        Root mean square deviation of each outline that its own points show, in radii.
    expected_share : float
        Deviation that each fit expected before it saw the points, in radii.

    Returns
    -------
    ndarray, shape (n,)
        Deviation to expect instead, in radii; 0 where the first fit is good as it is.
    """
    if len(shares) == 0 or not np.median(shares) > IRREGULARITY_FACTOR * expected_share:
        return np.zeros(len(shares))
    return np.sqrt(np.maximum(np.mean(shares**2) - shares**2, 0.0))
