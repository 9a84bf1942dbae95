"""Which crater is each rim, with a predicted pose: all rims at once, as its error is common to them.

The covariance of a prediction makes gates that hold many craters each, but with the right pose they all
shrink together. So pairs of rims are taken for pairs of craters that the prediction allows; the pose that
each gives is asked how many of the other rims it explains, and the best grows by them. Rims and craters are
then assigned globally under the gate of that pose. What two could claim is dropped: a rim less costs little,
a wrong one much.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.special import comb
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import mean_radius, relative_covariance
from craternav_fg.linalg import bisecting_triads, scaled_inverse, squared_distance
from craternav_fg.matching.gate_geometry import raised_above_ground
from factors.kernels import conic, rim_poses

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

_COMPONENTS = 5
# An ellipse's centre is not quite the image of the crater's, nor its area that of a small one's, rad, log.
_CENTRE_RAD, _LOG_SIZE = 0.01, 0.15
# The scatter of fewer rims about one pose says little about their covariances.
_MIN_SCATTER = 6
_REFINEMENTS = 4
# Lines of sight and ranges depend on each other: from a poor prediction, so often until they agree.
_STARTS = 3
# So many hypotheses are tried at a time.
_CHUNK = 1000
# Share of craters of about a rim's size whose size and shape agree with it.
_SHAPE_CHANCE = 0.15
# Share of the pairs of rims that agree with two craters although they are others', of those first allowed.
_PAIR_CHANCE = 1e-3


@dataclass(frozen=True)
class GateOptions:
    """What is matched, and when it is believed.

    Attributes
    ----------
    probability : float
        A true rim passes each gate, and a set of true rims the joint one, with this probability.
    ambiguity : float
        A second claimant to a rim or a crater counts when its squared distance is larger by less than this;
        neither is then matched. So does a second pose that explains as many rims.
    chance : float
        Expected number of wrong poses, of those tried, that as many rims would bear out by chance.
    floor_share : float
        Standard deviation of a rim's centre and axes, over their size, beside its covariance: outlines and
        light make errors that no scatter of edge points shows. A rim is that crater's all the same.
    seeds : int
        The largest rims, of which pairs make hypotheses.
    hypotheses : int
        Pairs of rims taken for craters that are tried at most, those nearest to the prediction first.
    grown : int
        Poses, those that explain most rims first, that are grown of each thousand.
    """

    probability: float = 0.9999
    ambiguity: float = 9.0
    chance: float = 1e-3
    floor_share: float = 0.005
    seeds: int = 8
    hypotheses: int = 40_000
    grown: int = 6


@dataclass(frozen=True)
class Matches:
    """Rims with their craters.

    Attributes
    ----------
    craters : ndarray of int, shape (n,)
        Row of each rim's crater in the catalogue, -1 for none.
    ambiguous : ndarray of bool, shape (n,)
        Rims without a crater because several could be it, or it several rims.
    gTb : ndarray, shape (4, 4)
        The prediction, corrected by the matched rims.
    pose_covariance : ndarray, shape (6, 6)
        Of attitude (rotation vector in b, rad) and position in g, m; prior and rims are both in it.
    distance2 : float
        Joint squared Mahalanobis norm of the matched rims' residuals and of the correction.
    """

    craters: IntArray
    ambiguous: BoolArray
    gTb: FloatArray
    pose_covariance: FloatArray
    distance2: float


@dataclass(frozen=True)
class _Grown:
    """A pose with the rims that it explains: pairs (k,), right-twist covariance, cost, distances (n, m)."""

    gTb: FloatArray
    covariance: FloatArray
    distances2: FloatArray
    rims: IntArray
    craters: IntArray
    score: float


def match_rims(
    charts: FloatArray,
    covariances: FloatArray,
    camera: Camera,
    catalog: Catalog,
    gTb: FloatArray,
    pose_covariance: FloatArray,
    options: GateOptions = GateOptions(),
) -> Matches:
    """Match the rims of an image to craters near where a predicted pose puts them.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        Ellipse charts in normalised coordinates.
    covariances : ndarray, shape (n, 5, 5)
    camera : Camera
    catalog : Catalog
    gTb : ndarray, shape (4, 4)
        Predicted pose of the lander.
    pose_covariance : ndarray, shape (6, 6)
        Of the prediction, positive definite: attitude error (rotation vector in b, rad), position error in
        g, m. The position must be known to about half the altitude, or better.
    options : GateOptions

    Returns
    -------
    Matches
        Without any crater when nothing agrees, or two poses do equally well.
    """
    nothing = Matches(
        np.full(len(charts), -1), np.zeros(len(charts), dtype=np.bool_), gTb, pose_covariance, 0.0
    )
    if not len(charts):
        return nothing
    search = _Search(charts, covariances, camera, catalog, gTb, pose_covariance, options)
    found = search.run()
    if not found:
        return nothing
    best = found[0]
    if search.by_chance(best) > options.chance:
        return nothing
    rivals = [one for one in found[1:] if best.score - one.score < options.ambiguity]
    if any(not _agree(best, one) for one in rivals):
        ambiguous = nothing.ambiguous.copy()
        ambiguous[best.rims] = True
        return Matches(nothing.craters, ambiguous, gTb, pose_covariance, 0.0)
    return search.judged(best)


class _Search:
    """One image's rims against the craters that a prediction allows."""

    def __init__(
        self, charts: FloatArray, covariances: FloatArray, camera: Camera, catalog: Catalog, gTb: FloatArray,
        pose_covariance: FloatArray, options: GateOptions,
    ) -> None:  # fmt: skip
        self.options = options
        self.tried = self.allowed = np.empty((0, 4), dtype=np.int64)
        self.possible = len(charts)
        self.prior = np.ascontiguousarray(gTb, dtype=np.float64)
        self.covariance = pose_covariance
        self.information = scaled_inverse(pose_covariance)
        self.bTc = camera.bTc
        self.charts = np.ascontiguousarray(charts, dtype=np.float64)
        self.noise = covariances + relative_covariance(self.charts, options.floor_share)
        self.weights = np.ascontiguousarray(scaled_inverse(self.noise))
        self.gate = float(chi2.ppf(options.probability, _COMPONENTS))
        self.sigmas = float(np.sqrt(chi2.ppf(options.probability, 2)))
        corner = np.array([[-0.5, -0.5], [camera.width_px - 0.5, camera.height_px - 0.5]])
        self.reach = 1.05 * np.abs(camera.normalised(corner)).max(axis=0)
        self.gTc = raised_above_ground(camera.gTc(self.prior), pose_covariance, catalog.body)
        self.rows, self.turn_rad, self.position_m = self._allowed(catalog)
        part = catalog.take(self.rows)
        self.centres, self.axes = np.ascontiguousarray(part.centres), part.axes
        line = self.centres - self.gTc[:3, 3]
        self.range_m = np.linalg.norm(line, axis=1)
        self.line = line / self.range_m[:, None]
        # An ellipse's area shows the range, foreshortened by the slant.
        self.normals, self.product_m2 = part.normals, part.semi_major_m * part.semi_minor_m
        slant = np.abs(np.sum(self.line * self.normals, axis=1))
        self.log_area = np.log(slant * self.product_m2) - 2.0 * np.log(self.range_m)
        ray = np.column_stack([self.charts[:, :2], np.ones(len(charts))])
        self.ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        self.log_solid = self.charts[:, 2] + self.charts[:, 4] + 3.0 * np.log(self.ray[:, 2])

    def _allowed(self, catalog: Catalog) -> tuple[IntArray, float, float]:
        """Rows that the image may show; how far the view may be turned, the position be off."""
        gPc, axis = self.gTc[:3, 3], self.gTc[:3, 2]
        turn_rad = self.sigmas * float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))
        position_m = self.sigmas * float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))
        altitude_m = max(float(catalog.body.altitude_m(gPc)), 1.0)
        field = float(np.arctan(np.linalg.norm(self.reach))) + turn_rad + position_m / altitude_m
        # The smallest rim's crater, from the farthest that its size allows.
        smallest = float(mean_radius(self.charts).min())
        reach = 3.0 * (1.0 + min(position_m / altitude_m, 1.0)) / smallest
        rows = catalog.index.in_view(gPc, axis, float(np.cos(min(field, np.pi))), reach)
        return np.sort(rows), turn_rad, position_m

    def run(self) -> list[_Grown]:
        """Poses that explain rims, the best first."""
        pairs, starts = self._hypotheses()
        self.allowed = pairs
        limit = chi2.ppf(self.options.probability, 2 * _COMPONENTS)
        found: list[_Grown] = []
        for begin in range(0, len(pairs), _CHUNK):
            some = pairs[begin : begin + _CHUNK]
            gTb, information, cost = self._solve(starts[begin : begin + _CHUNK], some[:, 1::2], some[:, ::2])
            # From far off the first steps only lead near.
            on = np.flatnonzero(np.isfinite(cost) & (cost >= limit))
            gTb[on], information[on], cost[on] = self._solve(gTb[on], some[on, 1::2], some[on, ::2])
            keep = np.flatnonzero(cost < limit)
            if not len(keep):
                continue
            self.tried = np.concatenate([self.tried, some[keep]])
            gTb, covariance = gTb[keep], np.ascontiguousarray(scaled_inverse(information[keep]))
            explained = rim_poses.support(
                gTb, covariance, self.bTc, self.centres, self.axes, self.charts, self.noise, self.reach
            )
            for k in np.lexsort((cost[keep], -explained))[: self.options.grown]:
                grown = self._grow(gTb[k], covariance[k])
                if grown is not None:
                    found.append(grown)
            found.sort(key=lambda one: -one.score)
            if found and self.by_chance(found[0]) <= self.options.chance:
                break
        return found

    def _hypotheses(self) -> tuple[IntArray, FloatArray]:
        """Pairs (h, 4) of rim and crater, twice, that the prediction allows, and poses (h, 4, 4) to begin at.

        A lone rim is paired with itself.
        """
        size_off = np.abs(self.log_solid[:, None] - self.log_area)
        size_limit = 2.0 * (_LOG_SIZE + self.position_m / np.maximum(self.range_m, 1.0))
        toward = self.ray @ self.gTc[:3, :3].T
        chord = np.linalg.norm(toward[:, None] - self.line, axis=2)
        aside = self.turn_rad + self.position_m / self.range_m + _CENTRE_RAD
        allowed = (size_off < size_limit) & (2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) < aside)
        self.possible = int(np.count_nonzero(allowed.any(axis=1)))
        seeds = np.argsort(-(self.charts[:, 2] + self.charts[:, 4]), kind="stable")
        seeds = seeds[allowed[seeds].any(axis=1)][: self.options.seeds]
        pairs, starts, costs = [], [], []
        for a, i in enumerate(seeds):
            for j in seeds[a + 1 :] if len(seeds) > 1 else seeds:
                first, second = np.flatnonzero(allowed[i]), np.flatnonzero(allowed[j])
                rows, gRc, cost = self._pair_poses(int(i), int(j), first, second)
                pairs.append(rows)
                starts.append(gRc)
                costs.append(cost)
        if not pairs:
            return np.empty((0, 4), dtype=np.int64), np.empty((0, 4, 4))
        pair, gRc, cost = np.concatenate(pairs), np.concatenate(starts), np.concatenate(costs)
        order = np.argsort(cost, kind="stable")[: self.options.hypotheses]
        return pair[order], self._starts(pair[order], gRc[order])

    def _starts(self, pairs: IntArray, gRc: FloatArray) -> FloatArray:
        """Poses (h, 4, 4) of b at which the pairs' sizes show their ranges, from attitudes (h, 3, 3) of c."""
        rims, craters = pairs[:, ::2], pairs[:, 1::2]
        centres, toward = self.centres[craters], self.ray[rims]
        gPc = np.tile(self.gTc[:3, 3], (len(pairs), 1))
        for _ in range(_STARTS):
            line = centres - gPc[:, None]
            line /= np.linalg.norm(line, axis=2, keepdims=True)
            if len(pairs) and pairs[0, 0] != pairs[0, 2]:
                gRc = bisecting_triads(line[:, 0], line[:, 1]) @ np.swapaxes(
                    bisecting_triads(toward[:, 0], toward[:, 1]), 1, 2
                )
            slant = np.abs(np.sum(line * self.normals[craters], axis=2))
            range_m = np.sqrt(slant * self.product_m2[craters] / np.exp(self.log_solid[rims]))
            gPc = np.mean(centres - range_m[:, :, None] * np.einsum("hij,hkj->hki", gRc, toward), axis=1)
        start = np.tile(np.eye(4), (len(pairs), 1, 1))
        start[:, :3, :3] = gRc @ self.bTc[:3, :3].T
        start[:, :3, 3] = gPc - start[:, :3, :3] @ self.bTc[:3, 3]
        return start

    def _pair_poses(
        self, i: int, j: int, first: IntArray, second: IntArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Pairs (h, 4), camera attitudes (h, 3, 3) and how far off these are, of two rims and craters."""
        position2 = (self.position_m / self.sigmas) ** 2
        if i == j:
            m, k = first, first
            gRc = np.tile(self.gTc[:3, :3], (len(m), 1, 1))
        else:
            m, k = (grid.ravel() for grid in np.meshgrid(first, second, indexing="ij"))
            between = np.linalg.norm(self.line[m] - self.line[k], axis=1)
            seen = float(np.linalg.norm(self.ray[i] - self.ray[j]))
            # A wrong position moves two directions apart by the difference of their parallaxes.
            parallax = np.linalg.norm(
                self.line[m] / self.range_m[m, None] - self.line[k] / self.range_m[k, None], axis=1
            )
            limit = self.position_m * (parallax + between / np.minimum(self.range_m[m], self.range_m[k]))
            # So does it their sizes, by as much of their ratio.
            off = self.log_solid[i] - self.log_solid[j] - (self.log_area[m] - self.log_area[k])
            size_limit = 2.0 * (_LOG_SIZE + self.position_m * parallax)
            keep = (
                (m != k) & (np.abs(between - seen) < limit + 2.0 * _CENTRE_RAD) & (np.abs(off) < size_limit)
            )
            m, k = m[keep], k[keep]
            gRc = (
                bisecting_triads(self.line[m], self.line[k])
                @ bisecting_triads(self.ray[i][None], self.ray[j][None])[0].T
            )
        gRb = gRc @ self.bTc[:3, :3].T
        turn = frames.rotation_log(self.prior[:3, :3].T @ gRb).reshape(-1, 3)
        slack = position2 / np.minimum(self.range_m[m], self.range_m[k]) ** 2 + _CENTRE_RAD**2
        if i != j:
            # Two rims close together tell the roll badly.
            slack = slack / max(float(np.linalg.norm(self.ray[i] - self.ray[j])), 0.05) ** 2
        spread = self.covariance[:3, :3] + slack[:, None, None] * np.eye(3)
        cost = squared_distance(turn, spread)
        near = cost < chi2.ppf(self.options.probability, 3)
        pairs = np.column_stack([np.full(len(m), i), m, np.full(len(m), j), k])
        return pairs[near], gRc[near], cost[near]

    def _solve(
        self, starts: FloatArray, craters: IntArray, rims: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Maximum a posteriori poses, information for the right twist, and costs."""
        if rims.shape[1] == 2 and len(rims) and rims[0, 0] == rims[0, 1]:
            rims, craters = rims[:, :1], craters[:, :1]
        gTb, information, cost = rim_poses.map_poses(
            self.prior, self.information, np.ascontiguousarray(starts), self.bTc, self.centres, self.axes,
            np.zeros_like(self.centres), self.charts, self.weights, np.zeros(len(self.charts)), 0.0,
            np.ascontiguousarray(craters), np.ascontiguousarray(rims),
        )  # fmt: skip
        return gTb, information, cost

    def _distances2(self, gTb: FloatArray, covariance: FloatArray) -> FloatArray:
        return np.asarray(
            rim_poses.distances2(
                gTb, covariance, self.bTc, self.centres, self.axes, self.charts, self.noise,
                self.gate + self.options.ambiguity, self.reach,
            )
        )  # fmt: skip

    def _grow(self, gTb: FloatArray, covariance: FloatArray) -> _Grown | None:
        """Refine a pose by the rims that agree with it, until they stay the same."""
        rims, craters = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        for _ in range(_REFINEMENTS):
            distances2 = self._distances2(gTb, covariance)
            found, chosen = _assigned(distances2, self.gate)
            if not len(found):
                return None
            if np.array_equal(found, rims) and np.array_equal(chosen, craters):
                break
            rims, craters = found, chosen
            poses, information, cost = self._solve(gTb[None], craters[None], rims[None])
            if not np.isfinite(cost[0]):
                return None
            gTb, covariance = poses[0], np.ascontiguousarray(scaled_inverse(information[0]))
        score = float(np.sum(self.gate - distances2[rims, craters]))
        return _Grown(gTb, covariance, distances2, rims, craters, score)

    def by_chance(self, best: _Grown) -> float:
        """Give the expected number of other poses tried that chance would bear out as well as one."""
        crater_of = np.full(len(self.charts), -1)
        crater_of[best.rims] = best.craters

        def others(pairs: IntArray) -> int:
            return int(np.count_nonzero(~(crater_of[pairs[:, ::2]] == pairs[:, 1::2]).all(axis=1)))

        # What was left by chance tells too little when it is nothing.
        rivals = max(others(self.tried), _PAIR_CHANCE * others(self.allowed))
        charts, H, seen = conic.chart_jacobian(best.gTb, self.bTc, self.centres, self.axes)
        seen[seen] = (np.abs(charts[seen, :2]) < self.reach).all(axis=1)
        H = H[seen, :2]
        spread = H @ best.covariance @ np.swapaxes(H, 1, 2) + np.median(self.noise[:, :2, :2], axis=0)
        areas = np.pi * self.gate * np.sqrt(np.linalg.det(spread))
        share = min(1.0, _SHAPE_CHANCE * float(np.sum(areas)) / (4.0 * float(np.prod(self.reach))))
        confirming = len(best.rims) - 2
        if confirming < 1:
            return float(rivals)
        # Rims of sizes that no crater has here, from nowhere that is predicted, confirm no pose.
        return float(rivals * comb(max(self.possible - 2, confirming), confirming) * share**confirming)

    def judged(self, best: _Grown) -> Matches:
        """Drop what two could claim, then what the others contradict."""
        n = len(self.charts)
        craters, ambiguous = np.full(n, -1), np.zeros(n, dtype=np.bool_)
        rims, chosen = [], []
        for i, m in zip(best.rims.tolist(), best.craters.tolist(), strict=True):
            own = best.distances2[i, m]
            others = np.concatenate([np.delete(best.distances2[i], m), np.delete(best.distances2[:, m], i)])
            second = float(others.min(initial=np.inf))
            if second < min(self.gate, own + self.options.ambiguity):
                ambiguous[i] = True
            else:
                rims.append(i)
                chosen.append(m)
        gTb, covariance, cost = best.gTb, best.covariance, 0.0
        while rims:
            poses, information, costs = self._solve(gTb[None], np.array([chosen]), np.array([rims]))
            gTb, covariance, cost = (
                poses[0],
                np.ascontiguousarray(scaled_inverse(information[0])),
                float(costs[0]),
            )
            limit = float(chi2.ppf(self.options.probability, _COMPONENTS * len(rims)))
            at_pose = self._distances2(gTb, covariance)[rims, chosen]
            factor = 1.0
            if len(rims) >= _MIN_SCATTER:
                factor = max(1.0, float(np.median(at_pose)) / float(chi2.median(_COMPONENTS)))
            if cost < limit * factor and at_pose.max() < self.gate * factor:
                break
            worst = int(np.argmax(at_pose))
            del rims[worst], chosen[worst]
        if not rims:
            return Matches(craters, ambiguous, self.prior, self.covariance, 0.0)
        craters[rims] = self.rows[chosen]
        turn = np.eye(6)
        turn[3:, 3:] = gTb[:3, :3]
        return Matches(craters, ambiguous, gTb, turn @ covariance @ turn.T, cost)


def _assigned(distances2: FloatArray, gate: float) -> tuple[IntArray, IntArray]:
    """Rims and craters that a global assignment pairs under a gate, each the other's nearest."""
    cost = np.minimum(distances2, gate)
    rims, craters = linear_sum_assignment(cost)
    own = distances2[rims, craters]
    keep = (own < gate) & (own <= distances2[rims].min(axis=1)) & (own <= distances2[:, craters].min(axis=0))
    return rims[keep], craters[keep]


def _agree(one: _Grown, other: _Grown) -> bool:
    """Whether two poses give no rim different craters."""
    mine = dict(zip(one.rims.tolist(), one.craters.tolist(), strict=True))
    return all(
        mine.get(rim, crater) == crater
        for rim, crater in zip(other.rims.tolist(), other.craters.tolist(), strict=True)
    )
