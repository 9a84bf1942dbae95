"""Identification of an image's rims without a prior position: the search, and the decision on its answer.

See the package's docstring for the algorithm.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.common_shift import share_of_rims
from craternav_fg.errors import EstimationError
from craternav_fg.matching.identify.chance import log_by_chance
from craternav_fg.matching.identify.evidence import log_evidence
from craternav_fg.matching.identify.expand import expand_inliers
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    HYPOTHESIS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
    PoseLimits,
)
from craternav_fg.matching.identify.nadir import models_around, nadirs
from craternav_fg.matching.identify.noise import shape_scale
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.refine import refine
from craternav_fg.matching.identify.result import Identification, Status, no_answer
from craternav_fg.matching.identify.shading import log_shading
from craternav_fg.matching.identify.single_rim_search import search_single_rims
from craternav_fg.matching.identify.size_excess import plausible_rims
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triple_search import (
    Projection,
    image_order,
    image_triples,
    largest,
    likeliest,
    project_all_to_sphere,
    search_triples,
)
from craternav_fg.matching.identify.view import View, distinct_rows, view_of
from craternav_fg.measurements import KnownAttitude
from craternav_fg.resection.intrinsics import (
    IntrinsicsFit,
    IntrinsicsPrior,
    fit_intrinsics,
    intrinsics_warnings,
)
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps
from factors.kernels.gauss_newton import screw

__all__ = ["Identification", "IdentifyOptions", "KnownAttitude", "Status", "identify"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Int32Array = npt.NDArray[np.int32]

# A hypothesis is formed from a triple.
_MIN_RIMS = 3
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
# Divisor of the number of triples for verticals around the best estimate.
_RING_DIVISOR = 4
# When all that has found nothing, so many times as many triples are looked up with the best vertical, at the
# noise levels with few candidates: one of many triples has small errors even in a noisy image.
_LAST_TRIPLES = 2
# Neighbours of a rim that are paired to triples.
_PAIRED_NEIGHBOURS = 6
# Rims around each rim that may be asked when a hypothesis is scored.
_ORDERED_RIMS = 24
# Rims of which hypotheses are formed, the largest: memory and time grow with the square of their number.
_MAX_RIMS = 1500
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
# Triples of an index for which the options' number of candidates is meant.
_TRIPLES_OF_CANDIDATES = 1_000_000
# Rims, the largest first, from which the position is sought with a known attitude, and hypotheses kept.
_SINGLE_RIMS = 8
_KEPT_OF_SINGLE_RIMS = 64
# Largest rotation of a triple's hypothesis from a known attitude, beside 5 standard deviations of that: three
# centres determine the attitude coarsely.
_MAX_TURN_RAD = float(np.radians(20.0))
_ATTITUDE_SIGMAS = 5.0
# Factor on the standard deviations of the intrinsics that the rims show: errors of the shapes of small rims
# are not Gaussian, and the focal length scatters 1.5 times as widely over simulated views.
_INTRINSICS_SPREAD = 2.0
# An attitude known more accurately than this, rad, is used with this: its information stays invertible.
_MIN_ATTITUDE_SIGMA_RAD = 1e-5


@dataclass
class _Expanded:
    """A pose with its matched rims, information N (6, 6), noise (3,) and logarithm of the evidence."""

    gTc: FloatArray
    match: IntArray
    N: FloatArray
    sigma: FloatArray
    log_ratio: float


class _Search:
    """Data of one call that every step needs."""

    def __init__(
        self, view: View, index: TripleIndex, known: KnownAttitude | None, camera: Camera,
        options: IdentifyOptions, maps: ShadingMaps = NO_SHADING,
    ) -> None:  # fmt: skip
        self.view, self.index, self.options, self.maps = view, index, options, maps
        self.n = len(view.charts)
        self.prior = np.eye(4)
        self.weight = np.zeros((6, 6))
        self.sigma_rad = max(1.0 if known is None else known.sigma_rad, _MIN_ATTITUDE_SIGMA_RAD)
        attitude, min_cos_turn = np.empty((0, 3)), -1.0
        if known is not None:
            gRc = known.gRb @ camera.bTc[:3, :3]
            attitude = np.ascontiguousarray(gRc)
            self.prior[:3, :3] = gRc
            self.weight[:3, :3] = np.eye(3) / self.sigma_rad**2
            min_cos_turn = float(np.cos(_MAX_TURN_RAD + _ATTITUDE_SIGMAS * self.sigma_rad))
        self.limits = PoseLimits(attitude, min_cos_turn, *options.altitudes_m)
        self.chance, self.shape_chance = log_by_chance(view)
        self.largest = largest(view, np.arange(self.n), _MAX_RIMS)
        self.begin_with(largest(view, plausible_rims(view), _MAX_RIMS))

    def begin_with(self, plausible: IntArray) -> None:
        """Begin hypotheses from these rims, the likeliest of them, and all."""
        self.plausible = plausible
        likely = likeliest(self.view, plausible, _ORDERED_RIMS)
        self.order = image_order(self.view, likely, _ORDERED_RIMS)
        groups = {len(rims): rims for rims in (likely, plausible, self.largest)}
        self.groups = list(groups.values())

    def expand(self, hypothesis: FloatArray, noise: float) -> _Expanded | None:
        """Expand a hypothesis; if its evidence is promising but too low, try variations of it."""
        gTc = np.eye(4)
        gTc[:3, :3] = hypothesis[ROTATION:POSITION].reshape(3, 3)
        gTc[:3, 3] = hypothesis[POSITION:SPHERE]
        match = np.full(self.n, -1)
        rims = hypothesis[RIMS:CRATERS].astype(np.int64)
        match[rims[rims >= 0]] = hypothesis[CRATERS:][rims >= 0]
        expanded = self._expand_from(gTc, match, noise)
        if expanded is not None and 0.0 < expanded.log_ratio < -self.options.log_chance:
            return self.best_variation(expanded)
        return expanded

    def expand_best(
        self, best: FloatArray, count: int, min_score: float, noise: float
    ) -> tuple[list[_Expanded], bool]:
        """Expand the best hypotheses and make room for others, until one has enough evidence.

        Give those that did not fail, the last one being that with enough evidence, and whether there is one.
        """
        out: list[_Expanded] = []
        for row in np.argsort(-best[:, SCORE])[:count]:
            if best[row, SCORE] == -np.inf or best[row, SCORE] < min_score:
                break
            expanded = self.expand(best[row], noise)
            best[row, SCORE] = -np.inf
            if expanded is not None:
                out.append(expanded)
                if expanded.log_ratio >= -self.options.log_chance:
                    return out, True
        return out, False

    def best_variation(self, expanded: _Expanded) -> _Expanded:
        """Expand again from the pairs in each half of the image, and with each noise level; return the best.

        Pairs that suit the noise assumed at first are kept, and wrong pairs on one side of the image distort
        the pose there: both are overcome from another start.
        """
        matched = expanded.match >= 0
        places = self.view.points_px[matched]
        halves = []
        for axis in range(2):
            middle = np.median(places[:, axis])
            for side in (self.view.points_px[:, axis] <= middle, self.view.points_px[:, axis] >= middle):
                if np.sum(side & matched) >= _MIN_RIMS:
                    halves.append(np.where(side, expanded.match, -1))
        levels = np.array(self.options.noise_levels_px)
        noise = float(levels[np.argmin(np.abs(np.log(levels / expanded.sigma[0])))])
        starts = [(expanded.match, float(level)) for level in levels] + [(half, noise) for half in halves]
        for match, level in starts:
            other = self._expand_from(expanded.gTc.copy(), match.copy(), level)
            if other is not None and other.log_ratio > expanded.log_ratio:
                expanded = other
        return expanded

    def _expand_from(self, gTc: FloatArray, match: IntArray, noise: float) -> _Expanded | None:
        """Expand a pose with some pairs (changed in place), and compute the evidence; None if it fails."""
        craters, index = self.index.craters, self.index.catalog.index
        N, sigma = np.empty((6, 6)), np.empty(3)
        pairs = expand_inliers(
            self.view, index, craters, noise, self.chance, self.prior, self.weight, gTc, match, N, sigma
        )
        if pairs < _MIN_RIMS:
            return None
        ratio = log_evidence(
            self.view, index, craters, gTc, match, N, self.chance, self.shape_chance, self._log_prior(gTc)
        )
        if not np.isfinite(ratio):
            return None
        ratio += log_shading(self.view, index, craters, gTc, match, N, self.maps)
        return _Expanded(gTc, match, N, sigma, ratio)

    def _log_prior(self, gTc: FloatArray) -> float:
        """Natural logarithm of the density of a pose before the image was seen, per rad^3 m^3."""
        least, most = self.options.altitudes_m
        range_m = float(np.linalg.norm(gTc[:3, 3]))
        altitude = range_m - self.index.catalog.body.radius_m
        if not least < altitude < most:
            return -np.inf
        place = -np.log(4.0 * np.pi * range_m**2) - np.log(altitude * np.log(most / least))
        if not len(self.limits.attitude):
            return float(place - np.log(8.0 * np.pi**2))
        turn = frames.rotation_log(self.limits.attitude.T @ gTc[:3, :3])
        spread = self.sigma_rad
        return float(place - 1.5 * np.log(2.0 * np.pi * spread**2) - 0.5 * turn @ turn / spread**2)


def identify(
    ellipses_px: FloatArray, camera: Camera, index: TripleIndex, attitude: KnownAttitude | None = None,
    options: IdentifyOptions = IdentifyOptions(), quality: FloatArray | None = None,
    maps: ShadingMaps = NO_SHADING,
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
    if not (np.isfinite(ellipses).all() and (ellipses[:, 2:4] > 0.0).all()):
        raise EstimationError("ellipses: expected finite numbers and positive axes")
    n = len(ellipses)
    once = distinct_rows(ellipses)
    if len(once) < _MIN_RIMS:
        reason = f"found {len(once)} rims, expected {_MIN_RIMS} or more"
        return no_answer(n, Status.TOO_FEW_RIMS, reason, 0.0, began)
    threshold = -(options.log_chance if attitude is None else options.log_chance_attitude)
    best, found = -np.inf, list[_Expanded]()
    for factor, depth in _passes(index, attitude, options):
        view = view_of(
            ellipses[once] / [1.0, 1.0, factor, factor, 1.0], camera, options.size_sigma,
            options.centre_share, None if quality is None else quality[once],
        )  # fmt: skip
        search = _Search(view, index, attitude, camera, options, maps)
        first = factor == options.size_factors[0]
        # Single rims are many: they are tried once.
        found = _expanded(search, depth, attitude is not None and first)
        if not first:
            # Each further factor is another way to agree by chance.
            for one in found:
                one.log_ratio -= float(np.log(len(options.size_factors)))
        best = max(best, found[0].log_ratio) if found else best
        if found and found[0].log_ratio >= threshold:
            break
    else:
        reason = "no pose puts more rims on craters of their size than chance does"
        return no_answer(n, Status.NO_ANSWER, reason, -best if np.isfinite(best) else 0.0, began)
    if len(found) > 1 and found[1].log_ratio - found[0].log_ratio > options.log_ambiguity:
        reason = f"a second pose is {np.exp(found[1].log_ratio - found[0].log_ratio):.2g} times as probable"
        return no_answer(n, Status.AMBIGUOUS, reason, -found[0].log_ratio, began)
    return _answer(search.best_variation(found[0]), search, once, n, camera, began)


def _passes(
    index: TripleIndex, attitude: KnownAttitude | None, options: IdentifyOptions
) -> list[tuple[float, int]]:
    """Size factors, and multiples of the number of candidates, in the order tried.

    The larger the catalogue, the more of its triples resemble one of rims as much as the right one does. A
    known attitude needs no triples.
    """
    depth = len(index.tree.points) // _TRIPLES_OF_CANDIDATES if options.deep else 1
    if options.deep and (depth < 2 or attitude is not None):
        return []
    return [(factor, depth) for factor in options.size_factors]


def _expanded(search: _Search, depth: int, singles: bool) -> list[_Expanded]:
    """Expand hypotheses from triples and, if wanted, from single rims; the best first."""
    found = _by_triples(search, depth)
    threshold = -search.options.log_chance
    if len(search.plausible) < search.n and not (found and found[0].log_ratio >= threshold):
        # Real images have many large craters, too: the excess may be these.
        search.begin_with(search.largest)
        found = sorted(found + _by_triples(search, depth), key=lambda one: -one.log_ratio)
    if singles and not (found and found[0].log_ratio >= threshold):
        found = _by_single_rims(search, found)
    return found


def _by_triples(search: _Search, depth: int) -> list[_Expanded]:
    """Expand hypotheses from triples until one has enough evidence; the best first."""
    view, index = search.view, search.index
    radius = index.catalog.body.radius_m
    found: list[_Expanded] = []
    count, min_score = _EXPANDED_PER_ROUND, _MIN_SCORE
    if depth > 1:
        count, min_score = _DEEP_EXPANDED_PER_ROUND, _DEEP_MIN_SCORE
    for model, tried, noise, candidates in _stages(search, depth):
        projection = project_all_to_sphere(
            view, np.ascontiguousarray(model[:3]), float(model[3] * radius), radius
        )
        triples = _triples(search, projection, noise)[tried]
        best = np.full((_KEPT_OF_TRIPLES, HYPOTHESIS), -np.inf)
        for start in range(0, len(triples), _LOOKED_UP):
            more = max(_FIRST_FACTOR >> start // _LOOKED_UP, 1) if depth > 1 else 1
            search_triples(
                view, index.catalog.index, index.craters, index.neighbours, index.tree, projection,
                triples[start : start + _LOOKED_UP], search.order, noise, more * candidates, search.limits,
                best,
            )  # fmt: skip
            expanded, enough = search.expand_best(best, count, min_score, noise)
            if enough:
                return expanded[-1:]
            found += expanded
    return sorted(found, key=lambda one: -one.log_ratio)


def _triples(search: _Search, projection: Projection, noise: float) -> Int32Array:
    """Triples of rims, the most promising first: those of each of the search's groups of rims in turn."""
    lists = [
        image_triples(search.view, projection, rims, _PAIRED_NEIGHBOURS, noise) for rims in search.groups
    ]
    turn = np.concatenate([np.arange(len(one)) for one in lists])
    return np.concatenate(lists)[np.argsort(turn, kind="stable")]


