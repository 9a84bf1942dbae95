"""Distortion of a lens: radial-tangential, rational and fisheye, with OpenCV's coefficients.

It maps the normalised image coordinates (u, v) = (x, y) / z of a direction to those at which the lens images
it. Radial-tangential (Brown 1971) with k1, k2, p1, p2, k3 and rational with k4, k5, k6 as well:

    [u s + 2 p1 u v + p2 (r2 + 2 u^2),
     v s + p1 (r2 + 2 v^2) + 2 p2 u v],   r2 = u^2 + v^2,
    s = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3).

Fisheye (Kannala and Brandt 2006) with k1, k2, k3, k4, at the angle t = atan(r) from the axis:

    [u s, v s],   s = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) / r.

The polynomials are fitted inside the image. Outside it they may turn back, and a direction far off the axis
would then seem to lie in the image. Beyond a radius, the reach, which covers the image's border, the
distortion at the reach is therefore scaled in proportion to the distance from the axis.

References
----------
Brown, D. C. (1971), Close-range camera calibration, Photogrammetric Engineering 37 (8), 855-866.

Kannala, J. and Brandt, S. S. (2006), A generic camera model and calibration method for conventional,
wide-angle, and fish-eye lenses, IEEE Transactions on Pattern Analysis and Machine Intelligence 28 (8).
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Newton steps of the inversion, and halvings of a step that does not reduce the error: far more than the
# strongest lenses of the tests need.
_MAX_STEPS, _MAX_HALVINGS = 100, 30
# Relative size of a step at convergence, and of an error that rounding explains: some units of 2^-52.
_STEP_TOLERANCE, _ERROR_TOLERANCE = 1e-14, 1e-13
# Points of a ray from the axis to the border at which the distortion must not fold.
_RAY_POINTS = 65

# The models and how many coefficients each takes; the shorter of two leaves out zeros at the end.
RADIAL_TANGENTIAL, RATIONAL, FISHEYE = "radial-tangential", "rational", "fisheye"
COUNTS = {RADIAL_TANGENTIAL: (4, 5), RATIONAL: (8,), FISHEYE: (4,)}
# Below this distance from the axis a fisheye's scale is that of its series.
_NEAR_AXIS = 1e-4


def parameters(model: str, coefficients: tuple[float, ...]) -> FloatArray:
    """Pack a lens for the kernels, without its reach.

    Parameters
    ----------
    model : str
        A key of `COUNTS`.
    coefficients : tuple of float
        Radial-tangential: k1, k2, p1, p2 and k3. Rational: these and k4, k5, k6. Fisheye: k1, k2, k3, k4.

    Returns
    -------
    ndarray, shape (9,)
        k1, k2, p1, p2, k3, k4, k5, k6 and 0; or k1, k2, k3, k4, zeros and 1 for a fisheye. Dimensionless.

    Raises
    ------
    ValueError
        When the model is unknown, or takes another number of coefficients.
    """
    if model not in COUNTS:
        raise ValueError(f"expected the model of the lens, {', '.join(COUNTS)}, found {model!r}")
    if len(coefficients) not in COUNTS[model]:
        counts = " or ".join(map(str, COUNTS[model]))
        raise ValueError(f"expected {counts} coefficients of a {model} lens, found {len(coefficients)}")
    lens = np.zeros(9)
    lens[: len(coefficients)] = coefficients
    lens[8] = model == FISHEYE
    return lens


@njit(cache=True, nogil=True, error_model="numpy")
def distort(u: float, v: float, lens: FloatArray, out: FloatArray) -> None:
    """Distort a point.

    Parameters
    ----------
    u, v : float
        Normalised image coordinates.
    lens : ndarray, shape (10,)
        As `parameters` gives it, and the reach, dimensionless.
    out : ndarray, shape (6,)
        Written: distorted coordinates and their Jacobian, x, y, dx/du, dx/dv, dy/du, dy/dv.
    """
    reach = lens[9]
    r = np.sqrt(u * u + v * v)
    beyond = r > reach
    a, b = u, v
    if beyond:
        a *= reach / r
        b *= reach / r
    if lens[8] != 0.0:
        _fisheye(a, b, lens, out)
    else:
        _rational(a, b, lens, out)
    if beyond:
        # F(u) = D(w) r / reach with w = reach u / r: dF = J(w) (I - e e') + D(w) e' / reach.
        e0, e1 = u / r, v / r
        for i in range(2):
            along = out[2 + 2 * i] * e0 + out[3 + 2 * i] * e1
            out[2 + 2 * i] += (out[i] / reach - along) * e0
            out[3 + 2 * i] += (out[i] / reach - along) * e1
            out[i] *= r / reach


@njit(cache=True, nogil=True, error_model="numpy")
def _rational(a: float, b: float, lens: FloatArray, out: FloatArray) -> None:
    """Distort a point by a radial-tangential or rational lens."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (
        lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7],
    )  # fmt: skip
    r2 = a * a + b * b
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)) / below
    slope -= 2.0 * radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)) / below
    out[0] = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    out[1] = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    out[2] = radial + slope * a * a + 2.0 * p1 * b + 6.0 * p2 * a
    out[3] = slope * a * b + 2.0 * p1 * a + 2.0 * p2 * b
    out[4] = out[3]
    out[5] = radial + slope * b * b + 6.0 * p1 * b + 2.0 * p2 * a


