"""Identification of an image: rims are detected again, under other assumptions, where the first fail.

On real ground, ridges and domes can look like craters that are lit from the opposite side, most craters are
worn, and plains have small ones only. If the rims found at first cannot be identified, those lit from the
opposite side are detected, then unlikely and smaller ones from both sides. If no rims were found at first,
the sides are those of the axis along which the image varies most. Where no rims can be identified at once,
all of them are searched widely, then deeply, in the same order. From the second rims on, the image's shading
where a pose predicts further craters counts, too (`shading`). An answer needs the same evidence each time.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import tee

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.matching.identify.detected import identify_detected
from craternav_fg.matching.identify.options import Effort, IdentifyOptions
from craternav_fg.matching.identify.result import Identification
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.brightness import brightness, filled
from craternav_fg.vision.detect import BlindOptions, FoundRims
from craternav_fg.vision.grey import undistorted
from craternav_fg.vision.network_detect import find_rims_network
from craternav_fg.vision.shading_maps import NO_SHADING, shading_maps, sun_axis

# Sizes of rims in images over those that people trace or the map's circles have, chosen: in 40 images of
# real ground the median logarithm against the circles of LU1319381 was 0.10 to 0.32, mostly 0.15. Of 16
# images, the rims of 14 have enough evidence at the right pose; of 12, 12 and 14 with 1, 1.12 and 1.25 alone;
# of 13 with 1.4 as well.
_SIZE_FACTORS = (1.0, 1.12, 1.25)
# A promising pose is expanded with finer ones, up to those of small craters of plains.
_FINE_SIZE_FACTORS = tuple(np.exp(np.arange(1, 11) * 0.04).tolist())
# And the scatter of the logarithms about that median, which was 0.03 to 0.18; 14 with 0.05 and 0.2, too.
_SIZE_SIGMA = 0.1
# Their centres scatter in proportion to the radius, of any size from 8 to 60 px: by 0.1 of it per coordinate.
# 13 with 0.06 and 0.2; the mean evidence is 108 with this, 106 and 109 with those.
_CENTRE_SHARE = 0.12
# And at least by 0.5 px. A level of 6 px takes most of the time of a search.
_NOISE_LEVELS_PX, _CANDIDATES = (1.0, 3.0), (16, 48)
# Where likelier rims do not suffice: the minimum quality, and the radius of the smallest. Above a plain at
# 200 km few craters are larger. Most of these rims are no craters, but identification knows their quality.
_UNLIKELY = BlindOptions(min_quality=0.05, min_radius_px=5.0)


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
        Except `size_factors`, `fine_size_factors`, `size_sigma_share`, `centre_share`, `noise_levels_px`,
        `candidates` and `effort`.

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
    options = replace(
        options, size_factors=_SIZE_FACTORS, fine_size_factors=_FINE_SIZE_FACTORS,
        size_sigma_share=_SIZE_SIGMA, noise_levels_px=_NOISE_LEVELS_PX, candidates=_CANDIDATES,
        centre_share=_CENTRE_SHARE,
    )  # fmt: skip
    first: tuple[FoundRims, Identification] | None = None
    seconds = 0.0
    maps = NO_SHADING
    for effort, detections in zip(Effort, tee(_detections(image), len(Effort)), strict=True):
        how = replace(options, effort=effort)
        for rims in detections:
            found = identify_detected(
                rims.ellipses_px, rims.traced, camera, index, attitude, how, rims.quality, maps
            )
            seconds += found.seconds
            if found.identified:
                return rims, replace(found, seconds=seconds)
            if first is None:
                first = rims, found
                straight = undistorted(filled(brightness(image))[0], camera)
                maps = shading_maps(np.asarray(straight, np.float32))
    assert first is not None
    return first[0], replace(first[1], seconds=seconds)


def _detections(image: npt.NDArray[np.generic]) -> Iterator[FoundRims]:
    """Detect rims, under the likeliest assumptions first."""
    rims = find_rims_network(image)
    yield rims
    if len(rims.quality):
        towards = float(rims.local_sun_angles_rad[np.argmax(rims.quality)])
        yield find_rims_network(image, towards + np.pi)
    else:
        towards = sun_axis(filled(brightness(image))[0])
    for side in (towards, towards + np.pi):
        yield find_rims_network(image, side, _UNLIKELY)
