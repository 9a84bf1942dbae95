"""Points and normals of rims in the image, through the lens and back; compiled.

Rims are ellipses in the pixels of the camera without its distortion. The brightness is read in the image as
it is: points and normals of a rim go through the lens first, and the edge points found come back.
"""

import numpy as np

from craternav_fg.ellipse import point_kernel, whiten_kernel
from craternav_fg.lens import distort, undistort
from factors.arrays import FloatArray
from factors.kernels.compiled import njit


@njit(cache=True, error_model="numpy")
def rim_point(chart_px: FloatArray, angle: float, out: FloatArray) -> None:
    """Compute a rim's point, outward normal, support distance and curvature at an affine angle.

    Parameters
    ----------
    chart_px : ndarray, shape (5,)
        Chart in pixels.
    angle : float
        Affine angle t: the point is m + L [cos t, sin t].
    out : ndarray, shape (6,)
        Written: point, unit normal, support distance, curvature, px. The support distance is that from the
        centre to the tangent: the rim's radius along the normal.
    """
    out[0], out[1], nx, ny = point_kernel(
        angle, chart_px[0], chart_px[1], chart_px[2], chart_px[3], chart_px[4]
    )
    g = np.sqrt(nx * nx + ny * ny)
    out[2] = nx / g
    out[3] = ny / g
    out[4] = 1.0 / g
    # kappa = h^3 / det(S).
    out[5] = 1.0 / (np.exp(2.0 * (chart_px[2] + chart_px[4])) * g * g * g)


@njit(cache=True, error_model="numpy")
def in_circle(chart_px: FloatArray, x: float, y: float) -> FloatArray:
    """Take a vector of the image to the coordinates in which a rim is the unit circle.

    Parameters
    ----------
    chart_px : ndarray, shape (5,)
        The rim, px.
    x, y : float
        The vector, px.

    Returns
    -------
    ndarray, shape (2,)
        In radii.
    """
    u, v = whiten_kernel(x, y, 0.0, 0.0, chart_px[2], chart_px[3], chart_px[4])
    return np.array([u, v])


@njit(cache=True, error_model="numpy")
def distorts(lens: FloatArray) -> bool:
    """Tell whether a lens distorts.

    Parameters
    ----------
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.
    """
    return bool(np.any(lens[4:13] != 0.0))


@njit(cache=True, error_model="numpy")
def through_lens(q: FloatArray, lens: FloatArray) -> float:
    """Take a rim point to the pixels of the distorted image, to first order around it.

    Parameters
    ----------
    q : ndarray, shape (6,)
        As `rim_point` writes it; overwritten.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.

    Returns
    -------
    float
        Pixels of the camera without distortion per pixel of the image, across the rim.
    """
    work = np.empty(6)
    fx, fy = lens[0], lens[1]
    distort((q[0] - lens[2]) / fx, (q[1] - lens[3]) / fy, lens[4:], work)
    xx, xy, yx, yy = work[2], work[3] * fx / fy, work[4] * fy / fx, work[5]
    determinant = xx * yy - xy * yx
    # Normals go by the inverse transpose.
    nx = (yy * q[2] - yx * q[3]) / determinant
    ny = (xx * q[3] - xy * q[2]) / determinant
    g = np.sqrt(nx * nx + ny * ny)
    q[0] = lens[2] + fx * work[0]
    q[1] = lens[3] + fy * work[1]
    q[2] = nx / g
    q[3] = ny / g
    q[4] /= g
    q[5] /= g * g * g * determinant * determinant
    return g


@njit(cache=True, error_model="numpy")
def back_through_lens(point: FloatArray, move: FloatArray, lens: FloatArray) -> None:
    """Take a point of the image and a small motion of it to the pixels of the camera without distortion.

    Parameters
    ----------
    point, move : ndarray, shape (2,)
        Overwritten, px.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.
    """
    work = np.empty(6)
    fx, fy = lens[0], lens[1]
    undistort((point[0] - lens[2]) / fx, (point[1] - lens[3]) / fy, lens[4:], work)
    xx, xy, yx, yy = work[2], work[3] * fx / fy, work[4] * fy / fx, work[5]
    determinant = xx * yy - xy * yx
    point[0] = lens[2] + fx * work[0]
    point[1] = lens[3] + fy * work[1]
    mx, my = move[0], move[1]
    move[0] = (yy * mx - xy * my) / determinant
    move[1] = (xx * my - yx * mx) / determinant


@njit(cache=True, error_model="numpy")
def rim_points(charts_px: FloatArray, angles: FloatArray) -> FloatArray:
    """Compute points around rims.

    Parameters
    ----------
    charts_px : ndarray, shape (n, 5)
        Charts in pixels.
    angles : ndarray, shape (k,)
        Affine angles, rad.

    Returns
    -------
    ndarray, shape (n, k, 6)
        See `rim_point`.
    """
    points = np.empty((charts_px.shape[0], angles.shape[0], 6))
    for r in range(charts_px.shape[0]):
        for k in range(angles.shape[0]):
            rim_point(charts_px[r], angles[k], points[r, k])
    return points
