"""Edge points along the normals of one rim, compiled; see `edges`."""

import numpy as np

from craternav_fg.vision.ground_level import evidence_of_level, level_at, levels_of_flanks
from craternav_fg.vision.image_sampling import SATURATED_BRIGHTNESS, cubic
from craternav_fg.vision.rim_geometry import back_through_lens, distorts, rim_point, through_lens
from factors.arrays import FloatArray, ImageArray
from factors.kernels.compiled import njit

# Normals per pixel of radius, and their range: one every three pixels along the rim of a
# mid-sized crater.
_NORMALS_PER_PX = 2.0
_MIN_NORMALS, _MAX_NORMALS = 56, 160
# Width of the second smoothing over that of the first: the crossing's displacement between them is observed.
_SECOND_SMOOTHING_FACTOR = 2.2
# Share of a rim's largest slope contrast below which errors of the reference brightness and of the rim's own
# slope direction, which the prediction does not know, outweigh the noise of the pixels. Chosen on rendered
# ground.
_FLAT_CONTRAST_SHARE = 0.35
# Prior weight of the canonical crater's displacement against the observed one, px^2.
_BLUNTNESS_PRIOR_PX2 = 0.1
# The inner wall and the outer slope are judged over this length, px, at least, and this share of the radius.
_MIN_SIDE_PX, _SIDE_SHARE = 2.0, 0.12
# These lengths are never more samples than this, given how the distance of the samples grows.
_MAX_SIDE_SAMPLES = 12
# The flanks of the crest begin one standard deviation of the whole blur from the crossing; with that of the
# pixels, px^2. They are as long as the sides above.
_PIXEL_VARIANCE_PX2 = 0.1
# Distance of the samples along a normal on small rims, px; it grows with the radius above 50 px.
_SAMPLE_STEP_PX = 0.5
# An edge is ambiguous if the second best one on its normal scores more than this share of the best.
_MAX_SECOND_SCORE = 0.75


@njit(cache=True, error_model="numpy")
def normal_count(radius_px: float) -> int:
    """Return the number of normals around a rim.

    Parameters
    ----------
    radius_px : float
        Size of the rim.
    """
    return int(min(max(_NORMALS_PER_PX * radius_px, _MIN_NORMALS), _MAX_NORMALS))


@njit(cache=True, error_model="numpy")
def _gaussian(width: float) -> FloatArray:
    """Half of a Gaussian kernel (n,) from its centre, not normalised; `width` is in samples."""
    kernel = np.empty(int(np.ceil(2.5 * width)) + 1)
    kernel[0] = 1.0
    for i in range(1, len(kernel)):
        kernel[i] = np.exp(-0.5 * (i / width) ** 2)
    return kernel


@njit(cache=True, error_model="numpy")
def _sample(image: ImageArray, q: FloatArray, step: float, raw: FloatArray) -> bool:
    """Sample the brightness along a normal, `q` as `rim_point` writes it; False if it leaves the image.

    The ends alone tell whether all samples lie in the image.
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
def _smooth(raw: FloatArray, first: int, last: int, kernel: FloatArray, out: FloatArray) -> None:
    """Write the samples `first` to `last` of a profile (n,) after smoothing to the same places of `out`.

    As `_smoothed`, several samples at a time where the kernel does not reach beyond the profile's ends.
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
def _crossing_near(raw: FloatArray, start: float, reach: int, kernel: FloatArray) -> float:
    """Place, in samples, of the fall of the smoothed profile through zero nearest `start`; NaN if none."""
    i0 = int(np.floor(start))
    best = np.nan
    low, high = max(0, i0 - reach), min(len(raw) - 2, i0 + reach)
    here = _smoothed(raw, low, kernel)
    for i in range(low, high + 1):
        after = _smoothed(raw, i + 1, kernel)
        if here > 0.0 and after <= 0.0:
            place = i + here / (here - after)
            if not np.abs(place - start) > np.abs(best - start):
                best = place
        here = after
    return best


@njit(cache=True, error_model="numpy")
def _moved_crossing(smoothed: FloatArray, start: float, level: float) -> float:
    """Distance, in samples, from `start` to the nearest fall of a profile through a level; 0 if none."""
    best = np.inf
    for i in range(len(smoothed) - 1):
        here, after = smoothed[i] - level, smoothed[i + 1] - level
        if here > 0.0 and after <= 0.0:
            moved = i + here / (here - after) - start
            if np.abs(moved) < np.abs(best):
                best = moved
    return best if np.isfinite(best) else 0.0


