"""Identification with no prior position: which catalogue crater is each rim, and from where it was seen.

Hypotheses of the pose come from triples of rims that have the form of a triple of the index or, with the
attitude known, from single rims. The best grow to all rims that agree, by Gauss-Newton on the kernels that
the static solver uses, too. One is believed when so many agreeing rims are improbable by chance, over all
places that were searched; otherwise there is no answer.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.errors import EstimationError
from craternav_fg.matching.identify.anchors import anchor_search
from craternav_fg.matching.identify.answer import Identification, IdentifyOptions, KnownAttitude, Status
from craternav_fg.matching.identify.evidence import log_by_chance, log_evidence
from craternav_fg.matching.identify.expand import expand_inliers
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    HYPOTHESIS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
)
from craternav_fg.matching.identify.nadir import nadirs
from craternav_fg.matching.identify.refine import settle
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triples import image_order, image_triples, project_all_to_sphere, search
from craternav_fg.matching.identify.view import View, view_of

__all__ = ["Identification", "IdentifyOptions", "KnownAttitude", "Status", "identify"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


_LEAST_RIMS = 3
_ANCHORS = 8
_SAME_PX = 0.05
# What the model of the view may be turned by, rad.
_TURN_RAD = float(np.radians(20.0))
# So many rims tell well which way is down; of fewer, another guess is made. Ways around the likeliest, rad
# away, are tried, too, with so small a part of the triples, by many rims only when all else was in vain.
_MANY = 15
_RING = float(np.radians(9.0))
_ASIDE = 4
# Triples that are looked up before the best of their hypotheses grow, how many, and of what score: with much
# noise right ones say little more than chance, and growing costs less than looking up.
_CHUNK = 12
_BEST = 4
_PROMISING = 4.0


@dataclass
class _Expanded:
    gTc: FloatArray
    match: IntArray
    N: FloatArray
    sigma: FloatArray
    log_ratio: float


class _Search:
    """What one call needs at every step."""

    def __init__(
        self, view: View, index: TripleIndex, gRc: FloatArray | None, known: KnownAttitude | None,
        options: IdentifyOptions,
    ) -> None:  # fmt: skip
        self.view, self.index, self.options = view, index, options
        self.n = len(view.charts)
        self.prior = np.eye(4)
        self.weight = np.zeros((6, 6))
        self.attitude = np.empty((0, 3))
        self.sigma_rad, self.least_cos = 1.0, -1.0
        if gRc is not None and known is not None:
            self.attitude = np.ascontiguousarray(gRc)
            self.prior[:3, :3] = gRc
            self.weight[:3, :3] = np.eye(3) / known.sigma_rad**2
            self.sigma_rad = known.sigma_rad
            self.least_cos = float(np.cos(_TURN_RAD + 5.0 * known.sigma_rad))
        self.chance, self.shape_chance = log_by_chance(view)
        self.order = image_order(view, 24)

    def expand(self, hypothesis: FloatArray, noise: float) -> _Expanded | None:
        """Grow a hypothesis and weigh it; what promises something but is not enough, in all ways."""
        gTc = np.eye(4)
        gTc[:3, :3] = hypothesis[ROTATION:POSITION].reshape(3, 3)
        gTc[:3, 3] = hypothesis[POSITION:SPHERE]
        match = np.full(self.n, -1)
        rims = hypothesis[RIMS:CRATERS].astype(np.int64)
        match[rims[rims >= 0]] = hypothesis[CRATERS:][rims >= 0]
        grown = self._from(gTc, match, noise)
        if grown is not None and 0.0 < grown.log_ratio < -self.options.log_chance:
            return self.best_near(grown)
        return grown

    def best_near(self, grown: _Expanded) -> _Expanded:
        """Grow anew from the pairs on each side of the image, and with all noises; the most probable.

        Growth that began with some noise keeps pairs that suit it; and where it met wrong craters on one
        side of the image, the other side knows better.
        """
        matched = grown.match >= 0
        places = self.view.points_px[matched]
        halves = []
        for axis in range(2):
            middle = np.median(places[:, axis])
            for side in (self.view.points_px[:, axis] <= middle, self.view.points_px[:, axis] >= middle):
                if np.sum(side & matched) >= _LEAST_RIMS:
                    halves.append(np.where(side, grown.match, -1))
        levels = np.array(self.options.noise_levels_px)
        noise = float(levels[np.argmin(np.abs(np.log(levels / grown.sigma[0])))])
        begun = [(grown.match, float(level)) for level in levels] + [(half, noise) for half in halves]
        for match, level in begun:
            other = self._from(grown.gTc.copy(), match.copy(), level)
            if other is not None and other.log_ratio > grown.log_ratio:
                grown = other
        return grown

    def _from(self, gTc: FloatArray, match: IntArray, noise: float) -> _Expanded | None:
        index = self.index
        N, sigma = np.empty((6, 6)), np.empty(3)
        pairs = expand_inliers(
            self.view, index.catalog.index, index.craters, noise, self.chance, self.prior,
            self.weight, gTc, match, N, sigma,
        )  # fmt: skip
        if pairs < _LEAST_RIMS:
            return None
        ratio, _ = log_evidence(
            self.view, index.catalog.index, index.craters, gTc, match, N, self.chance,
            self.shape_chance, self._log_prior(gTc),
        )  # fmt: skip
        return _Expanded(gTc, match, N, sigma, ratio) if np.isfinite(ratio) else None

    def _log_prior(self, gTc: FloatArray) -> float:
        """Logarithm of the density of a pose before the image was seen, per rad^3 m^3."""
        least, most = self.options.altitudes_m
        range_m = float(np.linalg.norm(gTc[:3, 3]))
        altitude = range_m - self.index.catalog.body.radius_m
        if not least < altitude < most:
            return -np.inf
        place = -np.log(4.0 * np.pi * range_m**2) - np.log(altitude * np.log(most / least))
        if not len(self.attitude):
            return float(place - np.log(8.0 * np.pi**2))
        turn = frames.rotation_log(self.attitude.T @ gTc[:3, :3])
        spread = self.sigma_rad
        return float(place - 1.5 * np.log(2.0 * np.pi * spread**2) - 0.5 * turn @ turn / spread**2)


def identify(
    ellipses_px: FloatArray, camera: Camera, index: TripleIndex, attitude: KnownAttitude | None = None,
    options: IdentifyOptions = IdentifyOptions(),
) -> Identification:  # fmt: skip
    """Find the craters of an image's rims, and the pose.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre, semi-axes, angle of the first from x towards y, rad; as the image shows them, through the
        lens.
    camera : Camera
    index : TripleIndex
    attitude : KnownAttitude, optional
    options : IdentifyOptions

    Returns
    -------
    Identification
        Three rims are the least; alone they are no answer without the attitude. Of a rim that is given
        twice the second has no crater.

    Raises
    ------
    EstimationError
        For ellipses that are none.
    """
    began = time.perf_counter()
    ellipses = np.asarray(ellipses_px, dtype=np.float64).reshape(-1, 5)
    if not (np.isfinite(ellipses).all() and (ellipses[:, 2:4] > 0.0).all()):
        raise EstimationError("ellipses: expected finite numbers and positive axes")
    n = len(ellipses)
    once = _once(ellipses)
    view = view_of(ellipses[once], camera)
    if len(once) < _LEAST_RIMS:
        reason = f"found {len(once)} rims, expected {_LEAST_RIMS} or more"
        return _nothing(n, Status.TOO_FEW_RIMS, reason, 0.0, began)
    searched = _Search(
        view, index, None if attitude is None else attitude.gRb @ camera.bTc[:3, :3], attitude, options
    )
    found = _by_triples(searched)
    threshold = -options.log_chance
    if attitude is not None:
        found = found if found and found[0].log_ratio >= threshold else _by_anchors(searched, found)
        threshold = -options.log_chance_attitude
    if not found or found[0].log_ratio < threshold:
        best = found[0].log_ratio if found else 0.0
        reason = "no pose puts more rims on craters of their size than chance does"
        return _nothing(n, Status.NO_ANSWER, reason, -best, began)
    if len(found) > 1 and found[1].log_ratio - found[0].log_ratio > options.log_ambiguity:
        reason = f"a second pose is {np.exp(found[1].log_ratio - found[0].log_ratio):.2g} as probable"
        return _nothing(n, Status.AMBIGUOUS, reason, -found[0].log_ratio, began)
    return _answer(searched.best_near(found[0]), searched, once, n, camera, began)


def _once(ellipses: FloatArray) -> IntArray:
    """Rows of the ellipses (n, 5) that repeat none before them."""
    kept: list[int] = []
    for i, row in enumerate(ellipses):
        others = ellipses[kept]
        near = np.abs(others[:, :4] - row[:4]).max(axis=1, initial=0.0) if kept else np.empty(0)
        if not (near < _SAME_PX).any():
            kept.append(i)
    return np.array(kept, dtype=np.int64)


def _by_triples(search_: _Search) -> list[_Expanded]:
    """Grow the hypotheses from triples until one has the evidence; the best first."""
    view, index, options = search_.view, search_.index, search_.options
    triples_of = index.triples
    radius = index.catalog.body.radius_m
    largest = np.argsort(-view.radius_px)[:40]
    models, misfits = nadirs(view, largest, np.array([0.08, 0.25]), 1 if search_.n >= _MANY else 2)
    models = models[np.argsort(misfits)]
    tried = [(model, options.triples) for model in models]
    tried += [(model, options.triples // _ASIDE) for model in _around(models[0])]
    levels = list(zip(options.noise_levels_px, options.candidates, strict=True))
    if search_.n >= _MANY:
        stages = [(*model, *level) for model in tried for level in levels]
    else:
        stages = [(*model, *level) for level in levels for model in tried]
    least, most = options.altitudes_m
    enough = -options.log_chance
    found: list[_Expanded] = []
    for model, count, noise, candidates in stages:
        down, height = np.ascontiguousarray(model[:3]), float(model[3] * radius)
        X, log_sizes, scale = project_all_to_sphere(view, down, height, radius)
        triples = image_triples(X, log_sizes, scale, view, 6, noise)[:count]
        best = np.full((24, HYPOTHESIS), -np.inf)
        for start in range(0, len(triples), _CHUNK):
            search(
                view, index.catalog.index, index.craters, triples_of.neighbours, triples_of.points,
                triples_of.codes, triples_of.dims, triples_of.splits, triples_of.levels, X, log_sizes,
                scale, triples[start : start + _CHUNK], search_.order, down, height, radius, noise, 0.02,
                0.05, candidates, search_.attitude, search_.least_cos, least, most, best,
            )  # fmt: skip
            for row in np.argsort(-best[:, SCORE])[:_BEST]:
                if best[row, SCORE] < _PROMISING:
                    break
                grown = search_.expand(best[row], noise)
                # It makes room for others.
                best[row, SCORE] = -np.inf
                if grown is None:
                    continue
                if grown.log_ratio >= enough:
                    return [grown]
                found.append(grown)
    return sorted(found, key=lambda g: -g.log_ratio)


def _around(model: FloatArray) -> FloatArray:
    """Models (6, 4) whose nadir lies around another's."""
    down = model[:3]
    aside = np.cross(down, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside)
    turn = np.pi / 3.0 * np.arange(6)[:, None]
    out = np.cos(_RING) * down + np.sin(_RING) * (np.cos(turn) * aside + np.sin(turn) * np.cross(down, aside))
    return np.column_stack([out, np.full(6, model[3])])


