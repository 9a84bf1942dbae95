"""Pooled covariances: means over the frames that show the same crater.

Where outlines deviate from ellipses, a fit estimates its own covariance poorly: from few harmonics, and with
edge points that one frame assigns to the rim and the next to something else. The estimate is several times
larger or smaller in the next frame. A weighted mean over frames would follow the frames that happen to claim
the smallest covariance, and a time-correlated error would seem to change with its stated size. Therefore a
rim's covariance is pooled over all frames that have shown its crater, those with most weight that showed it
at about the same size and foreshortening.
"""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import shape_change
from craternav_fg.measurements import RimSet
from craternav_fg.vision.error_model.correlated import in_plane_slopes
from factors.arrays import FloatArray

# Weight, in frames, of the mean covariance of a frame's rims in the pool of a crater that is new: one frame
# determines that of a single rim poorly. Chosen, see `craternav_fg.calibration.pooling`.
PRIOR_FRAMES = 2.0
# Rims are pooled in frames whose median rim deviates by more than this from an ellipse, in radii.
MIN_OUTLINE_SHARE = 0.003
# Change of a rim's image (`ellipse.shape_change`) over which a frame's weight falls to 1/e. Fitted by
# `craternav_fg.calibration.pooling`.
MEMORY = 1.0


@dataclass(frozen=True)
class _Pool:
    """Weighted sums over the frames of one crater.

    The sums (3, 5, 5) of the time-correlated covariance, the white one, and the white one of estimators that
    fuse frames are those of errors on the ground, in radii; `chart` (5,) is the rim's in the last frame.
    """

    weight: float
    covariances: FloatArray
    chart: FloatArray


class PooledErrors:
    """Pools of the craters of a descent, updated frame by frame.

    Parameters
    ----------
    camera : Camera
    catalog : Catalog
    """

    def __init__(self, camera: Camera, catalog: Catalog) -> None:
        self._camera = camera
        self._catalog = catalog
        self._pools: dict[int, _Pool] = {}

    def pool(self, rims: RimSet, gTb: FloatArray) -> RimSet:
        """Add the rims of the next frame to the pools, and give them pooled covariances.

        The time-correlated part becomes that of the pool. The white part becomes that of the pool, too, but
        in no direction smaller than the fit claims: a rim half in shadow does have a larger covariance than
        in other frames. So does the white part of estimators that fuse frames (`RimSet.fused_white`).

        Parameters
        ----------
        rims : RimSet
            Returned as it is when it has no correlated errors, no quality, or nearly elliptic outlines.
        gTb : ndarray, shape (4, 4)
            Approximate pose of the body in g that sees them.

        Returns
        -------
        RimSet
        """
        quality = rims.quality
        if rims.correlated is None or quality is None or len(rims) == 0:
            return rims
        if np.median(quality.outline_share) <= MIN_OUTLINE_SHARE:
            return rims
        slopes = in_plane_slopes(rims.craters, gTb, self._camera, self._catalog)
        inverse = np.linalg.inv(slopes)
        root = inverse @ rims.correlated
        correlated = root @ np.swapaxes(root, 1, 2)
        white, fused = (
            inverse @ S @ np.swapaxes(inverse, 1, 2)
            for S in (rims.uncorrelated_covariance, rims.fused_white_covariance)
        )
        own = np.stack([correlated, white, fused], axis=1)
        prior = PRIOR_FRAMES * own.mean(axis=0)
        for i, crater in enumerate(rims.craters.tolist()):
            pool = self._updated(crater, rims.chart[i], own[i], prior)
            self._pools[crater] = pool
            correlated[i], pooled_white, pooled_fused = pool.covariances / pool.weight
            white[i], fused[i] = _at_least(pooled_white, white[i]), _at_least(pooled_fused, fused[i])
        roots = slopes @ np.linalg.cholesky(correlated)
        covariance = slopes @ white @ np.swapaxes(slopes, 1, 2)
        for A in (roots, rims.of_map, rims.shared):
            if A is not None:
                covariance = covariance + A @ np.swapaxes(A, 1, 2)
        covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        fused_white = None if rims.fused_white is None else slopes @ fused @ np.swapaxes(slopes, 1, 2)
        return replace(rims, covariance=covariance, correlated=roots, fused_white=fused_white)

    def _updated(self, crater: int, chart: FloatArray, own: FloatArray, prior: FloatArray) -> _Pool:
        """Add one frame (3, 5, 5) to a crater's pool; a new pool begins with a prior."""
        before = self._pools.get(crater)
        if before is None:
            return _Pool(1.0 + PRIOR_FRAMES, prior + own, chart)
        decay = np.exp(-float(shape_change(before.chart, chart)) / MEMORY)
        return _Pool(1.0 + decay * before.weight, decay * before.covariances + own, chart)


def _at_least(pooled: FloatArray, stated: FloatArray) -> FloatArray:
    """Covariance (5, 5) with the larger variance in each principal direction of one against the other."""
    L = np.linalg.cholesky(pooled)
    inverse = np.linalg.inv(L)
    ratio, directions = np.linalg.eigh(inverse @ stated @ inverse.T)
    root = L @ directions
    return np.asarray((root * np.maximum(ratio, 1.0)) @ root.T)
