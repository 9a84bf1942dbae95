"""Relative error of the reference brightness at a rim: of the guided front end's map, of rings around it.

Rendered ground has no albedo: for the map, whose other errors are small, the fit is a lower bound.
"""

import numpy as np

from craternav_fg.calibration.likelihood import Parameter, estimate
from craternav_fg.calibration.regenerated import Regenerated, Relation
from craternav_fg.calibration.rendered_scenes import GROUNDS, scenes, true_reference_brightness
from craternav_fg.ellipse import chart_of_axes
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.simulation.scenes import Scene
from craternav_fg.vision.blind_fit import BRIGHTNESS_SIGMA
from craternav_fg.vision.blind_kernel import ring_brightness
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from factors.arrays import FloatArray


def reference_brightness() -> list[Regenerated]:
    """Regenerate `GuidedOptions.brightness_sigma_share` and `blind_fit.BRIGHTNESS_SIGMA`.

    Returns
    -------
    list of Regenerated
    """
    every = [_errors(one) for ground in GROUNDS for one in scenes(ground)]
    mapped, rings = ([errors[k] for errors in every] for k in (0, 1))
    shipped = GuidedOptions().brightness_sigma_share
    return [
        Regenerated("GuidedOptions.brightness_sigma_share", shipped, *_sigma(mapped), Relation.AT_LEAST),
        Regenerated("blind_fit.BRIGHTNESS_SIGMA", BRIGHTNESS_SIGMA, *_sigma(rings)),
    ]


def _sigma(errors: list[FloatArray]) -> tuple[float, float]:
    """Estimate the standard deviation of errors about 0, given by scene."""

    def costs(values: FloatArray) -> FloatArray:
        return np.array([np.sum(np.log(values[0]) + 0.5 * (e / values[0]) ** 2) for e in errors])

    values, sigmas = estimate(costs, [Parameter(BRIGHTNESS_SIGMA)])
    return float(values[0]), float(sigmas[0])


def _errors(one: Scene) -> tuple[FloatArray, FloatArray]:
    """Relative errors (n,) of the two, at a scene's wanted rims."""
    image = one.image.astype(np.float32)
    true = true_reference_brightness(one)
    rows, ellipses = one.craters[one.wanted], one.ellipses_px[one.wanted]
    view = one.gTb[:3, 3] - one.catalog.centres[rows]
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    law, _ = flat_terrain_brightness(one.catalog.normals[rows], one.sun_g, view)
    ratio = ReferenceBrightness(image, one.camera, one.catalog.body.radius_m, one.gTb, one.sun_g)
    mapped = law * ratio.ratio(one.camera.normalised(ellipses[:, :2]))
    rings = np.array([ring_brightness(image, chart) for chart in chart_of_axes(ellipses)])
    return mapped / true - 1.0, rings / true - 1.0
