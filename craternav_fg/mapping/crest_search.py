"""Search for the crest of one crater around an ellipse, in rings that become narrower."""

from collections.abc import Callable

import numpy as np

from craternav_fg.ellipse import mean_radius, points_on
from craternav_fg.mapping.crest_kernel import closed_ridge, crest_score
from factors.arrays import FloatArray

# Heights (n,) at places (n, 2) of the tangent plane, m.
Terrain = Callable[[FloatArray], FloatArray]

# Rays of a search.
RAYS = 72
# Ring of each search, in radii of its start, prior deviation of the crest there, weight of its height.
SEARCHES = ((0.6, 1.5, 0.25, 0.5), (0.75, 1.3, 0.12, 0.25), (0.8, 1.25, 0.1, 0.0))
# Samples per step of the model along a ray, and the minimum and maximum of a ray.
_SAMPLES_PER_STEP = 2.0
_RAY_SAMPLES = (24, 80)
# Smoothing along a ray, in radii: narrower than a rim's crest, wider than its roughness.
_SMOOTHING_RADII = 0.06


def find_crest(
    chart: FloatArray, terrain: Terrain, search: tuple[float, float, float, float], step_m: float
) -> FloatArray:
    """Find the crest around an ellipse.

    Parameters
    ----------
    chart : ndarray, shape (5,)
        Ellipse in the tangent plane, m and logarithms.
    terrain : callable
        Heights (n,) at places (n, 2) of the tangent plane, m.
    search : tuple of float
        One of `SEARCHES`.
    step_m : float
        Step of the elevation model.

    Returns
    -------
    ndarray, shape (72, 2)
        A point on each ray from the ellipse's centre, m.
    """
    radius_m = float(mean_radius(chart))
    low, high, prior, height_weight = search
    samples = int(np.clip(_SAMPLES_PER_STEP * (high - low) * radius_m / step_m, *_RAY_SAMPLES))
    share = np.linspace(low, high, samples)
    off = points_on(chart, RAYS) - chart[:2]
    places = chart[:2] + share[:, None] * off[:, None]
    heights = terrain(places.reshape(-1, 2))
    # The regional slope says nothing of the rim.
    G = np.column_stack([np.ones(len(heights)), (places.reshape(-1, 2) - chart[:2]) / radius_m])
    level = heights - G @ np.linalg.lstsq(G, heights, rcond=None)[0]
    spacing = share[1] - share[0]
    score = crest_score(level.reshape(RAYS, samples), max(_SMOOTHING_RADII / spacing, 1.0), height_weight)
    score -= 0.5 * ((share - 1.0) / prior) ** 2
    rays = np.arange(RAYS)
    line = np.clip(closed_ridge(score), 1, samples - 2)
    # The maximum of a parabola through the score's three values.
    before, at, after = (score[rays, line + k] for k in (-1, 0, 1))
    bend = np.minimum(before - 2.0 * at + after, -1e-12)
    fine = np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    return chart[:2] + (low + spacing * (line + fine))[:, None] * off
