"""Crater rims in an image of which hardly anything is known, as `acquire` needs them: see `detect`."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import normalised_chart
from craternav_fg.vision.detect import BlindOptions, find_rims
from craternav_fg.vision.ellipse_fit import FitOptions
from craternav_fg.vision.grey import GreyArray

FloatArray = npt.NDArray[np.float64]


# Rims count as much less certain than for navigation: here a wrong one must not outweigh a right one.
COARSE = BlindOptions(max_radius_share=0.16, fit=FitOptions(floor_px=0.5, floor_share=0.02))


@dataclass(frozen=True)
class Detections:
    """Rims found in an image, largest first.

    Attributes
    ----------
    charts_px : ndarray, shape (n, 5)
        Ellipse charts in pixels.
    charts, covariance : ndarray, shape (n, 5) and (n, 5, 5)
        The same in normalised coordinates, and what they may be wrong by.
    sunward_rad : ndarray, shape (n,)
        Direction in the image, from x towards y, in which each crater's wall is darkest.
    """

    charts_px: FloatArray
    charts: FloatArray
    covariance: FloatArray
    sunward_rad: FloatArray

    def __len__(self) -> int:
        return len(self.charts)


def detect_rims(image: GreyArray, camera: Camera, options: BlindOptions = COARSE) -> Detections:
    """Find rims without a prediction.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels up to 255.
    camera : Camera
        Without distortion.
    options : BlindOptions, optional

    Returns
    -------
    Detections
        Possibly none.
    """
    found = find_rims(image, options=options)
    order = np.argsort(-(found.charts_px[:, 2] + found.charts_px[:, 4]), kind="stable")
    charts_px = found.charts_px[order]
    charts, scale = normalised_chart(charts_px, camera)
    covariance = found.covariance_px[order] * np.outer(scale, scale)
    return Detections(charts_px, charts, covariance, found.local_sun_angles_rad[order])
