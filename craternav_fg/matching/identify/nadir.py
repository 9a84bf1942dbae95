"""Which way is down, from the rims alone: most craters are nearly round, and foreshortened alike.

A model of the view is the unit vector to the body's centre in the camera's frame and the altitude; it gives
each rim's place on the sphere, and how far its rim would be from round there.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.matching.identify.view import View

FloatArray = npt.NDArray[np.float64]

# Median distance from roundness of real craters, as the anisotropy (a^2 - b^2)/(a^2 + b^2).
ROUGHNESS = 0.1
_LIMB = 25.0
_STEP = 0.13
_RINGS = 6
_HALVINGS = 3


@njit(cache=True, error_model="numpy")
def place(view: View, i: int, down: FloatArray, range_m: float, radius_m: float, X: FloatArray) -> float:
    """Write where a rim lies, X (3,) from the body's centre in the camera's axes, m; give its distance or -1.

    Parameters
    ----------
    view : View
    i : int
        The rim.
    down : ndarray, shape (3,)
        Unit vector to the body's centre, camera frame.
    range_m : float
        Distance of that centre.
    radius_m : float
    """
    d = view.directions
    along = range_m * (d[i, 0] * down[0] + d[i, 1] * down[1] + d[i, 2] * down[2])
    under = along * along - (range_m * range_m - radius_m * radius_m)
    if not (along > 0.0 and under > 0.0):
        return -1.0
    distance = along - np.sqrt(under)
    for k in range(3):
        X[k] = distance * d[i, k] - range_m * down[k]
    return distance


@njit(cache=True, error_model="numpy")
def misfit(view: View, rims: npt.NDArray[np.int64], down: FloatArray, height: float) -> float:
    """How far some rims are from round on the ground, robustly, per rim; `height` is over the radius."""
    X = np.empty(3)
    total = 0.0
    for i in rims:
        if place(view, i, down, 1.0 + height, 1.0, X) < 0.0:
            total += np.log1p(_LIMB)
            continue
        u, v = view.charts[i, 0], view.charts[i, 1]
        w = u * X[0] + v * X[1] + X[2]
        # How the point on the tangent plane moves with the point in the image, but for the distance.
        p, q = X[0] / w, X[1] / w
        uu = (1.0 - u * p) ** 2 + (v * p) ** 2 + p * p
        vv = (u * q) ** 2 + (1.0 - v * q) ** 2 + q * q
        uv = -(1.0 - u * p) * u * q - v * p * (1.0 - v * q) + p * q
        sxx, sxy, syy = view.moments[i, 0], view.moments[i, 1], view.moments[i, 2]
        trace = sxx * uu + 2.0 * sxy * uv + syy * vv
        area2 = (sxx * syy - sxy * sxy) * (uu * vv - uv * uv)
        scatter = ROUGHNESS * ROUGHNESS + 1.0 / view.radius_px[i] ** 2
        total += np.log1p(max(1.0 - 4.0 * area2 / (trace * trace), 0.0) / scatter)
    return total / rims.shape[0]


@njit(cache=True, error_model="numpy")
def nadirs(
    view: View, rims: npt.NDArray[np.int64], heights: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Give the most probable models of the view, by the likeliest places of a coarse grid.

    Parameters
    ----------
    view : View
    rims : ndarray of int
        Which take part.
    heights : ndarray, shape (m,)
        Altitudes over the radius to try.
    count : int
        Models wanted at most.

    Returns
    -------
    models : ndarray, shape (k, 4)
        Unit vector to the body's centre in the camera frame, altitude over the radius.
    misfits : ndarray, shape (k,)
        Per rim.
    """
    side = 2 * _RINGS + 1
    score = np.full((side, side), np.inf)
    best_height = np.zeros((side, side))
    down = np.empty(3)
    for a in range(side):
        for b in range(side):
            x, y = _STEP * (a - _RINGS), _STEP * (b - _RINGS)
            if x * x + y * y > (_STEP * (_RINGS + 0.5)) ** 2:
                continue
            _unit(x, y, down)
            for height in heights:
                value = misfit(view, rims, down, height)
                if value < score[a, b]:
                    score[a, b], best_height[a, b] = value, height
    models = np.empty((count, 4))
    misfits = np.empty(count)
    found = 0
    while found < count:
        least, at = np.inf, 0
        for k in range(side * side):
            if score[k // side, k % side] < least:
                least, at = score[k // side, k % side], k
        if least == np.inf:
            break
        a, b = at // side, at % side
        for i in range(max(0, a - 2), min(side, a + 3)):
            for j in range(max(0, b - 2), min(side, b + 3)):
                score[i, j] = np.inf
        x, y, height, value = _STEP * (a - _RINGS), _STEP * (b - _RINGS), best_height[a, b], least
        step = _STEP
        for _ in range(_HALVINGS):
            step *= 0.5
            moved = True
            while moved:
                moved = False
                for k in range(4):
                    s, t = x + step * ((k == 0) - (k == 1)), y + step * ((k == 2) - (k == 3))
                    _unit(s, t, down)
                    new = misfit(view, rims, down, height)
                    if new < value - 1e-9:
                        value, x, y, moved = new, s, t, True
        _unit(x, y, down)
        # What leads to a better model's place is that model.
        repeated = False
        for k in range(found):
            cos = models[k, 0] * down[0] + models[k, 1] * down[1] + models[k, 2] * down[2]
            repeated = repeated or cos > np.cos(_STEP)
        if not repeated:
            models[found, :3], models[found, 3], misfits[found] = down, height, value
            found += 1
    return models[:found], misfits[:found]


@njit(cache=True, error_model="numpy")
def _unit(x: float, y: float, down: FloatArray) -> None:
    scale = 1.0 / np.sqrt(1.0 + x * x + y * y)
    down[0], down[1], down[2] = x * scale, y * scale, scale
