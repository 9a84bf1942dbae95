"""Centre of a crater by its walls, for rims whose crest the elevation model hardly resolves.

The walls lean about the centre: heights that are averaged around a centre that is off by u contain -u times
the slope of the mean profile in their first harmonic over the azimuth. What the ground adds to this harmonic,
a slope and a bend, changes with the radius as a parabola. Blur does not move this centre.
"""

import numpy as np

from craternav_fg.ellipse import mean_radius, points_on
from craternav_fg.mapping.crest_search import Terrain
from factors.arrays import FloatArray

# Rays, and rings in radii: from the foot of the wall to the flank.
_RAYS = 24
_RINGS = np.linspace(0.4, 1.3, 24)
# Largest shift, in radii: more is another crater's wall.
_MAX_SHIFT = 0.2
# Standard deviation of the centre of the walls about that of the crest, in radii. Chosen: 0.05 to 0.1 between
# the whole GLD100 and one of half its resolution.
_ERROR = 0.06


def wall_shift(chart: FloatArray, terrain: Terrain, crest_sigma_m: float) -> FloatArray:
    """Compute how far to move an ellipse towards the centre of the walls.

    Parameters
    ----------
    chart : ndarray, shape (5,)
        Ellipse in the tangent plane, m and logarithms.
    terrain : callable
        Heights (n,) at places (n, 2) of the tangent plane, m.
    crest_sigma_m : float
        Standard deviation of the ellipse's centre, per axis.

    Returns
    -------
    ndarray, shape (2,)
        From the ellipse's centre to the mean of both, weighted by their variances, m.
    """
    off = points_on(chart, _RAYS) - chart[:2]
    places = chart[:2] + _RINGS[:, None, None] * off
    heights = terrain(places.reshape(-1, 2)).reshape(len(_RINGS), _RAYS)
    slope = np.gradient(heights.mean(axis=1), _RINGS, edge_order=2)
    turn = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
    first = 2.0 / _RAYS * heights @ np.column_stack([np.cos(turn), np.sin(turn)])
    size = float(np.ptp(slope)) or 1.0
    G = np.column_stack([-slope, size * np.ones(len(_RINGS)), size * _RINGS, size * _RINGS**2])
    shift = np.linalg.lstsq(G, first, rcond=None)[0][0]
    shift *= min(1.0, _MAX_SHIFT / max(float(np.hypot(*shift)), 1e-12))
    # A quarter of the rays apart, two points of an ellipse lie on conjugate half-diameters.
    weight = crest_sigma_m**2 / (crest_sigma_m**2 + (_ERROR * float(mean_radius(chart))) ** 2)
    return np.asarray(weight * (shift[0] * off[0] + shift[1] * off[_RAYS // 4]))
