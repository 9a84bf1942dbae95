"""Identification of an image: rims are detected again, under other assumptions, where the first fail.

On real ground, ridges and domes can look like craters that are lit from the opposite side, and most craters
are worn. If the rims found at first cannot be identified, those lit from the opposite side are detected, then
less likely ones from both sides. An answer needs the same evidence each time.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.matching.identify.detected import identify_detected
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.result import Identification
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.detect import BlindOptions, FoundRims
from craternav_fg.vision.network_detect import find_rims_network

# Sizes of rims in images over those that people trace.
_SIZE_FACTORS = (1.0, 1.09)
# Minimum quality of the rims where likelier ones do not suffice: half of them are no craters.
_UNLIKELY = 0.2


def identify_image(
    image: npt.NDArray[np.generic],
    camera: Camera,
    index: TripleIndex,
    attitude: KnownAttitude | None = None,
    options: IdentifyOptions = IdentifyOptions(),
) -> tuple[FoundRims, Identification]:
    """Detect rims in an image and identify them.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, channels)
        Grey levels, see `vision.brightness.brightness`.
    camera : Camera
    index : TripleIndex
    attitude : KnownAttitude, optional
    options : IdentifyOptions, optional
        Except `size_factors` and `deep`.

    Returns
    -------
    FoundRims
        The rims that were identified; without an answer those found at first.
    Identification
        With one row for each of them.

    Raises
    ------
    ValueError
        When the array is no image.
    InputError
        When the network's weights are missing or damaged.
    """
    options = replace(options, size_factors=_SIZE_FACTORS, deep=True)
    first: tuple[FoundRims, Identification] | None = None
    seconds = 0.0
    for rims in _detections(image):
        found = identify_detected(rims.ellipses_px, rims.traced, camera, index, attitude, options)
        seconds += found.seconds
        if found.identified:
            return rims, replace(found, seconds=seconds)
        first = first or (rims, found)
    assert first is not None
    return first[0], replace(first[1], seconds=seconds)


def _detections(image: npt.NDArray[np.generic]) -> Iterator[FoundRims]:
    """Detect rims, under the likeliest assumptions first."""
    rims = find_rims_network(image)
    yield rims
    sides = [float("nan")]
    if len(rims.quality):
        towards = rims.local_sun_angles_rad[np.argmax(rims.quality)]
        sides = [float(towards), float(towards + np.pi)]
        yield find_rims_network(image, sides[1])
    unlikely = BlindOptions(min_quality=_UNLIKELY)
    for towards in sides:
        yield find_rims_network(image, None if np.isnan(towards) else towards, unlikely)
