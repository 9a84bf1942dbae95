"""Poses from rims that are not yet matched to craters: hypotheses, and how they grow.

One rim taken for one crater gives, with the sun's direction and a prior position, the whole pose to a
few degrees: the line of sight to the crater fixes two angles, the sun the third, the ellipse the rest.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.linalg import scaled_inverse, triads
from factors.kernels import rim_poses

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Rims that are let in as a pose grows.
_GROWTH = (2, 3, 5, 1000, 1000, 1000)


@dataclass(frozen=True)
class Prior:
    """A pose and its covariance.

    Attributes
    ----------
    gTb : ndarray, shape (4, 4)
        Of the lander.
    covariance : ndarray, shape (6, 6)
        Attitude error (rotation vector in b, rad), position error in g, m.
    """

    gTb: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Craters:
    """Craters that may be in the image.

    Attributes
    ----------
    centres, axes, normals : ndarray, shapes (n, 3), (n, 2, 3), (n, 3)
        As in the catalogue, in g.
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
    charts, covariance, weights : ndarray, shapes (n, 5), (n, 5, 5), (n, 5, 5)
        Ellipse charts in normalised coordinates, their covariances and inverses of these.
    sunward_rad : ndarray, shape (n,)
        Direction in the image in which a crater's wall is darkest.
    sunward_sigma_rad : float
        Standard deviation of all of them in common.
    """

    charts: FloatArray
    covariance: FloatArray
    weights: FloatArray
    sunward_rad: FloatArray
    sunward_sigma_rad: float


@dataclass(frozen=True)
class Hypotheses:
    """Poses, each with what it rests on.

    Attributes
    ----------
    gTb : ndarray, shape (h, 4, 4)
    covariance : ndarray, shape (h, 6, 6)
        For the right twist [w, rho]: R exp(w), t + R rho.
    cost : ndarray, shape (h,)
        Squared Mahalanobis norm of prior, rim and sun together.
    """

    gTb: FloatArray
    covariance: FloatArray
    cost: FloatArray

    def __len__(self) -> int:
        return len(self.gTb)

    def take(self, keep: npt.NDArray[np.bool_]) -> "Hypotheses":
        """Return some of them."""
        return Hypotheses(self.gTb[keep], self.covariance[keep], self.cost[keep])


def single_poses(
    prior: Prior, bTc: FloatArray, craters: Craters, rims: Rims, seeds: int, gate: float
) -> Hypotheses:
    """Poses that take one of the first `seeds` rims for one crater and agree with the prior.

    Parameters
    ----------
    prior : Prior
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    craters : Craters
    rims : Rims
    seeds : int
    gate : float
        Largest cost.
    """
    gTc = prior.gTb @ bTc
    position = prior.covariance[3:, 3:]
    line = craters.centres - gTc[:3, 3]
    range_m = np.linalg.norm(line, axis=-1)
    line /= range_m[:, None]
    along2 = np.einsum("ni,ij,nj->n", line, position, line) / range_m**2
    aside2 = 0.5 * (np.trace(position) / range_m**2 - along2)
    charts = rims.charts[:seeds]
    ray = np.concatenate([charts[:, :2], np.ones((len(charts), 1))], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    tilt = rims.sunward_rad[: len(charts)]
    sunward = np.stack([np.cos(tilt), np.sin(tilt), np.zeros_like(tilt)], axis=-1)
    # Attitudes (crater, rim) that put the crater on the rim's line of sight and the sun where it shows.
    gRc = triads(line, craters.contrasts)[:, None] @ np.swapaxes(triads(ray, sunward), 1, 2)
    gRb = gRc @ bTc[:3, :3].T
    turn = frames.rotation_log((prior.gTb[:3, :3].T @ gRb).reshape(-1, 3, 3)).reshape(*gRb.shape[:2], 3)
    slack = (aside2 + rims.sunward_sigma_rad**2)[:, None, None] * np.eye(3)
    weight = np.linalg.inv(prior.covariance[:3, :3] + slack)
    far = np.einsum("nmi,nij,nmj->nm", turn, weight, turn) > gate
    # An ellipse's area shows the range, foreshortened by the slant.
    area = 2.0 * np.log(range_m) - np.log(
        np.abs(np.sum(line * craters.normals, axis=-1)) * np.linalg.norm(craters.axes, axis=-1).prod(axis=-1)
    )
    measured = charts[:, 2] + charts[:, 4] + 3.0 * np.log(ray[:, 2])
    off = np.abs(0.5 * (area[:, None] + measured))
    misfit = off > 3.5 * (np.sqrt(along2) + np.sqrt(aside2))[:, None] + 0.15
    crater, rim = np.nonzero(~(far | misfit))
    start = np.tile(np.eye(4), (len(crater), 1, 1))
    start[:, :3, :3] = gRb[crater, rim]
    start[:, :3, 3] = gTc[:3, 3] - start[:, :3, :3] @ bTc[:3, 3]
    pose, information, cost = rim_poses.map_poses(
        prior.gTb, scaled_inverse(prior.covariance), start, bTc, craters.centres, craters.axes,
        craters.contrasts, rims.charts, rims.weights, rims.sunward_rad, rims.sunward_sigma_rad**-2.0,
        crater[:, None], rim[:, None],
    )  # fmt: skip
    found = Hypotheses(pose, information, cost).take(cost < gate)
    return Hypotheses(found.gTb, scaled_inverse(found.covariance), found.cost)


def support(
    hypotheses: Hypotheses, bTc: FloatArray, craters: Craters, rims: Rims, reach: FloatArray
) -> IntArray:
    """Count the rims (h,) that each hypothesis can explain.

    Craters further than `reach` (2,), normalised coordinates, from the optical axis are not looked at.
    """
    return rim_poses.support(
        hypotheses.gTb, hypotheses.covariance, bTc, craters.centres, craters.axes, rims.charts,
        rims.covariance, reach,
    )  # fmt: skip


def expand_inliers(
    prior: Prior, hypotheses: Hypotheses, k: int, bTc: FloatArray, craters: Craters, rims: Rims,
    reach: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray]:  # fmt: skip
    """Refine hypothesis `k` with the rims that agree with it: the surest first, then more and more.

    Returns
    -------
    gTb : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        For the right twist.
    crater : ndarray of int, shape (n,)
        Crater of each rim, or -1.
    """
    pose, covariance = hypotheses.gTb[k : k + 1], hypotheses.covariance[k : k + 1]
    information = scaled_inverse(prior.covariance)
    crater = np.full(len(rims.charts), -1, dtype=np.int64)
    for size in _GROWTH:
        crater, distance2 = rim_poses.nearest(
            pose[0], covariance[0], bTc, craters.centres, craters.axes, rims.charts, rims.covariance, reach
        )
        rim = np.argsort(distance2, kind="stable")[:size]
        rim = rim[crater[rim] >= 0]
        if len(rim) < 2:
            break
        pose, found, _ = rim_poses.map_poses(
            prior.gTb, information, pose, bTc, craters.centres, craters.axes, craters.contrasts, rims.charts,
            rims.weights, rims.sunward_rad, rims.sunward_sigma_rad**-2.0, crater[rim][None], rim[None],
        )  # fmt: skip
        covariance = scaled_inverse(found)
    return pose[0], covariance[0], crater