def _stages(search: _Search, depth: int) -> list[tuple[FloatArray, slice, float, int]]:
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


def _by_single_rims(search: _Search, found: list[_Expanded]) -> list[_Expanded]:
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


def _distinct(found: Sequence[_Expanded]) -> list[_Expanded]:
    """Select the poses that share at most one pair with any better one, the best first."""
    out: list[_Expanded] = []
    for expanded in sorted(found, key=lambda one: -one.log_ratio):
        same = (np.sum((expanded.match == other.match) & (expanded.match >= 0)) >= 2 for other in out)
        if not any(same):
            out.append(expanded)
    return out


def _answer(
    expanded: _Expanded, search: _Search, once: IntArray, n: int, camera: Camera, began: float
) -> Identification:
    """Refine the pose, and give it for the body."""
    index = search.index
    covariance = refine(
        search.view, index.craters, search.prior, search.weight, expanded.gTc, expanded.match, expanded.sigma
    )
    given = search.options
    prior = IntrinsicsPrior(
        search.view.focal_px, given.focal_sigma, given.principal_sigma_px, given.focal_stated
    )
    fit = _unknown_intrinsics(expanded, search, covariance, prior) if prior.sigmas.any() else None
    # From the camera's right twist to the body's.
    adjoint = frames.adjoint(camera.bTc)
    names = index.catalog.identifiers
    rows = np.full(n, -1)
    rows[once] = expanded.match
    gTb = expanded.gTc @ frames.inverse(camera.bTc)
    seen = index.catalog.take(rows[rows >= 0])
    share = 1.0
    if len(search.limits.attitude):
        share = share_of_rims(covariance[:3, :3], search.sigma_rad**2 * np.eye(3))
    of_map = seen.image_covariance(gTb, np.ones(len(seen)), share)
    return Identification(
        status=Status.IDENTIFIED,
        reason="",
        craters=tuple(names[row] if row >= 0 else None for row in rows),
        rows=rows,
        gTc=expanded.gTc,
        gTb=gTb,
        covariance=adjoint @ covariance @ adjoint.T + frames.rotate_position_block(of_map, gTb[:3, :3].T),
        log_chance=-expanded.log_ratio,
        sigma_px=float(expanded.sigma[0]),
        seconds=time.perf_counter() - began,
        focal_scale=np.nan if fit is None else fit.focal_scale,
        focal_scale_sigma=np.nan if fit is None else fit.focal_scale_sigma,
        warnings=() if fit is None else intrinsics_warnings(fit, prior),
    )


