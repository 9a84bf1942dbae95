"""How rims are detected: the method and its options, in a form that goes to workers and into a folder."""

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

import craternav_fg
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import BlindOptions, FoundRims, find_rims
from craternav_fg.vision.network_detect import find_rims_network


class Method(StrEnum):
    """Blind detectors."""

    NETWORK = "network"
    TEMPLATE = "template"
    CANNY = "canny"


_DETECTORS = {
    Method.NETWORK: find_rims_network,
    Method.TEMPLATE: find_rims,
    Method.CANNY: find_rims_canny,
}


@dataclass(frozen=True)
class DetectionSettings:
    """What is searched.

    Attributes
    ----------
    method : Method
    sun_deg : float, optional
        Direction towards the sun in the image, from x towards y; found in the image if not given.
    min_radius_px : float
        Radius of the smallest craters.
    min_quality : float
        Minimum quality of a rim.
    """

    method: Method = Method.NETWORK
    sun_deg: float | None = None
    min_radius_px: float = BlindOptions.min_radius_px
    min_quality: float = BlindOptions.min_quality

    @property
    def sun_rad(self) -> float | None:
        """Given direction towards the sun, rad."""
        return None if self.sun_deg is None else math.radians(self.sun_deg)

    def identity(self) -> dict[str, Any]:
        """Return everything that determines a result but the image, as JSON can carry it.

        Returns
        -------
        dict
        """
        return {**asdict(self), "method": self.method.value, "version": craternav_fg.__version__}

    def detect(
        self, pixels: npt.NDArray[np.generic], sun_rad: float | None, options: BlindOptions | None = None
    ) -> FoundRims:
        """Detect the rims of an image on one core.

        Parameters
        ----------
        pixels : ndarray, shape (H, W) or (H, W, channels)
        sun_rad : float, optional
            Direction towards the sun in the image, from x towards y.
        options : BlindOptions, optional
            Other ones than those of the settings.

        Returns
        -------
        FoundRims
        """
        return _DETECTORS[self.method](pixels, sun_rad, options or self.options())

    def options(self) -> BlindOptions:
        """Return the options of the detectors."""
        return BlindOptions(min_radius_px=self.min_radius_px, min_quality=self.min_quality)


def use_one_thread() -> None:
    """Leave the other cores to other workers: those of a cluster are not started by this program."""
    cv2.setNumThreads(1)
