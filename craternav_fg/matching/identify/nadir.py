"""Direction of the vertical from the rims alone: most craters are nearly circular and foreshortened alike.

A hypothesis of the vertical is the unit vector to the body's centre in the camera's frame and the altitude.
It places each rim on the sphere and predicts its foreshortening; the misfit is the eccentricity that remains.
"""

import numpy as np

from craternav_fg.matching.identify.sphere import distance_to_sphere
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

# Expected anisotropy (a^2 - b^2)/(a^2 + b^2) of craters and of their fitted rims; the median of the craters
# alone is 0.07 in the catalogue of Robbins (2018).
_ANISOTROPY = 0.1
# Normalised squared misfit that a rim beside the body counts as: as much as five standard deviations.
_MISFIT2_BESIDE = 25.0
# Grid of nadir directions in normalised coordinates about the optical axis: its step (7.4 deg), and the
# number of steps from the axis to the outermost directions (38 deg).
_GRID_STEP = 0.13
_GRID_RINGS = 6
# Times that the step is halved in the descent from a grid point.
_HALVINGS = 3
# Verticals around another that are tried: their number, a multiple of 4, so that images that are turned by
# 90 deg are searched alike; and their angle from it, rad.
_RING, _RING_RAD = 8, float(np.radians(9.0))


@njit(cache=True, error_model="numpy")
def place(view: View, i: int, down: FloatArray, range_m: float, radius_m: float, X: FloatArray) -> float:
    """Project a rim's centre to the sphere.

    Parameters
    ----------
    view : View
    i : int
        The rim.
    down : ndarray, shape (3,)
        Unit vector to the body's centre in c.
    range_m : float
        Distance of that centre.
    radius_m : float
        The sphere's radius.
    X : ndarray, shape (3,)
        Written: position of the rim's centre relative to the body's, in axes of c, m.

    Returns
    -------
    float
        Distance of the rim's centre from the camera, m; -1 beside the body, where X is not written.
    """
    d = view.directions
    along = range_m * (d[i, 0] * down[0] + d[i, 1] * down[1] + d[i, 2] * down[2])
    distance = distance_to_sphere(along, range_m * range_m, radius_m)
    if distance < 0.0:
        return -1.0
    for k in range(3):
        X[k] = distance * d[i, k] - range_m * down[k]
    return distance


@njit(cache=True, error_model="numpy")
def misfit(view: View, rims: IntArray, down: FloatArray, height: float) -> float:
    """Robust mean misfit of rims to circles on the ground.

    Parameters
    ----------
    view : View
    rims : ndarray of int, shape (m,)
        The rims that are used.
    down : ndarray, shape (3,)
        Unit vector to the body's centre in c.
    height : float
        Altitude over the body's radius.

    Returns
    -------
    float
        Mean of ln(1 + e^2), e the anisotropy on the ground over its expected value.
    """
    X = np.empty(3)
    total = 0.0
    for i in rims:
        if place(view, i, down, 1.0 + height, 1.0, X) < 0.0:
            total += np.log1p(_MISFIT2_BESIDE)
            continue
        u, v = view.charts[i, 0], view.charts[i, 1]
        w = u * X[0] + v * X[1] + X[2]
        # Metric of the tangent plane in normalised image coordinates, but for the scale.
        p, q = X[0] / w, X[1] / w
        uu = (1.0 - u * p) ** 2 + (v * p) ** 2 + p * p
        vv = (u * q) ** 2 + (1.0 - v * q) ** 2 + q * q
        uv = -(1.0 - u * p) * u * q - v * p * (1.0 - v * q) + p * q
        sxx, sxy, syy = view.moments[i, 0], view.moments[i, 1], view.moments[i, 2]
        trace = sxx * uu + 2.0 * sxy * uv + syy * vv
        area2 = (sxx * syy - sxy * sxy) * (uu * vv - uv * uv)
        scatter = _ANISOTROPY * _ANISOTROPY + 1.0 / view.radius_px[i] ** 2
        total += np.log1p(max(1.0 - 4.0 * area2 / (trace * trace), 0.0) / scatter)
    return total / rims.shape[0]


@njit(cache=True, error_model="numpy")
def nadirs(view: View, rims: IntArray, heights: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Estimate the vertical: the best points of a coarse grid, each refined by descent.

    Parameters
    ----------
    view : View
    rims : ndarray of int, shape (r,)
        The rims that are used.
    heights : ndarray, shape (m,)
        Altitudes over the radius that are tried.
    count : int
        Largest number of estimates.

    Returns
    -------
    models : ndarray, shape (k, 4)
        Unit vector to the body's centre in c, and altitude over the radius.
    misfits : ndarray, shape (k,)
        See `misfit`.
    """
    side = 2 * _GRID_RINGS + 1
    score = np.full((side, side), np.inf)
    best_height = np.zeros((side, side))
    down = np.empty(3)
    for a in range(side):
        for b in range(side):
            x, y = _GRID_STEP * (a - _GRID_RINGS), _GRID_STEP * (b - _GRID_RINGS)
            if x * x + y * y > (_GRID_STEP * (_GRID_RINGS + 0.5)) ** 2:
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
        x, y = _GRID_STEP * (a - _GRID_RINGS), _GRID_STEP * (b - _GRID_RINGS)
        height, value = best_height[a, b], least
        step = _GRID_STEP
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
        # Two grid points may lead to the same minimum.
        repeated = False
        for k in range(found):
            cos = models[k, 0] * down[0] + models[k, 1] * down[1] + models[k, 2] * down[2]
            repeated = repeated or cos > np.cos(_GRID_STEP)
        if not repeated:
            models[found, :3], models[found, 3], misfits[found] = down, height, value
            found += 1
    return models[:found], misfits[:found]


@njit(cache=True, error_model="numpy")
def _unit(x: float, y: float, down: FloatArray) -> None:
    """Write the unit vector (3,) along (x, y, 1)."""
    scale = 1.0 / np.sqrt(1.0 + x * x + y * y)
    down[0], down[1], down[2] = x * scale, y * scale, scale


def models_around(model: FloatArray) -> FloatArray:
    """Return models whose verticals lie on a circle around another's.

    Parameters
    ----------
    model : ndarray, shape (4,)
        Unit vector to the body's centre in c, and altitude in the body's radii.

    Returns
    -------
    ndarray, shape (8, 4)
    """
    down = model[:3]
    aside = np.cross(down, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside)
    turn = 2.0 * np.pi / _RING * np.arange(_RING)[:, None]
    ring = np.cos(turn) * aside + np.sin(turn) * np.cross(down, aside)
    return np.column_stack([np.cos(_RING_RAD) * down + np.sin(_RING_RAD) * ring, np.full(_RING, model[3])])
