"""Sub-pixel rim points along the normals of a predicted rim.

A rim's crest is level across the rim, so it is as bright as level ground: the edge is where the
brightness crosses that of level ground, between the inner wall and the outer slope. The strongest
gradient lies inside the crest, the more so the larger the crater. Which of the two sides is the bright
one follows from the shading gain (see `photometry`); where the gain runs along the rim there is no
contrast and no point.

Blurring moves the crossing, as the inner wall is steeper than the outer slope; see `crest`.

Rims are ellipses in the pixels of the camera without its distortion. The brightness is read in the image as
it is: points and normals of a rim go through the lens first, and the edge points found go back.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.ellipse import point_kernel
from craternav_fg.lens import distort, undistort

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.float32]

# Of 255: brighter is no brightness.
_SATURATED_BRIGHTNESS = 250.0
# The second smoothing, in units of the first, under which the crossing's displacement is observed.
_SECOND_SMOOTHING_FACTOR = 2.2
# Below this share of the rim's largest gain, errors of the level and of the rim's own direction, which
# the prediction does not know, outweigh the noise of the pixels.
_FLAT_CONTRAST_SHARE = 0.35
# Trust in the canonical crater before that, px^2 of observed displacement.
_BLUNTNESS_PRIOR_PX2 = 0.1


def noise_level(image: ImageArray) -> float:
    """Give the standard deviation of an image's pixel noise; edges and slopes hardly count.

    Immerkaer, "Fast noise variance estimation", CVIU 64 (2), 1996, with the median for the mean.
    """
    rows = np.arange(1, image.shape[0] - 1, max(1, image.shape[0] // 128))
    second = [image[rows + d, :-2] - 2.0 * image[rows + d, 1:-1] + image[rows + d, 2:] for d in (-1, 0, 1)]
    response = second[0] - 2.0 * second[1] + second[2]
    return float(np.median(np.abs(response)) * 1.4826 / 6.0)


@njit(cache=True, error_model="numpy")
def bilinear(image: ImageArray, x: float, y: float) -> float:
    """Brightness at pixel (x, y); NaN outside."""
    i, j = int(np.floor(x)), int(np.floor(y))
    if i < 0 or j < 0 or i + 1 >= image.shape[1] or j + 1 >= image.shape[0]:
        return np.nan
    u, v = x - i, y - j
    return (1.0 - v) * ((1.0 - u) * image[j, i] + u * image[j, i + 1]) + v * (
        (1.0 - u) * image[j + 1, i] + u * image[j + 1, i + 1]
    )


@njit(cache=True, error_model="numpy")
def bicubic(image: ImageArray, x: float, y: float) -> float:
    """Brightness at pixel (x, y) by Catmull-Rom interpolation; NaN near the border and outside."""
    i, j = int(np.floor(x)), int(np.floor(y))
    if i < 1 or j < 1 or i + 2 >= image.shape[1] or j + 2 >= image.shape[0]:
        return np.nan
    u, v = x - i, y - j
    a0 = 0.5 * u * (-1.0 + u * (2.0 - u))
    a1 = 1.0 + 0.5 * u * u * (-5.0 + 3.0 * u)
    a2 = 0.5 * u * (1.0 + u * (4.0 - 3.0 * u))
    a3 = 0.5 * u * u * (u - 1.0)
    b0 = 0.5 * v * (-1.0 + v * (2.0 - v))
    b1 = 1.0 + 0.5 * v * v * (-5.0 + 3.0 * v)
    b2 = 0.5 * v * (1.0 + v * (4.0 - 3.0 * v))
    b3 = 0.5 * v * v * (v - 1.0)
    total = 0.0
    for k in range(4):
        b = b0 if k == 0 else (b1 if k == 1 else (b2 if k == 2 else b3))
        row = j - 1 + k
        total += b * (
            a0 * image[row, i - 1] + a1 * image[row, i] + a2 * image[row, i + 1] + a3 * image[row, i + 2]
        )
    return total


@njit(cache=True, error_model="numpy")
def rim_point(chart_px: FloatArray, angle: float, out: FloatArray) -> None:
    """Write a rim's point, outward normal, support distance and curvature (6,) at an affine angle, pixels.

    The support distance is that from the centre to the tangent: the crater's radius along the normal.
    """
    out[0], out[1], nx, ny = point_kernel(
        angle, chart_px[0], chart_px[1], chart_px[2], chart_px[3], chart_px[4]
    )
    g = np.sqrt(nx * nx + ny * ny)
    out[2] = nx / g
    out[3] = ny / g
    out[4] = 1.0 / g
    # kappa = h^3 / det(S).
    out[5] = 1.0 / (np.exp(2.0 * (chart_px[2] + chart_px[4])) * g * g * g)


@njit(cache=True, error_model="numpy")
def distorts(lens: FloatArray) -> bool:
    """Whether `Camera.lens` has any distortion."""
    return bool(np.any(lens[4:9] != 0.0))


@njit(cache=True, error_model="numpy")
def through_lens(q: FloatArray, lens: FloatArray) -> float:
    """Take what `rim_point` wrote to the pixels of the distorted image; return how much lengths shrink.

    To first order in the rim's surroundings. The shrinkage is that across the rim: pixels of the camera
    without distortion per pixel of the image.
    """
    work = np.empty(6)
    fx, fy = lens[0], lens[1]
    distort((q[0] - lens[2]) / fx, (q[1] - lens[3]) / fy, lens[4:], work)
    xx, xy, yx, yy = work[2], work[3] * fx / fy, work[4] * fy / fx, work[5]
    determinant = xx * yy - xy * yx
    # Normals go by the inverse transpose.
    nx = (yy * q[2] - yx * q[3]) / determinant
    ny = (xx * q[3] - xy * q[2]) / determinant
    g = np.sqrt(nx * nx + ny * ny)
    q[0] = lens[2] + fx * work[0]
    q[1] = lens[3] + fy * work[1]
    q[2] = nx / g
    q[3] = ny / g
    q[4] /= g
    q[5] /= g * g * g * determinant * determinant
    return g


@njit(cache=True, error_model="numpy")
def _back_through_lens(point: FloatArray, move: FloatArray, lens: FloatArray) -> None:
    """Take a point of the image and a small motion of it to the pixels of the camera without distortion."""
    work = np.empty(6)
    fx, fy = lens[0], lens[1]
    undistort((point[0] - lens[2]) / fx, (point[1] - lens[3]) / fy, lens[4:], work)
    xx, xy, yx, yy = work[2], work[3] * fx / fy, work[4] * fy / fx, work[5]
    determinant = xx * yy - xy * yx
    point[0] = lens[2] + fx * work[0]
    point[1] = lens[3] + fy * work[1]
    mx, my = move[0], move[1]
    move[0] = (yy * mx - xy * my) / determinant
    move[1] = (xx * my - yx * mx) / determinant


@njit(cache=True, error_model="numpy")
def rim_points(charts_px: FloatArray, angles: FloatArray) -> FloatArray:
    """Points of rims (n, k, 6), see `rim_point`, at angles (k,)."""
    points = np.empty((charts_px.shape[0], angles.shape[0], 6))
    for r in range(charts_px.shape[0]):
        for k in range(angles.shape[0]):
            rim_point(charts_px[r], angles[k], points[r, k])
    return points


@njit(cache=True, error_model="numpy")
def shift_score(
    image: ImageArray, points: FloatArray, gain_px: FloatArray, level: FloatArray, dx: float, dy: float,
    reach_share: float, reach_px: float, lens: FloatArray,
) -> float:  # fmt: skip
    """How well rims, all moved by (dx, dy) px of the camera without distortion, agree with the brightness.

    The mean over the rims' `points` (n, k, 6) of the brightness step across the rim, signed and weighed by
    the shading gain across it. `gain_px` (n, 2) is the gain's image per pixel of crater radius, `level` (n,)
    the brightness of level ground; the step is taken reach_share radii, at least reach_px, to both sides.
    `lens` is `Camera.lens`, for the image's pixels.
    """
    total, mass = 0.0, 0.0
    q = np.empty(6)
    bent = distorts(lens)
    for r in range(points.shape[0]):
        for k in range(points.shape[1]):
            for j in range(6):
                q[j] = points[r, k, j]
            sign = -(gain_px[r, 0] * q[2] + gain_px[r, 1] * q[3]) / q[4]
            q[0] += dx
            q[1] += dy
            if bent:
                through_lens(q, lens)
            e = max(reach_px, reach_share * q[4])
            inner = bilinear(image, q[0] - e * q[2], q[1] - e * q[3])
            outer = bilinear(image, q[0] + e * q[2], q[1] + e * q[3])
            step = (inner - outer) / level[r]
            if step == step:
                # Clipped: one deep shadow must not outweigh the other rims.
                total += sign * min(max(step, -0.4), 0.4)
                mass += np.abs(sign)
    return total / mass if mass > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def search_shift(
    image: ImageArray, charts_px: FloatArray, gain_px: FloatArray, level: FloatArray, angles: FloatArray,
    start: FloatArray, radius: float, step: float, reach_share: float, reach_px: float, lens: FloatArray,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Best common shift (2,) on a square grid about `start`, and its score (see `shift_score`)."""
    points = rim_points(charts_px, angles)
    best = start.copy()
    top = -np.inf
    n = int(np.ceil(radius / step))
    for i in range(-n, n + 1):
        for j in range(-n, n + 1):
            dx, dy = start[0] + i * step, start[1] + j * step
            score = shift_score(image, points, gain_px, level, dx, dy, reach_share, reach_px, lens)
            if score > top:
                top = score
                best[0] = dx
                best[1] = dy
    return best, top


