"""A hypothetical pose of the camera, and its score by the rims that it puts on craters of their size.

A hypothesis is an array (`HYPOTHESIS`,): the score; gRc by rows; gPc, m; the radius of the sphere on which
its craters lie, m; the rows of its rims in the view and of their craters in the catalogue, three each, -1 for
none.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.matching.identify.craters import Craters, density
from craternav_fg.matching.identify.sphere import distance_to_sphere
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

Int32Array = npt.NDArray[np.int32]

SCORE, ROTATION, POSITION, SPHERE, RIMS, CRATERS, HYPOTHESIS = 0, 1, 10, 13, 14, 17, 20
# Most craters, as expected among the rims, by which a hypothesis is scored.
SCORED_RIMS = 14
# Share of the image's craters that fall on craters of the catalogue at the right pose: the others are missing
# from it, or are not where it puts them.
_SHARE_IN_CATALOG = 0.5
# Gate on a rim's place and size, in standard deviations.
_GATE_SIGMAS = 3.0
# Additions to the gates for what no noise accounts for: that an ellipse's centre is not the image of the
# crater's, px, and that the ground is not a sphere, in the logarithm of the size.
_GATE_PX = 1.0
_GATE_LOG_SIZE = 0.06
# Relative standard deviation of a rim's size per noise in px over the radius, beside the view's share.
_SIZE_PER_NOISE = 0.4
# Least cosine of the angle between a line of sight and the vertical: sizes nearer the limb are not used.
_MIN_COS_SLANT = 0.1
# Relative distance within which two hypothetical positions are one: squared, 1e-3 of the range.
_SAME_POSITION2 = 1e-6


class PoseLimits(NamedTuple):
    """What is known about the pose before the search."""

    attitude: FloatArray
    """Known rotation gRc, shape (3, 3), or shape (0, 3) when it is unknown."""
    min_cos_turn: float
    """Cosine of the largest rotation from the known attitude."""
    min_altitude_m: float
    """Lowest altitude above the sphere."""
    max_altitude_m: float
    """Highest altitude above the sphere."""


@njit(cache=True, error_model="numpy")
def allowed(pose: FloatArray, limits: PoseLimits) -> bool:
    """Whether a hypothesis agrees with what is known about the pose.

    Parameters
    ----------
    pose : ndarray, shape (HYPOTHESIS,)
    limits : PoseLimits
    """
    range2 = 0.0
    for r in range(3):
        range2 += pose[POSITION + r] ** 2
    altitude = np.sqrt(range2) - pose[SPHERE]
    if not limits.min_altitude_m < altitude < limits.max_altitude_m:
        return False
    known = limits.attitude.shape[0]
    trace = 0.0
    for r in range(known):
        for c in range(3):
            trace += limits.attitude[r, c] * pose[ROTATION + 3 * r + c]
    return known == 0 or 0.5 * (trace - 1.0) >= limits.min_cos_turn


@njit(cache=True, error_model="numpy")
def size_sigma(view: View, i: int, sigma: float) -> float:
    """Relative standard deviation of a rim's size.

    Parameters
    ----------
    view : View
    i : int
        The rim.
    sigma : float
        Noise of the centres, px.
    """
    return np.sqrt(view.size_share**2 + (_SIZE_PER_NOISE * sigma / view.radius_px[i]) ** 2)


@njit(cache=True, error_model="numpy")
def size_sigmas(view: View, sigma: float) -> FloatArray:
    """Relative standard deviations of all rims' sizes.

    Parameters
    ----------
    view : View
    sigma : float
        Noise of the centres, px.

    Returns
    -------
    ndarray, shape (n,)
    """
    out = np.empty(len(view.radius_px))
    for i in range(len(out)):
        out[i] = size_sigma(view, i, sigma)
    return out


@njit(cache=True, error_model="numpy")
def project_to_sphere(view: View, i: int, pose: FloatArray, X: FloatArray) -> tuple[bool, float, float]:
    """Project a rim to the sphere at a hypothetical pose.

    Parameters
    ----------
    view : View
    i : int
        The rim.
    pose : ndarray, shape (HYPOTHESIS,)
    X : ndarray, shape (3,)
        Written: unit vector in g to the rim's centre on the sphere.

    Returns
    -------
    seen : bool
        Whether the line of sight meets the sphere, and not too near the limb.
    log_size : float
        Natural logarithm of the geometric mean of the semi-axes there, m.
    scale : float
        Extent on the ground per radian, across the mean of the foreshortening, m.
    """
    dx, dy, dz = view.directions[i, 0], view.directions[i, 1], view.directions[i, 2]
    gx = pose[1] * dx + pose[2] * dy + pose[3] * dz
    gy = pose[4] * dx + pose[5] * dy + pose[6] * dz
    gz = pose[7] * dx + pose[8] * dy + pose[9] * dz
    px, py, pz = pose[POSITION], pose[POSITION + 1], pose[POSITION + 2]
    radius = pose[SPHERE]
    along = -(gx * px + gy * py + gz * pz)
    distance = distance_to_sphere(along, px * px + py * py + pz * pz, radius)
    if distance < 0.0:
        return False, 0.0, 0.0
    X[0], X[1], X[2] = (
        (px + distance * gx) / radius,
        (py + distance * gy) / radius,
        (pz + distance * gz) / radius,
    )
    cos = -(gx * X[0] + gy * X[1] + gz * X[2])
    if not cos > _MIN_COS_SLANT:
        return False, 0.0, 0.0
    return True, view.log_angle[i] + np.log(distance) - 0.5 * np.log(cos), distance / np.sqrt(cos)


@njit(cache=True, error_model="numpy")
def support(
    view: View, index: SphereIndex, craters: Craters, order: Int32Array, pose: FloatArray, extent_px: float,
    lever: float, sigma: float, patience: float, crowding: float,
) -> float:  # fmt: skip
    """Score a hypothesis: how improbable it is by chance that so many rims fall on craters of their size.

    Parameters
    ----------
    view : View
    index : SphereIndex
    craters : Craters
    order : ndarray of int32, shape (m,)
        Rims, those nearest to the hypothesis' own in the image first.
    pose : ndarray, shape (HYPOTHESIS,)
    extent_px : float
        Size of the group of its own rims: their noise, extrapolated to a rim at some distance, grows with the
        distance over this.
    lever : float
        Further error of a predicted place, over its distance in the image from the hypothesis' own rims.
    sigma : float
        Noise of the centres, px.
    patience : float
        Expected number of craters among the rims asked after which the scoring ends when the score is not
        positive.
    crowding : float
        Density of craters there over that of the whole body.

    Returns
    -------
    float
        Natural logarithm; -1 when no other rim falls on a crater.
    """
    X = np.empty(3)
    # Room for one: whether there is a crater, not how many.
    found = np.empty(1, dtype=np.int64)
    score = 0.0
    asked = 0.0
    hits = 0
    u0, v0, used = 0.0, 0.0, 0
    for k in range(3):
        i = int(pose[RIMS + k])
        if i >= 0:
            u0 += view.points_px[i, 0]
            v0 += view.points_px[i, 1]
            used += 1
    u0 /= used
    v0 /= used
    for n in range(order.shape[0]):
        i = int(order[n])
        own = False
        for k in range(3):
            own = own or i == int(pose[RIMS + k])
        if own:
            continue
        seen, size, scale = project_to_sphere(view, i, pose, X)
        if not seen:
            continue
        asked += view.quality[i]
        away = np.sqrt((view.points_px[i, 0] - u0) ** 2 + (view.points_px[i, 1] - v0) ** 2)
        gate_px = _GATE_PX + _GATE_SIGMAS * sigma * np.sqrt(1.0 + (away / extent_px) ** 2) + lever * away
        slack = _GATE_LOG_SIZE + _GATE_SIGMAS * size_sigma(view, i, sigma)
        angle = gate_px * scale / (view.focal_px * pose[SPHERE])
        chance = crowding * density(craters, size - slack, size + slack) * np.pi * angle * angle
        if chance < 1.0:
            true = _SHARE_IN_CATALOG * view.quality[i]
            score += np.log(1.0 - true)
            if within(index, X[0], X[1], X[2], angle, size - slack, size + slack, found):
                hits += 1
                score += np.log(1.0 + true / ((1.0 - true) * chance))
        if asked >= SCORED_RIMS or (asked >= patience and score <= 0.0):
            break
    return score if hits else -1.0


@njit(cache=True, error_model="numpy")
def keep(pose: FloatArray, best: FloatArray) -> None:
    """Replace the worst of the best hypotheses by another one, if that is better and no repetition.

    Parameters
    ----------
    pose : ndarray, shape (HYPOTHESIS,)
    best : ndarray, shape (k, HYPOTHESIS)
        Hypothetical poses; changed.
    """
    worst = 0
    for k in range(best.shape[0]):
        if best[k, SCORE] < best[worst, SCORE]:
            worst = k
        near = 0.0
        far = 0.0
        for r in range(3):
            near += (best[k, POSITION + r] - pose[POSITION + r]) ** 2
            far += pose[POSITION + r] ** 2
        if near < _SAME_POSITION2 * far and best[k, SCORE] >= pose[SCORE] > -np.inf:
            return
    if best[worst, SCORE] < pose[SCORE]:
        best[worst] = pose
