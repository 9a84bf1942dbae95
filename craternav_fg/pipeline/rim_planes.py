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
from craternav_fg.estimators.instruments import RIMS
from craternav_fg.evaluation.innovations import Innovations, innovations

# Logarithm of the likelihood ratio at which the heights are taken for those of the points: 3000 to 1.
_MIN_LOG_RATIO = 8.0
# Upper quartile of the NIS per dimension up to which rims tell so: where rims contradict one meaning and the
# other, something else is wrong. Errors of twice the stated size give about 5.
_MAX_QUARTILE_NIS = 6.0
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
    bounds wrong matches. They decide only if most rims are within their stated errors with one meaning.

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
    given, points = (_innovations(problems, one) for one in (catalog, lowered))
    # A filter that fails says nothing of the heights.
    if given is None or points is None:
        return False
    rims = points.of(RIMS)
    agree = len(rims.nis) and np.quantile(rims.nis / np.maximum(rims.dimension, 1), 0.75) <= _MAX_QUARTILE_NIS
    return bool(agree) and _log_likelihood(points) - _log_likelihood(given) > _MIN_LOG_RATIO


def _innovations(problems: Sequence[Problem], catalog: Catalog) -> Innovations | None:
    """Innovations of a filter with a catalogue, None if it fails."""
    parts = []
    for problem in problems:
        one = replace(problem, catalog=catalog)
        try:
            run = ekf().run(one)
            parts.append(innovations(one, run.states, run.predictions))
        except (EstimationError, np.linalg.LinAlgError):
            return None
    return Innovations.joined(parts)


def _log_likelihood(found: Innovations) -> float:
    """Log-likelihood of innovations, but for a constant, with errors of Student's kind."""
    size = np.maximum(found.dimension, 1)
    return -float(np.sum(size * np.log1p(found.nis / size)))
