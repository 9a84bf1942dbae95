"""Numbers behind the covariance of a fitted ellipse that follow from Gaussian errors alone.

With Tukey's psi(e) = e (1 - (e / c)^2)^2, 0 from c on, and m = E[psi'] the moments are E[psi^2] / m^2,
E[psi' e^2] / m, E[psi psi' e] / m^2 and Var[psi'] / m^2, by numerical integration. Two more are found by
drawing: the relative variance of the estimated scatter, with the cut-off at a multiple of the median
deviation; and the mean of the inverse of the outline's estimated variance, over the inverse of its mean, of
rims of which a third or less is not seen.
"""

import numpy as np

from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_axes, points_and_normals
from craternav_fg.vision import ellipse_bias, ellipse_kernel
from craternav_fg.vision.ellipse_fit import FitOptions, RimFit, refine_rim
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.robust_scale import MAD_TO_SIGMA
from factors.arrays import FloatArray

# Seed; samples, and points of each, from which the moments are taken.
_SEED = 600
_SAMPLES, _POINTS = 20_000, 400
# Rims, their points, deviation of the outline in radii and error of the points, px, and seen share.
_RIMS, _RIM_POINTS, _OUTLINE_SHARE, _POINT_SIGMA_PX, _SEEN = 3000, 90, 0.02, 0.1, (2.0 / 3.0, 1.0)
_AXES_PX = (300.0, 400.0, 30.0, 26.0, 0.4)
_CAMERA = Camera(1000, 1000, 1000.0, 1000.0, 0.0, 0.0)
_HALF_DIGIT = 5e-5


def robust_moments() -> list[Regenerated]:
    """Regenerate the moments of `ellipse_bias` and `ellipse_kernel`, and `OUTLINE_VARIANCE_FACTOR`.

    Returns
    -------
    list of Regenerated
    """
    e = np.linspace(-9.0, 9.0, 200_001)
    weight = np.exp(-0.5 * e**2)
    weight /= weight.sum()
    psi, slope = _tukey(e, 1.0)
    m = weight @ slope
    moments = {
        "ellipse_bias.PSI_VARIANCE": (ellipse_bias.PSI_VARIANCE, weight @ psi**2 / m**2),
        "ellipse_bias.PSI_CURVATURE": (ellipse_bias.PSI_CURVATURE, weight @ (slope * e**2) / m),
        "ellipse_bias.PSI_MIXED": (ellipse_bias.PSI_MIXED, weight @ (psi * slope * e) / m**2),
        "ellipse_kernel.PSI_SLOPE_VARIANCE": (
            ellipse_kernel.PSI_SLOPE_VARIANCE, weight @ slope**2 / m**2 - 1.0,
        ),
    }  # fmt: skip
    exact = [
        Regenerated(name, shipped, float(value), _HALF_DIGIT, Relation.EXACT)
        for name, (shipped, value) in moments.items()
    ]
    return [*exact, _scale_variance(), _outline_factor()]


def _tukey(e: FloatArray, sigma: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Values of psi and of its slope at errors, cut off at a multiple of a standard deviation."""
    t2 = (e / (ellipse_kernel.TUKEY_SIGMAS * np.asarray(sigma))) ** 2
    inside = t2 < 1.0
    return inside * e * (1.0 - t2) ** 2, inside * (1.0 - t2) * (1.0 - 5.0 * t2)


def _scale_variance() -> Regenerated:
    e = np.random.default_rng(_SEED).standard_normal((_SAMPLES, _POINTS))
    psi, slope = _tukey(e, MAD_TO_SIGMA * np.median(np.abs(e), axis=1, keepdims=True))
    sigma2 = np.sum(psi**2, axis=1) / np.sum(slope, axis=1) ** 2
    deviation2 = _POINTS * (sigma2 / sigma2.mean() - 1.0) ** 2
    sampling = deviation2.std() / np.sqrt(_SAMPLES)
    shipped = ellipse_kernel.SCALE_VARIANCE
    return Regenerated("ellipse_kernel.SCALE_VARIANCE", shipped, float(deviation2.mean()), float(sampling))


def _outline_factor() -> Regenerated:
    rng = np.random.default_rng(_SEED)
    chart = chart_of_axes(_AXES_PX)
    orders = np.arange(ellipse_kernel.FIRST_HARMONIC, ellipse_kernel.LAST_HARMONIC + 1)
    amplitude = _OUTLINE_SHARE * np.sqrt(ellipse_kernel.HARMONIC_VARIANCE_SHARE[::2])
    options = FitOptions(outline_share=GuidedOptions().fit.outline_share)
    found = []
    for _ in range(_RIMS):
        t = np.linspace(0.0, 2.0 * np.pi * rng.uniform(*_SEEN), _RIM_POINTS, endpoint=False)
        points, normals = points_and_normals(chart, t)
        share = (np.cos(np.outer(t, orders)) * amplitude) @ rng.standard_normal(len(orders))
        share += (np.sin(np.outer(t, orders)) * amplitude) @ rng.standard_normal(len(orders))
        error = rng.normal(0.0, _POINT_SIGMA_PX, (_RIM_POINTS, 1))
        outlined = chart[:2] + (1.0 + share[:, None]) * (points - chart[:2]) + error * normals
        fit = refine_rim(outlined, chart, _CAMERA, options, np.ones(_RIM_POINTS))
        if isinstance(fit, RimFit):
            found.append(fit.outline_share**2)
    variance = np.array(found)
    inverse = variance.mean() / variance
    sampling = float(inverse.std() / np.sqrt(len(inverse)))
    shipped = ellipse_kernel.OUTLINE_VARIANCE_FACTOR
    return Regenerated("ellipse_kernel.OUTLINE_VARIANCE_FACTOR", shipped, float(inverse.mean()), sampling)
