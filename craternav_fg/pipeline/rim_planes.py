"""Which height a catalogue gives: that of a rim's plane, or the mean of the rim's points.

Points of a rim on a sphere lie above the plane through them as seen from its centre, by a^2 / 2R for a radius
a: metres for small craters, hundreds for large ones. An elevation model read along rims gives the points'
mean height. Rims of several sizes in one frame tell the two apart: with the wrong one, large rims seem to lie
too high or too low.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craternav_fg.catalogs.heights import chord_depths_m
from craternav_fg.catalogs.model import Catalog
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.evaluation.innovations import innovations

# Logarithm of the likelihood ratio at which the heights are taken for those of the points: 3000 to 1.
_MIN_LOG_RATIO = 8.0
# Planes of rims that differ less in depth are lowered alike, which rims do not show.
_MIN_DEPTH_RANGE_M = 10.0


def lowered_to_planes(catalog: Catalog) -> Catalog:
    """Convert mean heights of rims' points to heights of their planes.

    Parameters
    ----------
    catalog : Catalog
        Whose heights are those of the points.

    Returns
    -------
    Catalog
    """
    return replace(catalog, height_m=catalog.height_m - chord_depths_m(catalog))


def heights_of_points(problems: Sequence[Problem]) -> bool:
    """Decide whether the catalogue's heights are those of the rims' points instead of their planes.

    The filter runs with either meaning, and the likelihoods of its innovations are compared under a loss that
    bounds wrong matches.

    Parameters
    ----------
    problems : sequence of Problem
        Segments of one descent.

    Returns
    -------
    bool
        False when the rims do not tell.
    """
    catalog = problems[0].catalog
    rows = np.unique(np.concatenate([f.rims.craters for p in problems for f in p.frames]))
    if not len(rows) or np.ptp(chord_depths_m(catalog)[rows]) < _MIN_DEPTH_RANGE_M:
        return False
    lowered = lowered_to_planes(catalog)
    given, points = (
        sum(_log_likelihood(replace(problem, catalog=one)) for problem in problems)
        for one in (catalog, lowered)
    )
    # A filter that fails says nothing of the heights.
    return bool(np.isfinite(given)) and points - given > _MIN_LOG_RATIO


def _log_likelihood(problem: Problem) -> float:
    """Log-likelihood of a filter's innovations, but for a constant, with errors of Student's kind."""
    try:
        run = ekf().run(problem)
        found = innovations(problem, run.states, run.predictions)
    except (EstimationError, np.linalg.LinAlgError):
        return -np.inf
    size = np.maximum(found.dimension, 1)
    return -float(np.sum(size * np.log1p(found.nis / size)))
