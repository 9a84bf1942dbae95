"""Hypotheses of the pose from single rims taken for single craters, and their expansion by further rims.

A rim taken for a crater gives the whole pose to a few degrees, with the position of the prior and the
direction of the shading: the line of sight to the crater gives two angles, the shading the third, the ellipse
the range.
"""

from dataclasses import dataclass

import numpy as np

from craternav_fg import frames
from craternav_fg.linalg import scaled_inverse, triads
from factors.arrays import FloatArray, IntArray
from factors.kernels import rim_poses

# Numbers of rims, those that agree best, by which a pose is estimated in the rounds of its expansion: few
# while the pose is uncertain, then all.
_EXPANSION_SIZES = (2, 3, 5, 1000, 1000, 1000)
# Gate on the range by a rim's size: in standard deviations of the prior's position, and an addition to the
# logarithm for the rim's own error.
_RANGE_SIGMAS, _LOG_RANGE_ERROR = 3.5, 0.15
# Bound on comparisons of rims and craters over all hypotheses (some seconds); at least so many are left.
_MOST_COMPARISONS, _LEAST_HYPOTHESES = 1e9, 1000


@dataclass(frozen=True)
class Prior:
    """Predicted pose of the body.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Pose.
    covariance : ndarray, shape (6, 6)
        Covariance of the attitude error (rotation vector in b, rad) and the position error in g, m.
    """

    gTb: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Craters:
    """Craters that may be in the image.

    Attributes
    ----------
    centres : ndarray, shape (n, 3)
        Rim centres in g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes in g, m.
    normals : ndarray, shape (n, 3)
        Outward unit normals in g.
    contrasts : ndarray, shape (n, 3)
        Slope contrasts in g (see `photometry`): the walls are darkest in this direction.
    """

    centres: FloatArray
    axes: FloatArray
    normals: FloatArray
    contrasts: FloatArray


@dataclass(frozen=True)
class Rims:
    """Rims of the image.

    Attributes
    ----------
    charts : ndarray, shape (n, 5)
        Ellipse charts in normalised image coordinates.
    covariance : ndarray, shape (n, 5, 5)
        Covariance of the charts.
    weights : ndarray, shape (n, 5, 5)
        Inverses of the covariances.
    sunward_rad : ndarray, shape (n,)
        Direction in the image in which a crater's wall is darkest.
    sunward_sigma_rad : float
        Standard deviation of each of these directions, whatever the number of rims: a common error.
    """

    charts: FloatArray
    covariance: FloatArray
    weights: FloatArray
    sunward_rad: FloatArray
    sunward_sigma_rad: float


@dataclass(frozen=True)
class Hypotheses:
    """Hypothetical poses.

    Attributes
    ----------
    gTb : ndarray, shape (h, 4, 4)
        Poses.
    covariance : ndarray, shape (h, 6, 6)
        For the right twist [w, rho], rad and m in b, with the pose R exp(w), t + R rho.
    cost : ndarray, shape (h,)
        Squared Mahalanobis norms of correction, rim and shading together: numbers without unit.
    """

    gTb: FloatArray
    covariance: FloatArray
    cost: FloatArray

    def __len__(self) -> int:
        return len(self.gTb)