@njit(cache=True, error_model="numpy")
def _mean(raw: FloatArray, first: int, end: int) -> float:
    """Mean of samples `first` to before `end` of a profile (n,), as far as they exist."""
    first, end = max(first, 0), min(end, len(raw))
    total = 0.0
    for i in range(first, end):
        total += raw[i]
    return total / max(end - first, 1)


@njit(cache=True, error_model="numpy")
def trace_rim(
    image: ImageArray, chart_px: FloatArray, contrast_px: FloatArray, reference: float, reach_px: float,
    smoothing_share: float, smoothing_px: float, psf_px: float, min_slope_contrast: float, min_step: float,
    noise_step: float, count: int, crossing_offset: FloatArray, table_blur: FloatArray,
    table_contrast: FloatArray, lens: FloatArray, ground: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, int, float, FloatArray, FloatArray]:  # fmt: skip
    """Find the edge points of one rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    chart_px : ndarray, shape (5,)
        Predicted rim, chart in pixels of the camera without distortion, as all results.
    contrast_px : ndarray, shape (2,)
        Slope contrast c in the image, per pixel of crater radius: ground that rises outward with slope 1 at a
        rim point with image normal n and support distance h is brighter by the share -c . n / h.
    reference : float
        Reference brightness: that of locally flat terrain.
    reach_px : float
        Half length of the searched normals.
    smoothing_share, smoothing_px : float
        Standard deviation of the Gaussian smoothing along the normal: smoothing_share of the radius, at least
        smoothing_px.
    psf_px : float
        Standard deviation of the point-spread function.
    min_slope_contrast : float
        Least absolute slope contrast across the rim of a normal that is searched.
    min_step : float
        Least relative brightness step across the edge, for a slope contrast of 1.
    noise_step : float
        Least relative brightness step between two pixels that noise does not explain; means over several
        pixels on both sides scatter less.
    count : int
        Normals around the rim.
    crossing_offset : ndarray, shape (m, k)
        Outward displacement of the crossing in radii, see `crater_profile.crossing_table`.
    table_blur, table_contrast : ndarray, shapes (m,), (k,)
        The regular grid on which it is given: blur in radii, and slope contrast across the rim.
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.
    ground : ndarray, shape (5,)
        Level of the ground around the rim that the edge is searched at, see `ground_level.smooth_level`; zero
        for the reference all around.

    Returns
    -------
    points : ndarray, shape (n, 2)
        Pixels.
    sigma_ratio : ndarray, shape (n,)
        Standard deviations relative to one another: an edge is the less certain the smaller the slope
        contrast, by itself and relative to the rim's largest.
    motion : ndarray, shape (n, 2)
        Motion of the points, px, per relative change of the reference brightness.
    tried : int
        Normals with enough contrast that lie in the image.
    bluntness : float
        Measured displacement of the crossing under more smoothing, relative to the canonical crater's.
    level : ndarray, shape (n,)
        Brightness of level ground at the points, relative to the level searched at, less 1; see
        `ground_level`. Times `motion` it takes the points to where the brightness crosses that level.
    evidence : ndarray, shape (2,)
        See `ground_level.evidence_of_level`.
    """
    points = np.empty((count, 2))
    ratio = np.empty(count)
    motion = np.empty((count, 2))
    normal = np.empty((count, 2))
    first = np.empty(count)
    contrasts = np.empty(count)
    more = np.empty(count)
    angles = np.empty(count)
    flanks = np.empty((count, 2))
    near = np.empty((count, 2 * _MAX_SIDE_SAMPLES + 2))
    sides = np.empty(count, np.int64)
    offsets = np.empty(count)
    steps = np.empty(count)
    falls = np.empty(count)
    found, tried, largest = 0, 0, 0.0
    dot, square = _BLUNTNESS_PRIOR_PX2, _BLUNTNESS_PRIOR_PX2
    q = np.empty(6)
    bent = distorts(lens)
    shrinks = 1.0
    samples, soft = np.empty(0), np.empty(0)
    width, kernel, wide_kernel = -1.0, samples, samples
    for k in range(count):
        rim_point(chart_px, 2.0 * np.pi * (k + 0.5) / count, q)
        h = q[4]
        contrast = -(contrast_px[0] * q[2] + contrast_px[1] * q[3]) / h
        if np.abs(contrast) < min_slope_contrast:
            continue
        if bent:
            shrinks = through_lens(q, lens)
            h = q[4]
        smooth = max(smoothing_px, smoothing_share * h)
        side = max(_MIN_SIDE_PX, _SIDE_SHARE * h)
        step = _SAMPLE_STEP_PX * max(1.0, 0.02 * h)
        half = int(np.ceil((reach_px + side + 4.0 * smooth) / step))
        if 2 * half + 1 > len(samples):
            samples, soft = np.empty(4 * half), np.empty(4 * half)
        raw = samples[: 2 * half + 1]
        inside = True
        sign = 1.0 if contrast > 0.0 else -1.0
        if not _sample(image, q, step, raw):
            continue
        local = reference * (1.0 + level_at(ground, 2.0 * np.pi * (k + 0.5) / count))
        for i in range(2 * half + 1):
            raw[i] = sign * (raw[i] / local - 1.0)
            inside = inside and not np.isnan(raw[i])
        if not inside:
            continue
        tried += 1
        n_side = int(side / step + 0.5)
        least = max(min_step * np.abs(contrast), noise_step / np.sqrt(side))
        n_reach = int(np.ceil(reach_px / step))
        best, second, where, fall = 0.0, 0.0, 0.0, 0.0
        if smooth / step != width:
            width = smooth / step
            kernel, wide_kernel = _gaussian(width), _gaussian(_SECOND_SMOOTHING_FACTOR * smooth / step)
        _smooth(raw, half - n_reach - n_side, half + n_reach + n_side + 1, kernel, soft)
        here = soft[half - n_reach]
        for i in range(half - n_reach, half + n_reach):
            after = soft[i + 1]
            if here > 0.0 and after <= 0.0:
                inner, outer = 0.0, 0.0
                for j in range(n_side):
                    inner += raw[i - j]
                    outer += raw[i + 1 + j]
                place = i + here / (here - after)
                t = (place - half) * step
                score = (inner - outer) / n_side
                if score > least:
                    # Of two equal edges the one nearer to the prediction.
                    score *= np.exp(-0.5 * (t / reach_px) ** 2)
                    if score > best:
                        second = best
                        best = score
                        where = place
                        fall = (here - after) / step
                    elif score > second:
                        second = score
            here = after
        if not (best > 0.0 and second < _MAX_SECOND_SCORE * best):
            continue
        brightest = 0.0
        for j in range(int(where) - n_side, int(where) + n_side + 2):
            brightest = max(brightest, local * (1.0 + sign * raw[j]))
        if brightest > SATURATED_BRIGHTNESS:
            continue
        blur = np.sqrt(smooth * smooth + psf_px * psf_px) / h
        shift = h * _interpolate(crossing_offset, table_blur, table_contrast, blur, contrast)
        wide = _SECOND_SMOOTHING_FACTOR * smooth
        again = _crossing_near(raw, where, n_side + n_side // 2, wide_kernel)
        if not np.isnan(again):
            blur = np.sqrt(wide * wide + psf_px * psf_px) / h
            expected = h * _interpolate(crossing_offset, table_blur, table_contrast, blur, contrast) - shift
            moved = (again - where) * step
            if np.abs(moved) < 4.0 * np.abs(expected) + 0.5:
                dot += contrast * contrast * moved * expected
                square += contrast * contrast * expected * expected
        points[found, 0] = q[0]
        points[found, 1] = q[1]
        normal[found, 0] = q[2]
        normal[found, 1] = q[3]
        first[found] = (where - half) * step + 0.5 * psf_px * psf_px * q[5]
        more[found] = shift
        ratio[found] = shrinks
        contrasts[found] = contrast
        largest = max(largest, np.abs(contrast))
        motion[found, 0] = -sign * q[2] / fall
        motion[found, 1] = -sign * q[3] / fall
        angles[found] = 2.0 * np.pi * (k + 0.5) / count
        middle = int(where)
        gap = int(np.sqrt(smooth * smooth + psf_px * psf_px + _PIXEL_VARIANCE_PX2) / step + 0.5)
        flanks[found, 0] = sign * _mean(raw, middle - gap - n_side + 1, middle - gap + 1)
        flanks[found, 1] = sign * _mean(raw, middle + 1 + gap, middle + 1 + gap + n_side)
        for j in range(2 * n_side + 2):
            near[found, j] = soft[middle - n_side + j]
        sides[found] = n_side
        offsets[found] = where - middle
        steps[found] = step
        falls[found] = sign * fall
        found += 1
    bluntness = dot / square
    level = np.zeros(found)
    evidence = np.zeros(2)
    if found > 0:
        found_level = levels_of_flanks(flanks[:found], contrasts[:found])
        contrasts = np.abs(contrasts)
        shifts = np.zeros(found)
        crossings = np.empty(found)
        for i in range(found):
            sign = np.sign(falls[i])
            shifts[i] = steps[i] * _moved_crossing(
                near[i, : 2 * sides[i] + 2], sides[i] + offsets[i], sign * found_level[i]
            )
            crossings[i] = first[i] - bluntness * more[i]
            level[i] = -falls[i] * shifts[i]
        evidence = evidence_of_level(angles[:found], contrasts[:found], crossings, shifts)
    for i in range(found):
        flat = _FLAT_CONTRAST_SHARE * largest / contrasts[i]
        ratio[i] *= np.sqrt(1.0 + flat * flat) / contrasts[i]
        t = first[i] - bluntness * more[i]
        points[i, 0] += t * normal[i, 0]
        points[i, 1] += t * normal[i, 1]
        if bent:
            back_through_lens(points[i], motion[i], lens)
    return points[:found], ratio[:found], motion[:found], tried, bluntness, level, evidence


@njit(cache=True, error_model="numpy")
def _interpolate(
    table: FloatArray, rows: FloatArray, columns: FloatArray, row: float, column: float
) -> float:
    """Bilinear value of a table on a regular grid, constant beyond its ends."""
    x = min(max((row - rows[0]) / (rows[1] - rows[0]), 0.0), len(rows) - 1.0)
    y = min(max((column - columns[0]) / (columns[1] - columns[0]), 0.0), len(columns) - 1.0)
    i, j = min(int(x), len(rows) - 2), min(int(y), len(columns) - 2)
    u, v = x - i, y - j
    return (1.0 - u) * ((1.0 - v) * table[i, j] + v * table[i, j + 1]) + u * (
        (1.0 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
    )


@njit(cache=True, error_model="numpy")
def flanks_around(
    image: ImageArray, chart_px: FloatArray, contrast_px: FloatArray, reference: float,
    smoothing_share: float, smoothing_px: float, psf_px: float, count: int, lens: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Sample the brightness of the flanks of a known crest, all around the rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.
    chart_px : ndarray, shape (5,)
        Fitted rim, chart in pixels of the camera without distortion.
    contrast_px : ndarray, shape (2,)
        As in `trace_rim`, as all that follow.
    reference, smoothing_share, smoothing_px, psf_px : float
    count : int
    lens : ndarray, shape (14,)
        `Camera.lens`: intrinsics, px, and distortion.

    Returns
    -------
    angles, contrasts : ndarray, shape (n,)
        Affine angles of the normals that lie in the image, and the slope contrasts across the rim.
    flanks : ndarray, shape (n, 2)
        See `ground_level.levels_of_flanks`.
    """
    angles, contrasts, flanks = np.empty(count), np.empty(count), np.empty((count, 2))
    q = np.empty(6)
    bent = distorts(lens)
    samples = np.empty(0)
    found = 0
    for k in range(count):
        angle = 2.0 * np.pi * (k + 0.5) / count
        rim_point(chart_px, angle, q)
        contrast = -(contrast_px[0] * q[2] + contrast_px[1] * q[3]) / q[4]
        if bent:
            through_lens(q, lens)
        h = q[4]
        smooth = max(smoothing_px, smoothing_share * h)
        step = _SAMPLE_STEP_PX * max(1.0, 0.02 * h)
        n_side = int(max(_MIN_SIDE_PX, _SIDE_SHARE * h) / step + 0.5)
        gap = int(np.sqrt(smooth * smooth + psf_px * psf_px + _PIXEL_VARIANCE_PX2) / step + 0.5)
        half = gap + n_side
        if 2 * half + 1 > len(samples):
            samples = np.empty(4 * half)
        raw = samples[: 2 * half + 1]
        if not _sample(image, q, step, raw):
            continue
        inner, outer = _mean(raw, 0, n_side), _mean(raw, half + gap + 1, 2 * half + 1)
        if np.isnan(inner + outer) or max(inner, outer) > SATURATED_BRIGHTNESS:
            continue
        angles[found], contrasts[found] = angle, contrast
        flanks[found, 0], flanks[found, 1] = inner / reference - 1.0, outer / reference - 1.0
        found += 1
    return angles[:found], contrasts[:found], flanks[:found]
