"""Radial-tangential distortion of a lens (Brown 1971), with OpenCV's coefficients k1, k2, p1, p2, k3.

It takes normalised coordinates (u, v) = (x, y) / z of a direction to those at which the lens images it:

    [u (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 u v + p2 (r2 + 2 u^2),
     v (1 + k1 r2 + k2 r2^2 + k3 r2^3) + p1 (r2 + 2 v^2) + 2 p2 u v],   r2 = u^2 + v^2.

The polynomials are fitted inside the image and may turn back outside it: a direction far off the axis would
then seem to lie in the image. Beyond a reach, which the caller derives from the image's border, the
distortion at the reach is therefore scaled with the distance from the axis.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

_STEPS = 100
_HALVINGS = 30
_CONVERGED = 1e-14
_ROUNDING = 1e-13


@njit(cache=True, nogil=True, error_model="numpy")
def distort(u: float, v: float, lens: FloatArray, out: FloatArray) -> None:
    """Write distorted coordinates and their Jacobian, (6,): x, y, dx/du, dx/dv, dy/du, dy/dv.

    Parameters
    ----------
    u, v : float
        Normalised coordinates.
    lens : ndarray, shape (6,)
        k1, k2, p1, p2, k3, reach.
    out : ndarray, shape (6,)
        Written.
    """
    k1, k2, p1, p2, k3, reach = lens[0], lens[1], lens[2], lens[3], lens[4], lens[5]
    r = np.sqrt(u * u + v * v)
    beyond = r > reach
    a, b = u, v
    if beyond:
        a *= reach / r
        b *= reach / r
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    out[0] = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    out[1] = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    out[2] = radial + slope * a * a + 2.0 * p1 * b + 6.0 * p2 * a
    out[3] = slope * a * b + 2.0 * p1 * a + 2.0 * p2 * b
    out[4] = out[3]
    out[5] = radial + slope * b * b + 6.0 * p1 * b + 2.0 * p2 * a
    if beyond:
        # F(u) = D(w) r / reach with w = reach u / r: dF = J(w) (I - e e') + D(w) e' / reach.
        e0, e1 = u / r, v / r
        for i in range(2):
            along = out[2 + 2 * i] * e0 + out[3 + 2 * i] * e1
            out[2 + 2 * i] += (out[i] / reach - along) * e0
            out[3 + 2 * i] += (out[i] / reach - along) * e1
            out[i] *= r / reach


@njit(cache=True, nogil=True, error_model="numpy")
def undistort(x: float, y: float, lens: FloatArray, out: FloatArray) -> None:
    """Write the normalised coordinates that `distort` takes to (x, y), and its Jacobian there, (6,).

    Parameters
    ----------
    x, y : float
        Distorted coordinates.
    lens : ndarray, shape (6,)
        As in `distort`.
    out : ndarray, shape (6,)
        Written; NaN when there are none before the distortion turns back.
    """
    u, v = 0.0, 0.0
    distort(u, v, lens, out)
    ex, ey = x - out[0], y - out[1]
    for _ in range(_STEPS):
        determinant = out[2] * out[5] - out[3] * out[4]
        du = (out[5] * ex - out[3] * ey) / determinant
        dv = (out[2] * ey - out[4] * ex) / determinant
        if abs(du) + abs(dv) < _CONVERGED * (1.0 + abs(u) + abs(v)):
            out[0] = u + du
            out[1] = v + dv
            return
        # Where the distortion is nearly flat, a full Newton step leads away, or beyond a fold.
        share = 1.0
        for _ in range(_HALVINGS):
            distort(u + share * du, v + share * dv, lens, out)
            fx, fy = x - out[0], y - out[1]
            if out[2] * out[5] > out[3] * out[4] and fx * fx + fy * fy < ex * ex + ey * ey:
                break
            share *= 0.5
        else:
            # Rounding leaves no better point: an error of some last digits is none.
            if ex * ex + ey * ey < _ROUNDING**2 * (1.0 + x * x + y * y):
                distort(u, v, lens, out)
                out[0] = u
                out[1] = v
                return
            break
        u += share * du
        v += share * dv
        ex, ey = fx, fy
    out[:] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def distort_all(points: FloatArray, lens: FloatArray, inverse: bool) -> FloatArray:
    """`distort` or, inverse, `undistort` of points (n, 2): coordinates and Jacobians (n, 6)."""
    out = np.empty((points.shape[0], 6))
    for i in range(points.shape[0]):
        if inverse:
            undistort(points[i, 0], points[i, 1], lens, out[i])
        else:
            distort(points[i, 0], points[i, 1], lens, out[i])
    return out


def reach_of(coefficients: tuple[float, ...], border: FloatArray) -> float:
    """Reach (see the module) that covers an image, in normalised coordinates.

    Parameters
    ----------
    coefficients : tuple of float
        k1, k2, p1, p2, k3.
    border : ndarray, shape (n, 2)
        Distorted coordinates around the image's border.

    Raises
    ------
    ValueError
        When the distortion folds inside the image: two directions would have one image.
    """
    lens = np.array([*coefficients, np.inf])
    points = distort_all(np.ascontiguousarray(border), lens, True)[:, :2]
    if np.all(np.isfinite(points)):
        along = np.linspace(0.0, 1.0, 65)[:, None, None] * points
        J = distort_all(np.ascontiguousarray(along.reshape(-1, 2)), lens, False)[:, 2:]
        if np.all(J[:, 0] * J[:, 3] - J[:, 1] * J[:, 2] > 0.0):
            return float(np.linalg.norm(points, axis=1).max())
    raise ValueError("the distortion folds inside the image: two directions would have one image")
