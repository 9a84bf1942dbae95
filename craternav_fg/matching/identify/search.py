"""Identification of an image's rims without a prior position: the search, and the decision on its answer.

See the package's docstring for the algorithm.
"""

import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.matching.identify.answer import answer
from craternav_fg.matching.identify.expansion import MIN_RIMS, PROMISING, Expanded, Search
from craternav_fg.matching.identify.given import Given
from craternav_fg.matching.identify.hypothesis import HYPOTHESIS
from craternav_fg.matching.identify.nadir import models_around, nadirs
from craternav_fg.matching.identify.options import Effort, IdentifyOptions
from craternav_fg.matching.identify.pair_search import image_pairs, search_pair
from craternav_fg.matching.identify.result import Identification, Status, no_answer
from craternav_fg.matching.identify.single_rim_search import search_single_rims
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triple_search import (
    LEVER,
    Projection,
    image_order,
    image_triples,
    likely_and_large,
    project_all_to_sphere,
    search_triples,
)
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps
from factors.arrays import BoolArray, FloatArray

__all__ = ["Identification", "IdentifyOptions", "KnownAttitude", "Status", "identify"]

Int32Array = npt.NDArray[np.int32]

# Images with at least so many rims determine the vertical well: one estimate is used, and all noise levels
# are tried with it before the vertical is varied. With fewer rims, all verticals are tried per noise level.
_MIN_RIMS_OF_ONE_NADIR = 15
# Rims, the largest first, from which the vertical is estimated, and altitudes over the body's radius that are
# tried for it: the foreshortening depends only weakly on the altitude.
_NADIR_RIMS = 40
_NADIR_HEIGHTS = np.array([0.08, 0.25])
# Where no estimate is so near to the optical axis, that is tried, too: many cameras look down, and craters
# that the light makes elongated alike seem to be foreshortened.
_MAX_OFF_AXIS_RAD = float(np.radians(15.0))
# Angle to the optical axis from which a wide search tries the vertical half way to it as well.
_HALF_WAY_RAD = float(np.radians(10.0))
# Divisor of the number of triples for verticals around the best estimate.
_RING_DIVISOR = 4
# When all that has found nothing, so many times as many triples are looked up with the best vertical, at the
# noise levels with few candidates: one of many triples has small errors even in a noisy image.
_LAST_TRIPLES = 2
# Neighbours of a rim that are paired to triples.
_PAIRED_NEIGHBOURS = 6
# Triples that are looked up between two expansions, hypotheses kept among all triples, how many of them are
# expanded each time, and the minimum score of those: with much noise the scores of right and wrong hypotheses
# differ little, and an expansion costs less than a look-up.
_LOOKED_UP = 12
_KEPT_OF_TRIPLES = 24
_EXPANDED_PER_ROUND = 4
_MIN_SCORE = 4.0
# The same in a search with multiplied candidates. Where a plain shows few rims, or the map has many craters
# that the image does not show, hypotheses of the right craters have scores of 1 to 3: others would end there.
_DEEP_EXPANDED_PER_ROUND = 24
_DEEP_MIN_SCORE = 1.0
# And the factor on the number of candidates of the first triples, which halves from expansion to expansion:
# the most promising triples are right most often, but often not with their nearest candidates.
_FIRST_FACTOR = 8
# And before that: rims that are likely and large, neighbours of each among them, and hypotheses that are
# expanded of each triple. Of 133 sets of rims on real ground, these have 14.0 triples that the index holds
# in the mean, fewer than three in 11 % of the sets; the 16 likeliest of any size, with all pairs, had 6.3,
# fewer than three in 37 %, at half as much again of the cost.
_CHOSEN_RIMS, _CHOSEN_NEIGHBOURS, _EXPANDED_OF_CHOSEN = 24, 10, 24
# In a wide search: triples, and candidates per million in the index, of neighbours among all rims and among
# the chosen ones. In one image of rendered real ground with 228 rims, eleven triples of chosen rims are of
# craters that the index has: at places 2 to 237 of 1001, six of them with 3,800 to 10,000 of ten million
# triples nearer, the others with more. In another with 42 rims there are two: at places 182 and 920 of all
# rims' triples, with up to 90 nearer.
_WIDE_OF_ALL, _WIDE_OF_CHOSEN = (1000, 25), (128, 600)
# Hypotheses that are then expanded, and the lever of their scores. Such triples agree in the pose to a
# percent in the median, with a vertical that is off by 5 deg. So scored, with the least noise, the best right
# one of those images is the 64th of 2.1 million and the 4th of 0.7 million; with a lever of 0.05 the 2,482nd
# and the 7th, and with the noise of the look-ups besides the 22,074th and the 35th.
_KEPT_WIDELY, _NARROW_LEVER = 256, 0.02
# And pairs of craters that are tried after these, at some 2 us each.
_PAIRS_OF_CRATERS = 1_500_000
# Triples of an index for which the options' number of candidates is meant.
_TRIPLES_OF_CANDIDATES = 1_000_000
# Rims, the largest first, from which the position is sought with a known attitude, and hypotheses kept.
_SINGLE_RIMS = 8
_KEPT_OF_SINGLE_RIMS = 64


