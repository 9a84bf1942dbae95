"""Measurements of a frame, linearised at a pose and whitened: rims, arcs of rims, sun tilt."""

from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import conics_of_charts
from craternav_fg.estimators import filter_kernel
from craternav_fg.estimators.rim_models import RimModel, rim_factors
from craternav_fg.linalg import whitening
from craternav_fg.measurements import ArcSet, RimSet, SunTilt
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.custom import Loss
from factors.kernels import rim, robust, shape, sun

NoiseModel = Literal["measured", "fixed"]

# Covariance of (A, ..., F) in 4.2.3, taken for conics with |q| = 1. Table 2 gives A and C errors of
# 2e-3 to 3e-3 and F errors of 1e-5: A and C are then of order one and F of the order of a squared image
# size, which also A + C = 1 would give (a factor of 1.4), but not F = 1.
PAPER_NOISE = np.diag([2.5e-5, 1.5e-4, 2.5e-5, 1.5e-6, 1.5e-6, 1.5e-8])


@dataclass(frozen=True)
class LinearMeasurement:
    """A linear, whitened measurement: residual = A error + white unit noise.

    Attributes
    ----------
    A : ndarray, shape (m, k)
        Derivatives in the first k entries of the error state; the others do not enter.
    residual : ndarray, shape (m,)
        Measured minus predicted at the linearisation point, whitened.
    """

    A: FloatArray
    residual: FloatArray


def linearise_rims(
    gTb: FloatArray,
    rims: RimSet,
    camera: Camera,
    catalog: Catalog,
    *,
    model: RimModel,
    noise: NoiseModel,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Linearise the rims of a frame at a pose.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    rims : RimSet
        n measured rims.
    camera : Camera
    catalog : Catalog
    model : {"chart", "eq19", "los", "los+shape", "points", "centre"}
        What is compared, see `rim_factors`.
    noise : {"measured", "fixed"}
        Each rim's own covariance, or the paper's Qn: of the chart, or of eq. (19) as an implicit measurement
        (Soatto), with innovation -h and noise D Qn D'. The other models have their own covariance alone.

    Returns
    -------
    A : ndarray, shape (n, m, 6)
        Whitened derivatives in the errors of attitude (in b) and position (in g).
    residual : ndarray, shape (n, m)
        Whitened, measured minus predicted.
    usable : ndarray of bool, shape (n,)
        Rims that are visible ellipses from this pose; the others have zero rows.

    Raises
    ------
    LinAlgError
        When the covariance of a usable rim is not positive definite.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (19), (25);
    docs/equations.md.
    """
    # The whitening of eq. (19) turns with the pose, by as much as a rim's own noise tells of the pose: a
    # filter that holds it at the prediction diverges. The smoothers' factor differentiates it.
    if model != "chart" and not (model == "eq19" and noise == "fixed"):
        return _of_factors(model, gTb, rims, camera, catalog)
    n = len(rims)
    rows = rims.craters
    if model == "chart":
        covariance = rims.covariance
        if noise == "fixed":
            # |q| = 1 makes the columns of dq/dy orthogonal to q: the pseudo-inverse is dy/dq.
            inverse = np.asarray(np.linalg.pinv(conics_of_charts(rims.chart)[1]), dtype=np.float64)
            covariance = inverse @ PAPER_NOISE @ np.swapaxes(inverse, 1, 2)
        A, residual, usable, sound = filter_kernel.whitened_rims(
            gTb, camera.bTc, rows, catalog.centres, catalog.axes, rims.chart, covariance
        )
        if not sound:
            raise np.linalg.LinAlgError("Matrix is not positive definite")
        return A, residual, usable
    centres = catalog.centres[rows]
    conics, _ = conics_of_charts(rims.chart)
    semi_axes = np.stack([catalog.semi_major_m[rows], catalog.semi_minor_m[rows]], axis=-1)
    h, H, D, usable = shape.shape_jacobian(gTb, camera.bTc, centres, catalog.gRl[rows], semi_axes, conics)
    innovation = -h
    covariance = D @ PAPER_NOISE @ np.swapaxes(D, 1, 2)
    A = np.zeros((n, 5, 6))
    residual = np.zeros((n, 5))
    if usable.any():
        A[usable], residual[usable] = _whiten(H[usable], innovation[usable], covariance[usable])
    A[:, :, 3:] = A[:, :, 3:] @ gTb[:3, :3].T
    return A, residual, usable


def _of_factors(
    model: RimModel, gTb: FloatArray, rims: RimSet, camera: Camera, catalog: Catalog
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Linearise the smoothers' factors of a frame's rims, which have the same rows for each rim."""
    n = len(rims)
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(gTb))
    parts = []
    for factor in rim_factors(model, X(0), camera, catalog, rims, gTb, Loss()) if n else []:
        J, residual = factor.linearize(values).jacobian()
        parts.append((J.reshape(n, -1, 6), residual.reshape(n, -1)))
    if not parts:
        return np.zeros((0, 1, 6)), np.zeros((0, 1)), np.zeros(0, dtype=np.bool_)
    A = np.concatenate([J for J, _ in parts], axis=1)
    residual = np.concatenate([r for _, r in parts], axis=1)
    # A rim out of sight has no slope: its rows are zero.
    usable = np.asarray(A.reshape(n, -1).any(axis=1))
    A[:, :, 3:] = A[:, :, 3:] @ gTb[:3, :3].T
    return A, residual, usable


