"""Profile of brightness along a normal of a rim: samples, smoothing, crossings of a level; compiled."""

import numpy as np

from craternav_fg.vision.image_sampling import cubic
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Distance of the samples along a normal on small rims, px; it grows with the radius above 50 px.
_SAMPLE_STEP_PX, _STEP_GROWTH_PER_PX = 0.5, 0.02
# The inner wall and the outer slope are judged over this length, px, at least, and this share of the radius.
# It is never more samples than this, given how the distance of the samples grows.
_MIN_SIDE_PX, _SIDE_SHARE = 2.0, 0.12
MAX_SIDE_SAMPLES = 12
# The flanks of the crest begin one standard deviation of the whole blur from the crossing; with that of the
# pixels, px^2. They are as long as the sides above.
_PIXEL_VARIANCE_PX2 = 0.1
# Newton steps to a crossing between samples.
_CROSSING_ITERATIONS = 3


@njit(cache=True, error_model="numpy")
def sample_step(radius_px: float) -> float:
    """Return the distance of the samples along a normal, px.

    Parameters
    ----------
    radius_px : float
        Radius along the normal.
    """
    return _SAMPLE_STEP_PX * max(1.0, _STEP_GROWTH_PER_PX * radius_px)


@njit(cache=True, error_model="numpy")
def smoothing_px_at(radius_px: float, smoothing_px: float, smoothing_share: float) -> float:
    """Return the standard deviation of the smoothing along a normal, px.

    Parameters
    ----------
    radius_px : float
        Radius along the normal.
    smoothing_px, smoothing_share : float
        See `edges.EdgeOptions`.
    """
    return max(smoothing_px, smoothing_share * radius_px)


@njit(cache=True, error_model="numpy")
def flank_samples(radius_px: float, step: float, smooth: float, psf_px: float) -> tuple[int, int]:
    """Return where the flanks of a crest are, in samples.

    Parameters
    ----------
    radius_px : float
        Radius along the normal.
    step : float
        Distance of the samples, px.
    smooth : float
        Standard deviation of the smoothing, px.
    psf_px : float
        Standard deviation of the point-spread function.

    Returns
    -------
    gap, side : int
        Distance of the flanks from the crossing, and their length.
    """
    side_px = max(_MIN_SIDE_PX, _SIDE_SHARE * radius_px)
    gap_px = np.sqrt(smooth * smooth + psf_px * psf_px + _PIXEL_VARIANCE_PX2)
    return int(gap_px / step + 0.5), int(side_px / step + 0.5)


@njit(cache=True, error_model="numpy")
def half_gaussian(width: float) -> FloatArray:
    """Compute half of a Gaussian kernel from its centre, not normalised.

    Parameters
    ----------
    width : float
        Standard deviation, in samples.

    Returns
    -------
    ndarray, shape (n,)
    """
    kernel = np.empty(int(np.ceil(2.5 * width)) + 1)
    kernel[0] = 1.0
    for i in range(1, len(kernel)):
        kernel[i] = np.exp(-0.5 * (i / width) ** 2)
    return kernel


@njit(cache=True, error_model="numpy")
def sample_normal(image: ImageArray, q: FloatArray, step: float, raw: FloatArray) -> bool:
    """Sample the brightness along a normal.

    The ends alone tell whether all samples lie in the image.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    q : ndarray, shape (6,)
        Its middle and direction, as `rim_geometry.rim_point` writes them.
    step : float
        Distance of the samples, px.
    raw : ndarray, shape (n,)
        Written.

    Returns
    -------
    bool
        False if the normal leaves the image.
    """
    half = len(raw) // 2
    for i in (0, len(raw) - 1):
        x, y = q[0] + (i - half) * step * q[2], q[1] + (i - half) * step * q[3]
        if not (x >= 1.0 and y >= 1.0 and x < image.shape[1] - 2 and y < image.shape[0] - 2):
            return False
    x0, y0, dx, dy = q[0], q[1], q[2], q[3]
    for i in range(len(raw)):
        t = (i - half) * step
        x, y = x0 + t * dx, y0 + t * dy
        raw[i] = cubic(image, int(x), int(y), x - int(x), y - int(y))
    return True


@njit(cache=True, error_model="numpy")
def _smoothed(raw: FloatArray, i: int, kernel: FloatArray) -> float:
    """Sample `i` of a profile (n,) after smoothing, as if it ended where the samples do."""
    total, mass = kernel[0] * raw[i], kernel[0]
    for j in range(1, len(kernel)):
        if i >= j:
            total += kernel[j] * raw[i - j]
            mass += kernel[j]
        if i + j < len(raw):
            total += kernel[j] * raw[i + j]
            mass += kernel[j]
    return total / mass


