"""Ellipses that were measured in the image of a lens that distorts."""

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_outline, points_on
from craternav_fg.ellipse_distance import signed_distances
from factors.arrays import FloatArray

# Points at which an ellipse is followed through a lens: harmonics of its distortion are far below this.
_POINTS = 32
# Gauss-Newton steps, of which each takes the fit to the square of its distance from the best one.
_STEPS = 3


def seen_through_lens(charts_px: FloatArray, camera: Camera) -> FloatArray:
    """Compute the charts of the ellipses that best follow ellipses seen in a distorted image.

    A lens images an ellipse as an outline that is nearly one. Whoever measured it took the ellipse that is
    nearest to the outline along its normals; the same is done on the way back. Harmonics of the outline,
    which also count how far points move along it, would be off by 0.15 px on a rim of 90 px.

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
        for k in np.flatnonzero(np.isfinite(charts).all(axis=1)):
            charts[k] = _nearest_along_normals(charts[k], outlines[k])
    return charts


def _nearest_along_normals(chart: FloatArray, points: FloatArray) -> FloatArray:
    """Fit an ellipse (5,) to points (k, 2) by least squares of distances along normals, from near by."""
    for _ in range(_STEPS):
        distances, _, derivatives = signed_distances(points, chart)
        chart = chart - np.linalg.lstsq(derivatives, distances, rcond=None)[0]
    return chart