def _whiten(H: FloatArray, innovation: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    # The rows of eq. (19) differ by the square of a length in metres.
    W = whitening(covariance)
    return W @ H, (W @ innovation[:, :, None])[:, :, 0]


def linearise_arcs(
    gTb: FloatArray, arcs: ArcSet, camera: Camera, catalog: Catalog
) -> list[LinearMeasurement]:
    """Linearise arcs at a pose: the distances of their edge points from the predicted rims.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    arcs : ArcSet
    camera : Camera
    catalog : Catalog

    Returns
    -------
    list of LinearMeasurement
        Whitened, in the errors of attitude (in b) and position (in g); one for each arc whose crater the pose
        can see.
    """
    updates = []
    for row, points, sigmas in zip(arcs.craters, arcs.points, arcs.sigmas, strict=True):
        e, J = np.empty(len(points)), np.zeros((len(points), 6))
        rim.rim_residuals(
            gTb, camera.bTc, catalog.centres[row : row + 1], catalog.axes[row : row + 1],
            np.array([0, len(points)]), points, sigmas, np.empty((1, 5, 0)), np.empty(0),
            robust.NONE, 1.0, True, e, J,
        )  # fmt: skip
        if J.any():
            J[:, 3:] = J[:, 3:] @ gTb[:3, :3].T
            updates.append(LinearMeasurement(J, -e))
    return updates


def arc_means(
    gTb: FloatArray, arcs: ArcSet, camera: Camera, catalog: Catalog
) -> tuple[IntArray, list[LinearMeasurement]]:
    """Linearise the mean distance of each arc's points: their errors are largely the same.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    arcs : ArcSet
        With time-correlated errors as white ones, see `ArcSet.inflate_correlated`.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    rows : ndarray of int, shape (k,)
        The arcs whose craters the pose can see.
    means : list of k LinearMeasurement
        One row each, as `linearise_arcs` gives them.
    """
    rows, means = [], []
    for row, sigmas in enumerate(arcs.sigmas):
        share = 1.0 / (sigmas * np.linalg.norm(1.0 / sigmas))
        for points in linearise_arcs(gTb, arcs.take(np.array([row])), camera, catalog):
            rows.append(row)
            means.append(LinearMeasurement(share[None] @ points.A, share[None] @ points.residual))
    return np.array(rows, dtype=np.int64), means


def linearise_sun(gTb: FloatArray, measured: SunTilt | None, camera: Camera) -> LinearMeasurement | None:
    """Linearise the sun's tilt at a pose, eq. (24) in its perspective form.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    measured : SunTilt or None
    camera : Camera

    Returns
    -------
    LinearMeasurement or None
        Whitened, in the errors of attitude (in b) and position (in g); None without a tilt, or where it is
        undefined.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (24); docs/equations.md.
    """
    if measured is None:
        return None
    J = np.zeros((1, 6))
    u, v = measured.point
    tilt, strength = sun.sun_tilt(gTb, camera.bTc, measured.direction, float(u), float(v), J)
    if strength == 0.0:
        return None
    J[:, 3:] = J[:, 3:] @ gTb[:3, :3].T
    residual = np.array([sun.wrap(measured.tilt_rad - tilt)])
    return LinearMeasurement(J / measured.sigma_rad, residual / measured.sigma_rad)
