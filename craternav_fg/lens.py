"""Radial-tangential distortion of a lens (Brown 1971), with OpenCV's coefficients k1, k2, p1, p2, k3.

It maps the normalised image coordinates (u, v) = (x, y) / z of a direction to those at which the lens images
it:

    [u (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 u v + p2 (r2 + 2 u^2),
     v (1 + k1 r2 + k2 r2^2 + k3 r2^3) + p1 (r2 + 2 v^2) + 2 p2 u v],   r2 = u^2 + v^2.

The polynomials are fitted inside the image. Outside it they may turn back, and a direction far off the axis
would then seem to lie in the image. Beyond a radius, the reach, which covers the image's border, the
distortion at the reach is therefore scaled in proportion to the distance from the axis.

References
----------
Brown, D. C. (1971), Close-range camera calibration, Photogrammetric Engineering 37 (8), 855-866.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

# Newton steps of the inversion, and halvings of a step that does not reduce the error: far more than the
# strongest lenses of the tests need.
_MAX_STEPS, _MAX_HALVINGS = 100, 30
# Relative size of a step at convergence, and of an error that rounding explains: some units of 2^-52.
_STEP_TOLERANCE, _ERROR_TOLERANCE = 1e-14, 1e-13
# Points of a ray from the axis to the border at which the distortion must not fold.
_RAY_POINTS = 65


@njit(cache=True, nogil=True, error_model="numpy")
def distort(u: float, v: float, lens: FloatArray, out: FloatArray) -> None:
    """Distort a point.

    Parameters
    ----------
    u, v : float
        Normalised image coordinates.
    lens : ndarray, shape (6,)
        k1, k2, p1, p2, k3 and the reach, dimensionless.
    out : ndarray, shape (6,)
        Written: distorted coordinates and their Jacobian, x, y, dx/du, dx/dv, dy/du, dy/dv.
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
    """Invert `distort` by damped Newton steps.

    Parameters
    ----------
    x, y : float
        Distorted coordinates.
    lens : ndarray, shape (6,)
        As in `distort`.
    out : ndarray, shape (6,)
        Written: the normalised image coordinates that `distort` maps to (x, y), and its Jacobian there. NaN
        when there are none within the fold of the distortion.
    """
    u, v = 0.0, 0.0
    distort(u, v, lens, out)
    ex, ey = x - out[0], y - out[1]
    for _ in range(_MAX_STEPS):
        determinant = out[2] * out[5] - out[3] * out[4]
        du = (out[5] * ex - out[3] * ey) / determinant
        dv = (out[2] * ey - out[4] * ex) / determinant
        if abs(du) + abs(dv) < _STEP_TOLERANCE * (1.0 + abs(u) + abs(v)):
            out[0] = u + du
            out[1] = v + dv
            return
        # Where the distortion is nearly flat, a full Newton step overshoots, or crosses a fold.
        share = 1.0
        for _ in range(_MAX_HALVINGS):
            distort(u + share * du, v + share * dv, lens, out)
            fx, fy = x - out[0], y - out[1]
            if out[2] * out[5] > out[3] * out[4] and fx * fx + fy * fy < ex * ex + ey * ey:
                break
            share *= 0.5
        else:
            # No better point, because the error is rounding.
            if ex * ex + ey * ey < _ERROR_TOLERANCE**2 * (1.0 + x * x + y * y):
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
    """Distort or undistort points.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Normalised image coordinates, distorted ones for the inverse.
    lens : ndarray, shape (6,)
        As in `distort`.
    inverse : bool
        Whether to undistort.

    Returns
    -------
    ndarray, shape (n, 6)
        What `distort` or `undistort` writes for each point.
    """
    out = np.empty((points.shape[0], 6))
    for i in range(points.shape[0]):
        if inverse:
            undistort(points[i, 0], points[i, 1], lens, out[i])
        else:
            distort(points[i, 0], points[i, 1], lens, out[i])
    return out


def reach_of(coefficients: tuple[float, ...], border: FloatArray) -> float:
    """Compute the reach that covers an image.

    Parameters
    ----------
    coefficients : tuple of float
        k1, k2, p1, p2, k3.
    border : ndarray, shape (n, 2)
        Distorted normalised image coordinates around the image's border.

    Returns
    -------
    float
        Largest distance of the border from the axis, undistorted, in normalised image coordinates.

    Raises
    ------
    ValueError
        When the distortion folds inside the image: two directions would have one image.
    """
    lens = np.array([*coefficients, np.inf])
    points = distort_all(np.ascontiguousarray(border), lens, True)[:, :2]
    if np.all(np.isfinite(points)):
        along = np.linspace(0.0, 1.0, _RAY_POINTS)[:, None, None] * points
        J = distort_all(np.ascontiguousarray(along.reshape(-1, 2)), lens, False)[:, 2:]
        if np.all(J[:, 0] * J[:, 3] - J[:, 1] * J[:, 2] > 0.0):
            return float(np.linalg.norm(points, axis=1).max())
    raise ValueError("the distortion folds inside the image: two directions would have one image")
