"""What identification is given of one image, and the searches of its distinct rims."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.errors import EstimationError
from craternav_fg.matching.identify.expansion import Expanded, Search
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.view import distinct_rows, view_of
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps
from factors.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Given:
    """The rims of an image and all that is known of it; see `search.identify`.

    Attributes
    ----------
    ellipses_px : ndarray, shape (n, 5)
    camera : Camera
    index : TripleIndex
    attitude : KnownAttitude or None
    options : IdentifyOptions
    quality : ndarray, shape (n,), or None
    maps : ShadingMaps
    traced : ndarray of bool, shape (n,), or None

    Raises
    ------
    EstimationError
        When an ellipse has a number that is not finite or an axis that is not positive.
    """

    ellipses_px: FloatArray
    camera: Camera
    index: TripleIndex
    attitude: KnownAttitude | None = None
    options: IdentifyOptions = IdentifyOptions()
    quality: FloatArray | None = None
    maps: ShadingMaps = NO_SHADING
    traced: npt.NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.ellipses_px).all() and (self.ellipses_px[:, 2:4] > 0.0).all()):
            raise EstimationError("ellipses: expected finite numbers and positive axes")

    @cached_property
    def once(self) -> npt.NDArray[np.int64]:
        """Rows (m,) of the distinct rims."""
        return distinct_rows(self.ellipses_px)

    def search(self, size_factor: float) -> Search:
        """Prepare a search of the distinct rims.

        Parameters
        ----------
        size_factor : float
            Sizes in the image over those on the map, one of the options' plain or fine ones.

        Returns
        -------
        Search
        """
        options, once = self.options, self.once
        view = view_of(
            self.ellipses_px[once] / [1.0, 1.0, size_factor, size_factor, 1.0], self.camera,
            options.size_sigma_share, options.centre_share,
            None if self.quality is None else self.quality[once],
            None if self.traced is None else self.traced[once],
        )  # fmt: skip
        ways = 1
        if size_factor != options.size_factors[0]:
            coarse = size_factor in options.size_factors
            ways = len(options.size_factors if coarse else options.fine_size_factors)
        log_ways = float(np.log(ways))
        return Search(view, self.index, self.attitude, self.camera, options, self.maps, log_ways)

    def at_other_sizes(
        self, gTc: FloatArray, match: IntArray, sigma_px: float
    ) -> tuple[Expanded, Search] | None:
        """Expand a pose with sizes in the image over those on the map that a search does not try.

        Parameters
        ----------
        gTc : ndarray, shape (4, 4)
        match : ndarray of int, shape (m,)
            Row of each distinct rim's crater, -1 for none.
        sigma_px : float
            Noise of the centres at that pose.

        Returns
        -------
        tuple of Expanded and Search, or None
            The pose with the most evidence, and the search that expanded it; None if all fail.
        """
        options = self.options
        noise = min(options.noise_levels_px, key=lambda level: abs(np.log(level / sigma_px)))
        best: tuple[Expanded, Search] | None = None
        for factor in dict.fromkeys(options.size_factors + options.fine_size_factors):
            search = self.search(factor)
            one = search.expand_from(gTc.copy(), match.copy(), noise)
            if one is not None and (best is None or one.log_ratio > best[0].log_ratio):
                best = one, search
        return None if best is None else (best[1].best_variation(best[0]), best[1])
