"""Maximum-likelihood ellipses of edge points with known noise, and their covariances.

In images, `vision.ellipse_fit` fits robustly and estimates the noise from the scatter of the points. Here the
noise is known, and Gaussian along the rim's normal: for simulated edges, and for ellipses fitted elsewhere.
"""

import cv2
import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import (
    chart_covariance,
    chart_of_axes,
    normalised_chart,
    pixel_chart,
    points_on,
    whiten_kernel,
    whitened_points,
)
from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.gauss_newton import invert, solve
from factors.kernels.rim import rim_distance

# Steps of the Levenberg-Marquardt fit.
_MAX_ITERATIONS = 20
# Its initial damping, and the least after a rejected step.
_INITIAL_DAMPING, _MIN_DAMPING = 1e-4, 1e-6
# A relative increase of the cost that is only rounding, and decreases, relative and absolute in px^2, that
# end the fit.
_ROUNDING, _RELATIVE_END, _ABSOLUTE_END_PX2 = 1e-14, 1e-10, 1e-20
# Five-point Gauss-Hermite quadrature for a standard normal variable: nodes and weights.
_NODES = np.array([-2.8569700138728056, -1.355626179974266, 0.0, 1.355626179974266, 2.8569700138728056])
_WEIGHTS = np.array(
    [0.011257411327720688, 0.2220759220056126, 0.5333333333333333, 0.2220759220056126, 0.011257411327720688]
)
# Step of a central difference in the units of a chart in pixels, px or 1.
_STEP = 1e-4


def fit_edges(points_px: FloatArray, camera: Camera, sigma_px: float) -> tuple[FloatArray, FloatArray] | None:
    """Fit an ellipse to edge points by maximum likelihood.

    Parameters
    ----------
    points_px : ndarray, shape (n, 2)
        Six or more points, spread over the rim, in the pixels of `camera.pinhole`.
    camera : Camera
    sigma_px : float
        Standard deviation of a point along the rim's normal.

    Returns
    -------
    tuple of ndarray, shapes (5,) and (5, 5), or None
        Chart in normalised image coordinates and its covariance, see `fit_covariance`; None when the points
        determine no ellipse.
    """
    points = np.ascontiguousarray(points_px, dtype=np.float64)
    (cx, cy), (d1, d2), angle_deg = cv2.fitEllipseAMS(points.astype(np.float32))
    if not (min(d1, d2) > 0.0 and np.isfinite([cx, cy, d1, d2, angle_deg]).all()):
        return None
    start = chart_of_axes([cx, cy, 0.5 * d1, 0.5 * d2, np.deg2rad(angle_deg)])
    fitted, y, covariance = _fit(points, start)
    if not fitted:
        return None
    chart, scale = normalised_chart(y, camera)
    if not _scatter(_feet(points, y), y, sigma_px, covariance):
        return None
    return chart, covariance * np.outer(scale, scale)


def fit_covariance(chart: FloatArray, camera: Camera, sigma_px: float, count: int) -> FloatArray:
    """Compute the covariance of a chart that was fitted to edge points all round the rim.

    On small rims a fit scatters more than its Cramer-Rao bound: where the noise is a considerable share of
    the semi-minor axis, the distances are not linear in it. The covariance is that of an M-estimate,
    A^-1 B A^-T with the mean derivative A and the covariance B of its score under the points' noise.

    Parameters
    ----------
    chart : ndarray, shape (5,)
        In normalised image coordinates.
    camera : Camera
    sigma_px : float
        Standard deviation of an edge point along the rim's normal.
    count : int
        Edge points, equally spaced in the ellipse's parameter.

    Returns
    -------
    ndarray, shape (5, 5)
        Covariance in the units of the chart. It approaches `ellipse.chart_covariance`, the bound, for large
        rims, and is the bound where the noise is so large that the estimate has no covariance.
    """
    y = pixel_chart(chart, camera)
    points = points_on(y, count)
    covariance = np.empty((5, 5))
    if not _scatter(points, y, sigma_px, covariance):
        return chart_covariance(chart, camera, sigma_px, count)
    _, scale = normalised_chart(chart, camera)
    return np.asarray(covariance * np.outer(scale, scale))


def _feet(points: FloatArray, y: FloatArray) -> FloatArray:
    """Points (n, 2) of the ellipse on the rays from its centre to some points (n, 2)."""
    white = whitened_points(points, y)
    return np.asarray(y[:2] + (points - y[:2]) / np.linalg.norm(white, axis=-1, keepdims=True))


