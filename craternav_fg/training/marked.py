"""Fit of the quality of proposals: python -m craternav_fg.training.marked FOLDER.

The quality is the probability that people mark a crater. The network's weights are from rendered ground
alone; the four weights that turn its log odds into a probability are from the annotated NAC images. HRSC
images are not used: they show what the probability is worth elsewhere.
"""

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from craternav_fg.dataset.annotated_images import annotated_images
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.evaluation.annotation import match_circles
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.detect import BlindOptions, candidates_in
from craternav_fg.vision.network_detect import lit_from, voted_quarter
from craternav_fg.vision.proposals import Proposals
from factors.arrays import BoolArray, FloatArray

# Kind of the images, and the smallest radii that are searched and fitted, px.
_KIND, _SEARCHED_PX, _FITTED_PX = "nac", 5.0, 6.0


def samples(image: npt.NDArray[np.generic], circles_px: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Propose craters in an image.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        See `brightness.brightness`.
    circles_px : ndarray, shape (m, 3)
        What people marked in the image: centre x, y and radius.

    Returns
    -------
    evidence : ndarray, shape (n, 4)
        See `network_detect.Lit`.
    right : ndarray of bool, shape (n,)
        Whether people marked each.
    """
    everywhere, _ = filled(brightness(image))
    largest = BlindOptions.max_radius_share * min(everywhere.shape)
    proposals = Proposals(everywhere, _SEARCHED_PX, largest)
    matched = candidates_in(everywhere, BlindOptions(min_radius_px=_SEARCHED_PX))
    quarters = proposals.sun_quarter(voted_quarter(matched)).quarters
    lit = lit_from(everywhere, proposals, matched, quarters, np.inf)
    radius = lit.candidates.radius_px
    # Matches go by falling log odds.
    order = np.argsort(-lit.evidence[:, 0], kind="stable")
    ellipses = np.column_stack([lit.candidates.xy_px, radius, radius, np.zeros(len(radius))])[order]
    matches = match_circles(ellipses, lit.evidence[order, 0], circles_px)
    fitted = radius[order] >= _FITTED_PX
    return lit.evidence[order][fitted], np.isfinite(matches.marked_radius_px)[fitted]


def weights(evidence: FloatArray, right: BoolArray) -> FloatArray:
    """Fit the weights of a logistic regression.

    Parameters
    ----------
    evidence : ndarray, shape (n, k)
        Dimensionless.
    right : ndarray of bool, shape (n,)
        Whether people marked each.

    Returns
    -------
    ndarray, shape (k,)
        Dimensionless.
    """

    def cost(of: FloatArray) -> float:
        logit = evidence @ of
        return float(np.mean(np.logaddexp(0.0, np.where(right, -logit, logit))))

    return np.asarray(minimize(cost, np.zeros(evidence.shape[1])).x)


def main(data: Path) -> None:
    """Print the weights.

    Parameters
    ----------
    data : Path
        See `annotated_images`.
    """
    marked = [one for one in annotated_images(data) if one.kind == _KIND]
    parts = [samples(read_foreign_image(one.path), one.circles_px) for one in marked]
    evidence, right = (np.concatenate(values) for values in zip(*parts, strict=True))
    sys.stdout.write(
        f"{len(right)} proposals in {len(marked)} images, {right.mean():.0%} marked\n"
        f"network_detect.QUALITY_WEIGHTS {weights(evidence, right).round(2).tolist()}\n"
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("marked: expected the folder of the annotated images")
    main(Path(sys.argv[1]))
