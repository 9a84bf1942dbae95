"""Blind detection by the crater network: craters that people see, worn, overlapped and cut ones among them.

The network proposes circles (see `proposals`). The rim is traced and fitted as in `detect`: from the matched
filter's candidate where there is one of the same crater, for it is closer to the rim, else from the circle.
Where that fails, or does not agree with the circle, the circle is given, with a covariance to match. The
probability of a crater is the network's, calibrated: how well a rim can be traced on rendered ground says
little of worn craters on photographs.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import axes_of_chart, mean_radius
from craternav_fg.vision.blind_fit import BlindFitter
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import (
    Candidates,
    common_sun_angle,
    distinct_circles,
    illuminated_from,
    local_sun_angles,
)
from craternav_fg.vision.circle_shading import shaded
from craternav_fg.vision.detect import (
    SUN_REACH_SHARE,
    BlindOptions,
    FoundRims,
    agreed_sun_angle,
    blind_fitter,
    candidates_in,
    require_finite_angle,
)
from craternav_fg.vision.graphics import on_ground
from craternav_fg.vision.image_sampling import noise_level
from craternav_fg.vision.proposal_fit import MIN_ARC_SHARE, MeasuredRims, measured
from craternav_fg.vision.proposals import QUARTERS, SURE_LOG_ODDS, Proposals, SunQuarter
from craternav_fg.vision.pyramid import quarters_to_right
from factors.arrays import FloatArray

Float32Array = npt.NDArray[np.float32]

# Probability of a quarter, against the opposite one, below which both are asked: the image does not show the
# direction towards the sun. And the logarithm of its odds.
_DECIDED, _DECIDED_LOG_ODDS = 0.95, float(np.log(19.0))
# Radius of the smallest craters that may be asked for the direction, px.
_SUN_RADIUS_PX = 8.0
# Largest deviation of a shading's direction from its quarter's middle.
_MAX_DEVIATION_RAD = float(np.deg2rad(70.0))
# Weights of `Lit.evidence` in the logarithm of the odds that people mark a crater. Fitted on the annotated
# NAC images by `craternav_fg.training.marked`.
QUALITY_WEIGHTS = np.array([1.24, -0.52, -7.22, 1.29])
# Weights of `Lit.doubt` times the logarithm of the odds, and of the doubt: where both quarters show about as
# many craters, most are none. Fitted on rendered ground with few craters or none by
# `craternav_fg.training.sparse`.
DOUBT_WEIGHTS = np.array([0.62, -5.05])
# Radius at which the size has no weight, px.
_REFERENCE_RADIUS_PX = 10.0
# A candidate of the matched filter is a proposed crater if its centre is within this share of the radius and
# the logarithms of the radii differ by less.
_SAME_CENTRE_RADII, _SAME_LOG_RADIUS = 0.4, 0.4


@dataclass(frozen=True)
class Lit:
    """Distinct proposals that are lit from one quarter, the likeliest first; n of them.

    Attributes
    ----------
    candidates : Candidates
        The circles.
    starts : Candidates
        Circles from which their rims are traced.
    evidence : ndarray, shape (n, 4)
        Logarithm of the odds of a crater, by the network; logarithm of the radius over 10 px; what is
        missing of half a radius between centre and border, as a share; 1. Dimensionless.
    sun_angles_rad : ndarray, shape (n,)
        Direction towards the sun in the image at each.
    sun_angle_rad : float
        The common one.
    quarter_log_odds : float
        Logarithm of the odds of the quarter against the opposite one.
    """

    candidates: Candidates
    starts: Candidates
    evidence: FloatArray
    sun_angles_rad: FloatArray
    sun_angle_rad: float
    quarter_log_odds: float

    @property
    def quality(self) -> FloatArray:
        """Probabilities (n,) of craters."""
        logit = self.evidence @ QUALITY_WEIGHTS
        logit = logit + self.doubt * (DOUBT_WEIGHTS[0] * logit + DOUBT_WEIGHTS[1])
        return np.asarray(1.0 / (1.0 + np.exp(-logit)))

    @property
    def doubt(self) -> float:
        """From 0, the image shows that the sun is in the quarter, to 1: it does not."""
        return float(np.interp(self.quarter_log_odds, (_DECIDED_LOG_ODDS, SURE_LOG_ODDS), (1.0, 0.0)))

    def likely(self, min_quality: float) -> "Lit":
        """Select those of at least a quality.

        Parameters
        ----------
        min_quality : float
        """
        rows = self.quality >= min_quality
        return replace(
            self, candidates=self.candidates.take(rows), starts=self.starts.take(rows),
            evidence=self.evidence[rows], sun_angles_rad=self.sun_angles_rad[rows],
        )  # fmt: skip


def find_rims_network(
    image: npt.NDArray[np.generic], sun_angle_rad: float | None = None, options: BlindOptions | None = None
) -> FoundRims:
    """Find crater rims by the crater network.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        See `brightness.brightness`.
    sun_angle_rad : float, optional
        Direction towards the sun in the image, from x towards y; found in the image if not given. Where the
        image does not show it, craters lit from two opposite sides are given.
    options : BlindOptions, optional

    Returns
    -------
    FoundRims
        Possibly none; quality is the probability.

    Raises
    ------
    ValueError
        When the array is no image, or the angle not finite.
    InputError
        When the network's weights are missing or damaged.
    """
    require_finite_angle(sun_angle_rad)
    options = options or BlindOptions()
    everywhere, pixels = filled(brightness(image))
    largest = options.max_radius_share * min(everywhere.shape)
    proposals = Proposals(everywhere, options.min_radius_px, largest)
    matched = candidates_in(everywhere, options)
    found = proposals.sun_quarter(voted_quarter(matched))
    if found.probability < _DECIDED and sun_angle_rad is None and options.min_radius_px > _SUN_RADIUS_PX:
        # The craters asked for are too few; smaller ones are lit from there, too.
        smaller = candidates_in(everywhere, replace(options, min_radius_px=_SUN_RADIUS_PX))
        found = Proposals(everywhere, _SUN_RADIUS_PX, largest).sun_quarter(voted_quarter(smaller))
    lit = [lit_from(everywhere, proposals, matched, *one) for one in _asked(found, sun_angle_rad)]
    noise = noise_level(everywhere) if min(pixels.shape) > 2 else 0.0
    lit = [one.likely(options.min_quality) for one in lit]
    rims = _gathered(lit, [_measured(pixels, one, noise, options) for one in lit])
    rims = rims.take(on_ground(pixels, rims.charts_px))
    if sun_angle_rad is None:
        towards = lit[0].sun_angle_rad if len(lit) == 1 else float("nan")
        return replace(
            rims, sun_angle_rad=towards, seen_sun_angle_rad=towards, sun_probability=found.probability
        )
    seen = float("nan")
    if found.probability >= _DECIDED:
        seen = lit_from(everywhere, proposals, matched, found.quarters, found.log_odds).sun_angle_rad
    return replace(rims, sun_angle_rad=float(sun_angle_rad), seen_sun_angle_rad=seen)


def _asked(found: SunQuarter, sun_angle_rad: float | None) -> list[tuple[int, float]]:
    """Quarters that the sun may be in, with the logarithms of their odds."""
    if sun_angle_rad is not None:
        return [(quarters_to_right(sun_angle_rad), np.inf)]
    if found.probability >= _DECIDED:
        return [(found.quarters, found.log_odds)]
    return [(found.quarters, found.log_odds), ((found.quarters + 2) % QUARTERS, -found.log_odds)]


def voted_quarter(matched: Candidates) -> int | None:
    """Find the quarter that the sun is in, as candidates of the matched filter show it.

    Parameters
    ----------
    matched : Candidates

    Returns
    -------
    int or None
        See `pyramid.quarters_to_right`; None where they do not clearly agree.
    """
    seen_rad = agreed_sun_angle(matched, None).seen_rad if len(matched) else float("nan")
    return None if np.isnan(seen_rad) else quarters_to_right(seen_rad)


def lit_from(
    image: Float32Array, proposals: Proposals, matched: Candidates, quarters: int, log_odds: float
) -> Lit:
    """Return the distinct proposals that are lit from a quarter, and their shading.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    proposals : Proposals
        Of the image.
    matched : Candidates
        Of the matched filter, the best first.
    quarters : int
        See `pyramid.quarters_to_right`.
    log_odds : float
        Logarithm of the odds of the quarter against the opposite one.

    Returns
    -------
    Lit
    """
    circles = proposals.circles(quarters)
    circles = circles[np.argsort(-circles[:, 3], kind="stable")]
    circles = circles[distinct_circles(circles[:, :2], circles[:, 2], len(circles))]
    candidates = shaded(image, circles[:, :3])
    middle = 0.5 * np.pi * quarters
    clear = candidates.take(illuminated_from(candidates, middle, _MAX_DEVIATION_RAD))
    reach = SUN_REACH_SHARE * max(image.shape)
    angles = np.full(len(candidates), middle)
    if len(clear):
        angles = local_sun_angles(clear, reach, candidates.xy_px)
        middle = common_sun_angle(clear)[0]
    starts = _starts(candidates, matched.take(illuminated_from(matched, middle, _MAX_DEVIATION_RAD)))
    return Lit(candidates, starts, _evidence(circles, image.shape), angles, middle, log_odds)


def _starts(circles: Candidates, matched: Candidates) -> Candidates:
    """Replace circles by the best candidate of the matched filter that is the same crater."""
    if not len(matched):
        return circles
    x, y = (circles.xy_px[:, None, k] - matched.xy_px[None, :, k] for k in range(2))
    size = np.log(circles.radius_px)[:, None] - np.log(matched.radius_px)[None]
    near = x * x + y * y < (_SAME_CENTRE_RADII * circles.radius_px[:, None]) ** 2
    near &= np.abs(size) < _SAME_LOG_RADIUS
    best = np.argmax(np.where(near, matched.correlation, 0.0), axis=1)
    both = [circles, matched.take(best)]
    same = np.take_along_axis(near, best[:, None], axis=1)[:, 0]
    joined = Candidates(*(np.concatenate([getattr(one, f.name) for one in both]) for f in fields(circles)))
    return joined.take(np.arange(len(circles)) + len(circles) * same)


def _evidence(circles: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Evidence (n, 4) of proposals (n, 4), see `Lit`."""
    x, y, radius, log_odds = circles.T
    inside = np.minimum(np.minimum(x, shape[1] - 1.0 - x), np.minimum(y, shape[0] - 1.0 - y))
    cut = np.clip(1.0 - 2.0 * inside / radius, 0.0, 1.0)
    return np.column_stack([log_odds, np.log(radius / _REFERENCE_RADIUS_PX), cut, np.ones(len(cut))])


