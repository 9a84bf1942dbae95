"""How far the asymmetry of a rim crest displaces the crossing in a blurred image.

Craters of three families, fresh to worn, are seen from above by a camera, by brightness in proportion to the
slope: edges between walls and flanks that diffusion rounds (those of `crest_blur`), the simulator's
hyperbolas, and logistic curves of the slope. Each shows what `vision.crest_asymmetry` reads: how far its
crossing moves under more smoothing, and how fast the slope falls there over the step between the flanks.
Where the crossing lies is regressed on both, with the same weight for each family. So is what an oblique view
does to the flanks: how much brighter it makes them at the share of the step at which the crest lies. The
tests' second world has no part in it.
"""

from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from craternav_fg.calibration.crest_blur import profiles
from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.simulation.crater_shape import crater_profile
from craternav_fg.vision import crater_profile as canonical
from craternav_fg.vision import crest_asymmetry as shipped
from craternav_fg.vision.edge_kernel import SECOND_SMOOTHING_FACTOR
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.normal_profile import flank_samples, sample_step, smoothing_px_at
from factors.arrays import FloatArray

# Radii of the rims and blur of the camera, px. Chosen.
_RADII_PX, _PSF_PX = (12.0, 20.0, 35.0, 60.0), 0.7
# Samples of a cross-section, in radii; depth of the craters, in radii; samples of a flank.
_STEP_RADII, _DEPTH_RADII, _FLANK_SAMPLES = 0.002, 0.4, 50
# The other families: depths, heights and widths of the crests, in radii; slopes of wall and flank, decay of
# the flank and sharpness of the crest, 1/radii, and where the floor ends. Chosen: shallow to deep, fresh to
# worn.
_DEPTHS, _RIMS, _CRESTS = (0.2, 0.3, 0.4), (0.05, 0.075, 0.1), (0.015, 0.03, 0.06, 0.12, 0.24)
_WALL_SLOPES, _FLANK_SLOPES, _DECAYS = (0.35, 0.5, 0.7), (0.12, 0.2, 0.3), (2.0, 3.0, 4.5)
_SHARPNESSES, _FLOOR_RADIUS = (8.0, 16.0, 32.0, 64.0), 0.6
_LEAST = 1e-9
_HALF_DIGIT = 5e-4
# Lift of an oblique view: the derivative is that between it and its negative. Chosen.
_LIFT = 0.3


class _Seen(NamedTuple):
    """Crossings at both smoothings beyond the crest, mean slopes of both flanks, fall at the first."""

    place: float
    farther: float
    flanks: tuple[float, float]
    fall: float


def crest_asymmetry() -> list[Regenerated]:
    """Regenerate `vision.crest_asymmetry.DISPLACEMENT` and `FLANK_LIFT`.

    Returns
    -------
    list of Regenerated
    """
    rows, displaced_px = [], []
    lifts, terms_of_lift = 0.0, 0.0
    for slopes in (_edges(), _hyperbolas(), _logistic()):
        flanks = np.array([_lift_of_flanks(slope, radius_px) for slope in slopes for radius_px in _RADII_PX])
        lifts += np.nanmean(flanks[:, 0] * flanks[:, 1])
        terms_of_lift += np.nanmean(flanks[:, 1] ** 2)
        of_family = [row for slope in slopes for radius_px in _RADII_PX if (row := _row(slope, radius_px))]
        share = len(of_family) ** -0.5
        rows += [[share * term for term in terms] for terms, _ in of_family]
        displaced_px += [share * displaced for _, displaced in of_family]
    values = np.linalg.lstsq(np.array(rows), np.array(displaced_px), rcond=None)[0]
    return [
        Regenerated(f"crest_asymmetry.DISPLACEMENT: {name}", one, float(value), _HALF_DIGIT, Relation.EXACT)
        for name, one, value in zip(("b", "b^2", "b ln n"), shipped.DISPLACEMENT, values, strict=True)
    ] + [
        Regenerated(
            "crest_asymmetry.FLANK_LIFT", shipped.FLANK_LIFT, float(lifts / terms_of_lift), _HALF_DIGIT,
            Relation.EXACT,
        )
    ]  # fmt: skip


def _row(slope: FloatArray, radius_px: float) -> tuple[list[float], float] | None:
    """Terms of the displacement and the displacement, px; None beyond what the terms tell apart."""
    place = _seen(slope, radius_px).place
    own_place = _of_canonical(radius_px).place
    blunt, narrowness, _ = _shape(slope, radius_px)
    terms = shipped.displacement_terms(blunt, narrowness)
    if not np.allclose(terms, (blunt, blunt**2, blunt * np.log(max(narrowness, _LEAST)))):
        return None
    return [radius_px * own_place * term for term in terms], radius_px * place