def _by_anchors(search_: _Search, found: list[_Expanded]) -> list[_Expanded]:
    """Grow the hypotheses from single rims; distinct ones and those found before, the best first."""
    view, index, options = search_.view, search_.index, search_.options
    anchors = np.argsort(-view.radius_px)[:_ANCHORS].astype(np.int32)
    least, most = options.altitudes_m
    left = options.tried
    for noise in options.noise_levels_px:
        best = np.full((64, HYPOTHESIS), -np.inf)
        for start in range(len(anchors)):
            left -= len(index.catalog)
            anchor_search(
                view, index.catalog.index, index.craters, anchors[start : start + 1],
                search_.order, search_.attitude, search_.sigma_rad, noise, least, most, best,
            )  # fmt: skip
            # Only where nothing else can be as good the other rims are not asked; many rims tell the best.
            last = start + 1 >= len(anchors) or left < len(index.catalog)
            for row in np.argsort(-best[:, SCORE])[: len(best) if last and search_.n < _MANY else _BEST]:
                if best[row, SCORE] == -np.inf:
                    break
                grown = search_.expand(best[row], noise)
                best[row, SCORE] = -np.inf
                if grown is None:
                    continue
                if grown.log_ratio >= -options.log_chance:
                    return [grown]
                found.append(grown)
            if last:
                break
        found = _distinct(found)
        enough = bool(found) and found[0].log_ratio >= -options.log_chance_attitude
        if enough or left < len(index.catalog):
            break
    return found


