"""Distance of a point to an ellipse, with its derivative; compiled."""

import numpy as np
import numpy.typing as npt

from factors.kernels.compiled import njit

FloatArray = npt.NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def signed_distance(px: float, py: float, y: FloatArray, n: FloatArray, w: FloatArray) -> float:
    """Compute the distance of a point to the ellipse, positive outside, with its derivative.

    Parameters
    ----------
    px, py : float
        The point, px.
    y : ndarray, shape (5,)
        Chart of the ellipse in pixels.
    n : ndarray, shape (2,)
        Written: outward unit normal.
    w : ndarray, shape (5,)
        Written: derivative of the distance in y at the ellipse; the part that vanishes with the distance is
        left out.

    Returns
    -------
    float
        Distance, px, exact for circles.
    """
    return distance_of(px, py, y, np.exp(y[2]), np.exp(y[4]), n, w)


@njit(cache=True, error_model="numpy")
def distance_of(
    px: float, py: float, y: FloatArray, ea: float, es: float, n: FloatArray, w: FloatArray
) -> float:
    """Compute the same for many points of one ellipse: its exponentials take longer than all the rest.

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
        Written: derivative of the distance in y, as in `signed_distance`.

    Returns
    -------
    float
        Distance, px, exact for circles.
    """
    x, z, beta = px - y[0], py - y[1], y[3]
    # Whitened point: S = L L', L = [[ea, 0], [beta ea, es]].
    u = x / ea
    v = (z - beta * x) / es
    r = np.sqrt(u * u + v * v)
    if r < 1e-9:
        r = 1e-9
    nx = (u / ea - beta * v / es) / r
    ny = v / es / r
    g = np.sqrt(nx * nx + ny * ny)
    n[0] = nx / g
    n[1] = ny / g
    # df = (u du + v dv) / r, divided by |grad f|.
    ig = 1.0 / g
    w[0] = -n[0]
    w[1] = -n[1]
    w[2] = -u * u / r * ig
    w[3] = -v * x / es / r * ig
    w[4] = -v * v / r * ig
    return (r - 1.0) * ig
