"""Distance of a point to an ellipse, with its derivative; compiled."""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit


@njit(cache=True, error_model="numpy")
def signed_distances(points: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the distances of points to one ellipse, positive outside, with their derivatives.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Pixels.
    y : ndarray, shape (5,)
        Chart of the ellipse in pixels.

    Returns
    -------
    distances : ndarray, shape (n,)
        Pixels, exact for circles.
    normals : ndarray, shape (n, 2)
        Outward unit normals.
    derivatives : ndarray, shape (n, 5)
        In y at the ellipse; the part that vanishes with the distance is left out.
    """
    count = len(points)
    distances, normals, derivatives = np.empty(count), np.empty((count, 2)), np.empty((count, 5))
    ea, es = np.exp(y[2]), np.exp(y[4])
    for i in range(count):
        distances[i] = distance_of(points[i, 0], points[i, 1], y, ea, es, normals[i], derivatives[i])
    return distances, normals, derivatives


@njit(cache=True, error_model="numpy")
def distance_of(
    px: float, py: float, y: FloatArray, ea: float, es: float, n: FloatArray, w: FloatArray
) -> float:
    """Compute the distance of one point: for many of one ellipse, as its exponentials take longest.

    Parameters
    ----------
    px, py : float
        The point, px.
    y : ndarray, shape (5,)
        Chart of the ellipse in pixels.
    ea, es : float
        Exponentials of its third and fifth element, px.
    n : ndarray, shape (2,)
        Written: outward unit normal.
    w : ndarray, shape (5,)
        Written: derivative of the distance in y, as in `signed_distances`.

    Returns
    -------
    float
        Distance, px, exact for circles.
    """
    x, z, beta = px - y[0], py - y[1], y[3]
    # Whitened point: S = L L', L = [[ea, 0], [beta ea, es]].
    per_a, per_s = 1.0 / ea, 1.0 / es
    u = x * per_a
    v = (z - beta * x) * per_s
    r = np.sqrt(u * u + v * v)
    if r < 1e-9:
        r = 1e-9
    # r times the gradient of r, and the reciprocal of its length: divisions take longest.
    ny = v * per_s
    nx = u * per_a - beta * ny
    per_g = 1.0 / np.sqrt(nx * nx + ny * ny)
    n[0] = nx * per_g
    n[1] = ny * per_g
    # dr = (u du + v dv) / r, divided by |grad r|.
    w[0] = -n[0]
    w[1] = -n[1]
    w[2] = -u * u * per_g
    w[3] = -v * x * per_s * per_g
    w[4] = -v * v * per_g
    return (r - 1.0) * r * per_g


@njit(cache=True, error_model="numpy")
def distances(xy: FloatArray, y: FloatArray, ea: float, es: float, out: FloatArray) -> None:
    """Compute the distances of many points to one ellipse without derivatives, several at a time.

    Parameters
    ----------
    xy : ndarray, shape (2, n)
        The points, px.
    y : ndarray, shape (5,)
        Chart of the ellipse in pixels.
    ea, es : float
        Exponentials of its third and fifth element, px.
    out : ndarray, shape (n,)
        Written: distances, px, as `distance_of` computes them.
    """
    px, py = xy[0], xy[1]
    centre_x, centre_y, per_a, per_s = y[0], y[1], 1.0 / ea, 1.0 / es
    shear = y[3] * per_s
    for i in range(len(out)):
        x = px[i] - centre_x
        u = x * per_a
        v = (py[i] - centre_y) * per_s - shear * x
        r = max(np.sqrt(u * u + v * v), 1e-9)
        nx, ny = u * per_a - shear * v, v * per_s
        out[i] = (r - 1.0) * r / np.sqrt(nx * nx + ny * ny)