def _distinct(found: Sequence[_Expanded]) -> list[_Expanded]:
    out: list[_Expanded] = []
    for grown in sorted(found, key=lambda g: -g.log_ratio):
        same = (np.sum((grown.match == other.match) & (grown.match >= 0)) >= 2 for other in out)
        if not any(same):
            out.append(grown)
    return out


def _answer(
    grown: _Expanded, searched: _Search, once: IntArray, n: int, camera: Camera, began: float
) -> Identification:
    index = searched.index
    covariance = settle(
        searched.view, index.craters, searched.prior, searched.weight, grown.gTc,
        grown.match, grown.sigma,
    )  # fmt: skip
    # From the camera's twist to the body's.
    cTb = frames.inverse(camera.bTc)
    R, t = camera.bTc[:3, :3], camera.bTc[:3, 3]
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    adjoint = np.block([[R, np.zeros((3, 3))], [cross @ R, R]])
    names = index.catalog.identifiers
    rows = np.full(n, -1)
    rows[once] = grown.match
    return Identification(
        Status.IDENTIFIED, "", tuple(names[row] if row >= 0 else None for row in rows), rows,
        grown.gTc, grown.gTc @ cTb, adjoint @ covariance @ adjoint.T, -grown.log_ratio,
        float(grown.sigma[0]), time.perf_counter() - began,
    )  # fmt: skip


def _nothing(n: int, status: Status, reason: str, log_chance: float, began: float) -> Identification:
    empty = np.full((4, 4), np.nan)
    return Identification(
        status, reason, (None,) * n, np.full(n, -1), empty, empty, np.full((6, 6), np.nan), log_chance,
        np.nan, time.perf_counter() - began,
    )  # fmt: skip