def identify(
    ellipses_px: FloatArray, camera: Camera, index: TripleIndex, attitude: KnownAttitude | None = None,
    options: IdentifyOptions = IdentifyOptions(), quality: FloatArray | None = None,
    maps: ShadingMaps = NO_SHADING, traced: BoolArray | None = None,
) -> Identification:  # fmt: skip
    """Identify the craters of an image's rims, and estimate the pose.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre, semi-axes, angle of the first axis from x towards y, rad; px, as seen in the image through
        the lens.
    camera : Camera
    index : TripleIndex
        The catalogue's index.
    attitude : KnownAttitude, optional
        An exact attitude is used with a standard deviation of 1e-5 rad.
    options : IdentifyOptions
    quality : ndarray, shape (n,), optional
        Probability of each rim to be a crater's, above 0; 1 if not given. Only ratios matter to the evidence.
    maps : ShadingMaps, optional
        Of the image without distortion: poses are judged by it, too.
    traced : ndarray of bool, shape (n,), optional
        Whether each ellipse shows its rim's shape, else only its place and size; all if not given.

    Returns
    -------
    Identification
        No answer for fewer than three rims, and usually none for three with an unknown attitude. If a rim is
        given twice, the second has no crater.

    Raises
    ------
    EstimationError
        When an ellipse has a number that is not finite or an axis that is not positive.
    """
    began = time.perf_counter()
    ellipses = np.asarray(ellipses_px, dtype=np.float64).reshape(-1, 5)
    n = len(ellipses)
    given = Given(ellipses, camera, index, attitude, options, quality, maps, traced)
    if len(given.once) < MIN_RIMS:
        reason = f"found {len(given.once)} rims, expected {MIN_RIMS} or more"
        return no_answer(n, Status.TOO_FEW_RIMS, reason, 0.0, began)
    threshold = -(options.log_chance if attitude is None else options.log_chance_attitude)
    best, found = -np.inf, list[Expanded]()
    depth = _depth(index, attitude, options)
    for factor in options.size_factors if depth else ():
        search = given.search(factor)
        # Single rims are many: they are tried once.
        singles = attitude is not None and factor == options.size_factors[0]
        wide = options.effort is Effort.WIDE
        found = _widely(search, depth) if wide else _expanded(search, depth, singles)
        if options.fine_size_factors and found and PROMISING < found[0].log_ratio < threshold:
            more = given.at_other_sizes(found[0].gTc, found[0].match, found[0].sigma[0])
            if more is not None and more[0].log_ratio > found[0].log_ratio:
                found[0], search = more
        best = max(best, found[0].log_ratio) if found else best
        if found and found[0].log_ratio >= threshold:
            break
    else:
        reason = "no pose puts more rims on craters of their size than chance does"
        return no_answer(n, Status.NO_ANSWER, reason, -best if np.isfinite(best) else 0.0, began)
    second = max((one.log_ratio for one in found[1:] if not _same(one, found[0])), default=-np.inf)
    if second - found[0].log_ratio > options.log_ambiguity:
        reason = f"a second pose is {np.exp(second - found[0].log_ratio):.2g} times as probable"
        return no_answer(n, Status.AMBIGUOUS, reason, -found[0].log_ratio, began)
    return answer(search.best_variation(found[0]), search, given.once, n, camera, began)


