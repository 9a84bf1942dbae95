"""Figure of the check of poses against an elevation model."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from craternav_fg.evaluation.dem_check import DemCheck
from factors.arrays import FloatArray


def draw_dem_check(checks: Sequence[DemCheck], altitude_sigma_m: FloatArray) -> Figure:
    """Draw correlations and altitudes of all frames.

    Parameters
    ----------
    checks : sequence of DemCheck, length k
    altitude_sigma_m : ndarray, shape (k,)
        Standard deviations of the estimated altitudes.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    frames = np.arange(len(checks))
    left.plot(frames, [one.correlation for one in checks], "o", label="at the estimated pose")
    left.plot(frames, [one.best for one in checks], "s", mfc="none", label="at the best pose nearby")
    # A wrong pose may correlate negatively.
    least = min([0.0, *(one.correlation - 0.05 for one in checks), *(one.best - 0.05 for one in checks)])
    left.set(xlabel="frame", ylabel="correlation with the photograph", ylim=(least, 1.0), xticks=frames)
    left.legend(loc="lower right")
    right.errorbar(frames, [-one.altitude_m for one in checks], altitude_sigma_m, fmt="o", capsize=3)
    right.axhline(0.0, color="0.6", lw=0.8)
    right.set(xlabel="frame", ylabel="estimated minus best altitude, m", xticks=frames)
    return figure
