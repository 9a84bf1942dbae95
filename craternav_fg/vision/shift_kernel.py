"""Search for the shift of predicted rims by the brightness steps across them; compiled."""

import numpy as np

from craternav_fg.vision.image_sampling import bilinear
from craternav_fg.vision.rim_geometry import distorts, rim_points, through_lens
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Largest relative brightness step that counts: one deep shadow must not outweigh the other rims.
_MAX_STEP = 0.4


@njit(cache=True, error_model="numpy")
def shift_score(
    image: ImageArray, points: FloatArray, contrast_px: FloatArray, reference: FloatArray, dx: float,
    dy: float, reach_share: float, reach_px: float, lens: FloatArray,
) -> float:  # fmt: skip
    """Score how well rims, all moved by the same shift, agree with the brightness.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    points : ndarray, shape (n, k, 6)
        Points of the rims, see `rim_geometry.rim_points`.
    contrast_px : ndarray, shape (n, 2)
        Slope contrast in the image, see `edge_kernel.trace_rim`.
    reference : ndarray, shape (n,)
        Reference brightness of each rim.
    dx, dy : float
        Shift, px of the camera without distortion.
    reach_share, reach_px : float
        The brightness step is taken reach_share radii, at least reach_px, to both sides of the rim.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.

    Returns
    -------
    float
        Mean relative brightness step across the rims, signed and weighted by the slope contrast across them;
        NaN where no point of them is in the image.
    """
    total, mass = 0.0, 0.0
    q = np.empty(6)
    bent = distorts(lens)
    for r in range(points.shape[0]):
        for k in range(points.shape[1]):
            for j in range(6):
                q[j] = points[r, k, j]
            sign = -(contrast_px[r, 0] * q[2] + contrast_px[r, 1] * q[3]) / q[4]
            q[0] += dx
            q[1] += dy
            if bent:
                through_lens(q, lens)
            e = max(reach_px, reach_share * q[4])
            inner = bilinear(image, q[0] - e * q[2], q[1] - e * q[3])
            outer = bilinear(image, q[0] + e * q[2], q[1] + e * q[3])
            step = (inner - outer) / reference[r]
            if step == step:
                total += sign * min(max(step, -_MAX_STEP), _MAX_STEP)
                mass += np.abs(sign)
    return total / mass if mass > 0.0 else np.nan


@njit(cache=True, error_model="numpy")
def search_shift(
    image: ImageArray, charts_px: FloatArray, contrast_px: FloatArray, reference: FloatArray,
    angles: FloatArray, start: FloatArray, radius: float, step: float, reach_share: float, reach_px: float,
    lens: FloatArray,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Search the best common shift on a square grid.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    charts_px : ndarray, shape (n, 5)
        Predicted rims, charts in pixels of the camera without distortion.
    contrast_px : ndarray, shape (n, 2)
    reference : ndarray, shape (n,)
        See `shift_score`.
    angles : ndarray, shape (k,)
        Affine angles of the rim points, rad.
    start : ndarray, shape (2,)
        Middle of the grid, px.
    radius, step : float
        Half width and step of the grid, px.
    reach_share, reach_px : float
        See `shift_score`.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.

    Returns
    -------
    shift : ndarray, shape (2,)
        px.
    score : float
        See `shift_score`; -inf where no shift brings the rims into the image.
    """
    points = rim_points(charts_px, angles)
    best = start.copy()
    top = -np.inf
    n = int(np.ceil(radius / step))
    for i in range(-n, n + 1):
        for j in range(-n, n + 1):
            dx, dy = start[0] + i * step, start[1] + j * step
            score = shift_score(image, points, contrast_px, reference, dx, dy, reach_share, reach_px, lens)
            if score > top:
                top = score
                best[0] = dx
                best[1] = dy
    return best, top
