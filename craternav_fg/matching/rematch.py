"""Another crater for a rim whose match was found wrong: where the pose is known, its image tells which.

A rim with a wrong name is still a rim. From poses that the right ones determine to metres, the catalogue's
craters are predicted far more closely than they lie apart, so its image picks out the crater it is of.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import semi_minor
from craternav_fg.measurements import RimSet

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Craters down to this part of the smallest rim's size, and this far beyond the image's border, are compared.
SMALLER = 0.5
BEYOND_PX = 5.0
NO_CRATER = -1


def rematched(
    rims: RimSet,
    used: npt.NDArray[np.bool_],
    gTb: FloatArray,
    camera: Camera,
    catalog: Catalog,
    limit2: float,
) -> IntArray:
    """Craters that the rims of a frame are of, as seen from a pose.

    Parameters
    ----------
    rims : RimSet
        n rims.
    used : ndarray of bool, shape (n,)
        Rims whose match is right; the crater of one is no other's.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, far better known than a rim alone tells it.
    camera : Camera
    catalog : Catalog
    limit2 : float
        Squared whitened norm, 5 degrees of freedom, beyond which a rim is not of a crater.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the catalogue; `NO_CRATER` for a rim that agrees with no crater that is free, with two of
        them, or with one that another rim agrees with, too.
    """
    out = np.where(used, rims.craters, NO_CRATER)
    rejected = np.flatnonzero(~used)
    if not len(rejected):
        return out
    smallest_px = float(semi_minor(rims.chart[rejected]).min()) * min(camera.fx_px, camera.fy_px)
    rows, charts = catalog.visible(camera, gTb, min_semi_minor_px=SMALLER * smallest_px, margin_px=-BEYOND_PX)
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
