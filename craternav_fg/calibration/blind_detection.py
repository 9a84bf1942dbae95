"""Blind detection: quality of a rim; size, contrast and illumination direction from candidates.

The quality is a logistic regression of right and wrong fits: of candidates on smooth, irregular and textured
cratered ground, on rough ground without craters, and on noise. These three kinds of image count alike.
Uncatalogued craters are real, too: fits below the size that a detector is asked for are left out where they
match no rim.

Three values are kept although these images give others:

- The weight of the correlation, 32 for 22. With all five weights as regenerated, fewer rims are found: on
  hard ground (345 rims) 94.5 % in place of 95.7 %, on an image of Eros 4 in place of 10. Precisions are
  alike.
- The size of a candidate's crater, 1.07 templates for 1.03, and its contrast, 1.3 times the canonical
  crater's for 1.6. Both only begin the fit: with both as regenerated, recall and precision on smooth,
  irregular and hard ground (322, 135 and 345 rims) change by less than 1 %, mean errors by less than 0.01
  px.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from craternav_fg.calibration.likelihood import Parameter, Scale, estimate
from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.calibration.rendered_scenes import EMPTY, SMOOTH, noise, scenes, textured
from craternav_fg.ellipse import axes_of_chart
from craternav_fg.evaluation.detection import GATE_CHI2, SIGMA_PX, gaussian_angle
from craternav_fg.simulation.scenes import IRREGULAR, MIN_SEMI_MINOR_PX, Scene
from craternav_fg.vision import detect
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.candidates import (
    MAX_VOTERS,
    TEMPLATE_SIZE_FACTOR,
    Candidates,
    common_sun_angle,
    illuminated_from,
    local_sun_angles,
)
from craternav_fg.vision.image_sampling import noise_level
from factors.arrays import BoolArray, FloatArray

# Seed of the first scene.
_SEED = 200
# What these images give where another value is kept.
_CORRELATION_WEIGHT, _SIZE_FACTOR, _CONTRAST_FACTOR = 21.7, 1.035, 1.58
# Two textures of each scene.
_TEXTURES = 2
_NO_RIMS = np.empty((0, 5))
# A candidate is a rim's if its centre is within this share of the radius and its radius within this factor.
_SAME_CENTRE, _SAME_RADIUS = 0.4, 1.5
_VOTE_TRIALS = 400


def blind_quality() -> list[Regenerated]:
    """Regenerate `detect.QUALITY_WEIGHTS` and `QUALITY_OFFSET`.

    Returns
    -------
    list of Regenerated
    """
    rng = np.random.default_rng(_SEED)
    cratered = [(one.image, one.ellipses_px) for ground in (SMOOTH, IRREGULAR) for one in scenes(ground)]
    for one in scenes(SMOOTH):
        cratered += [(textured(one, rng), one.ellipses_px) for _ in range(_TEXTURES)]
    empty = [(one.image, _NO_RIMS) for one in scenes(EMPTY)]
    kinds = [cratered, empty, [(image, _NO_RIMS) for image in noise(rng)]]
    samples = [[_samples(*image) for image in kind] for kind in kinds]
    counts = [sum(len(right) for _, right in kind) for kind in samples]
    shipped = np.append(detect.QUALITY_WEIGHTS, detect.QUALITY_OFFSET)

    def costs(weights: FloatArray) -> FloatArray:
        totals = []
        for kind, count in zip(samples, counts, strict=True):
            for evidence, right in kind:
                logit = evidence @ weights[:-1] + weights[-1]
                totals.append(np.logaddexp(0.0, np.where(right, -logit, logit)).sum() / count)
        return np.mean(counts) * np.array(totals)

    parameters = [Parameter(float(w), Scale.LINEAR, 0.1 * abs(float(w))) for w in shipped]
    values, errors = estimate(costs, parameters)
    names = ("correlation", "agreeing share", "scatter, radii", "covered share", "offset")
    out = []
    for name, given, value, error in zip(names, shipped, values, errors, strict=True):
        kept = (Relation.KEPT, _CORRELATION_WEIGHT) if name == "correlation" else (Relation.FITTED,)
        out.append(Regenerated(f"detect.QUALITY: {name}", float(given), float(value), float(error), *kept))
    return out


def _samples(image: npt.NDArray[np.uint8], true_px: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Evidence (n, 4) of an image's fits, and whether they are right."""
    options = detect.BlindOptions()
    everywhere, pixels = filled(brightness(image))
    candidates = detect.candidates_in(everywhere, options)
    if len(candidates) == 0:
        return np.empty((0, 4)), np.empty(0, dtype=np.bool_)
    sun_angle, _ = common_sun_angle(candidates)
    lit = candidates.take(illuminated_from(candidates, sun_angle, options.max_sun_deviation_rad))
    sun_angles = local_sun_angles(lit, detect.SUN_REACH_SHARE * max(pixels.shape))
    fits = detect.fit_candidates(pixels, lit, sun_angles, noise_level(everywhere), options)
    rims = [rim for rim in fits if rim is not None]
    found_px = axes_of_chart(np.array([rim.fit.chart_px for rim in rims]).reshape(-1, 5))
    sigma = SIGMA_PX / np.sqrt(true_px[:, 2] * true_px[:, 3])
    apart = gaussian_angle(found_px[:, None], true_px[None]) / sigma
    right = np.min(apart**2, axis=1, initial=np.inf) < GATE_CHI2
    counts = right | (found_px[:, 3] >= MIN_SEMI_MINOR_PX)
    return np.array([rim.evidence for rim in rims]).reshape(-1, 4)[counts], right[counts]


