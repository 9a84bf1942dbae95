"""Size of a rim whose crest an elevation model has blurred.

A model that does not resolve a crest bends most elsewhere, at small craters farther out. How far, follows
from the resolution over the radius and little from the profile: the numbers are means over a family of
profiles, see `craternav_fg.calibration.crest_blur`, and their spread is what is not known of a single crater.
A profile fitted to each crater instead errs more on real ground than the search does.
"""

import numpy as np

# Resolution, in radii of the ellipse found.
RESOLUTION_RADII = np.linspace(0.05, 0.45, 9)
# Logarithm of the mean radius found over that of the crest, mean and standard deviation over the profiles.
LOG_FOUND = np.array([-0.011, -0.014, 0.001, 0.025, 0.052, 0.078, 0.102, 0.124, 0.163])
CREST_SPREAD = np.array([0.010, 0.019, 0.022, 0.026, 0.029, 0.029, 0.027, 0.026, 0.042])
for _table in (RESOLUTION_RADII, LOG_FOUND, CREST_SPREAD):
    _table.flags.writeable = False


def crest_bias(resolution_radii: float) -> tuple[float, float]:
    """Compute how much larger than the crest an ellipse is that was fitted to the greatest bend.

    Parameters
    ----------
    resolution_radii : float
        Resolution of the elevation model, a standard deviation, in radii of the ellipse.

    Returns
    -------
    mean, spread : float
        Logarithm of the ratio of the sizes, and its standard deviation between craters.
    """
    mean, spread = (np.interp(resolution_radii, RESOLUTION_RADII, row) for row in (LOG_FOUND, CREST_SPREAD))
    return float(mean), float(spread)
