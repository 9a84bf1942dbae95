"""A crater's rim as the paper measures it: Canny edges, grouped into an ellipse.

Which edges are the crater's is taken from where its rim is known to be, so that what is left is what the
edges are worth; `craternav_fg.vision.canny` groups them without knowing.
"""

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import pixel_chart, whitened_points
from craternav_fg.simulation.scenes import Scene
from craternav_fg.vision.ellipse_fit import FitFailure, FitOptions, fit_rim
from factors.kernels.conic import project_rims

FloatArray = npt.NDArray[np.float64]

# Gaussian blur before gradients are taken.
_BLUR_PX = 1.2
# Thresholds as shares of the gradient's quantile, %.
_LOW, _HIGH, _QUANTILE = 0.25, 0.6, 97.0
# Edges of a rim: so far off it, in radii, their gradients so much towards the light, as a cosine.
_NEAR, _LEAST_COSINE = 0.25, 0.2


def canny_edges(image: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Edges (H, W) and gradients (H, W, 2) of an image."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR_PX)
    gradient = np.dstack([cv2.Sobel(smooth, cv2.CV_32F, *step, scale=0.125) for step in ((1, 0), (0, 1))])
    high = _HIGH * float(np.percentile(np.linalg.norm(gradient, axis=-1), _QUANTILE))
    # Canny takes whole numbers.
    whole = np.clip(np.rint(32.0 * gradient), -32000, 32000).astype(np.int16)
    dx, dy = (np.ascontiguousarray(whole[..., k]) for k in range(2))
    edges = cv2.Canny(dx, dy, 32.0 * _LOW / _HIGH * high, 32.0 * high, L2gradient=True)
    return edges > 0, gradient.astype(np.float64)


def canny_rim(one: Scene, crater: int, options: FitOptions | None = None) -> FloatArray | None:
    """Fit an ellipse to the Canny edges around a catalogue crater's rim.

    Parameters
    ----------
    one : Scene
    crater : int
        Row of its catalogue.
    options : FitOptions, optional

    Returns
    -------
    ndarray, shape (5,), or None
        Chart in pixels; None where the edges determine no ellipse.
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
    keep = (np.abs(np.hypot(u, v) - 1.0) < _NEAR) & (towards > _LEAST_COSINE * np.linalg.norm(g, axis=1))
    # Neighbours' errors go together: the fit wants them in their order along the rim.
    order = np.flatnonzero(keep)[np.argsort(np.arctan2(v[keep], u[keep]))]
    fit = fit_rim(np.column_stack([column, row])[order].astype(np.float64), one.camera, options)
    return None if isinstance(fit, FitFailure) else fit.chart_px