def _depth(index: TripleIndex, attitude: KnownAttitude | None, options: IdentifyOptions) -> int:
    """Multiple of the number of candidates; 0 where more effort would change nothing.

    The larger the catalogue, the more of its triples resemble one of rims as much as the right one does. A
    known attitude needs no triples.
    """
    if options.effort is Effort.PLAIN:
        return 1
    depth = len(index.tree.points) // _TRIPLES_OF_CANDIDATES
    return depth if depth > 1 and attitude is None else 0


def _expanded(search: Search, depth: int, singles: bool) -> list[Expanded]:
    """Expand hypotheses from triples and, if wanted, from single rims; the best first."""
    threshold = -search.options.log_chance
    found: list[Expanded] = []
    if depth > 1:
        plausible = search.plausible
        search.begin_with(search.largest)
        found = _among_chosen(search, depth)
        if not (found and found[0].log_ratio >= threshold):
            found = _best_first(found + _by_pairs(search, depth))
        search.begin_with(plausible)
    if not (found and found[0].log_ratio >= threshold):
        found = _best_first(found + _by_triples(search, depth))
    if len(search.plausible) < search.n and not (found and found[0].log_ratio >= threshold):
        # Real images have many large craters, too: the excess may be these.
        search.begin_with(search.largest)
        found = _best_first(found + _by_triples(search, depth))
    if singles and not (found and found[0].log_ratio >= threshold):
        found = _by_single_rims(search, found)
    return found


def _best_first(found: list[Expanded]) -> list[Expanded]:
    return sorted(found, key=lambda one: -one.log_ratio)


