"""Poses of one image: hypotheses that are expanded to all rims that they explain, and judged."""

import math
from dataclasses import dataclass

import numpy as np

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.matching.identify.chance import log_by_chance
from craternav_fg.matching.identify.evidence import log_evidence
from craternav_fg.matching.identify.expand import expand_inliers
from craternav_fg.matching.identify.hypothesis import (
    CRATERS,
    POSITION,
    RIMS,
    ROTATION,
    SCORE,
    SPHERE,
    PoseLimits,
)
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.pose_fit import fit_pose, pack_rims, shifts_without
from craternav_fg.matching.identify.shading import log_shading
from craternav_fg.matching.identify.size_excess import plausible_rims
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triple_search import image_order, largest, likeliest
from craternav_fg.matching.identify.view import View
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps
from factors.arrays import FloatArray, IntArray

# A hypothesis is formed from a triple.
MIN_RIMS = 3
# Rims around each rim that may be asked when a hypothesis is scored; they are of the likeliest third.
_ORDERED_RIMS, _LIKELY_DIVISOR = 24, 3
# Rims of which hypotheses are formed, the largest: memory and time grow with the square of their number.
_MAX_RIMS = 1500
# A pose whose attitude is more uncertain is none: its evidence takes residuals for linear in it. Right poses
# over rendered real ground have up to 0.03; three large rims on wrong craters had 0.25, and e^9 in evidence.
# Three on right ones had 0.06, and an error of 15 % of the altitude.
_MAX_ATTITUDE_SIGMA_RAD = 0.05
# Least evidence of a pose that is varied.
PROMISING = -5.0
# Share of the images whose optical axis meets the ground, chosen: the others show the limb.
_AIMED_SHARE = 0.9
# Pairs that are left out, the most influential first, and times that a pose is varied.
_LEFT_OUT, _MAX_VARIED = 3, 4
# Evidence that a variation must gain for a further one: less is hardly another pose.
_LEAST_GAIN = 1.0
# Largest rotation of a triple's hypothesis from a known attitude, beside 5 standard deviations of that: three
# centres determine the attitude coarsely.
_MAX_TURN_RAD = float(np.radians(20.0))
_ATTITUDE_SIGMAS = 5.0
# An attitude known more accurately than this, rad, is used with this: its information stays invertible.
_MIN_ATTITUDE_SIGMA_RAD = 1e-5


@dataclass
class Expanded:
    """A pose with its matched rims, and its evidence.

    Attributes
    ----------
    gTc : ndarray, shape (4, 4)
        Pose of the camera, m.
    match : ndarray of int, shape (n,)
        Row of each rim's crater, -1 for none.
    N : ndarray, shape (6, 6)
        Information of the pose for its right twist in c, rad and m.
    sigma : ndarray, shape (3,)
        Noise, see `noise`.
    log_ratio : float
        Natural logarithm of the evidence.
    """

    gTc: FloatArray
    match: IntArray
    N: FloatArray
    sigma: FloatArray
    log_ratio: float


def _evidence(one: Expanded) -> float:
    return one.log_ratio


