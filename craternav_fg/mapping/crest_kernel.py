"""Rim crest of one crater on an elevation model: the ridge around a start ellipse; compiled.

On rays from the start's centre the crest is where the profile bends down most, and high. It is looked for as
one closed line: of all lines that change little from ray to ray the one of the greatest total score
(dynamic programming over the azimuth). A rough or cut rim may then lack its crest on some rays without the
line going astray.
"""

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

# Score that a change of the crest's radius by one step costs, from ray to ray.
_STEP_COST = 0.7
# Most steps that the radius may change from ray to ray.
_MOST_STEPS = 2


@njit(cache=True, nogil=True, error_model="numpy")
def crest_score(heights: FloatArray, width: float, height_weight: float) -> FloatArray:
    """Score how much a ring of profiles looks like a rim crest at each radius.

    Parameters
    ----------
    heights : ndarray, shape (rays, steps)
        Heights on rays from the crater's centre, equally spaced in radius, m.
    width : float
        Standard deviation of the smoothing along the rays, in steps.
    height_weight : float
        Weight of the height against the bend: both count in standard deviations over the ring. It keeps the
        line off terraces, but draws it outward, as a blurred crest is highest outside its sharpest bend.

    Returns
    -------
    ndarray, shape (rays, steps)
        Downward bend and height, each in standard deviations over the ring.
    """
    rays, steps = heights.shape
    reach = int(np.ceil(3.0 * width))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= kernel.sum()
    smooth = np.empty_like(heights)
    for i in range(rays):
        for j in range(steps):
            total = 0.0
            for k in range(-reach, reach + 1):
                total += kernel[k + reach] * heights[i, min(max(j + k, 0), steps - 1)]
            smooth[i, j] = total
    bend = np.zeros_like(heights)
    for i in range(rays):
        for j in range(1, steps - 1):
            bend[i, j] = 2.0 * smooth[i, j] - smooth[i, j - 1] - smooth[i, j + 1]
    spread = np.sqrt(np.mean(bend * bend))
    level = smooth - np.mean(smooth)
    range_m = np.sqrt(np.mean(level * level))
    if not (spread > 0.0 and range_m > 0.0):
        return np.zeros_like(heights)
    return bend / spread + height_weight * level / range_m


@njit(cache=True, nogil=True, error_model="numpy")
def closed_ridge(score: FloatArray) -> IntArray:
    """Find the closed line of the greatest total score around a ring.

    Parameters
    ----------
    score : ndarray, shape (rays, steps)
        Dimensionless.

    Returns
    -------
    ndarray of int, shape (rays,)
        Step of the line on each ray.
    """
    rays, steps = score.shape
    line = np.zeros(rays, dtype=np.int64)
    # Twice around: in the second turn the line no longer knows where it began.
    total = score[0].copy()
    origin = np.zeros((2 * rays, steps), dtype=np.int64)
    after = np.empty(steps)
    for i in range(1, 2 * rays):
        for j in range(steps):
            best, at = -np.inf, j
            for k in range(max(j - _MOST_STEPS, 0), min(j + _MOST_STEPS + 1, steps)):
                value = total[k] - _STEP_COST * abs(j - k)
                if value > best:
                    best, at = value, k
            after[j] = best + score[i % rays, j]
            origin[i, j] = at
        total[:] = after
    j = int(np.argmax(total))
    for i in range(2 * rays - 1, -1, -1):
        if rays // 2 <= i < rays // 2 + rays:
            line[i % rays] = j
        j = origin[i, j]
    return line
