"""Poses of one image: hypotheses that are expanded to all rims that they explain, and judged."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
from craternav_fg.matching.identify.shading import log_shading
from craternav_fg.matching.identify.size_excess import plausible_rims
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.triple_search import image_order, largest, likeliest
from craternav_fg.matching.identify.view import View
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# A hypothesis is formed from a triple.
MIN_RIMS = 3
# Rims around each rim that may be asked when a hypothesis is scored.
_ORDERED_RIMS = 24
# Rims of which hypotheses are formed, the largest: memory and time grow with the square of their number.
_MAX_RIMS = 1500
# Largest rotation of a triple's hypothesis from a known attitude, beside 5 standard deviations of that: three
# centres determine the attitude coarsely.
_MAX_TURN_RAD = float(np.radians(20.0))
_ATTITUDE_SIGMAS = 5.0
# An attitude known more accurately than this, rad, is used with this: its information stays invertible.
_MIN_ATTITUDE_SIGMA_RAD = 1e-5


@dataclass
class Expanded:
    """A pose with its matched rims, information N (6, 6), noise (3,) and logarithm of the evidence."""

    gTc: FloatArray
    match: IntArray
    N: FloatArray
    sigma: FloatArray
    log_ratio: float


class Search:
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

    def expand(self, hypothesis: FloatArray, noise: float) -> Expanded | None:
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
    ) -> tuple[list[Expanded], bool]:
        """Expand the best hypotheses and make room for others, until one has enough evidence.

        Give those that did not fail, the last one being that with enough evidence, and whether there is one.
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
                if np.sum(side & matched) >= MIN_RIMS:
                    halves.append(np.where(side, expanded.match, -1))
        levels = np.array(self.options.noise_levels_px)
        noise = float(levels[np.argmin(np.abs(np.log(levels / expanded.sigma[0])))])
        starts = [(expanded.match, float(level)) for level in levels] + [(half, noise) for half in halves]
        for match, level in starts:
            other = self._expand_from(expanded.gTc.copy(), match.copy(), level)
            if other is not None and other.log_ratio > expanded.log_ratio:
                expanded = other
        return expanded

    def _expand_from(self, gTc: FloatArray, match: IntArray, noise: float) -> Expanded | None:
        """Expand a pose with some pairs (changed in place), and compute the evidence; None if it fails."""
        craters, index = self.index.craters, self.index.catalog.index
        N, sigma = np.empty((6, 6)), np.empty(3)
        pairs = expand_inliers(
            self.view, index, craters, noise, self.chance, self.prior, self.weight, gTc, match, N, sigma
        )
        if pairs < MIN_RIMS:
            return None
        ratio = log_evidence(
            self.view, index, craters, gTc, match, N, self.chance, self.shape_chance, self._log_prior(gTc)
        )
        if not np.isfinite(ratio):
            return None
        ratio += log_shading(self.view, index, craters, gTc, match, N, self.maps)
        return Expanded(gTc, match, N, sigma, ratio)

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
