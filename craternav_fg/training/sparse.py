"""Fit of the quality where the sun's quarter is in doubt: python -m craternav_fg.training.sparse [TERRAINS].

Where both the sun's quarter and the opposite one show about as many craters, most of them are none. The
annotated images, on which `marked` fits the quality, have many craters and say nothing of it. The weights are
fitted on rendered ground with few craters or none, of seeds that the network was not trained on.
"""

import sys

import numpy as np
from scipy.optimize import minimize

from craternav_fg.evaluation.annotation import match_circles
from craternav_fg.training.light import photograph
from craternav_fg.training.targets import marking
from craternav_fg.training.terrain import sparse_terrain
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.detect import BlindOptions, candidates_in
from craternav_fg.vision.network_detect import QUALITY_WEIGHTS, lit_from, voted_quarter
from craternav_fg.vision.proposals import QUARTERS, SURE_LOG_ODDS, Proposals
from factors.arrays import BoolArray, FloatArray

# Seed, which no training uses, and terrains.
SEED, TERRAINS = 78, 64
# Smallest radius that is searched, px.
_MIN_RADIUS_PX = 6.0


def samples(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Propose craters in a photograph of sparse ground, lit from the sun's quarter and from the opposite one.

    Parameters
    ----------
    rng : Generator

    Returns
    -------
    log_odds : ndarray, shape (n,)
        Logarithm of the odds that each is a crater, if the quarter is certain.
    doubt : ndarray, shape (n,)
        See `network_detect.Lit`; only proposals with any.
    right : ndarray of bool, shape (n,)
        Whether people would mark each.
    """
    ground = sparse_terrain(rng)
    photo = photograph(rng, ground, float(rng.uniform(-np.pi, np.pi)))
    marked = ground.circles_px[rng.random(len(ground.circles_px)) < marking(ground, photo)]
    everywhere, _ = filled(brightness(photo.image))
    options = BlindOptions(min_radius_px=_MIN_RADIUS_PX)
    proposals = Proposals(everywhere, _MIN_RADIUS_PX, options.max_radius_share * min(everywhere.shape))
    matched = candidates_in(everywhere, options)
    found = proposals.sun_quarter(voted_quarter(matched))
    log_odds, doubt, right = [np.empty(0)], [np.empty(0)], [np.empty(0, dtype=np.bool_)]
    if found.log_odds < SURE_LOG_ODDS:
        for quarters, sure in ((found.quarters, found.log_odds), (found.quarters + 2, -found.log_odds)):
            lit = lit_from(everywhere, proposals, matched, quarters % QUARTERS, sure)
            radius = lit.candidates.radius_px
            ellipses = np.column_stack([lit.candidates.xy_px, radius, radius, np.zeros(len(radius))])
            matches = match_circles(ellipses, lit.evidence[:, 0], marked)
            log_odds.append(lit.evidence @ QUALITY_WEIGHTS)
            doubt.append(np.full(len(radius), lit.doubt))
            right.append(np.isfinite(matches.marked_radius_px))
    return np.concatenate(log_odds), np.concatenate(doubt), np.concatenate(right)


def weights(log_odds: FloatArray, doubt: FloatArray, right: BoolArray) -> FloatArray:
    """Fit the weights of the doubt, by logistic regression.

    Parameters
    ----------
    log_odds, doubt : ndarray, shape (n,)
        See `samples`.
    right : ndarray of bool, shape (n,)

    Returns
    -------
    ndarray, shape (2,)
        Of the doubt times the logarithm of the odds, and of the doubt; dimensionless.
    """

    def cost(of: FloatArray) -> float:
        logit = log_odds + doubt * (of[0] * log_odds + of[1])
        return float(np.mean(np.logaddexp(0.0, np.where(right, -logit, logit))))

    return np.asarray(minimize(cost, np.zeros(2)).x)


def main(terrains: int = TERRAINS) -> None:
    """Print the weights.

    Parameters
    ----------
    terrains : int
    """
    parts = [samples(np.random.default_rng([SEED, k])) for k in range(terrains)]
    log_odds, doubt, right = (np.concatenate(values) for values in zip(*parts, strict=True))
    sys.stdout.write(
        f"{len(right)} proposals, {right.sum()} craters\n"
        f"network_detect.DOUBT_WEIGHTS {weights(log_odds, doubt, right).round(2).tolist()}\n"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
