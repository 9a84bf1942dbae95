"""Re-association of rims whose match was rejected.

A rim with a wrong match is still a measured rim. Where the other rims determine the pose to metres, the
catalogue's craters are predicted far more accurately than they lie apart, and the rim's image shows which
crater it is.
"""

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import semi_minor
from craternav_fg.measurements import RimSet
from factors.arrays import BoolArray, FloatArray, IntArray

# Craters are compared down to this share of the smallest rejected rim's semi-minor axis, and up to this far
# beyond the image's border.
MIN_SIZE_SHARE = 0.5
BEYOND_BORDER_PX = 5.0
NO_CRATER = -1


def rematched(
    rims: RimSet,
    used: BoolArray,
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    limit2: float,
) -> IntArray:
    """Associate the rejected rims of a frame with craters, at a known pose.

    Parameters
    ----------
    rims : RimSet
        n rims.
    used : ndarray of bool, shape (n,)
        Rims whose match is right; their craters are not given to others.
    gTb : ndarray, shape (4, 4)
        Pose of the body, known far better than from a single rim.
    camera : Camera
    catalog : Catalog
    limit2 : float
        Largest squared Mahalanobis distance, five degrees of freedom, of a rim from its crater.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the catalogue; `NO_CRATER` for a rim that agrees with no available crater, with two of them,
        or with one that another rejected rim agrees with, too.
    """
    out = np.where(used, rims.craters, NO_CRATER)
    rejected = np.flatnonzero(~used)
    if not len(rejected):
        return out
    smallest_px = float(semi_minor(rims.chart[rejected]).min()) * min(camera.fx_px, camera.fy_px)
    rows, charts = catalog.visible(
        camera, gTb, min_semi_minor_px=MIN_SIZE_SHARE * smallest_px, margin_px=-BEYOND_BORDER_PX
    )
    free = ~np.isin(rows, rims.craters[used])
    rows, charts = rows[free], charts[free]
    off = rims.chart[rejected, None] - charts[None]
    weights = np.linalg.inv(rims.covariance[rejected])
    agree = np.einsum("nki,nij,nkj->nk", off, weights, off) <= limit2
    alone = agree.sum(axis=1) == 1
    for i in np.flatnonzero(alone):
        crater = int(np.argmax(agree[i]))
        if agree[:, crater].sum() == 1:
            out[rejected[i]] = rows[crater]
    return out