def _unknown_intrinsics(
    expanded: _Expanded, search: _Search, covariance: FloatArray, prior: IntrinsicsPrior
) -> IntrinsicsFit:
    """Fit the intrinsics too: moves the pose and enlarges the covariance (6, 6) in place."""
    view, craters = search.view, search.index.craters
    matched = np.flatnonzero(expanded.match >= 0)
    rows = expanded.match[matched]
    scale = np.array([shape_scale(view, int(i), expanded.sigma) for i in matched])
    sigma = np.column_stack([np.full((len(matched), 2), expanded.sigma[0]), *(scale[:, None],) * 3])
    variance = (sigma / view.precision[matched]) ** 2
    rims = MatchedRims(
        tuple(map(str, rows)), craters.centres[rows], craters.axes[rows], view.charts[matched],
        np.einsum("ni,ij->nij", variance, np.eye(5)),
    )  # fmt: skip
    known = search.limits.attitude
    attitude = KnownAttitude(known, search.sigma_rad) if len(known) else None
    fit = fit_intrinsics(ResectionProblem(rims, attitude=attitude), expanded.gTc, prior)
    covariance += fit.effect @ fit.unknowns_covariance @ fit.effect.T
    screw(expanded.gTc, fit.effect @ fit.unknowns)
    return replace(
        fit,
        focal_scale_sigma=_INTRINSICS_SPREAD * fit.focal_scale_sigma,
        principal_covariance_px2=_INTRINSICS_SPREAD**2 * fit.principal_covariance_px2,
    )
