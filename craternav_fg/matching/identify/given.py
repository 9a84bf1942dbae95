"""What identification is given of one image, and the searches of its distinct rims."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.matching.identify.expansion import Search
from craternav_fg.matching.identify.options import IdentifyOptions
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.matching.identify.view import distinct_rows, view_of
from craternav_fg.measurements import KnownAttitude
from craternav_fg.vision.shading_maps import NO_SHADING, ShadingMaps
from factors.arrays import FloatArray


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
    """

    ellipses_px: FloatArray
    camera: Camera
    index: TripleIndex
    attitude: KnownAttitude | None = None
    options: IdentifyOptions = IdentifyOptions()
    quality: FloatArray | None = None
    maps: ShadingMaps = NO_SHADING
    traced: npt.NDArray[np.bool_] | None = None

    @cached_property
    def once(self) -> npt.NDArray[np.int64]:
        """Rows (m,) of the distinct rims."""
        return distinct_rows(self.ellipses_px)

    def search(self, size_factor: float) -> Search:
        """Prepare a search of the distinct rims.

        Parameters
        ----------
        size_factor : float
            Sizes in the image over those on the map, one of the options'.

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
        ways = 1 if size_factor == options.size_factors[0] else len(options.size_factors)
        log_ways = float(np.log(ways))
        return Search(view, self.index, self.attitude, self.camera, options, self.maps, log_ways)
