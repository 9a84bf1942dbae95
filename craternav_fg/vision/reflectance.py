"""Photometric law of the ground, from how its rims are shaded.

The brightness of a slope changes with the directions to the sun and to the camera in a ratio that depends on
the law. So does the direction, around each rim, in which the step between its flanks is largest. How steep a
crater is, its albedo and the exposure do not matter.
"""

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.photometry import LunarLambert, lunar_lambert_share
from craternav_fg.vision.crest_tables import CrestTables, flank_means
from craternav_fg.vision.edges import EdgeOptions
from craternav_fg.vision.flank_kernel import normal_count, sample_flanks
from craternav_fg.vision.predicted_rims import PredictedRims
from craternav_fg.vision.rim_geometry import rim_point
from craternav_fg.vision.rim_shading import RimShading, normal_view, rim_light, sloping_terms, turned
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Laws that are tried: shares in the middle, with the deviation that is usual, and changes with phase.
_MIDDLE_SHARES, _USUAL_SHARE, _USUAL_SIGMA = np.linspace(-0.5, 1.5, 41), 0.5, 0.25
_PHASE_FACTORS = np.linspace(0.0, 1.0, 5)
# Steepest ground of a crater, and the least cosine of incidence there of walls that are not in the shadow.
_STEEPEST, _LEAST_LIT = 0.8, 0.1
# Neighbouring normals show the same relief: as many count as one. Scatter of the steps, at least.
_ALIKE, _LEAST_SCATTER = 8.0, 0.02


def photometric_law(
    image: ImageArray, camera: Camera, rims: PredictedRims, options: EdgeOptions
) -> LunarLambert:
    """Estimate the photometric law of the ground.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    camera : Camera
    rims : PredictedRims
        To a few pixels.
    options : EdgeOptions

    Returns
    -------
    LunarLambert
        Its mean, given the image and what is usual.
    """
    middle, factor = (a.ravel() for a in np.meshgrid(_MIDDLE_SHARES, _PHASE_FACTORS))
    evidence = -0.5 * ((middle - _USUAL_SHARE) / _USUAL_SIGMA) ** 2
    tables = options.crest_tables(camera.psf_sigma_px)
    for i in range(len(rims)):
        shading = rims.shading(i)
        angles, flanks, _ = sample_flanks(
            image, rims.charts_px[i], shading, options.smoothing_share, options.smoothing_px,
            camera.psf_sigma_px, normal_count(rims.smallest_radius_px(i)), tables, camera.lens,
        )  # fmt: skip
        if len(angles) < 2.0 * _ALIKE:
            continue
        shares = lunar_lambert_share(rims.phase_rad[i], LunarLambert(middle, factor))
        misfits = _misfits(rims.charts_px[i], shading, tables, angles, flanks[:, 0] - flanks[:, 1], shares)
        variance = max(misfits.min() / len(angles), _LEAST_SCATTER**2)
        evidence -= misfits / (2.0 * _ALIKE * variance)
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    return LunarLambert(float(weight @ middle), float(weight @ factor))


@njit(cache=True, error_model="numpy")
def _misfits(
    chart_px: FloatArray, shading: RimShading, tables: CrestTables, angles: FloatArray, steps: FloatArray,
    shares: FloatArray,
) -> FloatArray:  # fmt: skip
    """Squared misfits (m,) of steps (n,) between flanks for shares L (m,), the rim's steepness adjusted."""
    light = rim_light(chart_px, shading)
    q, means = np.empty(6), np.empty((2, 2))
    # Of the steps, and of what the two terms of the law predict for them.
    whole = by_lommel = by_lambert = lommel2 = mixed = lambert2 = 0.0
    flat = sloping_terms(light, 0.0, 1.0, 0.0)
    for i in range(len(angles)):
        rim_point(chart_px, angles[i], q)
        view = normal_view(chart_px, light, shading.curvature_px, angles[i], q)
        # Walls in the shadow tell nothing.
        towards_sun = view.cosine * light.to_sun[0] + view.sine * light.to_sun[1]
        if light.cosines[0] < _STEEPEST * towards_sun + _LEAST_LIT:
            continue
        flank_means(tables, view, q[4], means)
        x, y = turned(view, means[0, 0])
        inner = sloping_terms(light, x, y, means[0, 1])
        x, y = turned(view, means[1, 0])
        outer = sloping_terms(light, x, y, means[1, 1])
        lommel, lambert = inner[0] - outer[0], inner[1] - outer[1]
        whole += steps[i] * steps[i]
        by_lommel += steps[i] * lommel
        by_lambert += steps[i] * lambert
        lommel2 += lommel * lommel
        mixed += lommel * lambert
        lambert2 += lambert * lambert
    out = np.empty(len(shares))
    for k in range(len(shares)):
        a, b = shares[k], 1.0 - shares[k]
        level = a * flat[0] + b * flat[1]
        product = (a * by_lommel + b * by_lambert) / level
        square = (a * a * lommel2 + 2.0 * a * b * mixed + b * b * lambert2) / (level * level)
        out[k] = whole - max(product, 0.0) ** 2 / max(square, 1e-12)
    return out