def candidates() -> list[Regenerated]:
    """Regenerate `TEMPLATE_SIZE_FACTOR`, `CONTRAST_FACTOR` and `SUN_VOTE_CHANCE_SHARE`.

    The last, an upper bound, from candidates whose directions are random.

    Returns
    -------
    list of Regenerated
    """
    radii, contrasts = [], []
    for one in scenes(SMOOTH):
        found = detect.candidates_in(filled(brightness(one.image))[0], detect.BlindOptions())
        radii.append(np.median(_radius_factors(one, found)))
        whole, _ = one.catalog.visible(one.camera, one.gTb, min_semi_minor_px=MIN_SEMI_MINOR_PX)
        true = np.median(one.slope_contrast[np.isin(one.craters, whole)])
        contrasts.append(true / np.median(found.slope_contrast[: detect.CONTRAST_CANDIDATES]))
    rng = np.random.default_rng(_SEED)
    places, ones = np.zeros((MAX_VOTERS, 2)), np.ones(MAX_VOTERS)
    drawn = [
        Candidates(places, ones, ones, rng.uniform(-np.pi, np.pi, MAX_VOTERS), ones)
        for _ in range(_VOTE_TRIALS)
    ]
    shares = [common_sun_angle(voters)[1] for voters in drawn]
    size, contrast, share = TEMPLATE_SIZE_FACTOR, detect.CONTRAST_FACTOR, detect.SUN_VOTE_CHANCE_SHARE
    return [
        Regenerated("candidates.TEMPLATE_SIZE_FACTOR", size, *_mean(radii), Relation.KEPT, _SIZE_FACTOR),
        Regenerated("detect.CONTRAST_FACTOR", contrast, *_mean(contrasts), Relation.KEPT, _CONTRAST_FACTOR),
        Regenerated("detect.SUN_VOTE_CHANCE_SHARE", share, *_mean(shares), Relation.AT_LEAST),
    ]


def _mean(values: Sequence[float]) -> tuple[float, float]:
    """Mean and its standard error."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


def _radius_factors(one: Scene, found: Candidates) -> FloatArray:
    """Radii of wanted rims over those of the templates that found them."""
    x, y, major, minor, _ = one.ellipses_px[one.wanted].T
    radius = np.sqrt(major * minor)
    apart = np.hypot(found.xy_px[:, 0] - x[:, None], found.xy_px[:, 1] - y[:, None])
    ratio = radius[:, None] / found.radius_px
    same = (apart < _SAME_CENTRE * radius[:, None]) & (np.abs(np.log(ratio)) < np.log(_SAME_RADIUS))
    # The first of a rim's candidates is the best.
    best = np.argmax(same, axis=1)[same.any(axis=1)]
    return np.asarray(TEMPLATE_SIZE_FACTOR * ratio[same.any(axis=1), best])
