"""Ellipses that were measured in the image of a lens that distorts."""

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_outline, mean_radius, points_on
from factors.arrays import FloatArray

# Points at which an ellipse is followed through a lens: harmonics of its distortion are far below this.
_POINTS = 32
# Gauss-Newton steps, of which each takes the fit to the square of its distance from the best one.
_STEPS = 3


def seen_through_lens(charts_px: FloatArray, camera: Camera) -> FloatArray:
    """Compute the charts of the ellipses that best follow ellipses seen in a distorted image.

    A lens images an ellipse as an outline that is nearly one. Whoever measured it took the ellipse that is
    nearest to the outline along its normals; the same is done on the way back. Harmonics of the outline,
    which also count how far points move along it, would be off by up to a pixel on large rims.

    Parameters
    ----------
    charts_px : ndarray, shape (n, 5)
        Charts in the pixels of the image as it is, not of `camera.pinhole`.
    camera : Camera

    Returns
    -------
    ndarray, shape (n, 5)
        Charts in normalised image coordinates; NaN where the distortion has no inverse.
    """
    outlines = camera.normalised(points_on(charts_px, _POINTS))
    charts = chart_of_outline(outlines)
    if camera.distorts:
        sound = np.isfinite(charts).all(axis=1)
        charts[sound] = _nearest_along_normals(charts[sound], outlines[sound])
    return charts


def _nearest_along_normals(charts: FloatArray, points: FloatArray) -> FloatArray:
    """Fit ellipses (n, 5) to points (n, k, 2) by least squares of distances along normals, from near by."""
    middle, size = charts[:, :2].copy(), mean_radius(charts)
    # About the unit circle's size, for the normal equations.
    unit = (points - middle[:, None]) / size[:, None, None]
    y = charts.copy()
    y[:, :2] = 0.0
    y[:, [2, 4]] -= np.log(size)[:, None]
    for _ in range(_STEPS):
        mx, my, log_x, shear, log_y = y.T[:, :, None]
        du, dv = unit[..., 0] - mx, unit[..., 1] - my
        u, v = du / np.exp(log_x), (dv - shear * du) / np.exp(log_y)
        # r times the gradient of r, the distance from the middle of the whitened ellipse.
        ny = v / np.exp(log_y)
        nx = u / np.exp(log_x) - shear * ny
        r, length = np.hypot(u, v), np.hypot(nx, ny)
        distance = (r - 1.0) * r / length
        slopes = np.stack([-nx, -ny, -u * u, -v * du / np.exp(log_y), -v * v], axis=-1) / length[..., None]
        normal = np.einsum("nki,nkj->nij", slopes, slopes)
        y -= np.linalg.solve(normal, np.einsum("nki,nk->ni", slopes, distance)[..., None])[..., 0]
    y[:, :2] = middle + y[:, :2] * size[:, None]
    y[:, [2, 4]] += np.log(size)[:, None]
    return y