def poses_of_single_rims(
    prior: Prior, bTc: FloatArray, craters: Craters, rims: Rims, seeds: int, gate: float
) -> Hypotheses:
    """Compute the poses of the largest rims, each taken for each crater, that agree with the prior.

    Parameters
    ----------
    prior : Prior
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    craters : Craters
    rims : Rims
        The largest first.
    seeds : int
        Number of rims that are used.
    gate : float
        Largest cost.

    Returns
    -------
    Hypotheses
    """
    gTc = prior.gTb @ bTc
    position = prior.covariance[3:, 3:]
    sight = craters.centres - gTc[:3, 3]
    range_m = np.linalg.norm(sight, axis=-1)
    sight /= range_m[:, None]
    # Variances of the position over the squared range, along and across the line of sight.
    along2 = np.einsum("ni,ij,nj->n", sight, position, sight) / range_m**2
    aside2 = 0.5 * (np.trace(position) / range_m**2 - along2)
    charts = rims.charts[:seeds]
    ray = np.concatenate([charts[:, :2], np.ones((len(charts), 1))], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    tilt = rims.sunward_rad[: len(charts)]
    sunward = np.stack([np.cos(tilt), np.sin(tilt), np.zeros_like(tilt)], axis=-1)
    # Attitudes (crater, rim) that put the crater on the rim's line of sight, with the shading as it is seen.
    gRc = triads(sight, craters.contrasts)[:, None] @ np.swapaxes(triads(ray, sunward), 1, 2)
    gRb = gRc @ bTc[:3, :3].T
    turn = frames.rotation_log((prior.gTb[:3, :3].T @ gRb).reshape(-1, 3, 3)).reshape(*gRb.shape[:2], 3)
    slack = (aside2 + rims.sunward_sigma_rad**2)[:, None, None] * np.eye(3)
    weight = np.linalg.inv(prior.covariance[:3, :3] + slack)
    cost = np.einsum("nmi,nij,nmj->nm", turn, weight, turn)
    # The solid angle of a rim is its foreshortened area over the squared range.
    area = 2.0 * np.log(range_m) - np.log(
        np.abs(np.sum(sight * craters.normals, axis=-1)) * np.linalg.norm(craters.axes, axis=-1).prod(axis=-1)
    )
    measured = charts[:, 2] + charts[:, 4] + 3.0 * np.log(ray[:, 2])
    off = np.abs(0.5 * (area[:, None] + measured))
    misfit = off > _RANGE_SIGMAS * (np.sqrt(along2) + np.sqrt(aside2))[:, None] + _LOG_RANGE_ERROR
    cost = np.where(misfit, np.inf, cost)
    crater, rim = np.nonzero(cost <= gate)
    # A prediction that says nothing allows every crater for every rim: the likeliest attitudes remain.
    most = max(int(_MOST_COMPARISONS / max(len(rims.charts) * len(craters.centres), 1)), _LEAST_HYPOTHESES)
    if len(crater) > most:
        first = np.sort(np.argsort(cost[crater, rim], kind="stable")[:most])
        crater, rim = crater[first], rim[first]
    start = np.tile(np.eye(4), (len(crater), 1, 1))
    start[:, :3, :3] = gRb[crater, rim]
    start[:, :3, 3] = gTc[:3, 3] - start[:, :3, :3] @ bTc[:3, 3]
    gTb, information, cost = _map_poses(prior, start, bTc, craters, rims, crater[:, None], rim[:, None])
    keep = cost < gate
    return Hypotheses(gTb[keep], scaled_inverse(information[keep]), cost[keep])


def count_explained(
    hypotheses: Hypotheses, bTc: FloatArray, craters: Craters, rims: Rims, reach: FloatArray
) -> IntArray:
    """Count the rims that each hypothesis explains.

    Parameters
    ----------
    hypotheses : Hypotheses
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    craters : Craters
    rims : Rims
    reach : ndarray, shape (2,)
        Largest |u| and |v|, normalised, of craters that are considered.

    Returns
    -------
    ndarray of int, shape (h,)
    """
    return rim_poses.support(
        hypotheses.gTb, hypotheses.covariance, bTc, craters.centres, craters.axes, rims.charts,
        rims.covariance, reach,
    )  # fmt: skip


def expand_inliers(
    prior: Prior, hypotheses: Hypotheses, k: int, bTc: FloatArray, craters: Craters, rims: Rims,
    reach: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray]:  # fmt: skip
    """Re-estimate a hypothesis from the rims that agree with it, with more rims in each round.

    Parameters
    ----------
    prior : Prior
    hypotheses : Hypotheses
    k : int
        The hypothesis.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    craters : Craters
    rims : Rims
    reach : ndarray, shape (2,)
        Largest |u| and |v|, normalised, of craters that are considered.

    Returns
    -------
    gTb : ndarray, shape (4, 4)
        Pose.
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b.
    crater : ndarray of int, shape (n,)
        Row of each rim's crater, or -1.
    """
    pose, covariance = hypotheses.gTb[k : k + 1], hypotheses.covariance[k : k + 1]
    crater = np.full(len(rims.charts), -1, dtype=np.int64)
    for size in _EXPANSION_SIZES:
        crater, distance2 = rim_poses.nearest(
            pose[0], covariance[0], bTc, craters.centres, craters.axes, rims.charts, rims.covariance, reach
        )
        rim = np.argsort(distance2, kind="stable")[:size]
        rim = rim[crater[rim] >= 0]
        if len(rim) < 2:
            break
        pose, found, _ = _map_poses(prior, pose, bTc, craters, rims, crater[rim][None], rim[None])
        covariance = scaled_inverse(found)
    return pose[0], covariance[0], crater


def _map_poses(
    prior: Prior, starts: FloatArray, bTc: FloatArray, craters: Craters, rims: Rims, crater: IntArray,
    rim: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Maximum a posteriori poses (h, 4, 4) of pairs (h, k), information for the right twist, and costs."""
    return rim_poses.map_poses(
        prior.gTb, scaled_inverse(prior.covariance), starts, bTc, craters.centres, craters.axes,
        craters.contrasts, rims.charts, rims.weights, rims.sunward_rad, rims.sunward_sigma_rad**-2.0,
        np.ascontiguousarray(crater), np.ascontiguousarray(rim),
    )  # fmt: skip
