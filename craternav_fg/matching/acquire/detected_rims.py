"""Rims of an image without a prediction, as acquisition uses them; see `vision.detect`."""

from dataclasses import dataclass

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import normalised_chart
from craternav_fg.vision.detect import BlindOptions
from craternav_fg.vision.ellipse_fit import FitOptions
from craternav_fg.vision.grey import GreyArray
from craternav_fg.vision.network_detect import find_rims_network
from factors.arrays import FloatArray

# Detection for acquisition: larger standard deviations than for navigation, so that a wrong rim cannot
# outweigh right ones, and craters of up to about a third of the image across.
COARSE = BlindOptions(max_radius_share=0.16, fit=FitOptions(floor_px=0.5, floor_share=0.02))


@dataclass(frozen=True)
class DetectedRims:
    """Rims found in an image, the largest first.

    Attributes
    ----------
    charts_px : ndarray, shape (n, 5)
        Ellipse charts in pixels.
    charts : ndarray, shape (n, 5)
        The same in normalised image coordinates.
    covariance : ndarray, shape (n, 5, 5)
        Covariance of `charts`.
    sunward_rad : ndarray, shape (n,)
        Direction in the image, from x towards y, in which each crater's wall is darkest.
    """

    charts_px: FloatArray
    charts: FloatArray
    covariance: FloatArray
    sunward_rad: FloatArray

    def __len__(self) -> int:
        return len(self.charts)


def detect_rims(image: GreyArray, camera: Camera, options: BlindOptions = COARSE) -> DetectedRims:
    """Detect rims without a prediction.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels up to 255.
    camera : Camera
        Without distortion.
    options : BlindOptions, optional

    Returns
    -------
    DetectedRims
        Possibly empty.
    """
    found = find_rims_network(image, options=options)
    found = found.take(found.traced)
    order = np.argsort(-(found.charts_px[:, 2] + found.charts_px[:, 4]), kind="stable")
    charts_px = found.charts_px[order]
    charts, scale = normalised_chart(charts_px, camera)
    covariance = found.covariance_px[order] * np.outer(scale, scale)
    return DetectedRims(charts_px, charts, covariance, found.local_sun_angles_rad[order])
