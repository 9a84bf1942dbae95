"""Association of an image's rims with catalogue craters, given a predicted pose.

An uncertain prediction makes gates that hold many craters each. But its error is common to all rims: with
the right pose, all gates shrink together. `gate_search` therefore takes pairs of rims for pairs of craters
that the prediction allows, scores the pose of each by the further rims that it explains, and expands the best
ones. Here the best pose is accepted or rejected, and its matches are judged:

- A pose is rejected when chance would produce its number of matches, or when another pose with other matches
  is nearly as good.
- A match is dropped when rim or crater has another candidate of similar distance. A missing match costs
  little accuracy, a wrong one much.
- Matches are dropped, worst first, until the remaining ones are consistent.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.frames import rotate_position_block
from craternav_fg.matching.expanded_pose import ExpandedPose
from craternav_fg.matching.gate_search import COMPONENTS, GateOptions, GateSearch
from factors.arrays import BoolArray, FloatArray, IntArray

__all__ = ["GateOptions", "Matches", "match_rims"]

# Fewest matches whose scatter about the pose says something about their covariances.
_MIN_SCATTER = 6


@dataclass(frozen=True)
class Matches:
    """Rims with their craters.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each rim's crater in the catalogue, -1 for none.
    ambiguous : ndarray of bool, shape (n,)
        Rims without a crater because several craters are possible, or their crater has several rims.
    gTb : ndarray, shape (4, 4)
        Predicted pose, updated by the matched rims.
    pose_covariance : ndarray, shape (6, 6)
        Covariance of the attitude error (rotation vector in b, rad) and the position error in g, m. It
        contains prior and rims: use it as a guide, and not together with measurements of the same image.
    """

    craters: IntArray
    ambiguous: BoolArray
    gTb: FloatArray
    pose_covariance: FloatArray


def match_rims(
    charts: FloatArray,
    covariances: FloatArray,
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    pose_covariance: FloatArray,
    options: GateOptions = GateOptions(),
) -> Matches:
    """Match the rims of an image with the craters near where a predicted pose puts them.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        Ellipse charts in normalised image coordinates.
    covariances : ndarray, shape (n, 5, 5)
        Covariances of the charts.
    camera : Camera
        Without distortion.
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Predicted pose of the body.
    pose_covariance : ndarray, shape (6, 6)
        Covariance of the prediction, positive definite: attitude error (rotation vector in b, rad), position
        error in g, m. The standard deviation of the position should be at most about half the altitude.
    options : GateOptions

    Returns
    -------
    Matches
        Without any crater when no pose is accepted.
    """
    nothing = Matches(np.full(len(charts), -1), np.zeros(len(charts), dtype=np.bool_), gTb, pose_covariance)
    if not len(charts):
        return nothing
    search = GateSearch(charts, covariances, camera, catalog, gTb, pose_covariance, options)
    found, tried = search.run()
    if not found:
        return nothing
    best = found[0]
    if search.by_chance(best, tried) > options.chance:
        return nothing
    rivals = [one for one in found[1:] if best.score - one.score < options.ambiguity]
    if any(not _compatible(best, one) for one in rivals):
        ambiguous = nothing.ambiguous.copy()
        ambiguous[best.rims] = True
        return Matches(nothing.craters, ambiguous, gTb, pose_covariance)
    return _judge(search, best)


def _compatible(one: ExpandedPose, other: ExpandedPose) -> bool:
    """Whether two poses give no rim different craters."""
    mine = dict(zip(one.rims.tolist(), one.craters.tolist(), strict=True))
    return all(
        mine.get(rim, crater) == crater
        for rim, crater in zip(other.rims.tolist(), other.craters.tolist(), strict=True)
    )


def _judge(search: GateSearch, best: ExpandedPose) -> Matches:
    """Drop ambiguous matches, then those that contradict the others."""
    options = search.options
    n = len(search.charts)
    craters, ambiguous = np.full(n, -1), np.zeros(n, dtype=np.bool_)
    rims, chosen = [], []
    distances2 = zip(best.distances2.tolist(), best.second_distances2.tolist(), strict=True)
    matches = zip(best.rims.tolist(), best.craters.tolist(), strict=True)
    for (i, m), (own, second) in zip(matches, distances2, strict=True):
        if second < min(search.gate, own + options.ambiguity):
            ambiguous[i] = True
        else:
            rims.append(i)
            chosen.append(m)
    gTb, covariance = best.gTb, best.covariance
    while rims:
        gTb, covariance, cost = search.solve_one(gTb, np.array(chosen), np.array(rims))
        limit = float(chdtri(COMPONENTS * len(rims), 1.0 - options.probability))
        at_pose = search.distances2(gTb, covariance)[rims, chosen]
        # When the typical rim is worse than its covariance says, all limits are widened.
        factor = 1.0
        if len(rims) >= _MIN_SCATTER:
            factor = max(1.0, float(np.median(at_pose)) / float(chdtri(COMPONENTS, 0.5)))
        if cost < limit * factor and at_pose.max() < search.gate * factor:
            break
        worst = int(np.argmax(at_pose))
        del rims[worst], chosen[worst]
    if not rims:
        return Matches(craters, ambiguous, search.prior, search.covariance)
    craters[rims] = search.rows[chosen]
    return Matches(craters, ambiguous, gTb, rotate_position_block(covariance, gTb[:3, :3]))