@njit(cache=True, error_model="numpy")
def smooth_between(raw: FloatArray, first: int, last: int, kernel: FloatArray, out: FloatArray) -> None:
    """Smooth some samples of a profile, as if it ended where the samples do.

    Several at a time where the kernel does not reach beyond the profile's ends.

    Parameters
    ----------
    raw : ndarray, shape (n,)
        Brightness.
    first, last : int
        The samples, both included.
    kernel : ndarray, shape (k,)
        See `half_gaussian`.
    out : ndarray, shape (n,)
        Written at the same places.
    """
    mass = kernel[0]
    for j in range(1, len(kernel)):
        mass += 2.0 * kernel[j]
    low, high = max(first, len(kernel) - 1), min(last + 1, len(raw) + 1 - len(kernel))
    n = max(high - low, 0)
    target, source = out[low : low + n], raw[low : low + n]
    share = kernel[0] / mass
    for i in range(n):
        target[i] = share * source[i]
    for j in range(1, len(kernel)):
        share = kernel[j] / mass
        before, after = raw[low - j : low - j + n], raw[low + j : low + j + n]
        for i in range(n):
            target[i] += share * (before[i] + after[i])
    for i in range(max(first, 0), min(low, last + 1)):
        out[i] = _smoothed(raw, i, kernel)
    for i in range(max(high, low), min(last + 1, len(raw))):
        out[i] = _smoothed(raw, i, kernel)


@njit(cache=True, error_model="numpy")
def crossing_between(before: float, here: float, after: float, beyond: float) -> float:
    """Find where a profile falls through zero between two samples.

    By the cubic through them whose slopes are those between their neighbours: on a crest a profile bends so
    much that a line between samples half a pixel apart would cross up to 0.03 px too far out.

    Parameters
    ----------
    before, here, after, beyond : float
        Successive samples; `here` is above zero, `after` is not.

    Returns
    -------
    float
        From `here`, in samples, 0 to 1.
    """
    a = 0.5 * (after - before)
    b = before - 2.5 * here + 2.0 * after - 0.5 * beyond
    c = 1.5 * (here - after) + 0.5 * (beyond - before)
    low, high = 0.0, 1.0
    u = here / (here - after)
    for _ in range(_CROSSING_ITERATIONS):
        value = here + u * (a + u * (b + u * c))
        if value > 0.0:
            low = u
        else:
            high = u
        slope = a + u * (2.0 * b + 3.0 * c * u)
        u = u - value / slope if slope < 0.0 else 0.5 * (low + high)
        if not low <= u <= high:
            u = 0.5 * (low + high)
    return u


@njit(cache=True, error_model="numpy")
def crossing_near(raw: FloatArray, start: float, reach: int, kernel: FloatArray, curved: bool) -> float:
    """Find where the smoothed profile falls through zero nearest a place.

    Parameters
    ----------
    raw : ndarray, shape (n,)
        Brightness.
    start : float
        The place, in samples.
    reach : int
        How far from it is searched, in samples.
    kernel : ndarray, shape (k,)
        See `half_gaussian`.
    curved : bool
        Whether the place between samples is that of `crossing_between` or on a line.

    Returns
    -------
    float
        In samples; NaN if it does not.
    """
    i0 = int(np.floor(start))
    best = np.nan
    last = len(raw) - 1
    low, high = max(0, i0 - reach), min(last - 1, i0 + reach)
    here = _smoothed(raw, low, kernel)
    for i in range(low, high + 1):
        after = _smoothed(raw, i + 1, kernel)
        if here > 0.0 and after <= 0.0:
            place = i + here / (here - after)
            if curved:
                before = _smoothed(raw, max(i - 1, 0), kernel)
                beyond = _smoothed(raw, min(i + 2, last), kernel)
                place = i + crossing_between(before, here, after, beyond)
            if not np.abs(place - start) > np.abs(best - start):
                best = place
        here = after
    return best


@njit(cache=True, error_model="numpy")
def moved_crossing(smoothed: FloatArray, start: float, level: float) -> float:
    """Compute how far from a place a profile falls through a level.

    Parameters
    ----------
    smoothed : ndarray, shape (n,)
        Brightness.
    start : float
        The place, in samples.
    level : float

    Returns
    -------
    float
        To the nearest, in samples; 0 if it does not.
    """
    best = np.inf
    last = len(smoothed) - 1
    for i in range(last):
        here, after = smoothed[i] - level, smoothed[i + 1] - level
        if here > 0.0 and after <= 0.0:
            before, beyond = smoothed[max(i - 1, 0)] - level, smoothed[min(i + 2, last)] - level
            moved = i + crossing_between(before, here, after, beyond) - start
            if np.abs(moved) < np.abs(best):
                best = moved
    return best if np.isfinite(best) else 0.0


@njit(cache=True, error_model="numpy")
def mean_between(raw: FloatArray, first: int, end: int) -> float:
    """Compute the mean of some samples of a profile, as far as they exist.

    Parameters
    ----------
    raw : ndarray, shape (n,)
        Brightness.
    first, end : int
        The first sample, and that after the last.
    """
    first, end = max(first, 0), min(end, len(raw))
    total = 0.0
    for i in range(first, end):
        total += raw[i]
    return total / max(end - first, 1)
