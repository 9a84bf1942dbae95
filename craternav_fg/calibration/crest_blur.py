"""Where the search finds the crest of a crater whose elevation model is blurred.

Craters of a family of profiles, each blurred as an elevation model blurs it, are searched as `catalog refine`
does. A wall is a power of the distance from the floor's edge, steeper than the flank, which falls as a power
of the radius; wear rounds the crest. The true crest is the highest line of the ground that is not blurred. A
blurred crest bends most farther out: its wall is concave and keeps its slope, its flank runs out. That
outweighs the crest's own wear, which has the highest line outside of the bend, for all but large craters.
"""

from itertools import product

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import ive

from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.ellipse import chart_of_axes
from craternav_fg.mapping.crest_blur import CREST_SPREAD, LOG_FOUND, RESOLUTION_RADII
from craternav_fg.mapping.crest_search import SEARCHES, find_crest
from craternav_fg.mapping.refine import RefineOptions
from factors.arrays import FloatArray

# The family: edge of the floor in radii, power of the wall, rim's height over the depth, power of the flank,
# and wear, a standard deviation in radii. Chosen: bowls to flat floors, fresh rims to such that a catalogue
# just has. Larger craters wear by as many metres: below a resolution of `_FULL_WEAR` radii, wear in radii is
# in proportion to it. The flank ends between the last two radii.
_FLOORS, _WALLS, _RIMS, _FALLS = (0.0, 0.25, 0.5), (1.2, 1.7, 2.4, 3.4), (0.12, 0.2, 0.3), (2.0, 3.0, 4.5)
_WEARS, _FULL_WEAR = (0.01, 0.03, 0.06), 0.1
_FLANK_ENDS = (1.6, 2.6)
# Samples of a profile, in radii, and of the blurred one that is searched.
_STEP_RADII, _LAST_RADIUS, _BLURRED_LAST = 0.01, 3.2, 2.4
# Errors of the circles at which a search begins, logarithms: those of LU1319381.
_STARTS = (-0.1, 0.0, 0.1)
# Resolutions that are searched, in radii of the true crest.
_TRUE_RADII = np.linspace(0.03, 0.6, 20)
_HALF_DIGIT = 5e-4


def crest_blur() -> list[Regenerated]:
    """Regenerate `mapping.crest_blur.LOG_FOUND` and `CREST_SPREAD`.

    Returns
    -------
    list of Regenerated
    """
    rows = []
    for share in _TRUE_RADII:
        found = log_found(profiles(min(1.0, share / _FULL_WEAR)), float(share))
        rows.append((share * np.exp(-found.mean()), found.mean(), found.std()))
    resolution, mean, spread = np.array(rows).T
    out = []
    for name, shipped, values in (("LOG_FOUND", LOG_FOUND, mean), ("CREST_SPREAD", CREST_SPREAD, spread)):
        for at, one in zip(RESOLUTION_RADII, shipped, strict=True):
            value = float(np.interp(at, resolution, values))
            title = f"crest_blur.{name} at a resolution of {at:.2f} radii"
            out.append(Regenerated(title, float(one), value, _HALF_DIGIT, Relation.EXACT))
    return out


def profiles(worn: float, step_radii: float = _STEP_RADII) -> FloatArray:
    """Draw the family's cross-sections.

    Parameters
    ----------
    worn : float
        The wear over the family's own.
    step_radii : float
        Distance between samples.

    Returns
    -------
    ndarray, shape (n, m)
        Heights over a depth of 1, at odd multiples of half a step, to 3.2 radii; the highest line is at 1.
    """
    rho = np.arange(0.5, _LAST_RADIUS / step_radii) * step_radii
    out = []
    for floor, wall, rim, fall, wear in product(_FLOORS, _WALLS, _RIMS, _FALLS, _WEARS):
        inner = rim - 1.0 + np.clip((rho - floor) / (1.0 - floor), 0.0, 1.0) ** wall
        fade = np.clip((_FLANK_ENDS[1] - rho) / (_FLANK_ENDS[1] - _FLANK_ENDS[0]), 0.0, 1.0)
        height = np.where(rho < 1.0, inner, rim * np.maximum(rho, 1.0) ** -fall * fade)
        both = gaussian_filter1d(
            np.concatenate([height[::-1], height]), worn * wear / step_radii, mode="nearest"
        )
        height = both[len(rho) :]
        out.append(np.interp(rho * _highest(rho, height), rho, height, right=0.0))
    return np.array(out)


def log_found(heights: FloatArray, share: float) -> FloatArray:
    """Search the blurred crests of craters.

    Parameters
    ----------
    heights : ndarray, shape (n, 320)
        See `profiles`.
    share : float
        Standard deviation of the blur, in radii.

    Returns
    -------
    ndarray, shape (n,)
        Logarithm of the radius that is found, over the true one.
    """
    rho = np.arange(0.5, _LAST_RADIUS / _STEP_RADII) * _STEP_RADII
    seen = np.arange(0.0, _BLURRED_LAST, _STEP_RADII)
    blurred = heights @ _blur(seen, rho, share).T
    return np.array([np.mean([_searched(seen, one, share, start) for start in _STARTS]) for one in blurred])


def _searched(rho: FloatArray, height: FloatArray, share: float, start: float) -> float:
    """Logarithm of the radius that the searches find, from that at which they begin."""

    def terrain(places: FloatArray) -> FloatArray:
        return np.interp(np.hypot(places[:, 0], places[:, 1]), rho, height)

    radius = float(np.exp(start))
    for search in SEARCHES:
        circle = chart_of_axes([0.0, 0.0, radius, radius, 0.0])
        crest = find_crest(circle, terrain, search, share / RefineOptions().resolution_steps)
        radius = float(np.hypot(crest[:, 0], crest[:, 1]).mean())
    return float(np.log(radius))


def _blur(seen: FloatArray, rho: FloatArray, sigma: float) -> FloatArray:
    """Matrix (seen, rho) that blurs a round hill in two dimensions, from profile to profile."""
    across = seen[:, None] * rho / sigma**2
    along = np.exp(-0.5 * ((seen[:, None] - rho) / sigma) ** 2)
    return np.asarray(_STEP_RADII * rho / sigma**2 * along * ive(0, across))


def _highest(rho: FloatArray, height: FloatArray) -> float:
    """Place of the highest point: the vertex of the parabola through three samples."""
    i = int(np.argmax(height))
    before, here, after = height[i - 1 : i + 2]
    return float(rho[i] + 0.5 * (rho[1] - rho[0]) * (before - after) / (before - 2.0 * here + after))