class Search:
    """Data of one call that every step needs.

    Parameters
    ----------
    view : View
    index : TripleIndex
    known : KnownAttitude or None
    camera : Camera
    options : IdentifyOptions
    maps : ShadingMaps, optional
    log_ways : float, optional
        Natural logarithm of the number of ways to agree by chance beside the poses: lowers the evidence.
    """

    def __init__(
        self, view: View, index: TripleIndex, known: KnownAttitude | None, camera: Camera,
        options: IdentifyOptions, maps: ShadingMaps = NO_SHADING, log_ways: float = 0.0,
    ) -> None:  # fmt: skip
        self.view, self.index, self.options, self.maps = view, index, options, maps
        self.log_ways = log_ways
        self.n = len(view.charts)
        self.prior = np.eye(4)
        self.weight = np.zeros((6, 6))
        # Of the camera's attitude: what is known is that of b.
        sigma_rad = 1.0 if known is None else math.hypot(known.sigma_rad, camera.mounting_sigma_rad)
        self.sigma_rad = max(sigma_rad, _MIN_ATTITUDE_SIGMA_RAD)
        attitude, min_cos_turn = np.empty((0, 3)), -1.0
        if known is not None:
            gRc = known.gRb @ camera.bTc[:3, :3]
            attitude = np.ascontiguousarray(gRc)
            self.prior[:3, :3] = gRc
            self.weight[:3, :3] = np.eye(3) / self.sigma_rad**2
            min_cos_turn = float(np.cos(_MAX_TURN_RAD + _ATTITUDE_SIGMAS * self.sigma_rad))
        sizes = index.craters.log_size
        altitudes_m = options.searched_m(camera, np.exp([sizes.min(), sizes.max()]))
        self.limits = PoseLimits(attitude, min_cos_turn, *altitudes_m)
        self.chance, self.shape_chance = log_by_chance(view)
        self.largest = largest(view, np.arange(self.n), _MAX_RIMS)
        self.begin_with(largest(view, plausible_rims(view), _MAX_RIMS))

    def begin_with(self, plausible: IntArray) -> None:
        """Begin hypotheses from some rims, the likeliest of them, and all.

        Parameters
        ----------
        plausible : ndarray of int, shape (m,)
            Rows of the rims.
        """
        self.plausible = plausible
        likely = likeliest(self.view, plausible, max(_ORDERED_RIMS, len(plausible) // _LIKELY_DIVISOR))
        self.order = image_order(self.view, likely, _ORDERED_RIMS)
        groups = {len(rims): rims for rims in (likely, plausible, self.largest)}
        self.groups = list(groups.values())

    def expand(self, hypothesis: FloatArray, noise: float) -> Expanded | None:
        """Expand a hypothesis; if its evidence is promising but too low, try variations of it.

        Parameters
        ----------
        hypothesis : ndarray, shape (HYPOTHESIS,)
            See `hypothesis`; the pose in m.
        noise : float
            Assumed noise of the centres, px.

        Returns
        -------
        Expanded or None
            None if the fit fails or too few rims agree.
        """
        gTc = np.eye(4)
        gTc[:3, :3] = hypothesis[ROTATION:POSITION].reshape(3, 3)
        gTc[:3, 3] = hypothesis[POSITION:SPHERE]
        match = np.full(self.n, -1)
        rims = hypothesis[RIMS:CRATERS].astype(np.int64)
        match[rims[rims >= 0]] = hypothesis[CRATERS:][rims >= 0]
        expanded = self.expand_from(gTc, match, noise)
        if expanded is not None and PROMISING < expanded.log_ratio < -self.options.log_chance:
            return self.best_variation(expanded)
        return expanded

    def expand_best(
        self, best: FloatArray, count: int, min_score: float, noise: float
    ) -> tuple[list[Expanded], bool]:
        """Expand the best hypotheses and make room for others, until one has enough evidence.

        Parameters
        ----------
        best : ndarray, shape (h, HYPOTHESIS)
            See `hypothesis`; the poses in m. Changed: those that were expanded have no score.
        count : int
            Largest number of them.
        min_score : float
        noise : float
            Assumed noise of the centres, px.

        Returns
        -------
        expanded : list of Expanded
            Those that did not fail, the last one being that with enough evidence.
        enough : bool
            Whether there is one.
        """
        out: list[Expanded] = []
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

    def best_variation(self, expanded: Expanded) -> Expanded:
        """Expand again from other starts, as long as that finds more evidence.

        Pairs that suit the noise assumed at first are kept, wrong pairs on one side of the image distort the
        pose there, and a small rim with a wrong crater outweighs many large ones, or a distant one many that
        are close together.

        Parameters
        ----------
        expanded : Expanded

        Returns
        -------
        Expanded
            With at least as much evidence.
        """
        # A fit forgets where it began: the same pairs and noise lead to the same pose, whichever turn it is.
        starts, ends = set[tuple[bytes, float]](), set[tuple[bytes, float]]()
        for _ in range(_MAX_VARIED):
            others = []
            for match, noise in self._starts(expanded):
                start = (match.tobytes(), noise)
                if start not in starts:
                    starts.add(start)
                    others.append(self.expand_from(expanded.gTc.copy(), match.copy(), noise, ends))
            best = max((one for one in others if one is not None), key=_evidence, default=expanded)
            gain, expanded = best.log_ratio - expanded.log_ratio, max(expanded, best, key=_evidence)
            if gain < _LEAST_GAIN:
                break
        return expanded

    def _starts(self, expanded: Expanded) -> list[tuple[IntArray, float]]:
        """Pairs and noise: all, all but the most influential ones, and those of each half of the image."""
        matched = expanded.match >= 0
        places = self.view.points_px[matched]
        halves = []
        for axis in range(2):
            middle = np.median(places[:, axis])
            for side in (self.view.points_px[:, axis] <= middle, self.view.points_px[:, axis] >= middle):
                if np.sum(side & matched) >= MIN_RIMS:
                    halves.append(np.where(side, expanded.match, -1))
        levels = np.array(self.options.noise_levels_px)
        noise = float(levels[np.argmin(np.abs(np.log(levels / expanded.sigma[0])))])
        sets = [expanded.match, *self._without_influential(expanded)]
        return [(match, float(level)) for match in sets for level in levels] + [
            (one, noise) for one in halves
        ]

    def _without_influential(self, expanded: Expanded) -> list[IntArray]:
        """Pairs without the most influential one, without the one that then is, and so on."""
        gTc, match = expanded.gTc.copy(), expanded.match.copy()
        out: list[IntArray] = []
        N = np.empty((6, 6))
        while len(out) < _LEFT_OUT and np.sum(match >= 0) > MIN_RIMS:
            data = pack_rims(self.view, self.index.craters, match, expanded.sigma)
            if not fit_pose(gTc, data, self.prior, self.weight, N):
                break
            _, influence, _ = shifts_without(gTc, data, N)
            match[np.flatnonzero(match >= 0)[np.argmax(influence)]] = -1
            out.append(match.copy())
        return out

    def expand_from(
        self, gTc: FloatArray, match: IntArray, noise: float, known: set[tuple[bytes, float]] | None = None
    ) -> Expanded | None:
        """Expand a pose with some pairs, and compute the evidence.

        Parameters
        ----------
        gTc : ndarray, shape (4, 4)
            Pose of the camera. Changed.
        match : ndarray of int, shape (n,)
            Row of each rim's crater, -1 for none. Changed.
        noise : float
            Assumed noise of the centres, px.
        known : set, optional
            Pairs and noise of poses whose evidence is known, and to which this one's are added.

        Returns
        -------
        Expanded or None
            None if the fit fails, too few rims agree, or the evidence is known.
        """
        craters, index = self.index.craters, self.index.catalog.index
        N, sigma = np.empty((6, 6)), np.empty(3)
        pairs = expand_inliers(
            self.view, index, craters, noise, self.chance, self.prior, self.weight, gTc, match, N, sigma
        )
        if pairs < MIN_RIMS:
            return None
        if known is not None:
            end = (match.tobytes(), noise)
            if end in known:
                return None
            known.add(end)
        if np.trace(np.linalg.inv(N)[:3, :3]) > _MAX_ATTITUDE_SIGMA_RAD**2:
            return None
        ratio = log_evidence(
            self.view, index, craters, gTc, match, N, self.chance, self.shape_chance, self._log_prior(gTc)
        )
        if not np.isfinite(ratio):
            return None
        ratio += log_shading(self.view, index, craters, gTc, match, N, self.maps) - self.log_ways
        return Expanded(gTc, match, N, sigma, ratio)

    def _log_prior(self, gTc: FloatArray) -> float:
        """Natural logarithm of the density of a pose before the image was seen, per rad^3 m^3."""
        least, most = self.limits.min_altitude_m, self.limits.max_altitude_m
        range_m = float(np.linalg.norm(gTc[:3, 3]))
        altitude = range_m - self.index.catalog.body.radius_m
        if not least < altitude < most:
            return -np.inf
        place = -np.log(4.0 * np.pi * range_m**2) - np.log(altitude * np.log(most / least))
        if not len(self.limits.attitude):
            cos_horizon = float(np.sqrt(1.0 - (self.index.catalog.body.radius_m / range_m) ** 2))
            ground = 0.5 * (1.0 - cos_horizon)
            meets = -gTc[:3, 2] @ gTc[:3, 3] > cos_horizon * range_m
            likely = _AIMED_SHARE / ground if meets else (1.0 - _AIMED_SHARE) / (1.0 - ground)
            return float(place + np.log(likely) - np.log(8.0 * np.pi**2))
        turn = frames.rotation_log(self.limits.attitude.T @ gTc[:3, :3])
        spread = self.sigma_rad
        return float(place - 1.5 * np.log(2.0 * np.pi * spread**2) - 0.5 * turn @ turn / spread**2)
