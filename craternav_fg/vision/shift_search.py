"""Search for predicted rims by shifts: one common to all, then each rim by itself.

The rims' shapes are predicted well even from a poor pose; their places are not. Shifts are scored by the
brightness steps across the rims, signed by the slope contrast (see `shift_kernel`).
"""

import cv2
import numpy as np

from craternav_fg.ellipse import semi_minor_bound
from craternav_fg.vision import shift_kernel
from craternav_fg.vision.predicted_rims import PredictedRims
from factors.arrays import FloatArray, ImageArray

# Rims of largest size and contrast that vote for the common shift: more do not make it surer.
_MAX_RIMS = 60
# Affine angles of the rim points.
_ANGLES_RAD: FloatArray = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False, dtype=np.float64)
# The brightness step across a rim is taken over this share of its radius to both sides, at least so many px.
_STEP_REACH_SHARE, _STEP_REACH_PX = 0.12, 1.0
# Factors by which the image is reduced, coarse to fine; a reduction is used if the searched radius is at
# least this many reduced pixels.
_REDUCTIONS, _MIN_RADIUS_REDUCED_PX = (4, 2, 1), 4.0
# Half width of the next finer search, in pixels of the coarser image.
_REFINEMENT_PX = 1.5
# Own shift of a rim: largest one, in semi-minor axes; steps of the grid to each side, and the finest step,
# px.
_MAX_OWN_SHIFT_SHARE, _OWN_STEPS, _MIN_OWN_STEP_PX = 0.5, 8.0, 0.5


def common_shift(image: ImageArray, rims: PredictedRims, lens: FloatArray, radius_px: float) -> FloatArray:
    """Search one shift of all rims, coarse to fine.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    rims : PredictedRims
        At least one.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.
    radius_px : float
        Largest component of the shift.

    Returns
    -------
    ndarray, shape (2,)
        Pixels of the camera without distortion.
    """
    minor = semi_minor_bound(rims.charts_px)
    order = np.argsort(-minor * np.linalg.norm(rims.contrast_px, axis=-1), kind="stable")[:_MAX_RIMS]
    start = np.zeros(2)
    radius = radius_px
    for factor in _REDUCTIONS:
        if factor > 1 and radius_px < _MIN_RADIUS_REDUCED_PX * factor:
            continue
        small = image
        if factor > 1:
            size = (image.shape[1] // factor, image.shape[0] // factor)
            whole = image[: size[1] * factor, : size[0] * factor]
            small = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        charts = rims.charts_px[order].copy()
        charts[:, :2] = (charts[:, :2] + 0.5) / factor - 0.5
        charts[:, 2] -= np.log(factor)
        charts[:, 4] -= np.log(factor)
        reduced_lens = lens.copy()
        reduced_lens[:2] /= factor
        reduced_lens[2:4] = (reduced_lens[2:4] + 0.5) / factor - 0.5
        best, _ = shift_kernel.search_shift(
            small, charts, rims.contrast_px[order] / factor, rims.reference[order], _ANGLES_RAD,
            start / factor, radius / factor, 1.0, _STEP_REACH_SHARE, _STEP_REACH_PX, reduced_lens,
        )  # fmt: skip
        start = best * factor
        radius = _REFINEMENT_PX * factor
    return start


def own_shifts(
    image: ImageArray, rims: PredictedRims, lens: FloatArray, common: FloatArray, reach_px: FloatArray
) -> FloatArray:
    """Search the shift of each rim near the common one.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    rims : PredictedRims
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.
    common : ndarray, shape (2,)
        Common shift, px.
    reach_px : ndarray, shape (n,)
        Largest deviation from it.

    Returns
    -------
    ndarray, shape (n, 2)
        Pixels of the camera without distortion; NaN for a rim that no such shift brings into the image.
    """
    out = np.empty((len(rims), 2))
    for i in range(len(out)):
        one = slice(i, i + 1)
        reach = min(reach_px[i], _MAX_OWN_SHIFT_SHARE * rims.smallest_radius_px(i))
        step = max(_MIN_OWN_STEP_PX, reach / _OWN_STEPS)
        out[i], score = shift_kernel.search_shift(
            image, rims.charts_px[one], rims.contrast_px[one], rims.reference[one], _ANGLES_RAD, common,
            reach, step, _STEP_REACH_SHARE, _STEP_REACH_PX, lens,
        )  # fmt: skip
        if np.isneginf(score):
            out[i] = np.nan
    return out
