"""Fit of the constants of `proposal_fit` that need whole rims: python -m craternav_fg.training.rim_fits.

On rendered ground whose rims are known: craters that cut one another on rough ground, smooth and irregular
ones. Fitted are the odds that a fit is a proposed crater's rim, and the errors of proposals that the border
cuts.
"""

import sys

import numpy as np

from craternav_fg.ellipse import axes_of_chart, mean_radius
from craternav_fg.evaluation.detection import GATE_CHI2, SIGMA_PX, gaussian_angle
from craternav_fg.simulation.scenes import HARD, IRREGULAR, MIN_SEMI_MINOR_PX, Ground, Scene, scene
from craternav_fg.training.marked import weights
from craternav_fg.vision.blind_fit import BlindFitter
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.detect import BlindOptions, candidates_in
from craternav_fg.vision.image_sampling import noise_level
from craternav_fg.vision.network_detect import Lit, lit_from, proposal_fitter
from craternav_fg.vision.proposal_fit import (
    beyond_border,
    coarse_covariances,
    distance2,
    first_fits,
    measured,
)
from craternav_fg.vision.proposals import Proposals
from craternav_fg.vision.pyramid import quarters_to_right
from factors.arrays import BoolArray, FloatArray

# Seeds of the scenes of each kind of ground.
SCENES = ((HARD, range(300, 310)), (Ground(), range(320, 324)), (IRREGULAR, range(330, 334)))
# Least quality of a proposal that is fitted.
_LEAST_QUALITY = 0.3
# A proposal is the nearest rim's if the distance of the centres, in radii, and the logarithm of the radii's
# ratio add up to less.
_SAME_RADII = 1.5


def samples(one: Scene) -> tuple[FloatArray, BoolArray]:
    """Fit the proposals in a scene.

    Parameters
    ----------
    one : Scene

    Returns
    -------
    evidence : ndarray, shape (n, 4)
        Share of the normals that agree, scatter in radii, `distance2` from the proposal, 1.
    right : ndarray of bool, shape (n,)
        Whether each fit is a true rim. Fits of rims too small to be known are left out.
    """
    fitter, lit = _proposals(one)
    first, charts = first_fits(fitter, lit.candidates, lit.starts, lit.sun_angles_rad)
    again = [fitter.fit(chart, angle) for chart, angle in zip(charts, lit.sun_angles_rad, strict=True)]
    covariance = coarse_covariances(charts)
    found = [
        (rim, distance2(rim, charts[k], covariance[k]))
        for fits in (first, again)
        for k, rim in enumerate(fits)
        if rim is not None
    ]
    fitted = np.array([rim.fit.chart_px for rim, _ in found])
    evidence = np.array([[*rim.evidence[:2], apart, 1.0] for rim, apart in found])
    sigma = SIGMA_PX / np.sqrt(one.ellipses_px[:, 2] * one.ellipses_px[:, 3])
    angle = gaussian_angle(axes_of_chart(fitted)[:, None], one.ellipses_px[None])
    right = np.min((angle / sigma) ** 2, axis=1, initial=np.inf) < GATE_CHI2
    known = right | (mean_radius(fitted) >= MIN_SEMI_MINOR_PX)
    return evidence[known], right[known]


def cut_errors(one: Scene) -> FloatArray:
    """Compare the proposals that the border cuts, and whose rims cannot be traced, with the true rims.

    Parameters
    ----------
    one : Scene

    Returns
    -------
    ndarray, shape (n, 2)
        Distance of the centre from the nearest rim's, in radii of the image's proposal; logarithm of the
        radii's ratio, dimensionless.
    """
    fitter, lit = _proposals(one)
    found = measured(fitter, lit.candidates, lit.starts, lit.sun_angles_rad)
    true_px = one.ellipses_px
    out = [np.empty((0, 2))]
    for chart in found.charts_px[~found.traced]:
        radius = float(mean_radius(chart))
        apart = np.hypot(*(true_px[:, :2] - chart[:2]).T) / radius
        size = np.log(np.sqrt(true_px[:, 2] * true_px[:, 3]) / radius)
        nearest = int(np.argmin(apart + np.abs(size)))
        same = apart[nearest] + abs(size[nearest]) < _SAME_RADII
        if same and beyond_border(chart, one.image.shape).any():
            out.append(np.array([[apart[nearest], size[nearest]]]))
    return np.concatenate(out)


def _proposals(one: Scene) -> tuple[BlindFitter, Lit]:
    """Return the proposals in a scene, and what traces their rims."""
    everywhere, pixels = filled(brightness(one.image))
    options = BlindOptions()
    proposals = Proposals(everywhere, options.min_radius_px, options.max_radius_share * min(everywhere.shape))
    quarters = quarters_to_right(one.sun_angle_rad)
    lit = lit_from(everywhere, proposals, candidates_in(everywhere, options), quarters, np.inf)
    lit = lit.likely(_LEAST_QUALITY)
    return proposal_fitter(pixels, lit, noise_level(everywhere), options), lit


def main() -> None:
    """Print the constants."""
    rendered = [scene(seed, ground) for ground, seeds in SCENES for seed in seeds]
    evidence, right = (np.concatenate(v) for v in zip(*map(samples, rendered), strict=True))
    found = weights(evidence, right)
    # Of one of two coordinates, and of one semi-axis, if the two are independent, as in `judgement`.
    cut = np.sqrt(np.mean(np.concatenate([cut_errors(one) for one in rendered]) ** 2, axis=0) * [0.5, 2.0])
    sys.stdout.write(
        f"{len(right)} fits, {right.mean():.1%} right\n"
        f"proposal_fit.RIM_WEIGHTS {found[:-1].round(2).tolist()}, RIM_OFFSET {found[-1]:.2f}\n"
        f"proposal_fit.CUT_SIGMA_RADII {cut.round(2).tolist()}\n"
    )


if __name__ == "__main__":
    main()
