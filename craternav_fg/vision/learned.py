"""Blind detection by a learned judgement: worn, overlapped and shadowed craters, which the rules refuse.

Candidates come from the matched filter with a low threshold, and their common direction towards the sun as in
`detect`. A network that has seen rendered ground alone estimates how probable each is a crater (`judge`); of
several candidates of one crater the most probable stays. Where the rim can be traced, the ellipse is measured
as in `detect`. Where it cannot, the candidate's circle is given, with a covariance to match.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import axes_covariance, axes_of_chart, mean_radius
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import (
    Candidates,
    distinct,
    find_candidates,
    illuminated_from,
    local_sun_angles,
)
from craternav_fg.vision.detect import (
    BlindOptions,
    FoundRims,
    SunVote,
    agreed_sun_angle,
    find_rims,
    fit_candidates,
)
from craternav_fg.vision.image_sampling import noise_level
from craternav_fg.vision.judge import crater_probability

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Float32Array = npt.NDArray[np.float32]

# Standard deviation, in the image's longer sides, of the neighbourhood that shares a direction towards the
# sun.
SUN_REACH_SHARE = 0.25
# Standard deviation of centre and semi-axes of a circle whose rim could not be traced, in radii.
CIRCLE_SIGMA_RADII = 0.12
# Two marks are the same crater if their centres are closer than this share of the larger radius and the
# logarithms of their radii differ by less.
_SAME_CENTRE_SHARE, _SAME_LOG_RADIUS = 0.5, 0.6


@dataclass(frozen=True)
class LearnedOptions:
    """What is proposed and accepted.

    Attributes
    ----------
    blind : BlindOptions
        Sizes, the fit, and `min_quality`: the least probability.
    min_correlation : float
        Least correlation of a candidate with the canonical crater.
    max_candidates : int
    max_sun_deviation_rad : float
        Candidates lit from farther than this from the common direction are rejected.
    """

    blind: BlindOptions = field(default_factory=BlindOptions)
    min_correlation: float = 0.45
    max_candidates: int = 6000
    max_sun_deviation_rad: float = float(np.deg2rad(50.0))


def find_rims_learned(
    image: npt.NDArray[np.generic], sun_angle_rad: float | None = None, options: BlindOptions | None = None
) -> FoundRims:
    """Find crater rims by the learned judgement.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        See `brightness.brightness`.
    sun_angle_rad : float, optional
        Direction towards the sun in the image, from x towards y; found in the image if not given.
    options : BlindOptions, optional

    Returns
    -------
    FoundRims
        Possibly none; quality is the probability.

    Raises
    ------
    ValueError
        When the array is no image.
    """
    learned = LearnedOptions() if options is None else LearnedOptions(options)
    everywhere, pixels = filled(brightness(image))
    candidates, vote = lit_candidates(everywhere, sun_angle_rad, learned)
    if not vote.certain:
        # The network knows cratered ground only: where the image shows no common direction the rules judge.
        return find_rims(image, sun_angle_rad, learned.blind)
    sun_angles = local_sun_angles(candidates, SUN_REACH_SHARE * max(everywhere.shape))
    probability = crater_probability(everywhere, candidates, sun_angles)
    rows = _strongest(candidates, probability, learned.blind.min_quality)
    candidates, probability = candidates.take(rows), probability[rows]
    fits = fit_candidates(pixels, candidates, noise_level(everywhere), learned.blind)
    radius = np.log(candidates.radius_px)
    charts = np.column_stack([candidates.xy_px, radius, np.zeros(len(radius)), radius])
    covariance = np.array([axes_covariance(y, CIRCLE_SIGMA_RADII * np.exp(y[2])) for y in charts])
    for k, rim in enumerate(fits):
        if rim is not None:
            charts[k], covariance[k] = rim.fit.chart_px, rim.fit.covariance
    return _found(charts, covariance.reshape(-1, 5, 5), probability, sun_angles[rows], vote)


def lit_candidates(
    image: Float32Array, sun_angle_rad: float | None, options: LearnedOptions
) -> tuple[Candidates, SunVote]:
    """Find candidates that are lit from a common direction.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    sun_angle_rad : float or None
        What is known of the direction, in the image, from x towards y.
    options : LearnedOptions

    Returns
    -------
    candidates : Candidates
    vote : SunVote
    """
    blind = options.blind
    largest = blind.max_radius_share * min(image.shape)
    found = find_candidates(image, blind.min_radius_px, largest, options.min_correlation)
    candidates = distinct(found, options.max_candidates)
    strong = candidates.take(candidates.correlation > blind.min_correlation)
    if not len(strong):
        given = float("nan") if sun_angle_rad is None else float(sun_angle_rad)
        return candidates, SunVote(given, False, float("nan"))
    vote = agreed_sun_angle(strong, sun_angle_rad)
    lit = illuminated_from(candidates, vote.sun_angle_rad, options.max_sun_deviation_rad)
    return candidates.take(lit), vote


def _strongest(candidates: Candidates, probability: FloatArray, least: float) -> IntArray:
    """Rows of the most probable candidate of each crater, most probable first."""
    kept: list[int] = []
    xy, radius = candidates.xy_px, candidates.radius_px
    for k in np.argsort(-probability, kind="stable"):
        if probability[k] < least:
            break
        larger = np.maximum(radius[kept], radius[k])
        near = np.hypot(*(xy[kept] - xy[k]).T) < _SAME_CENTRE_SHARE * larger
        if not np.any(near & (np.abs(np.log(radius[kept] / radius[k])) < _SAME_LOG_RADIUS)):
            kept.append(int(k))
    return np.array(kept, dtype=np.int64)


def _found(
    charts: FloatArray, covariance: FloatArray, probability: FloatArray, sun: FloatArray, vote: SunVote
) -> FoundRims:
    """Put rims together; fits may have brought two candidates to one rim."""
    kept: list[int] = []
    size = mean_radius(charts)
    for k in range(len(charts)):
        near = np.hypot(*(charts[kept, :2] - charts[k, :2]).T) < _SAME_CENTRE_SHARE * np.maximum(
            size[kept], size[k]
        )
        if not np.any(near & (np.abs(np.log(size[kept] / size[k])) < _SAME_LOG_RADIUS)):
            kept.append(k)
    return FoundRims(
        axes_of_chart(charts[kept]), charts[kept], covariance[kept], probability[kept], sun[kept],
        vote.sun_angle_rad, vote.seen_rad,
    )  # fmt: skip