def _by_triples(search: Search, depth: int) -> list[Expanded]:
    """Expand hypotheses from triples until one has enough evidence; the best first."""
    found: list[Expanded] = []
    count, min_score = _EXPANDED_PER_ROUND, _MIN_SCORE
    if depth > 1:
        count, min_score = _DEEP_EXPANDED_PER_ROUND, _DEEP_MIN_SCORE
    for model, tried, noise, candidates in _stages(search, depth):
        projection = _projected(search, model)
        triples = _triples(search, projection, noise)[tried]
        best = np.full((_KEPT_OF_TRIPLES, HYPOTHESIS), -np.inf)
        for start in range(0, len(triples), _LOOKED_UP):
            more = max(_FIRST_FACTOR >> start // _LOOKED_UP, 1) if depth > 1 else 1
            chosen = triples[start : start + _LOOKED_UP]
            _look_up(search, projection, chosen, noise, more * candidates, best)
            expanded, enough = search.expand_best(best, count, min_score, noise)
            if enough:
                return expanded[-1:]
            found += expanded
    return _best_first(found)


def _widely(search: Search, depth: int) -> list[Expanded]:
    """Expand the best of very many hypotheses from triples, scored by narrow gates.

    Where rims are off by more than their noise, or false rims are around, the right craters are among the
    nearest thousands only. So many hypotheses cannot all be expanded: their scores must tell which are right.
    """
    found: list[Expanded] = []
    search.begin_with(search.largest)
    for model in _towards_axis(_stages(search, depth)[0][0]):
        expanded = _widely_with(search, depth, _projected(search, model))
        if expanded and expanded[0].log_ratio >= -search.options.log_chance:
            return expanded
        found += expanded
    return _best_first(found)


def _towards_axis(model: FloatArray) -> list[FloatArray]:
    """Return a vertical and altitude (4,) and, where the optical axis is far, the same half way to it.

    Rims that could not be traced are circles in the image: many pull the estimate to the axis, few leave it
    to the false rims that were traced.
    """
    if model[2] >= np.cos(_HALF_WAY_RAD):
        return [model]
    half_way = model[:3] + np.array([0.0, 0.0, 1.0])
    return [model, np.append(half_way / np.linalg.norm(half_way), model[3])]


def _widely_with(search: Search, depth: int, projection: Projection) -> list[Expanded]:
    """Expand the best of very many hypotheses for one vertical; the best first."""
    view, index, options = search.view, search.index, search.options
    chosen = likely_and_large(view, search.largest, _CHOSEN_RIMS)
    order = image_order(view, chosen, _CHOSEN_RIMS)
    least, most = options.noise_levels_px[0], options.noise_levels_px[-1]
    found: list[Expanded] = []
    for rims, count, candidates in ((search.largest, *_WIDE_OF_ALL), (chosen, *_WIDE_OF_CHOSEN)):
        triples = image_triples(view, projection, rims, _CHOSEN_NEIGHBOURS, most)[:count]
        best = np.full((_KEPT_WIDELY, HYPOTHESIS), -np.inf)
        search_triples(
            view, index.catalog.index, index.craters, index.neighbours, index.tree, projection, triples,
            order, most, least, _NARROW_LEVER, depth * candidates, search.limits, best,
        )  # fmt: skip
        expanded, enough = search.expand_best(best, _KEPT_WIDELY, -np.inf, most)
        if enough:
            return expanded[-1:]
        found += expanded
    return _best_first(found)


def _among_chosen(search: Search, depth: int) -> list[Expanded]:
    """Expand hypotheses from triples of a few rims that are likely and large, one after the other.

    Elsewhere a rim is paired with its neighbours, which among many false ones are rarely craters. The index
    has triples of craters that are large among their neighbours.
    """
    view = search.view
    model, _, noise, candidates = _stages(search, depth)[0]
    projection = _projected(search, model)
    rims = likely_and_large(view, search.largest, _CHOSEN_RIMS)
    found: list[Expanded] = []
    for triple in image_triples(view, projection, rims, _CHOSEN_NEIGHBOURS, noise):
        best = np.full((_KEPT_OF_TRIPLES, HYPOTHESIS), -np.inf)
        _look_up(search, projection, triple[None], noise, candidates, best)
        expanded, enough = search.expand_best(best, _EXPANDED_OF_CHOSEN, -np.inf, noise)
        if enough:
            return expanded[-1:]
        found += expanded
    return _best_first(found)


def _by_pairs(search: Search, depth: int) -> list[Expanded]:
    """Expand hypotheses from pairs of rims that are likely and large over their distance."""
    view, index = search.view, search.index
    model, _, noise, _ = _stages(search, depth)[0]
    projection = _projected(search, model)
    found: list[Expanded] = []
    left = _PAIRS_OF_CRATERS
    for pair in image_pairs(view, projection, likely_and_large(view, search.largest, _CHOSEN_RIMS)):
        best = np.full((_KEPT_OF_TRIPLES, HYPOTHESIS), -np.inf)
        left -= search_pair(
            view, index.catalog.index, index.craters, projection, index.catalog.body.radius_m, pair,
            search.order, noise, search.limits, left, best,
        )  # fmt: skip
        expanded, enough = search.expand_best(best, _EXPANDED_OF_CHOSEN, -np.inf, noise)
        if enough:
            return expanded[-1:]
        found += expanded
        if left <= 0:
            break
    return _best_first(found)


def _projected(search: Search, model: FloatArray) -> Projection:
    """Rims on the sphere for a vertical and an altitude in the body's radii (4,)."""
    radius = search.index.catalog.body.radius_m
    return project_all_to_sphere(
        search.view, np.ascontiguousarray(model[:3]), float(model[3] * radius), radius
    )


def _look_up(
    search: Search, projection: Projection, triples: Int32Array, noise: float, candidates: int,
    best: FloatArray,
) -> None:  # fmt: skip
    """Add the best hypotheses of some triples of rims to others."""
    index = search.index
    search_triples(
        search.view, index.catalog.index, index.craters, index.neighbours, index.tree, projection, triples,
        search.order, noise, noise, LEVER, candidates, search.limits, best,
    )  # fmt: skip


def _triples(search: Search, projection: Projection, noise: float) -> Int32Array:
    """Triples of rims, the most promising first: those of each of the search's groups of rims in turn."""
    lists = [
        image_triples(search.view, projection, rims, _PAIRED_NEIGHBOURS, noise) for rims in search.groups
    ]
    turn = np.concatenate([np.arange(len(one)) for one in lists])
    return np.concatenate(lists)[np.argsort(turn, kind="stable")]


def _stages(search: Search, depth: int) -> list[tuple[FloatArray, slice, float, int]]:
    """Vertical and altitude (4,), which triples, noise, and candidates per triple, in the order tried."""
    view, options = search.view, search.options
    plausible = search.plausible
    by_size = plausible[np.argsort(-view.radius_px[plausible])[:_NADIR_RIMS]]
    models, misfits = nadirs(view, by_size, _NADIR_HEIGHTS, 1 if search.n >= _MIN_RIMS_OF_ONE_NADIR else 2)
    models = models[np.argsort(misfits)]
    if models[:, 2].max() < np.cos(_MAX_OFF_AXIS_RAD):
        models = np.insert(models, 1, [0.0, 0.0, 1.0, models[0, 3]], axis=0)
    tried = [(model, slice(options.triples)) for model in models]
    tried += [(model, slice(options.triples // _RING_DIVISOR)) for model in models_around(models[0])]
    candidates = [depth * count for count in options.candidates]
    levels = list(zip(options.noise_levels_px, candidates, strict=True))
    rest = slice(options.triples, _LAST_TRIPLES * options.triples)
    last = [(models[0], rest, *level) for level in levels[:-1]]
    if search.n >= _MIN_RIMS_OF_ONE_NADIR:
        return [(*model, *level) for model in tried for level in levels] + last
    return [(*model, *level) for level in levels for model in tried] + last


def _by_single_rims(search: Search, found: list[Expanded]) -> list[Expanded]:
    """Expand hypotheses from single rims; distinct ones and those found before, the best first."""
    view, index, options = search.view, search.index, search.options
    rims = np.argsort(-view.radius_px)[:_SINGLE_RIMS].astype(np.int32)
    left = options.tried
    for noise in options.noise_levels_px:
        best = np.full((_KEPT_OF_SINGLE_RIMS, HYPOTHESIS), -np.inf)
        for start in range(len(rims)):
            left -= len(index.catalog)
            search_single_rims(
                view, index.catalog.index, index.craters, rims[start : start + 1], search.order,
                search.sigma_rad, noise, search.limits, best,
            )  # fmt: skip
            # With few rims, all that was kept is expanded once no further rim is tried.
            last = start + 1 >= len(rims) or left < len(index.catalog)
            count = len(best) if last and search.n < _MIN_RIMS_OF_ONE_NADIR else _EXPANDED_PER_ROUND
            expanded, enough = search.expand_best(best, count, -np.inf, noise)
            if enough:
                return expanded[-1:]
            found += expanded
            if last:
                break
        found = _distinct(found)
        answered = bool(found) and found[0].log_ratio >= -options.log_chance_attitude
        if answered or left < len(index.catalog):
            break
    return found


def _same(one: Expanded, other: Expanded) -> bool:
    """Whether poses share most of their pairs: several triples may lead to one."""
    shared = np.count_nonzero((one.match == other.match) & (one.match >= 0))
    return bool(2 * shared > min(np.count_nonzero(one.match >= 0), np.count_nonzero(other.match >= 0)))


def _distinct(found: Sequence[Expanded]) -> list[Expanded]:
    """Select the poses that share at most one pair with any better one, the best first."""
    out: list[Expanded] = []
    for expanded in sorted(found, key=lambda one: -one.log_ratio):
        same = (np.sum((expanded.match == other.match) & (expanded.match >= 0)) >= 2 for other in out)
        if not any(same):
            out.append(expanded)
    return out