@njit(cache=True, error_model="numpy")
def _gaussian(width: float) -> FloatArray:
    """Half of a Gaussian kernel, from its centre, not normalised."""
    kernel = np.empty(int(np.ceil(2.5 * width)) + 1)
    for i in range(len(kernel)):
        kernel[i] = np.exp(-0.5 * (i / width) ** 2)
    return kernel


@njit(cache=True, error_model="numpy")
def _smoothed(raw: FloatArray, i: int, kernel: FloatArray) -> float:
    """Sample `i` of a profile after smoothing, its ends left out."""
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
def _crossing_near(raw: FloatArray, start: float, reach: int, kernel: FloatArray) -> float:
    """Place, in samples, of the fall through zero of the smoothed profile nearest `start`; NaN if none."""
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
def trace_rim(
    image: ImageArray, chart_px: FloatArray, gain_px: FloatArray, level: float, reach_px: float,
    smooth_share: float, smooth_px: float, psf_px: float, min_slope_contrast: float, min_step: float,
    noise_step: float, count: int, bias: FloatArray, bias_share: FloatArray, bias_gain: FloatArray,
    lens: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, int, float]:  # fmt: skip
    """Edge points of one rim.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
    chart_px : ndarray, shape (5,)
        Predicted rim, chart in the pixels of the camera without distortion, as the results and `gain_px`.
    gain_px : ndarray, shape (2,)
        Shading gain: -gain . n / h is the share by which a slope of 1 rising outward brightens the
        ground at a rim point with image normal n and support distance h.
    level : float
        Brightness of level ground.
    reach_px : float
        Half length of the searched normals.
    smooth_share, smooth_px : float
        Gaussian smoothing along the normal: smooth_share of the radius, at least smooth_px.
    psf_px : float
        Standard deviation of the point-spread function.
    min_slope_contrast : float
        Least |gain| of a normal that is searched.
    min_step : float
        Least step of brightness across the edge, relative to the level, for a gain of 1.
    noise_step : float
        Least step of brightness that noise does not explain, relative to the level, between two pixels; the
        means of several on both sides scatter less.
    count : int
        Normals about the rim.
    bias, bias_share, bias_gain : ndarray, shapes (m, k), (m,), (k,)
        Outward displacement of the crossing in radii, on a regular grid of blur (in radii) and signed gain.
    lens : ndarray, shape (10,)
        `Camera.lens`.

    Returns
    -------
    points : ndarray, shape (n, 2)
        Pixels.
    sigma_ratio : ndarray, shape (n,)
        Relative standard deviations: the edge is the less certain the smaller the gain, in all and beside
        the rim's largest.
    lever : ndarray, shape (n, 2)
        Motion of the points, px, per relative change of the level.
    tried : int
        Normals searched, with enough gain and inside the image.
    bluntness : float
        Displacement of the crossing under more blur, relative to the canonical crater's.
    """
    points = np.empty((count, 2))
    ratio = np.empty(count)
    lever = np.empty((count, 2))
    normal = np.empty((count, 2))
    first = np.empty(count)
    gains = np.empty(count)
    more = np.empty(count)
    found, tried, largest = 0, 0, 0.0
    dot, square = _BLUNTNESS_PRIOR_PX2, _BLUNTNESS_PRIOR_PX2
    q = np.empty(6)
    bent = distorts(lens)
    shrinks = 1.0
    for k in range(count):
        rim_point(chart_px, 2.0 * np.pi * (k + 0.5) / count, q)
        h = q[4]
        gain = -(gain_px[0] * q[2] + gain_px[1] * q[3]) / h
        if np.abs(gain) < min_slope_contrast:
            continue
        if bent:
            shrinks = through_lens(q, lens)
            h = q[4]
        smooth = max(smooth_px, smooth_share * h)
        side = max(2.0, 0.12 * h)
        step = 0.5 * max(1.0, 0.02 * h)
        half = int(np.ceil((reach_px + side + 4.0 * smooth) / step))
        raw = np.empty(2 * half + 1)
        inside = True
        sign = 1.0 if gain > 0.0 else -1.0
        for i in range(2 * half + 1):
            t = (i - half) * step
            value = bicubic(image, q[0] + t * q[2], q[1] + t * q[3])
            if np.isnan(value):
                inside = False
                break
            raw[i] = sign * (value / level - 1.0)
        if not inside:
            continue
        tried += 1
        n_side = int(side / step + 0.5)
        least = max(min_step * np.abs(gain), noise_step / np.sqrt(side))
        n_reach = int(np.ceil(reach_px / step))
        best, second, where, fall = 0.0, 0.0, 0.0, 0.0
        kernel = _gaussian(smooth / step)
        here = _smoothed(raw, half - n_reach, kernel)
        for i in range(half - n_reach, half + n_reach):
            after = _smoothed(raw, i + 1, kernel)
            if here > 0.0 and after <= 0.0:
                inner, outer = 0.0, 0.0
                for j in range(n_side):
                    inner += raw[i - j]
                    outer += raw[i + 1 + j]
                place = i + here / (here - after)
                t = (place - half) * step
                score = (inner - outer) / n_side
                if score > least:
                    # The prediction counts, weakly: of two equal edges the nearer.
                    score *= np.exp(-0.5 * (t / reach_px) ** 2)
                    if score > best:
                        second = best
                        best = score
                        where = place
                        fall = (here - after) / step
                    elif score > second:
                        second = score
            here = after
        if not (best > 0.0 and second < 0.75 * best):
            continue
        brightest = 0.0
        for j in range(int(where) - n_side, int(where) + n_side + 2):
            brightest = max(brightest, level * (1.0 + sign * raw[j]))
        if brightest > _SATURATED_BRIGHTNESS:
            continue
        blur = np.sqrt(smooth * smooth + psf_px * psf_px) / h
        shift = h * _interpolate(bias, bias_share, bias_gain, blur, gain)
        wide = _SECOND_SMOOTHING_FACTOR * smooth
        again = _crossing_near(raw, where, n_side + n_side // 2, _gaussian(wide / step))
        if not np.isnan(again):
            blur = np.sqrt(wide * wide + psf_px * psf_px) / h
            expected = h * _interpolate(bias, bias_share, bias_gain, blur, gain) - shift
            moved = (again - where) * step
            if np.abs(moved) < 4.0 * np.abs(expected) + 0.5:
                dot += gain * gain * moved * expected
                square += gain * gain * expected * expected
        points[found, 0] = q[0]
        points[found, 1] = q[1]
        normal[found, 0] = q[2]
        normal[found, 1] = q[3]
        first[found] = (where - half) * step + 0.5 * psf_px * psf_px * q[5]
        more[found] = shift
        ratio[found] = shrinks
        gains[found] = np.abs(gain)
        largest = max(largest, np.abs(gain))
        lever[found, 0] = -sign * q[2] / fall
        lever[found, 1] = -sign * q[3] / fall
        found += 1
    bluntness = dot / square
    for i in range(found):
        flat = _FLAT_CONTRAST_SHARE * largest / gains[i]
        ratio[i] *= np.sqrt(1.0 + flat * flat) / gains[i]
        t = first[i] - bluntness * more[i]
        points[i, 0] += t * normal[i, 0]
        points[i, 1] += t * normal[i, 1]
        if bent:
            _back_through_lens(points[i], lever[i], lens)
    return points[:found], ratio[:found], lever[:found], tried, bluntness


@njit(cache=True, error_model="numpy")
def _interpolate(
    table: FloatArray, rows: FloatArray, columns: FloatArray, row: float, column: float
) -> float:
    """Bilinear value of a table on a regular grid, held constant beyond its ends."""
    x = min(max((row - rows[0]) / (rows[1] - rows[0]), 0.0), len(rows) - 1.0)
    y = min(max((column - columns[0]) / (columns[1] - columns[0]), 0.0), len(columns) - 1.0)
    i, j = min(int(x), len(rows) - 2), min(int(y), len(columns) - 2)
    u, v = x - i, y - j
    return (1.0 - u) * ((1.0 - v) * table[i, j] + v * table[i, j + 1]) + u * (
        (1.0 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
    )