def _measured(pixels: Float32Array, lit: Lit, noise: float, options: BlindOptions) -> MeasuredRims:
    """Measure the proposals of one quarter."""
    if not len(lit.candidates):
        return MeasuredRims(np.empty((0, 5)), np.empty((0, 5, 5)), np.empty(0, dtype=np.bool_))
    fitter = proposal_fitter(pixels, lit, noise, options)
    return measured(fitter, lit.candidates, lit.starts, lit.sun_angles_rad)


def proposal_fitter(pixels: Float32Array, lit: Lit, noise: float, options: BlindOptions) -> BlindFitter:
    """Return what traces the rims of proposals.

    Parameters
    ----------
    pixels : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    lit : Lit
        At least one proposal.
    noise : float
        Standard deviation of the pixels' noise, see `image_sampling.noise_level`.
    options : BlindOptions
    """
    fit = replace(options.fit, min_arc_share=MIN_ARC_SHARE)
    return blind_fitter(pixels, lit.starts, noise, replace(options, fit=fit))


def _gathered(lit: list[Lit], rims: list[MeasuredRims]) -> FoundRims:
    """Put rims together, the likeliest first; fits may have brought two circles to one rim."""
    charts, covariance, traced = (np.concatenate(parts) for parts in zip(*rims, strict=True))
    quality = np.concatenate([one.quality for one in lit])
    angles = np.concatenate([one.sun_angles_rad for one in lit])
    order = np.argsort(-quality, kind="stable")
    rows = order[distinct_circles(charts[order, :2], mean_radius(charts[order]), len(order))]
    return FoundRims(
        axes_of_chart(charts[rows]), charts[rows], covariance[rows], quality[rows], traced[rows],
        angles[rows], float("nan"),
    )  # fmt: skip