@njit(cache=True, nogil=True, error_model="numpy")
def _fisheye(a: float, b: float, lens: FloatArray, out: FloatArray) -> None:
    """Distort a point by a fisheye lens."""
    k1, k2, k3, k4 = lens[0], lens[1], lens[2], lens[3]
    r2 = a * a + b * b
    r = np.sqrt(r2)
    if r < _NEAR_AXIS:
        scale = 1.0 + (k1 - 1.0 / 3.0) * r2
        slope = 2.0 * (k1 - 1.0 / 3.0)
    else:
        t = np.arctan(r)
        t2 = t * t
        scale = t * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r
        rate = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        slope = (rate / (1.0 + r2) - scale) / r2
    out[0] = a * scale
    out[1] = b * scale
    out[2] = scale + slope * a * a
    out[3] = slope * a * b
    out[4] = out[3]
    out[5] = scale + slope * b * b


@njit(cache=True, nogil=True, error_model="numpy")
def undistort(x: float, y: float, lens: FloatArray, out: FloatArray) -> None:
    """Invert `distort` by damped Newton steps.

    Parameters
    ----------
    x, y : float
        Distorted coordinates.
    lens : ndarray, shape (10,)
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
    lens : ndarray, shape (10,)
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


def reach_of(lens: FloatArray, border: FloatArray) -> float:
    """Compute the reach that covers an image.

    Parameters
    ----------
    lens : ndarray, shape (9,)
        As `parameters` gives it, dimensionless.
    border : ndarray, shape (n, 2)
        Distorted normalised image coordinates around the image's border.

    Returns
    -------
    float
        Largest distance of the border from the axis, undistorted, in normalised image coordinates.

    Raises
    ------
    ValueError
        When the distortion folds inside the image: two directions would have one image. Also when a fisheye
        sees 90 deg from its axis in the image, where the coordinates end.
    """
    unbound = np.append(lens, np.inf)
    points = distort_all(np.ascontiguousarray(border), unbound, True)[:, :2]
    if np.all(np.isfinite(points)):
        along = np.linspace(0.0, 1.0, _RAY_POINTS)[:, None, None] * points
        J = distort_all(np.ascontiguousarray(along.reshape(-1, 2)), unbound, False)[:, 2:]
        if np.all(J[:, 0] * J[:, 3] - J[:, 1] * J[:, 2] > 0.0):
            return float(np.linalg.norm(points, axis=1).max())
    elif lens[8]:
        raise ValueError("the fisheye sees 90 deg from its axis or more inside the image, or folds: crop it")
    raise ValueError("the distortion folds inside the image: two directions would have one image")
