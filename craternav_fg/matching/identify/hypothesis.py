"""A hypothetical pose of the camera, and how many other rims it puts on craters of their size.

A hypothesis is an array (`HYPOTHESIS`,): the score, gRc by rows, gPc, the sphere's radius there, and the rims
and craters that it was made of, three at most, -1 for none.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.catalogs.sphere_index import SphereIndex, within
from craternav_fg.matching.identify.craters import Craters, density
from craternav_fg.matching.identify.view import View

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SCORE, ROTATION, POSITION, SPHERE, RIMS, CRATERS, HYPOTHESIS = 0, 1, 10, 13, 14, 17, 20
# A rim without a crater: of its visible craters a catalogue lacks, or an image's rims are false.
_MISS = 0.7
_GATE = 3.0


@njit(cache=True, error_model="numpy")
def axis_share(view: View, i: int, sigma: float) -> float:
    """Relative standard deviation of a rim's size at a noise in px."""
    return np.sqrt(0.02**2 + (0.4 * sigma / view.radius_px[i]) ** 2)


def axis_shares(view: View, sigma: float) -> FloatArray:
    """Relative standard deviations (n,) of the rims' sizes, as `axis_share`."""
    return np.array([axis_share(view, i, sigma) for i in range(len(view.radius_px))])


@njit(cache=True, error_model="numpy")
def project_to_sphere(view: View, i: int, pose: FloatArray, X: FloatArray) -> tuple[bool, float, float]:
    """Write the unit vector X (3,) in g to where a rim lies; give whether it does, log size, distance, m."""
    dx, dy, dz = view.directions[i, 0], view.directions[i, 1], view.directions[i, 2]
    gx = pose[1] * dx + pose[2] * dy + pose[3] * dz
    gy = pose[4] * dx + pose[5] * dy + pose[6] * dz
    gz = pose[7] * dx + pose[8] * dy + pose[9] * dz
    px, py, pz = pose[POSITION], pose[POSITION + 1], pose[POSITION + 2]
    radius = pose[SPHERE]
    along = -(gx * px + gy * py + gz * pz)
    under = along * along - (px * px + py * py + pz * pz - radius * radius)
    if not (along > 0.0 and under > 0.0):
        return False, 0.0, 0.0
    distance = along - np.sqrt(under)
    X[0], X[1], X[2] = (
        (px + distance * gx) / radius,
        (py + distance * gy) / radius,
        (pz + distance * gz) / radius,
    )
    cos = -(gx * X[0] + gy * X[1] + gz * X[2])
    if not cos > 0.1:
        return False, 0.0, 0.0
    return True, view.log_angle[i] + np.log(distance) - 0.5 * np.log(cos), distance / np.sqrt(cos)


@njit(cache=True, error_model="numpy")
def support(
    view: View, index: SphereIndex, craters: Craters, order: npt.NDArray[np.int32], pose: FloatArray,
    extent_px: float, lever: float, sigma: float, most: int, patience: int,
) -> float:  # fmt: skip
    """Logarithm of how unlikely it is by chance that so many rims fall on craters of their size.

    Parameters
    ----------
    view : View
    index, craters
        Of the catalogue.
    order : ndarray of int32
        Rims, those nearest to the hypothesis' own first.
    pose : ndarray, shape (HYPOTHESIS,)
    extent_px : float
        Of its own rims: what their noise is a lever of.
    lever : float
        Error of the places that it predicts, per distance in the image from its own rims.
    sigma : float
        Noise of the rims' centres, px.
    most : int
        Rims to ask at most.
    patience : int
        Rims that may be asked in vain.
    """
    X = np.empty(3)
    # Whether there is one, not how many.
    found = np.empty(1, dtype=np.int64)
    score = 0.0
    asked = 0
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
        seen, size, distance = project_to_sphere(view, i, pose, X)
        if not seen:
            continue
        asked += 1
        away = np.sqrt((view.points_px[i, 0] - u0) ** 2 + (view.points_px[i, 1] - v0) ** 2)
        gate_px = 1.0 + _GATE * sigma * np.sqrt(1.0 + (away / extent_px) ** 2) + lever * away
        slack = 0.06 + _GATE * axis_share(view, i, sigma)
        angle = gate_px * distance / (view.focal_px * pose[SPHERE])
        chance = density(craters, size - slack, size + slack) * np.pi * angle * angle
        if chance < 1.0:
            if within(index, X[0], X[1], X[2], angle, size - slack, size + slack, found):
                hits += 1
                score -= np.log(chance)
            else:
                score -= _MISS * (1.0 - chance)
        if asked == most or (asked >= patience and score <= 0.0):
            break
    return score if hits else -1.0


@njit(cache=True, error_model="numpy")
def keep(pose: FloatArray, best: FloatArray) -> None:
    """Put a hypothesis in the place of the worst of the best (k, HYPOTHESIS), unless that is better."""
    worst = 0
    for k in range(best.shape[0]):
        if best[k, SCORE] < best[worst, SCORE]:
            worst = k
        # The same crater for the same rim from the same side: the same hypothesis again.
        near = 0.0
        far = 0.0
        for r in range(3):
            near += (best[k, POSITION + r] - pose[POSITION + r]) ** 2
            far += pose[POSITION + r] ** 2
        if near < 1e-6 * far and best[k, SCORE] >= pose[SCORE] > -np.inf:
            return
    if best[worst, SCORE] < pose[SCORE]:
        best[worst] = pose
