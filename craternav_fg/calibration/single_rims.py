"""Errors of single rims, without what the other rims of an image say of them."""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray
from craternav_fg.vision.error_model.correlated import CorrelatedErrorOptions, correlated_roots
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.predicted_rims import predict_rims
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from craternav_fg.vision.reflectance import photometric_law
from craternav_fg.vision.rim_fitting import FittedRims, RimFitter
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims


@dataclass(frozen=True)
class SingleRims:
    """Errors of the rims of an image and what their covariances are made of. Charts are normalised.

    Attributes
    ----------
    error : ndarray, shape (n, 5)
        Measured less true charts.
    rest : ndarray, shape (n, 5, 5)
        Covariance without the part from the unknown level of the ground, with that of what all rims share:
        it is in the errors as well.
    of_scatter, of_rim : ndarray, shape (n, 5, 5)
        That part, for a share of 1 of the scatter of the image's brightness and of that of the levels around
        the rim, see `GuidedOptions`.
    """

    error: FloatArray
    rest: FloatArray
    of_scatter: FloatArray
    of_rim: FloatArray


def fitted_alone(
    image: ImageArray,
    camera: Camera,
    catalog: Catalog,
    poses: tuple[FloatArray, FloatArray],
    sun_g: FloatArray,
) -> SingleRims:
    """Fit the rims of an image near their predictions.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
    camera : Camera
    catalog : Catalog
    poses : tuple of ndarray, shape (4, 4)
        Predicted and true pose of the body in g, less than a pixel apart.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.

    Returns
    -------
    SingleRims
    """
    predicted, true = poses
    options = GuidedOptions()
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    brightness = ReferenceBrightness(pixels, camera, catalog.body.radius_m, predicted, sun_g)
    rows, _ = catalog.visible(
        camera, predicted, min_semi_minor_px=options.min_semi_minor_px, margin_px=options.margin_px
    )
    rims = predict_rims(rows, camera, catalog, predicted, sun_g, brightness)
    brightness = brightness.under(photometric_law(pixels, camera, rims, options.edges))
    rims = predict_rims(rows, camera, catalog, predicted, sun_g, brightness)
    minor_px = np.array([rims.smallest_radius_px(i) for i in range(len(rims))])
    reach_px = options.second_reach_px + options.second_reach_share * minor_px

    def fitted(of_scatter: float, of_rim: float) -> FittedRims:
        shares = replace(options, level_scatter_share=of_scatter, level_rim_share=of_rim)
        fitter = RimFitter(pixels, brightness.noise, brightness.scatter, camera, shares)
        return fitter.fit(rims, reach_px)

    found = fitted(0.0, 0.0)
    rows = found.predicted.rows
    truth = project_rims(true, camera.bTc, catalog.centres[rows], catalog.axes[rows])[0]
    rest = found.errors.covariance
    _, shared = correlated_roots(
        found.errors, rows, true, sun_g, camera, catalog, CorrelatedErrorOptions(brightness_share=0.0)
    )
    return SingleRims(
        found.charts - truth,
        rest + shared @ np.swapaxes(shared, 1, 2),
        fitted(1.0, 0.0).errors.covariance - rest,
        fitted(0.0, 1.0).errors.covariance - rest,
    )
