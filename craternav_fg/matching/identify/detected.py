"""Identification of rims that were detected, some of them as coarse ellipses only."""

import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.matching.identify.answer import answer
from craternav_fg.matching.identify.given import Given
from craternav_fg.matching.identify.options import Effort, IdentifyOptions
from craternav_fg.matching.identify.result import Identification
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps


def identify_detected(
    ellipses_px: npt.NDArray[np.float64],
    traced: npt.NDArray[np.bool_],
    camera: Camera,
    index: TripleIndex,
    attitude: KnownAttitude | None = None,
    options: IdentifyOptions = IdentifyOptions(),
    quality: npt.NDArray[np.float64] | None = None,
    maps: ShadingMaps = NO_SHADING,
) -> Identification:
    """Identify detected rims: by those that were traced or, where they do not suffice, by all.

    More than a plain search is by all at once.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre x, y, semi-axes, px, and rotation, rad, as in `vision.detect.FoundRims`.
    traced : ndarray of bool, shape (n,)
        Whether each rim was traced; else its ellipse is coarse.
    camera : Camera
    index : TripleIndex
    attitude : KnownAttitude, optional
    options : IdentifyOptions, optional
    quality : ndarray, shape (n,), optional
    maps : ShadingMaps, optional
        See `search.identify`.

    Returns
    -------
    Identification
        With one row for each of the n ellipses.

    Raises
    ------
    EstimationError
        When an ellipse has a number that is not finite or an axis that is not positive.
    """
    if options.effort is not Effort.PLAIN:
        # The traced ones alone would take as long, and rarely answer where the others do not.
        return identify(ellipses_px, camera, index, attitude, options, quality, maps, traced)
    of_traced = None if quality is None else quality[traced]
    found = identify(ellipses_px[traced], camera, index, attitude, options, of_traced, maps)
    if not found.identified and not traced.all():
        all_of = identify(ellipses_px, camera, index, attitude, options, quality, maps, traced)
        return replace(all_of, seconds=found.seconds + all_of.seconds)
    places = np.flatnonzero(traced)
    craters: list[str | None] = [None] * len(ellipses_px)
    rows = np.full(len(ellipses_px), -1)
    rows[places] = found.rows
    for place, name in zip(places.tolist(), found.craters, strict=True):
        craters[place] = name
    found = replace(found, craters=tuple(craters), rows=rows)
    if not found.identified or traced.all():
        return found
    return _with_all(found, Given(ellipses_px, camera, index, attitude, options, quality, maps, traced))


def _with_all(found: Identification, given: Given) -> Identification:
    """Expand an answer to all rims, also those that show only place and size; as it is if that fails."""
    began = time.perf_counter()
    more = given.at_other_sizes(found.gTc, found.rows[given.once], found.sigma_px)
    if more is None or more[0].log_ratio < -found.log_chance:
        return found
    extended = answer(*more, given.once, len(given.ellipses_px), given.camera, began)
    return replace(extended, seconds=found.seconds + extended.seconds)
