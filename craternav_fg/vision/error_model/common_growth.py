"""Growth that all rims of a frame have in common, and arcs without it.

The edge of a rim is found where the blurred crest is as bright as flat ground: outside of the crest, by an
amount that depends on the crest's profile and on the point-spread function, alike for the craters of a
region. A whole rim is too large then, but its centre is right, and centres determine the pose. An arc has no
centre. The image's border leaves the side of a rim that faces the middle of the image: with rims too large,
all arcs claim an image of smaller scale, taken from higher up. The frame's whole rims show the growth.
"""

from typing import NamedTuple

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import RimSet
from craternav_fg.vision.error_model.correlated import in_plane_slopes, radii_px
from craternav_fg.vision.pose_correction import beside_pose
from factors.arrays import FloatArray
from factors.kernels import conic

# Prior standard deviations of the growth: px, and share of the radius. Wide, as the profiles of crests differ
# from world to world: with several rims they hardly matter.
_SIGMA_PX, _SIGMA_SHARE = 0.2, 0.005
# Columns of `in_plane_slopes` that are the growth of the two semi-axes.
_GROWTH = [2, 4]


class CommonGrowth(NamedTuple):
    """Growth of the radius that the rims of a frame have in common.

    Attributes
    ----------
    mean : ndarray, shape (2,)
        px, and share of the radius.
    covariance : ndarray, shape (2, 2)
    """

    mean: FloatArray
    covariance: FloatArray

    def shares(self, radius_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the growth of rims, as a share of their radius.

        Parameters
        ----------
        radius_px : ndarray, shape (n,)

        Returns
        -------
        share, sigma : ndarray, shape (n,)
        """
        weights = np.stack([1.0 / radius_px, np.ones_like(radius_px)], axis=1)
        variance = np.einsum("ni,ij,nj->n", weights, self.covariance, weights)
        return weights @ self.mean, np.sqrt(variance)


def common_growth(
    rims: RimSet, gTb: FloatArray, predicted: FloatArray, prior: FloatArray, camera: Camera, catalog: Catalog
) -> CommonGrowth:
    """Estimate the common growth of a frame's rims, together with the pose.

    Parameters
    ----------
    rims : RimSet
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m, at which the rims are linearised.
    predicted : ndarray, shape (4, 4)
        Predicted pose of the body in g, m.
    prior : ndarray, shape (6, 6)
        Its covariance, of the right twist: rad, then m in b.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    CommonGrowth
    """
    rows = rims.craters
    charts, H, _ = conic.chart_jacobian(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    share = in_plane_slopes(rows, gTb, camera, catalog)[:, :, _GROWTH].sum(axis=2)
    px = share / radii_px(rows, gTb, camera, catalog)[:, None]
    both = np.zeros((8, 8))
    both[:6, :6] = prior
    both[[6, 7], [6, 7]] = _SIGMA_PX**2, _SIGMA_SHARE**2
    slopes = np.concatenate([H, px[:, :, None], share[:, :, None]], axis=2)
    return CommonGrowth(*beside_pose(predicted, both, gTb, slopes, rims.chart - charts, rims.covariance))


def without_growth(points_px: FloatArray, centre_px: FloatArray, share: float) -> FloatArray:
    """Move edge points to where they would be without the growth of their rim.

    Parameters
    ----------
    points_px : ndarray, shape (n, 2)
    centre_px : ndarray, shape (2,)
        Centre of the rim's image.
    share : float
        Growth of the rim, as a share of its radius.

    Returns
    -------
    ndarray, shape (n, 2)
    """
    return np.asarray(centre_px + (points_px - centre_px) / (1.0 + share))
