"""Fit of the constants by which proposals are judged: python -m craternav_fg.training.judgement [TERRAINS].

On rendered ground of seeds that the network was not trained on: the standard deviations of circles whose rim
cannot be traced, and the weight of the evidence for the quarter that the sun is in. The quality is fitted by
`marked`, the odds of a rim by `rim_fits`.
"""

import sys
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from craternav_fg.evaluation.annotation import match_circles
from craternav_fg.training.light import photograph
from craternav_fg.training.targets import marking
from craternav_fg.training.terrain import terrain
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.detect import BlindOptions, candidates_in
from craternav_fg.vision.image_sampling import noise_level
from craternav_fg.vision.network_detect import lit_from, proposal_fitter
from craternav_fg.vision.proposal_fit import measured
from craternav_fg.vision.proposals import Proposals, sun_excess
from factors.arrays import BoolArray, FloatArray

# Seed, which no training uses, terrains, and photographs of each.
SEED = 77
TERRAINS, _PHOTOGRAPHS = 24, 2
# Smallest radius that is asked for, and the sides of cut-outs that show the sun's quarter, px.
_MIN_RADIUS_PX, _CUTS_PX = 6.0, (96, 192, 384)
# Directions towards the sun: within a quarter turn about the right.
_MOST_SUN_RAD = 0.25 * np.pi


class Samples(NamedTuple):
    """Proposals in images; n of them, and j cut-outs.

    Attributes
    ----------
    right : ndarray of bool, shape (n,)
        Whether each is a crater that people mark.
    traced : ndarray of bool, shape (n,)
        Whether the rim can be traced: its circle is not used.
    centre_radii : ndarray, shape (n,)
        Distance from the crater's centre, in radii; NaN where there is none.
    log_size : ndarray, shape (n,)
        Logarithm of the proposed radius over the crater's; NaN likewise.
    excess : ndarray, shape (j,)
        Evidence for the sun's quarter against the opposite one, dimensionless.
    """

    right: BoolArray
    traced: BoolArray
    centre_radii: FloatArray
    log_size: FloatArray
    excess: FloatArray


def samples(rng: np.random.Generator) -> list[Samples]:
    """Detect craters in photographs of a terrain.

    Parameters
    ----------
    rng : Generator

    Returns
    -------
    list of Samples
        One for each photograph.
    """
    ground, out = terrain(rng), []
    for _ in range(_PHOTOGRAPHS):
        photo = photograph(rng, ground, float(rng.uniform(-_MOST_SUN_RAD, _MOST_SUN_RAD)))
        # People mark a crater with this probability; those that are buried, not.
        marked = rng.random(len(ground.circles_px)) < marking(ground, photo)
        out.append(_of_image(photo.image, ground.circles_px[marked]))
    return out


def _of_image(image: npt.NDArray[np.uint8], circles_px: FloatArray) -> Samples:
    """Detect craters, the sun being to the right, of which people marked some."""
    everywhere, pixels = filled(brightness(image))
    options = BlindOptions(min_radius_px=_MIN_RADIUS_PX)
    largest = options.max_radius_share * min(image.shape)
    proposals = Proposals(everywhere, _MIN_RADIUS_PX, largest)
    lit = lit_from(everywhere, proposals, candidates_in(everywhere, options), 0, np.inf)
    fitter = proposal_fitter(pixels, lit, noise_level(everywhere), options)
    traced = measured(fitter, lit.candidates, lit.starts, lit.sun_angles_rad).traced
    radius = lit.candidates.radius_px
    ellipses = np.column_stack([lit.candidates.xy_px, radius, radius, np.zeros(len(radius))])
    sure = match_circles(ellipses, lit.evidence[:, 0], circles_px)
    cuts = [
        Proposals(everywhere[:side, :side], _MIN_RADIUS_PX, options.max_radius_share * side)
        for side in _CUTS_PX
    ]
    return Samples(
        np.isfinite(sure.marked_radius_px),
        traced,
        sure.centre_error_px / sure.marked_radius_px,
        np.log(sure.radius_px / sure.marked_radius_px),
        np.array([sun_excess(cut.support(0), cut.support(2)) for cut in cuts]),
    )


def circle_sigmas(found: Samples) -> FloatArray:
    """Compute standard deviations of a centre's coordinate and of a semi-axis, of untraced circles.

    Parameters
    ----------
    found : Samples

    Returns
    -------
    ndarray, shape (2,)
        In radii.
    """
    given = found.right & ~found.traced
    # Of one of two coordinates, and of one semi-axis, if the two are independent: both change the size.
    squares = np.array([0.5 * found.centre_radii[given] ** 2, 2.0 * found.log_size[given] ** 2])
    return np.asarray(np.sqrt(squares.mean(axis=1)))


def sun_weight(found: Samples) -> float:
    """Fit the weight of the evidence for the sun's quarter.

    Parameters
    ----------
    found : Samples
    """

    def cost(weight: FloatArray) -> float:
        return float(np.mean(np.logaddexp(0.0, -weight[0] * found.excess)))

    return float(minimize(cost, np.ones(1)).x[0])


def main(terrains: int = TERRAINS) -> None:
    """Print the constants.

    Parameters
    ----------
    terrains : int
    """
    parts = [one for k in range(terrains) for one in samples(np.random.default_rng([SEED, k]))]
    found = Samples(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    lines = [
        f"{len(found.right)} proposals, {found.right.mean():.0%} craters",
        f"proposal_fit.CIRCLE_SIGMA_RADII {circle_sigmas(found).round(3).tolist()}",
        f"proposals.SUN_EVIDENCE_WEIGHT {sun_weight(found):.2f}",
    ]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
