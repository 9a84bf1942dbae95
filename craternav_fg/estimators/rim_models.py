"""How a frame's rims enter the graph: the paper's measurements and ours, as factors of one pose."""

from typing import Literal, get_args

import gtsam
import numpy as np
from scipy.special import chdtrc, chdtri

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import points_on
from craternav_fg.measurements import RimSet
from factors.arrays import FloatArray
from factors.conic_shape import conic_shape_factor
from factors.crater_centre import crater_centre_factor
from factors.crater_los import crater_los_factor
from factors.custom import Loss
from factors.implicit_shape import implicit_shape_factor
from factors.kernels.rim import rim_distance
from factors.rim_points import rim_points_factor
from factors.shape_beside_los import shape_beside_los_factor

RimModel = Literal["chart", "eq19", "los", "los+shape", "points", "centre"]
RIM_MODELS: tuple[RimModel, ...] = get_args(RimModel)
# Points that stand for a fitted ellipse where no edge points are kept.
POINTS = 32
FULL_DIMENSION = 5


def rim_factors(
    model: RimModel,
    key: int,
    camera: Camera,
    catalog: Catalog,
    rims: RimSet,
    gTb: FloatArray,
    loss: Loss,
) -> list[gtsam.CustomFactor]:
    """Build the factors of a frame's rims.

    Parameters
    ----------
    model : {"chart", "eq19", "los", "los+shape", "points", "centre"}
        The ellipse chart; eq. (19), whitened; the line of sight of the true centre, eq. (11); that with what
        (19) says beside it; points of the fitted ellipse; the image ellipse's centre, taken for the crater's.
    key : int
        Key of the pose gTb.
    camera : Camera
    catalog : Catalog
    rims : RimSet
        n of them, at least one; their covariances are used as they are.
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m, near which the noise of lines of sight is evaluated.
    loss : Loss
        For five dimensions; that of fewer begins at the same probability.

    Returns
    -------
    list of gtsam.CustomFactor

    References
    ----------
    Tian et al. (2019), eqs. (10), (11) and (19), DOI 10.1017/S0373463318000966.
    """
    centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
    bTc, S = camera.bTc, rims.covariance
    gRc = camera.gTc(gTb)[:3, :3]
    match model:
        case "chart":
            return [conic_shape_factor(key, bTc, centres, axes, rims.chart, S, loss)]
        case "eq19":
            return [implicit_shape_factor(key, bTc, centres, axes, rims.chart, S, loss)]
        case "points":
            points, sigmas = equivalent_points(rims)
            return [rim_points_factor(key, bTc, centres, axes, points, sigmas, _of_mean(loss))]
        case "centre":
            seen = rims.centres()
            return [crater_centre_factor(key, bTc, centres, seen.points, seen.covariance, loss)]
    normals = catalog.normals[rims.craters]
    out = [crater_los_factor(key, bTc, centres, normals, rims.chart, S, gRc, _of_dimension(loss, 2))]
    if model == "los+shape":
        beside = _of_dimension(loss, 3)
        out.append(shape_beside_los_factor(key, bTc, centres, axes, rims.chart, S, gRc, beside))
    return out


def equivalent_points(rims: RimSet) -> tuple[list[FloatArray], list[FloatArray]]:
    """Points of the fitted ellipses, with the noise that gives a fit their covariance in the mean.

    Parameters
    ----------
    rims : RimSet
        n of them.

    Returns
    -------
    points : list of n ndarray, shape (32, 2)
        Normalised image coordinates of c.
    sigmas : list of n ndarray, shape (32,)
        Along the normal, normalised.
    """
    outlines = points_on(rims.chart, POINTS)
    out = []
    slope = np.empty(FULL_DIMENSION)
    for chart, S, outline in zip(rims.chart, rims.covariance, outlines, strict=True):
        N = np.zeros((FULL_DIMENSION, FULL_DIMENSION))
        for x, y in outline:
            rim_distance(x, y, chart, slope)
            N += np.outer(slope, slope)
        # The determinants of S and of sigma^2 N^-1 agree: neither an axis nor a unit is preferred.
        log_sigma2 = (np.linalg.slogdet(S)[1] + np.linalg.slogdet(N)[1]) / FULL_DIMENSION
        out.append(np.full(POINTS, np.exp(0.5 * log_sigma2)))
    return list(outlines), out


def _of_dimension(loss: Loss, dimension: int) -> Loss:
    """Return the loss that begins at the same probability in fewer dimensions."""
    beyond = chdtrc(FULL_DIMENSION, loss.scale_sigmas**2)
    return Loss(loss.kind, float(np.sqrt(chdtri(dimension, beyond))))


def _of_mean(loss: Loss) -> Loss:
    """Return the loss on the root mean square of a rim's whitened distances.

    Of points on the fitted ellipse the five dimensions of its error remain, spread over all of them.
    """
    return Loss(loss.kind, loss.scale_sigmas / float(np.sqrt(POINTS)))