def _lift_of_flanks(slope: FloatArray, radius_px: float) -> tuple[float, float]:
    """Compare what a lift does with the canonical crater: difference and term; nan as `_row` has None."""
    blunt, narrowness, steepness = _shape(slope, radius_px)
    if not np.allclose(shipped.displacement_terms(blunt, narrowness)[:2], (blunt, blunt**2)) or not (
        np.isclose(shipped.lift_of_flanks(1.0, narrowness), shipped.FLANK_LIFT * np.log(narrowness))
    ):
        return np.nan, np.nan
    inner, outer = _seen(slope, radius_px).flanks
    share = -outer / (inner - outer)
    lifted = _slopes_of_lift(slope, radius_px) - steepness**2 * _slopes_of_lift(_canonical(), radius_px)
    return float(share * lifted[0] + (1.0 - share) * lifted[1]), steepness**2 * float(np.log(narrowness))


def _slopes_of_lift(slope: FloatArray, radius_px: float) -> FloatArray:
    """Change of the mean slopes (2,) of inner wall and outer slope in the image per lift."""
    above, below = (_seen(_in_view(slope, lift), radius_px).flanks for lift in (_LIFT, -_LIFT))
    return np.subtract(above, below) / (2.0 * _LIFT)


def _in_view(slope: FloatArray, lift: float) -> FloatArray:
    """Slopes along the image of a crater, see `crater_profile.seen_ground`."""
    rho = canonical.IMAGE_RADII
    height = np.cumsum(slope) * canonical.STEP_RADII
    image = rho + lift * (height - np.interp(1.0, rho, height))
    farthest = np.maximum.accumulate(image) if lift > 0.0 else np.minimum.accumulate(image[::-1])[::-1]
    seen = image == farthest
    return np.interp(rho, image[seen], slope[seen])


def _shape(slope: FloatArray, radius_px: float) -> tuple[float, float, float]:
    """Bluntness, narrowness and steepness over the canonical crater's."""
    seen, own = _seen(slope, radius_px), _of_canonical(radius_px)
    blunt = (seen.farther - seen.place) / (own.farther - own.place)
    steepness = np.subtract(*seen.flanks) / np.subtract(*own.flanks)
    return blunt, max(seen.fall, 0.0) / own.fall / steepness, float(steepness)


def _edges() -> list[FloatArray]:
    """Slopes of walls and flanks that meet in edges, rounded by diffusion."""
    heights = profiles(1.0, _STEP_RADII)
    rho = (np.arange(heights.shape[1]) + 0.5) * _STEP_RADII
    return [
        np.interp(canonical.IMAGE_RADII, rho, _DEPTH_RADII * np.gradient(height, _STEP_RADII))
        for height in heights
    ]


def _hyperbolas() -> list[FloatArray]:
    """Slopes of the simulator's craters, whose crests are as round inside as outside."""
    return [
        np.gradient(
            [crater_profile(rho, depth, rim, crest) for rho in canonical.IMAGE_RADII], canonical.STEP_RADII
        )
        for depth, rim, crest in product(_DEPTHS, _RIMS, _CRESTS)
    ]


def _logistic() -> list[FloatArray]:
    """Slopes that go over from wall to flank along a logistic curve."""
    x = canonical.IMAGE_RADII - 1.0
    out = []
    for wall, flank, decay, sharpness in product(_WALL_SLOPES, _FLANK_SLOPES, _DECAYS, _SHARPNESSES):
        share = 1.0 / (1.0 + np.exp(-sharpness * x) * flank / wall)
        rising = wall * np.minimum((1.0 + x) / _FLOOR_RADIUS, 1.0)
        out.append((1.0 - share) * rising - share * flank * np.exp(-decay * np.maximum(x, 0.0)))
    return out


@cache
def _canonical() -> FloatArray:
    return canonical.seen_ground(0.0)[2]


@cache
def _of_canonical(radius_px: float) -> _Seen:
    return _seen(_canonical(), radius_px)


def _seen(slope: FloatArray, radius_px: float) -> _Seen:
    options = EdgeOptions()
    smooth = smoothing_px_at(radius_px, options.smoothing_px, options.smoothing_share)
    blurs = np.hypot([0.0, smooth, SECOND_SMOOTHING_FACTOR * smooth], _PSF_PX) / radius_px
    raw, soft, softer = canonical.blurred(slope, blurs)
    place = canonical.crossing(soft, 1.0)
    farther = canonical.crossing(softer, place)
    step = sample_step(radius_px)
    gap, side = (n * step / radius_px for n in flank_samples(radius_px, step, smooth, _PSF_PX))
    near = np.linspace(gap, gap + side, _FLANK_SAMPLES)
    inner, outer = (np.interp(place + s * near, canonical.IMAGE_RADII, raw).mean() for s in (-1.0, 1.0))
    fall = -np.interp(place, canonical.IMAGE_RADII, np.gradient(soft, canonical.STEP_RADII))
    return _Seen(place - 1.0, farther - 1.0, (float(inner), float(outer)), float(fall))