@njit(cache=True, error_model="numpy")
def _normal_matrix(points: FloatArray, y: FloatArray, N: FloatArray, g: FloatArray) -> float:
    """Write N = sum D D' and g = sum D d of the points' distances d; return the sum of their squares."""
    D = np.empty(5)
    N[:] = 0.0
    g[:] = 0.0
    total = 0.0
    for i in range(points.shape[0]):
        d = rim_distance(points[i, 0], points[i, 1], y, D)
        total += d * d
        for a in range(5):
            g[a] += D[a] * d
            for b in range(5):
                N[a, b] += D[a] * D[b]
    return total


@njit(cache=True, error_model="numpy")
def _fit(points: FloatArray, start: FloatArray) -> tuple[bool, FloatArray, FloatArray]:
    """Fit by Levenberg-Marquardt; return convergence, chart, and covariance for points of unit variance."""
    y, candidate = start.copy(), np.empty(5)
    N, trial = np.empty((5, 5)), np.empty((5, 5))
    g, trial_g, step = np.empty(5), np.empty(5), np.empty(5)
    cost = _normal_matrix(points, y, N, g)
    damping = _INITIAL_DAMPING
    converged = False
    for _ in range(_MAX_ITERATIONS):
        damped = N.copy()
        for a in range(5):
            damped[a, a] *= 1.0 + damping
        solve(damped, g, step)
        for a in range(5):
            candidate[a] = y[a] - step[a]
        # Also false for NaN.
        new = _normal_matrix(points, candidate, trial, trial_g)
        if new <= cost * (1.0 + _ROUNDING):
            converged = cost - new <= _RELATIVE_END * cost + _ABSOLUTE_END_PX2
            for a in range(5):
                y[a], g[a] = candidate[a], trial_g[a]
                for b in range(5):
                    N[a, b] = trial[a, b]
            cost = new
            damping *= 0.1
            if converged:
                break
        else:
            damping = max(damping, _MIN_DAMPING) * 10.0
    covariance = np.empty((5, 5))
    invert(N, covariance)
    for a in range(5):
        converged = converged and covariance[a, a] > 0.0 and np.isfinite(covariance[a, a])
    return converged, y, covariance


@njit(cache=True, error_model="numpy")
def _scatter(points: FloatArray, y: FloatArray, sigma: float, covariance: FloatArray) -> bool:
    """Write the covariance (5, 5) of a fit to noisy points around a rim; false when there is none."""
    A, B = np.zeros((5, 5)), np.zeros((5, 5))
    ea, es = np.exp(y[2]), np.exp(y[4])
    D, mean, moved = np.empty(5), np.empty(5), y.copy()
    for i in range(points.shape[0]):
        s, t = whiten_kernel(points[i, 0], points[i, 1], y[0], y[1], y[2], y[3], y[4])
        nx, ny = s / ea - y[3] * t / es, t / es
        length = np.sqrt(nx * nx + ny * ny)
        mean[:] = 0.0
        for k in range(_NODES.shape[0]):
            step = sigma * _NODES[k] / length
            u, v = points[i, 0] + step * nx, points[i, 1] + step * ny
            d = rim_distance(u, v, y, D)
            for a in range(5):
                mean[a] += _WEIGHTS[k] * d * D[a]
                for b in range(5):
                    B[a, b] += _WEIGHTS[k] * d * d * D[a] * D[b]
            for b in range(5):
                for sign in (-1.0, 1.0):
                    moved[b] = y[b] + sign * _STEP
                    d = rim_distance(u, v, moved, D)
                    for a in range(5):
                        A[a, b] += 0.5 * sign / _STEP * _WEIGHTS[k] * d * D[a]
                moved[b] = y[b]
        for a in range(5):
            for b in range(5):
                B[a, b] -= mean[a] * mean[b]
    inverse = np.empty((5, 5))
    invert(A, inverse)
    for a in range(5):
        for b in range(5):
            covariance[a, b] = 0.0
            for c in range(5):
                for e in range(5):
                    covariance[a, b] += inverse[a, c] * B[c, e] * inverse[b, e]
    definite = True
    for a in range(5):
        definite = definite and A[a, a] > 0.0 and 0.0 < covariance[a, a] < np.inf
    return definite
