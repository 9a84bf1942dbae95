"""A crater's rim as the paper measures it: an ellipse fitted to Canny edges.

The edges are selected around the true rim, so that only the errors of the edges themselves remain.
`craternav_fg.vision.canny` groups edges without such knowledge.
"""

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import pixel_chart, whitened_points
from craternav_fg.simulation.scenes import Scene
from craternav_fg.vision.ellipse_fit import FitFailure, fit_rim
from factors.arrays import FloatArray
from factors.kernels.conic import project_rims

# Gaussian blur before gradients are taken.
_BLUR_PX = 1.2
# Percentile of the gradient's magnitude, and the two thresholds as shares of it. Lower thresholds give edges
# of the rough terrain, higher ones break rims apart.
_PERCENTILE, _LOW_SHARE, _HIGH_SHARE = 97.0, 0.25, 0.6
# Edges of a rim: at most this far from it, in radii, and gradients towards the sun with at least this cosine.
_MAX_DISTANCE_RADII, _MIN_COSINE = 0.25, 0.2
# OpenCV's Canny takes whole numbers: gradients are scaled by this.
_FIXED_POINT = 32.0


def canny_edges(image: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Canny edges and gradients of an image.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W)

    Returns
    -------
    edges : ndarray of bool, shape (H, W)
    gradient : ndarray, shape (H, W, 2)
        Grey levels per pixel.
    """
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR_PX)
    gradient = np.dstack([cv2.Sobel(smooth, cv2.CV_32F, *step, scale=0.125) for step in ((1, 0), (0, 1))])
    high = _HIGH_SHARE * float(np.percentile(np.linalg.norm(gradient, axis=-1), _PERCENTILE))
    whole = np.clip(np.rint(_FIXED_POINT * gradient), -32000, 32000).astype(np.int16)
    dx, dy = (np.ascontiguousarray(whole[..., k]) for k in range(2))
    edges = cv2.Canny(
        dx, dy, _FIXED_POINT * _LOW_SHARE / _HIGH_SHARE * high, _FIXED_POINT * high, L2gradient=True
    )
    return edges > 0, gradient.astype(np.float64)


def canny_rim(one: Scene, crater: int) -> FloatArray | None:
    """Fit an ellipse to the Canny edges around a catalogue crater's rim.

    Parameters
    ----------
    one : Scene
    crater : int
        Row in the scene's catalogue.

    Returns
    -------
    ndarray, shape (5,), or None
        Chart in pixels; None when the edges determine no ellipse.
    """
    catalog = one.catalog
    rows = slice(crater, crater + 1)
    chart = project_rims(one.gTb, one.camera.bTc, catalog.centres[rows], catalog.axes[rows])[0]
    rim_px = pixel_chart(chart, one.camera)[0]
    edges, gradient = canny_edges(one.image)
    row, column = np.nonzero(edges)
    u, v = whitened_points(np.stack([column, row], axis=-1), rim_px).T
    g = gradient[row, column]
    towards = g @ [np.cos(one.sun_angle_rad), np.sin(one.sun_angle_rad)]
    keep = (np.abs(np.hypot(u, v) - 1.0) < _MAX_DISTANCE_RADII) & (
        towards > _MIN_COSINE * np.linalg.norm(g, axis=1)
    )
    # The fit models the correlation of neighbours' errors: it needs the points in order along the rim.
    order = np.flatnonzero(keep)[np.argsort(np.arctan2(v[keep], u[keep]))]
    fit = fit_rim(np.column_stack([column, row])[order].astype(np.float64), one.camera)
    return None if isinstance(fit, FitFailure) else fit.chart_px
