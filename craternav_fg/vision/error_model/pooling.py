"""What rims of rough ground usually err by.

Where outlines deviate from ellipses a fit tells its own covariance poorly: from few harmonics, with points
that one frame takes for the rim and the next for something else. So it is several times larger or smaller in
the next frame. A mean over frames would follow those that happen to claim most, and an error that lasts would
be thought to change as its claimed size does. What a crater's rim errs by is therefore taken from all frames
that have shown it, most from those that showed it in the same size and slant.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import shape_change
from craternav_fg.measurements import RimSet
from craternav_fg.vision.error_model.correlated import in_plane_slopes

FloatArray = npt.NDArray[np.float64]

# As many frames as what the rims of the present one err by in the mean counts for.
PRIOR_FRAMES = 2.0


@dataclass(frozen=True)
class PoolingOptions:
    """Which rims are given their usual covariances.

    Attributes
    ----------
    min_outline_share : float
        Those of frames whose median rim deviates by more from an ellipse, in radii.
    memory : float
        Change of a rim's image (`ellipse.shape_change`) over which a frame's weight falls to 1/e.
    """

    min_outline_share: float = 0.003
    memory: float = 1.0


@dataclass(frozen=True)
class _Crater:
    """Sums over frames: weights, lasting and other covariance on the ground; the last frame's chart."""

    weight: float
    lasting: FloatArray
    white: FloatArray
    chart: FloatArray


class PooledErrors:
    """Remembers what rims erred by, frame by frame.

    Parameters
    ----------
    camera : Camera
    catalog : Catalog
    options : PoolingOptions, optional
    """

    def __init__(self, camera: Camera, catalog: Catalog, options: PoolingOptions = PoolingOptions()) -> None:
        self._camera = camera
        self._catalog = catalog
        self._options = options
        self._craters: dict[int, _Crater] = {}

    def pool(self, rims: RimSet, gTb: FloatArray) -> RimSet:
        """Return the rims of the next frame with their usual covariances.

        What lasts of an error is as usual. What does not is as usual at least: a fit that claims less than
        others, of a rim half in the shade, is believed.

        Parameters
        ----------
        rims : RimSet
        gTb : ndarray, shape (4, 4)
            Pose that sees them, about.
        """
        quality = rims.quality
        if rims.correlated is None or quality is None or len(rims) == 0:
            return rims
        if np.median(quality.outline_share) <= self._options.min_outline_share:
            return rims
        slopes = in_plane_slopes(rims.craters, gTb, self._camera, self._catalog)
        inverse = np.linalg.inv(slopes)
        turned = np.swapaxes(inverse, 1, 2)
        root = inverse @ rims.correlated
        lasting, white = root @ np.swapaxes(root, 1, 2), inverse @ rims.uncorrelated_covariance @ turned
        others = lasting.mean(axis=0), white.mean(axis=0)
        for i, crater in enumerate(rims.craters.tolist()):
            one = self._with(crater, rims.chart[i], lasting[i], white[i], others)
            self._craters[crater] = one
            lasting[i] = one.lasting / one.weight
            white[i] = _at_least(one.white / one.weight, white[i])
        correlated = slopes @ np.linalg.cholesky(lasting)
        covariance = slopes @ white @ np.swapaxes(slopes, 1, 2) + correlated @ np.swapaxes(correlated, 1, 2)
        if rims.shared is not None:
            covariance = covariance + rims.shared @ np.swapaxes(rims.shared, 1, 2)
        covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        return replace(rims, covariance=covariance, correlated=correlated)

    def _with(
        self,
        crater: int,
        chart: FloatArray,
        lasting: FloatArray,
        white: FloatArray,
        others: tuple[FloatArray, FloatArray],
    ) -> _Crater:
        """Give a crater's sums with those of a frame; it begins with the mean of the frame's rims."""
        before = self._craters.get(crater)
        if before is None:
            return _Crater(
                1.0 + PRIOR_FRAMES,
                PRIOR_FRAMES * others[0] + lasting,
                PRIOR_FRAMES * others[1] + white,
                chart,
            )
        kept = np.exp(-float(shape_change(before.chart, chart)) / self._options.memory)
        return _Crater(
            1.0 + kept * before.weight, kept * before.lasting + lasting, kept * before.white + white, chart
        )


def _at_least(usual: FloatArray, found: FloatArray) -> FloatArray:
    """Covariance (5, 5) that is `found`, in its principal directions relative to `usual`, but not smaller."""
    L = np.linalg.cholesky(usual)
    inverse = np.linalg.inv(L)
    ratio, directions = np.linalg.eigh(inverse @ found @ inverse.T)
    root = L @ directions
    return np.asarray((root * np.maximum(ratio, 1.0)) @ root.T)
