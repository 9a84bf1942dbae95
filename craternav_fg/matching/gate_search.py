"""Search for poses near a prediction that explain many rims at once; see `gate`.

1. Pairs of the largest rims are taken for pairs of craters that the prediction allows; each pair gives an
   initial pose.
2. The maximum a posteriori pose of each pair is computed, and the other rims that it explains are counted.
3. The best poses are expanded: rims and craters are assigned globally under the gate of the pose, the pose is
   re-estimated from them, and so on until the assignment no longer changes.
4. How many wrong poses would explain as many rims by chance is estimated; the search ends when that is small.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri, comb

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import mean_radius, relative_covariance
from craternav_fg.linalg import bisecting_triads, scaled_inverse
from craternav_fg.matching import pair_kernel
from craternav_fg.matching.expanded_pose import ExpandedPose, Tried
from craternav_fg.matching.pair_kernel import AREA_PER_RANGE, CENTRE_ERROR_RAD, LOG_AREA_ERROR, Directions
from factors.arrays import FloatArray, IntArray
from factors.kernels import conic, rim_poses

# Elements of an ellipse chart.
COMPONENTS = 5
# Craters farther than this times the range at which they would be as large as the smallest rim are ignored.
_REACH_FACTOR = 3.0
# Margin on the image's bounds in normalised coordinates.
_BORDER_FACTOR = 1.05
# Rounds in which an expanded pose is re-estimated.
_MAX_EXPANSIONS = 4
# Rounds of line of sight and range: each depends on the other when the prediction is poor.
_START_ROUNDS = 3
# Hypotheses that are computed together.
_CHUNK = 1000
# Bounds on the search with a prediction that says next to nothing: craters, those nearest to where it puts
# the rim, that a rim of a pair is taken for; comparisons of rims and craters over all poses (some seconds).
_MOST_CRATERS = 500
_MOST_COMPARISONS = 1e9
# Share of craters of about a rim's size whose size and shape agree with the rim by chance.
_SHAPE_CHANCE = 0.15
# Share of the allowed pairs of rims and craters that agree with each other by chance. Used where the number
# of such pairs that were found is too small to tell.
_PAIR_CHANCE = 1e-3


@dataclass(frozen=True)
class GateOptions:
    """Extent of the search, and when matches are accepted.

    Attributes
    ----------
    probability : float
        Probability that a true match passes each gate, and that a set of true matches passes the joint one.
    ambiguity : float
        Squared Mahalanobis distance by which a second candidate for a rim or a crater must be worse than the
        first; otherwise the rim is not matched. The same for a second pose with other matches.
    chance : float
        Largest expected number of wrong poses, among those tried, that explain as many rims by chance.
    floor_share : float
        Standard deviation of a rim's centre and axes in addition to its covariance, over the rim's size. It
        allows for irregular outlines and illumination, which the scatter of edge points does not show.
    seeds : int
        Number of rims, the largest first, of which pairs give hypotheses.
    hypotheses : int
        Largest number of hypotheses, those nearest to the prediction first.
    expanded : int
        Number of poses, those that explain most rims first, that are expanded per thousand hypotheses.
    """

    probability: float = 0.9999
    ambiguity: float = 9.0
    chance: float = 1e-3
    floor_share: float = 0.005
    seeds: int = 8
    hypotheses: int = 40_000
    expanded: int = 6


class GateSearch:
    """Search of one image.

    Attributes
    ----------
    options : GateOptions
    prior : ndarray, shape (4, 4)
        Predicted pose gTb.
    covariance : ndarray, shape (6, 6)
        Covariance of the prediction: attitude (rotation vector in b, rad), position in g, m.
    charts : ndarray, shape (n, 5)
        Charts of the rims, normalised image coordinates.
    rows : ndarray of int, shape (m,)
        Rows of the catalogue of the craters that the image may show.
    gate : float
        Largest squared distance of a match.
    """

    def __init__(
        self, charts: FloatArray, covariances: FloatArray, camera: Camera, catalog: Catalog, gTb: FloatArray,
        pose_covariance: FloatArray, options: GateOptions,
    ) -> None:  # fmt: skip
        self.options = options
        self.prior = np.ascontiguousarray(gTb, dtype=np.float64)
        self.covariance = pose_covariance
        self.charts = np.ascontiguousarray(charts, dtype=np.float64)
        self.gate = float(chdtri(COMPONENTS, 1.0 - options.probability))
        self._information = scaled_inverse(pose_covariance)
        self._bTc = camera.bTc
        self._noise = covariances + relative_covariance(self.charts, options.floor_share)
        self._weights = np.ascontiguousarray(scaled_inverse(self._noise))
        self._sigmas = float(np.sqrt(chdtri(2, 1.0 - options.probability)))
        corner = np.array([[-0.5, -0.5], [camera.width_px - 0.5, camera.height_px - 0.5]])
        self._bounds = _BORDER_FACTOR * np.abs(camera.normalised(corner)).max(axis=0)
        self._gTc = _raised_above_ground(camera.gTc(self.prior), pose_covariance, catalog.body)
        self.rows, self._turn_rad, self._position_m = self._craters_in_reach(catalog)
        part = catalog.take(self.rows)
        self._centres, self._axes = np.ascontiguousarray(part.centres), part.axes
        sight = self._centres - self._gTc[:3, 3]
        self._range_m = np.linalg.norm(sight, axis=1)
        self._sight = sight / self._range_m[:, None]
        # Solid angles, over pi, of the craters and of the rims: foreshortened area over squared range.
        self._normals, self._area_m2 = part.normals, part.semi_major_m * part.semi_minor_m
        slant = np.abs(np.sum(self._sight * self._normals, axis=1))
        self._log_solid_of_craters = np.log(slant * self._area_m2) - 2.0 * np.log(self._range_m)
        ray = np.column_stack([self.charts[:, :2], np.ones(len(charts))])
        self._ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        self._log_solid = self.charts[:, 2] + self.charts[:, 4] + 3.0 * np.log(self._ray[:, 2])
        self._directions = Directions(
            self._ray, self._log_solid, self._sight @ self._gTc[:3, :3], self._range_m,
            self._log_solid_of_craters,
        )  # fmt: skip
        self._attitude_variances, axes = np.linalg.eigh(pose_covariance[:3, :3])
        self._axes_of_attitude = self._bTc[:3, :3].T @ axes

    def _craters_in_reach(self, catalog: Catalog) -> tuple[IntArray, float, float]:
        """Rows that the image may show; largest errors of attitude, rad, and position, m."""
        gPc, axis = self._gTc[:3, 3], self._gTc[:3, 2]
        turn_rad = self._sigmas * float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))
        position_m = self._sigmas * float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))
        altitude_m = max(float(catalog.body.altitude_m(gPc)), 1.0)
        field = float(np.arctan(np.linalg.norm(self._bounds))) + turn_rad + position_m / altitude_m
        smallest = float(mean_radius(self.charts).min())
        reach = _REACH_FACTOR * (1.0 + min(position_m / altitude_m, 1.0)) / smallest
        rows = catalog.index.in_view(gPc, axis, float(np.cos(min(field, np.pi))), reach)
        return np.sort(rows), turn_rad, position_m

    def run(self) -> tuple[list[ExpandedPose], Tried]:
        """Find poses that explain rims.

        Returns
        -------
        found : list of ExpandedPose
            The best first, and after it those that are nearly as good.
        tried : Tried
        """
        pairs, starts, possible_rims = self._hypotheses()
        tried = Tried(pairs, pairs[:0], possible_rims)
        limit = chdtri(2 * COMPONENTS, 1.0 - self.options.probability)
        found: list[ExpandedPose] = []
        for begin in range(0, len(pairs), _CHUNK):
            some = pairs[begin : begin + _CHUNK]
            gTb, information, cost = self._solve(starts[begin : begin + _CHUNK], some[:, 1::2], some[:, ::2])
            # Far from the solution, the first call may not converge.
            on = np.flatnonzero(np.isfinite(cost) & (cost >= limit))
            gTb[on], information[on], cost[on] = self._solve(gTb[on], some[on, 1::2], some[on, ::2])
            keep = np.flatnonzero(cost < limit)
            if not len(keep):
                continue
            tried = tried._replace(solved=np.concatenate([tried.solved, some[keep]]))
            gTb, covariance = gTb[keep], np.ascontiguousarray(scaled_inverse(information[keep]))
            explained = rim_poses.support(
                gTb, covariance, self._bTc, self._centres, self._axes, self.charts, self._noise, self._bounds
            )
            for k in np.lexsort((cost[keep], -explained))[: self.options.expanded]:
                expanded = self._expand(gTb[k], covariance[k], found)
                if expanded is not None:
                    found.append(expanded)
            found.sort(key=lambda one: -one.score)
            found = [one for one in found if found[0].score - one.score < self.options.ambiguity]
            if found and self.by_chance(found[0], tried) <= self.options.chance:
                break
        return found, tried

    def _hypotheses(self) -> tuple[IntArray, FloatArray, int]:
        """Pairs (h, 4) of rim and crater, twice, that the prediction allows, and initial poses gTb (h, 4, 4).

        A single rim is paired with itself. Last comes the number of rims that some crater in reach could be.
        """
        by_size = np.argsort(-(self.charts[:, 2] + self.charts[:, 4]), kind="stable")
        allowed = {int(i): self._allowed_craters(int(i)) for i in by_size}
        possible = [i for i, craters in allowed.items() if len(craters)]
        seeds = possible[: self.options.seeds]
        comparisons = max(len(self.charts) * len(self.rows), 1)
        most = min(self.options.hypotheses, max(int(_MOST_COMPARISONS / comparisons), _CHUNK))
        pair, cost = np.empty((0, 4), dtype=np.int64), np.empty(0)
        for some in _pairs_of_seeds(seeds, allowed):
            more = self._near(some)
            pair, cost = (np.concatenate(both) for both in zip((pair, cost), more, strict=True))
            if len(cost) > most:
                order = np.sort(np.argsort(cost, kind="stable")[:most])
                pair, cost = pair[order], cost[order]
        pair = pair[np.argsort(cost, kind="stable")]
        return pair, self._starts(pair), len(possible)

    def _allowed_craters(self, rim: int) -> IntArray:
        """Rows of the craters, among those of the search, that the prediction allows for a rim."""
        off = np.abs(self._log_solid[rim] - self._log_solid_of_craters)
        off_limit = AREA_PER_RANGE * (LOG_AREA_ERROR + self._position_m / np.maximum(self._range_m, 1.0))
        chord = np.linalg.norm(self._gTc[:3, :3] @ self._ray[rim] - self._sight, axis=1)
        aside = self._turn_rad + self._position_m / self._range_m + CENTRE_ERROR_RAD
        allowed = np.flatnonzero((off < off_limit) & (2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) < aside))
        if len(allowed) > _MOST_CRATERS:
            allowed = np.sort(allowed[np.argsort(chord[allowed], kind="stable")[:_MOST_CRATERS]])
        return allowed

    def _starts(self, pairs: IntArray) -> FloatArray:
        """Compute initial poses gTb (h, 4, 4): sizes give ranges; for a single rim the predicted attitude."""
        gRc = np.tile(self._gTc[:3, :3], (len(pairs), 1, 1))
        rims, craters = pairs[:, ::2], pairs[:, 1::2]
        centres, toward = self._centres[craters], self._ray[rims]
        gPc = np.tile(self._gTc[:3, 3], (len(pairs), 1))
        for _ in range(_START_ROUNDS):
            sight = centres - gPc[:, None]
            sight /= np.linalg.norm(sight, axis=2, keepdims=True)
            if len(pairs) and pairs[0, 0] != pairs[0, 2]:
                gRc = bisecting_triads(sight[:, 0], sight[:, 1]) @ np.swapaxes(
                    bisecting_triads(toward[:, 0], toward[:, 1]), 1, 2
                )
            slant = np.abs(np.sum(sight * self._normals[craters], axis=2))
            range_m = np.sqrt(slant * self._area_m2[craters] / np.exp(self._log_solid[rims]))
            gPc = np.mean(centres - range_m[:, :, None] * np.einsum("hij,hkj->hki", gRc, toward), axis=1)
        start = np.tile(np.eye(4), (len(pairs), 1, 1))
        start[:, :3, :3] = gRc @ self._bTc[:3, :3].T
        start[:, :3, 3] = gPc - start[:, :3, :3] @ self._bTc[:3, 3]
        return start

    def _near(self, pairs: IntArray) -> tuple[IntArray, FloatArray]:
        """Pairs (h, 4) of rim and crater, twice, near the predicted attitude, and their costs (h,).

        The cost is the squared distance from the predicted attitude; pairs whose angles or sizes do not agree
        and those beyond its gate are left out. A single rim is paired with itself, and keeps that attitude.
        """
        if len(pairs) and pairs[0, 0] == pairs[0, 2]:
            return pairs, np.zeros(len(pairs))
        cost = pair_kernel.costs_of_pairs(
            pairs, self._directions, self._axes_of_attitude, self._attitude_variances, self._position_m,
            self._position_m / self._sigmas,
        )  # fmt: skip
        near = cost < chdtri(3, 1.0 - self.options.probability)
        return pairs[near], cost[near]

    def _solve(
        self, starts: FloatArray, craters: IntArray, rims: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Maximum a posteriori poses, information for the right twist, and costs."""
        if rims.shape[1] == 2 and len(rims) and rims[0, 0] == rims[0, 1]:
            rims, craters = rims[:, :1], craters[:, :1]
        # Without shading: contrasts of zero, and a weight of zero.
        gTb, information, cost = rim_poses.map_poses(
            self.prior, self._information, np.ascontiguousarray(starts), self._bTc, self._centres, self._axes,
            np.zeros_like(self._centres), self.charts, self._weights, np.zeros(len(self.charts)), 0.0,
            np.ascontiguousarray(craters), np.ascontiguousarray(rims),
        )  # fmt: skip
        return gTb, information, cost

    def solve_one(
        self, gTb: FloatArray, craters: IntArray, rims: IntArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Compute the maximum a posteriori pose of matched rims.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Initial pose.
        craters, rims : ndarray of int, shape (k,)
            Rows among the craters of the search, and of the rims.

        Returns
        -------
        gTb : ndarray, shape (4, 4)
        covariance : ndarray, shape (6, 6)
            For the right twist [w, rho], rad and m in b.
        cost : float
            Squared Mahalanobis norm of residuals and correction; inf when a rim is not visible.
        """
        poses, information, costs = self._solve(gTb[None], craters[None], rims[None])
        return poses[0], np.ascontiguousarray(scaled_inverse(information[0])), float(costs[0])

    def distances2(self, gTb: FloatArray, covariance: FloatArray) -> FloatArray:
        """Compute squared Mahalanobis distances of all rims from all craters at a pose.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose.
        covariance : ndarray, shape (6, 6)
            For its right twist [w, rho], rad and m in b.

        Returns
        -------
        ndarray, shape (n, m)
            Numbers of five degrees of freedom; inf far beyond the gate.
        """
        return np.asarray(
            rim_poses.distances2(
                gTb, covariance, self._bTc, self._centres, self._axes, self.charts, self._noise,
                self.gate + self.options.ambiguity, self._bounds,
            )
        )  # fmt: skip

    def _expand(
        self, gTb: FloatArray, covariance: FloatArray, known: list[ExpandedPose]
    ) -> ExpandedPose | None:
        """Assign rims to craters and re-estimate the pose, in turn, until the assignment stays.

        None where there is no pose, and where the assignment is that of a known one, which has the same.
        """
        rims, craters = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        for _ in range(_MAX_EXPANSIONS):
            distances2 = self.distances2(gTb, covariance)
            found, chosen = _assigned(distances2, self.gate)
            if not len(found):
                return None
            if np.array_equal(found, rims) and np.array_equal(chosen, craters):
                break
            if any(one.matches(found, chosen) for one in known):
                return None
            rims, craters = found, chosen
            gTb, covariance, cost = self.solve_one(gTb, craters, rims)
            if not np.isfinite(cost):
                return None
        own = distances2[rims, craters]
        others = distances2.copy()
        others[rims, craters] = np.inf
        second = np.minimum(others[rims].min(axis=1), others[:, craters].min(axis=0))
        return ExpandedPose(gTb, covariance, rims, craters, own, second, float(np.sum(self.gate - own)))

    def by_chance(self, best: ExpandedPose, tried: Tried) -> float:
        """Estimate how many of the other poses tried would explain as many rims by chance.

        Parameters
        ----------
        best : ExpandedPose
        tried : Tried

        Returns
        -------
        float
            Expected number.
        """
        crater_of = np.full(len(self.charts), -1)
        crater_of[best.rims] = best.craters

        def others(pairs: IntArray) -> int:
            return int(np.count_nonzero(~(crater_of[pairs[:, ::2]] == pairs[:, 1::2]).all(axis=1)))

        rivals = max(others(tried.solved), _PAIR_CHANCE * others(tried.allowed))
        charts, H, seen = conic.chart_jacobian(best.gTb, self._bTc, self._centres, self._axes)
        seen[seen] = (np.abs(charts[seen, :2]) < self._bounds).all(axis=1)
        H = H[seen, :2]
        spread = H @ best.covariance @ np.swapaxes(H, 1, 2) + np.median(self._noise[:, :2, :2], axis=0)
        areas = np.pi * self.gate * np.sqrt(np.maximum(np.linalg.det(spread), 0.0))
        share = min(1.0, _SHAPE_CHANCE * float(np.sum(areas)) / (4.0 * float(np.prod(self._bounds))))
        # The first two rims made the pose.
        confirming = len(best.rims) - 2
        if confirming < 1:
            return float(rivals)
        # Only rims that some crater in reach could be can confirm a pose.
        ways = comb(max(tried.possible_rims - 2, confirming), confirming)
        return float(rivals * ways * share**confirming)


def _pairs_of_seeds(seeds: list[int], allowed: dict[int, IntArray]) -> Iterator[IntArray]:
    """Pairs (h, 4) of rim and crater, twice, of all pairs of seeds; a single seed is paired with itself.

    Seeds that have few craters come together, as most of the time would be calls; seeds with many craters one
    pair at a time, as most of the memory would be pairs that are left out.
    """
    some, count = list[IntArray](), 0
    if len(seeds) == 1:
        craters = allowed[seeds[0]]
        rim = np.full(len(craters), seeds[0])
        yield np.column_stack([rim, craters, rim, craters])
        return
    for i, j in combinations(seeds, 2):
        pairs = np.empty((len(allowed[i]), len(allowed[j]), 4), dtype=np.int64)
        pairs[..., 0], pairs[..., 1], pairs[..., 2], pairs[..., 3] = i, allowed[i][:, None], j, allowed[j]
        some.append(pairs.reshape(-1, 4))
        count += len(some[-1])
        if count > _CHUNK:
            yield np.concatenate(some)
            some, count = [], 0
    if count:
        yield np.concatenate(some)


def _raised_above_ground(gTc: FloatArray, pose_covariance: FloatArray, body: Body) -> FloatArray:
    """Raise the camera when its predicted altitude is below the standard deviation of the altitude."""
    up = gTc[:3, 3] / np.linalg.norm(gTc[:3, 3])
    sigma_m = float(np.sqrt(up @ pose_covariance[3:, 3:] @ up))
    raised = gTc.copy()
    raised[:3, 3] += max(sigma_m - float(body.altitude_m(gTc[:3, 3])), 0.0) * up
    return raised


def _assigned(distances2: FloatArray, gate: float) -> tuple[IntArray, IntArray]:
    """Rims and craters that a global assignment pairs within a gate, each being the other's nearest."""
    cost = np.minimum(distances2, gate)
    rims, craters = linear_sum_assignment(cost)
    own = distances2[rims, craters]
    keep = (own < gate) & (own <= distances2[rims].min(axis=1)) & (own <= distances2[:, craters].min(axis=0))
    return rims[keep], craters[keep]
