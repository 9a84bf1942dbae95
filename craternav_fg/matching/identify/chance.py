"""Density of false rims: how probable a rim's chart is when the rim is not the crater that it is taken for.

The centre of a false rim is uniform over the ground that the image shows. Its size follows, half and half,
a power law that the image's smallest rim fixes, and the distribution of the sizes of all rims of the image:
hills and ridges that look like craters are often larger than most craters. Its shape is, half and half, like
those of all rims of the image, and like those of craters seen from the pose in question: a wrong pose is
often found where the foreshortening is right, and then other craters are foreshortened alike.
"""

import numpy as np

from craternav_fg.matching.identify.noise import CHI2_2_MEDIAN, median
from craternav_fg.matching.identify.sphere import distance_to_sphere
from craternav_fg.matching.identify.view import View
from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import chart, rim_in_camera

_LOG_2PI = float(np.log(2.0 * np.pi))
# Exponent of the size distribution of rims: their number above a size falls with its square, as that of small
# lunar craters does.
SIZE_EXPONENT = 2.0
# The distribution of the logarithm of sizes begins this much below the image's smallest rim.
LOG_SIZE_MARGIN = 0.05
# Least variance of the logarithm of sizes: of rims that are all about the same.
_MIN_SIZE_VARIANCE = 0.2**2
# Least variance of the two parameters of shape, ln(L22 / L11) and the shear: rounder than craters are.
_MIN_SHAPE_VARIANCE = 0.05**2
# Points per side of the image by which the share of it that shows the ground is measured.
_SAMPLES_PER_SIDE = 12


def log_by_chance(view: View) -> tuple[FloatArray, FloatArray]:
    """Compute densities of the rims' charts if they are false, whatever the pose.

    Parameters
    ----------
    view : View

    Returns
    -------
    log_chart : ndarray, shape (n,)
        Natural logarithms of the density of the chart, the whole image taken for ground.
    log_shape : ndarray, shape (n,)
        Natural logarithms of the density of the shape alone.
    """
    left, top, right, bottom = view.bounds_px
    area = (right - left) * (bottom - top) / (view.fx_px * view.fy_px)
    log_size = np.log(view.radius_px)
    q = view.charts[:, 4] - view.charts[:, 2]
    shape2 = q**2 + (view.charts[:, 3] * np.exp(-q)) ** 2
    spread = 0.5 * shape2.mean() + _MIN_SHAPE_VARIANCE
    above = log_size - log_size.min() + LOG_SIZE_MARGIN
    power = np.log(SIZE_EXPONENT) - SIZE_EXPONENT * above
    width2 = log_size.var() + _MIN_SIZE_VARIANCE
    alike = -0.5 * (_LOG_2PI + np.log(width2) + (log_size - log_size.mean()) ** 2 / width2)
    by_size = np.logaddexp(power, alike) - np.log(2.0)
    by_shape = -_LOG_2PI - np.log(spread) - 0.5 * shape2 / spread - q
    return np.asarray(by_size + by_shape - np.log(area)), np.asarray(by_shape)


@njit(cache=True, error_model="numpy")
def chance_at(
    view: View, R: FloatArray, P: FloatArray, sphere: float, chance: FloatArray, shape_chance: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Compute densities of the rims' charts if they are false, seen from a pose.

    Parameters
    ----------
    view : View
    R : ndarray, shape (3, 3)
        Rotation gRc.
    P : ndarray, shape (3,)
        gPc, m.
    sphere : float
        Radius of the ground, m.
    chance, shape_chance : ndarray, shape (n,)
        From `log_by_chance`.
    out : ndarray, shape (n,)
        Written: natural logarithms.
    """
    n = chance.shape[0]
    left, top = view.bounds_px[0], view.bounds_px[1]
    right, bottom = view.bounds_px[2], view.bounds_px[3]
    range_m = np.sqrt(P[0] ** 2 + P[1] ** 2 + P[2] ** 2)
    ground = np.empty(3)
    shown = 0
    for i in range(_SAMPLES_PER_SIDE):
        for j in range(_SAMPLES_PER_SIDE):
            x = left + (i + 0.5) / _SAMPLES_PER_SIDE * (right - left)
            y = top + (j + 0.5) / _SAMPLES_PER_SIDE * (bottom - top)
            shown += ground_direction(view, R, P, range_m, sphere, x, y, ground)
    log_share = np.log(max(shown, 1) / _SAMPLES_PER_SIDE**2)
    up, p, c, y5 = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty(5)
    circle = np.empty((2, 3))
    stretch, apart2, ordered = np.empty(n), np.full(n, np.inf), np.empty(n)
    seen = 0
    for i in range(n):
        x, y = view.points_px[i, 0], view.points_px[i, 1]
        if not ground_direction(view, R, P, range_m, sphere, x, y, up):
            continue
        # A small circle at the rim's place, spanned by any two orthogonal horizontal directions.
        k = 0 if abs(up[0]) < 0.7 else 1
        length2 = 1.0 - up[k] * up[k]
        for r in range(3):
            circle[0, r] = ((1.0 if r == k else 0.0) - up[k] * up[r]) / np.sqrt(length2)
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            circle[1, r] = up[s] * circle[0, t] - up[t] * circle[0, s]
        for r in range(3):
            up[r] *= sphere
        rim_in_camera(R, P, up, circle, p, c)
        if not chart(p, c, y5):
            continue
        stretch[i] = y5[4] - y5[2]
        along = view.charts[i, 4] - view.charts[i, 2] - stretch[i]
        lean = (view.charts[i, 3] - y5[3]) * np.exp(-stretch[i])
        apart2[i] = ordered[seen] = along * along + lean * lean
        seen += 1
    spread = _MIN_SHAPE_VARIANCE + (median(ordered, seen) / CHI2_2_MEDIAN if seen else 0.0)
    for i in range(n):
        out[i] = chance[i] - log_share
        if apart2[i] < np.inf:
            likewise = -_LOG_2PI - np.log(spread) - 0.5 * apart2[i] / spread - stretch[i]
            out[i] += np.log(0.5 + 0.5 * np.exp(likewise - shape_chance[i]))


@njit(cache=True, error_model="numpy")
def ground_direction(
    view: View, R: FloatArray, P: FloatArray, range_m: float, sphere: float, x: float, y: float,
    out: FloatArray,
) -> bool:  # fmt: skip
    """Find where a pixel's line of sight meets the ground.

    Parameters
    ----------
    view : View
    R : ndarray, shape (3, 3)
        Rotation gRc.
    P : ndarray, shape (3,)
        gPc, m.
    range_m : float
        Its length.
    sphere : float
        Radius of the ground, m.
    x, y : float
        Pixel without distortion.
    out : ndarray, shape (3,)
        Written: unit vector in g to the place.

    Returns
    -------
    bool
        False when the pixel shows the sky.
    """
    u, v = (x - view.principal_px[0]) / view.fx_px, (y - view.principal_px[1]) / view.fy_px
    length = np.sqrt(1.0 + u * u + v * v)
    g = np.empty(3)
    along = 0.0
    for r in range(3):
        g[r] = (R[r, 0] * u + R[r, 1] * v + R[r, 2]) / length
        along -= g[r] * P[r]
    distance = distance_to_sphere(along, range_m * range_m, sphere)
    if distance < 0.0:
        return False
    for r in range(3):
        out[r] = (P[r] + distance * g[r]) / sphere
    return True
