"""Ellipses in their several forms, the conversions between them, and covariances of their charts.

The chart of an ellipse (u - m)' S^-1 (u - m) = 1 is

    y = [m_x, m_y, ln(S_xx)/2, S_xy/S_xx, ln(S_yy - S_xy^2/S_xx)/2],

a global parametrisation of all ellipses without singularities. With the lower triangular root of S = L L',
L = [[e^y3, 0], [y4 e^y3, e^y5]], the points of the ellipse are m + L [cos t, sin t]; t is the ellipse's
parameter. Axes are [x, y, a, b, angle]: centre, semi-axes a >= b, and direction of a from x towards y, rad.
Conics are (A, B, C, D, E, F) of eq. (3); their kernels are in `factors.kernels.conic`, as factors need them.

Charts are in normalised image coordinates unless a name ends in `_px`; pixels are those of `camera.pinhole`,
because a lens that distorts does not image an ellipse as an ellipse.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.linalg import scaled_inverse
from factors.arrays import FloatArray
from factors.kernels import conic
from factors.kernels.compiled import njit


# Arithmetic on the elements of charts: on arrays in this module, on numbers and compiled in kernels.
def _moments(log_x: Any, shear: Any, log_y: Any) -> tuple[Any, Any, Any]:
    """S_xx, S_xy and S_yy of the last three elements of a chart."""
    sxx = np.exp(2.0 * log_x)
    sxy = shear * sxx
    return sxx, sxy, np.exp(2.0 * log_y) + shear * sxy


def _semi_axes(sxx: Any, sxy: Any, syy: Any, product: Any) -> tuple[Any, Any]:
    """Semi-axes a >= b of S, given their product."""
    half = 0.5 * (sxx - syy)
    major = np.sqrt(0.5 * (sxx + syy) + np.sqrt(half * half + sxy * sxy))
    # As a quotient: no digits are lost on a thin ellipse.
    return major, product / major


def _half_sides(log_x: Any, shear: Any, log_y: Any) -> tuple[Any, Any]:
    """Half width and half height of the upright box, of the last three elements of a chart."""
    half_x = np.exp(log_x)
    return half_x, np.hypot(np.exp(log_y), shear * half_x)


def _point(t: Any, x: Any, y: Any, log_x: Any, shear: Any, log_y: Any) -> tuple[Any, Any, Any, Any]:
    """Point at a parameter, and there the gradient of sqrt((u - m)' S^-1 (u - m)), which is outward."""
    ex, ey = np.exp(log_x), np.exp(log_y)
    c, s = np.cos(t), np.sin(t)
    gradient_y = s / ey
    return x + ex * c, y + shear * ex * c + ey * s, c / ex - shear * gradient_y, gradient_y


def _whiten(u: Any, v: Any, x: Any, y: Any, log_x: Any, shear: Any, log_y: Any) -> tuple[Any, Any]:
    """Point L^-1 ((u, v) - m): its place when the ellipse is made the unit circle."""
    du = u - x
    return du / np.exp(log_x), (v - y - shear * du) / np.exp(log_y)


_compiled = njit(cache=True, nogil=True, error_model="numpy")
moments_kernel = _compiled(_moments)
semi_axes_kernel = _compiled(_semi_axes)
half_sides_kernel = _compiled(_half_sides)
point_kernel = _compiled(_point)
whiten_kernel = _compiled(_whiten)


def normalised_chart(chart_px: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Turn charts in pixels into charts in normalised image coordinates.

    Parameters
    ----------
    chart_px : ndarray, shape (..., 5)
        In the pixels of `camera.pinhole`.
    camera : Camera

    Returns
    -------
    chart : ndarray, shape (..., 5)
        In normalised image coordinates.
    scale : ndarray, shape (5,)
        Diagonal of the derivative of `chart` in `chart_px`.
    """
    scale = np.array([1.0 / camera.fx_px, 1.0 / camera.fy_px, 1.0, camera.fx_px / camera.fy_px, 1.0])
    offset = np.array([camera.cx_px, camera.cy_px, np.log(camera.fx_px), 0.0, np.log(camera.fy_px)])
    return (chart_px - offset) * scale, scale


def pixel_chart(chart: FloatArray, camera: Camera) -> FloatArray:
    """Turn charts in normalised image coordinates into charts in pixels.

    Parameters
    ----------
    chart : ndarray, shape (..., 5)
        In normalised image coordinates.
    camera : Camera

    Returns
    -------
    ndarray, shape (..., 5)
        In the pixels of `camera.pinhole`.
    """
    scale = np.array([camera.fx_px, camera.fy_px, 1.0, camera.fy_px / camera.fx_px, 1.0])
    offset = np.array([camera.cx_px, camera.cy_px, np.log(camera.fx_px), 0.0, np.log(camera.fy_px)])
    return np.asarray(chart * scale + offset)


def chart_of_outline(points: FloatArray) -> FloatArray:
    """Compute the charts of the ellipses that best follow outlines: their first harmonics.

    Parameters
    ----------
    points : ndarray, shape (n, k, 2)
        On each outline, at even steps of an ellipse's parameter, as `points_on` gives them.

    Returns
    -------
    ndarray, shape (n, 5)
        In the coordinates of the points.
    """
    k = points.shape[1]
    t = 2.0 * np.pi * np.arange(k) / k
    cosine, sine = (2.0 / k * np.einsum("nkd,k->nd", points, f(t)) for f in (np.cos, np.sin))
    return chart_of_diameters(points.mean(axis=1), cosine, sine)


def chart_of_diameters(centre: FloatArray, p: FloatArray, q: FloatArray) -> FloatArray:
    """Compute the charts of ellipses centre + p cos t + q sin t.

    Parameters
    ----------
    centre, p, q : ndarray, shape (..., 2)
        Centres and conjugate semi-diameters, in one unit.

    Returns
    -------
    ndarray, shape (..., 5)
        Charts in that unit.
    """
    sxx = p[..., 0] ** 2 + q[..., 0] ** 2
    sxy = p[..., 0] * p[..., 1] + q[..., 0] * q[..., 1]
    # The root of the determinant of S: no digits are lost on a thin ellipse.
    root = np.abs(p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0])
    log_x = 0.5 * np.log(sxx)
    return np.stack([centre[..., 0], centre[..., 1], log_x, sxy / sxx, np.log(root) - log_x], axis=-1)


def chart_of_axes(axes: npt.ArrayLike) -> FloatArray:
    """Compute charts from axes.

    Parameters
    ----------
    axes : array_like, shape (..., 5)
        Centre, semi-axes in any order, and direction of the first one, rad.

    Returns
    -------
    ndarray, shape (..., 5)
        Charts in the unit of the axes.
    """
    x, y, a, b, angle = np.moveaxis(np.asarray(axes, dtype=np.float64), -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    first, second = np.stack([a * c, a * s], axis=-1), np.stack([-b * s, b * c], axis=-1)
    return chart_of_diameters(np.stack([x, y], axis=-1), first, second)


def axes_of_chart(charts: FloatArray) -> FloatArray:
    """Compute axes from charts.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.

    Returns
    -------
    ndarray, shape (..., 5)
        Centre, semi-axes a >= b, in the charts' unit, and direction of a, rad, -pi/2 to pi/2.
    """
    x, y, log_x, shear, log_y = np.moveaxis(np.asarray(charts), -1, 0)
    sxx, sxy, syy = _moments(log_x, shear, log_y)
    major, minor = _semi_axes(sxx, sxy, syy, np.exp(log_x + log_y))
    angle = 0.5 * np.arctan2(sxy, 0.5 * (sxx - syy))
    return np.stack([x, y, major, minor, angle], axis=-1)


def semi_minor(charts: FloatArray) -> FloatArray:
    """Compute the semi-minor axes of ellipses.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.

    Returns
    -------
    ndarray, shape (...,)
        In the charts' unit.
    """
    log_x, shear, log_y = np.moveaxis(np.asarray(charts)[..., 2:], -1, 0)
    return np.asarray(_semi_axes(*_moments(log_x, shear, log_y), np.exp(log_x + log_y))[1])


def semi_minor_bound(charts: FloatArray) -> FloatArray:
    """Compute upper bounds of the semi-minor axes: the lesser of half width and half vertical chord.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.

    Returns
    -------
    ndarray, shape (...,)
        In the charts' unit; the semi-minor axis itself where it is along x or y.
    """
    return np.asarray(np.exp(np.minimum(charts[..., 2], charts[..., 4])))


def mean_radius(charts: FloatArray) -> FloatArray:
    """Compute the geometric means of the semi-axes: the radii of circles of equal area.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.

    Returns
    -------
    ndarray, shape (...,)
        In the charts' unit.
    """
    return np.asarray(np.exp(0.5 * (charts[..., 2] + charts[..., 4])))


def matrix_of_chart(charts: FloatArray) -> FloatArray:
    """Compute the matrices S of ellipses.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.

    Returns
    -------
    ndarray, shape (..., 2, 2)
        In the charts' unit squared.
    """
    sxx, sxy, syy = _moments(*np.moveaxis(np.asarray(charts)[..., 2:], -1, 0))
    return np.stack([sxx, sxy, sxy, syy], axis=-1).reshape(*np.shape(sxx), 2, 2)


def half_sides(charts: FloatArray) -> FloatArray:
    """Compute half widths and half heights of the upright boxes around ellipses.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.

    Returns
    -------
    ndarray, shape (..., 2)
        In the charts' unit.
    """
    return np.stack(_half_sides(*np.moveaxis(np.asarray(charts)[..., 2:], -1, 0)), axis=-1)


def points_on(charts: FloatArray, count: int = 48) -> FloatArray:
    """Compute points around ellipses, equally spaced in the parameter.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.
    count : int
        Number of points.

    Returns
    -------
    ndarray, shape (..., count, 2)
        In the charts' coordinates, from parameter 0 on.
    """
    t = 2.0 * np.pi * np.arange(count) / count
    return np.stack(_point(t, *np.moveaxis(np.asarray(charts)[..., None, :], -1, 0))[:2], axis=-1)


def points_and_normals(charts: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute points of ellipses and the outward unit normals there.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In any unit.
    t : ndarray, shape (k,)
        Parameters of the points, rad.

    Returns
    -------
    points : ndarray, shape (..., k, 2)
        In the charts' coordinates.
    normals : ndarray, shape (..., k, 2)
        Unit vectors.
    """
    x, y, gx, gy = _point(t, *np.moveaxis(np.asarray(charts)[..., None, :], -1, 0))
    normals = np.stack([gx, gy], axis=-1)
    return np.stack([x, y], axis=-1), normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def whitened_points(points: FloatArray, chart: FloatArray) -> FloatArray:
    """Map points by the affine map that makes an ellipse the unit circle about the origin.

    Parameters
    ----------
    points : ndarray, shape (..., 2)
        In the chart's coordinates.
    chart : ndarray, shape (5,)
        Chart of the ellipse.

    Returns
    -------
    ndarray, shape (..., 2)
        L^-1 (u - m): of length 1 on the ellipse, in the direction of the parameter t.
    """
    return np.stack(_whiten(points[..., 0], points[..., 1], *chart), axis=-1)


def conics_of_charts(charts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the conics of ellipses, and their derivatives.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        In any unit.

    Returns
    -------
    conics : ndarray, shape (n, 6)
        (A, B, C, D, E, F) of eq. (3), of unit norm.
    jacobians : ndarray, shape (n, 6, 5)
        Derivatives of the conics by the charts.

    References
    ----------
    Tian et al. (2019), DOI 10.1017/S0373463318000966, eq. (3).
    """
    conics = np.array([conic.chart_to_conic(y) for y in charts]).reshape(-1, 6)
    return conics, np.array([conic.chart_to_conic_jacobian(y) for y in charts]).reshape(-1, 6, 5)


def shape_change(before: FloatArray, after: FloatArray) -> FloatArray:
    """Measure by how much the shapes of ellipses differ: the largest logarithm of a stretch, over directions.

    An ellipse that is larger by 10 % has changed by 0.1, whatever its shape; one foreshortened by a factor c
    has changed by |ln c|. Neither its place nor a common rotation matters.

    Parameters
    ----------
    before, after : ndarray, shape (..., 5)
        Charts in the same coordinates.

    Returns
    -------
    ndarray, shape (...,)
        Zero for equal shapes, else positive.
    """
    # S = L L', L lower triangular: singular values of inv(L1) L2.
    a = np.exp(after[..., 2] - before[..., 2])
    d = np.exp(after[..., 4] - before[..., 4])
    b = (after[..., 3] - before[..., 3]) * np.exp(after[..., 2] - before[..., 4])
    half = 0.5 * np.log(a * d)
    # Half the sum of squares over the product is cosh of the difference of the logarithms.
    spread = 0.5 * np.arccosh(np.maximum(0.5 * (a * a + b * b + d * d) / (a * d), 1.0))
    return np.asarray(np.abs(half) + spread)


def chart_covariance(charts: FloatArray, camera: Camera, sigma_px: float, count: int) -> FloatArray:
    """Compute the covariances of charts fitted to edge points all round: their Cramer-Rao bound.

    Parameters
    ----------
    charts : ndarray, shape (..., 5)
        In normalised image coordinates.
    camera : Camera
    sigma_px : float
        Standard deviation of an edge point along the rim's normal.
    count : int
        Edge points, equally spaced in the ellipse's parameter.

    Returns
    -------
    ndarray, shape (..., 5, 5)
        sigma^2 (J'J)^-1, J being the derivative of the points' distances in the chart; in the units of the
        chart in normalised image coordinates.
    """
    charts_px = pixel_chart(charts, camera)
    points, normals = points_and_normals(charts_px, 2.0 * np.pi * np.arange(count) / count)
    off = points - charts_px[..., None, :2]
    shear = charts_px[..., None, 3]
    nx, ny = normals[..., 0], normals[..., 1]
    # The derivative of a rim point along its normal.
    x_and_shear = (nx + shear * ny) * off[..., 0]
    along_y = ny * (off[..., 1] - shear * off[..., 0])
    J = np.stack([nx, ny, x_and_shear, ny * off[..., 0], along_y], axis=-1)
    _, scale = normalised_chart(charts, camera)
    bound = scaled_inverse(np.swapaxes(J, -1, -2) @ J)
    return np.asarray(sigma_px**2 * bound * scale[:, None] * scale)


def relative_covariance(charts: FloatArray, share: float) -> FloatArray:
    """Compute the covariances of charts with independent errors in proportion to the ellipse's size.

    Parameters
    ----------
    charts : ndarray, shape (n, 5)
        In any unit.
    share : float
        Standard deviation of the centre, the logarithmic sizes and the vertical ends of the ellipse, as a
        share of its half sides.

    Returns
    -------
    ndarray, shape (n, 5, 5)
        Diagonal, in the charts' unit.
    """
    half = half_sides(charts)
    ones = np.ones(len(charts))
    # The shear is a length over the half width.
    shear = np.exp(charts[:, 4] - charts[:, 2])
    scale = np.column_stack([half, ones, shear, ones])
    return np.asarray((share * scale[:, :, None]) ** 2 * np.eye(5))


@_compiled
def axes_covariance(chart: FloatArray, sigma: float) -> FloatArray:
    """Compute the covariance of a chart whose centre and semi-axes have independent errors of one size.

    The symmetric root A of S changes by a symmetric matrix. Its element off the diagonal, which turns the
    ellipse by itself over a - b, has half the variance of those on it: the covariance is then the same for
    all directions of the axes.

    Parameters
    ----------
    chart : ndarray, shape (5,)
        In any unit.
    sigma : float
        Standard deviation of the centre's coordinates and of the semi-axes, in the chart's unit.

    Returns
    -------
    ndarray, shape (5, 5)
        Covariance of the chart.
    """
    beta, product = chart[3], np.exp(chart[2] + chart[4])
    sxx, sxy, syy = moments_kernel(chart[2], beta, chart[4])
    schur = np.exp(2.0 * chart[4])
    # A = (S + ab I) / (a + b), and dS = A dA + dA A for the elements xx, yy and xy of dA.
    total = np.sqrt(sxx + syy + 2.0 * product)
    xx, xy, yy = (sxx + product) / total, sxy / total, (syy + product) / total
    of_root = ((2.0 * xx, xy, 0.0, 1.0), (0.0, xy, 2.0 * yy, 1.0), (2.0 * xy, xx + yy, 2.0 * xy, 0.5))
    out = np.zeros((5, 5))
    out[0, 0] = out[1, 1] = sigma * sigma
    g = np.empty(3)
    for dxx, dxy, dyy, share in of_root:
        g[0] = 0.5 * dxx / sxx
        g[1] = (dxy - beta * dxx) / sxx
        g[2] = 0.5 * (dyy - 2.0 * beta * dxy + beta * beta * dxx) / schur
        for i in range(3):
            for j in range(3):
                out[2 + i, 2 + j] += share * sigma * sigma * g[i] * g[j]
    return out
