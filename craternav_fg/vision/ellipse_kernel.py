"""Robust least-squares ellipse on distances, its covariance and second-order bias; see `ellipse_fit`.

The ellipse is the chart y of pixel coordinates (see `craternav_fg.ellipse`): m + L [cos t, sin t] are its
points, L = [[e^y3, 0], [y4 e^y3, e^y5]], S = L L'.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.ellipse import whiten_kernel
from craternav_fg.vision.dense_kernel import factorised, inverse_block, ordered, solved
from craternav_fg.vision.ellipse_bias import PSI_VARIANCE, second_order_bias
from craternav_fg.vision.ellipse_distance import signed_distance
from craternav_fg.vision.robust_scale import MAD_TO_SIGMA

FloatArray = npt.NDArray[np.float64]

# Cut-off of Tukey's biweight in standard deviations: 95 % efficiency under Gaussian errors.
TUKEY_SIGMAS = 4.685
# Iterations under Cauchy's weights, which only down-weight; up to which the scale follows the residuals; up
# to which the weights do; and in all. Numerics: enough for convergence, few enough against cycles.
_CAUCHY_ITERATIONS = 5
_SCALE_ITERATIONS = 15
_WEIGHT_ITERATIONS = 22
_MAX_ITERATIONS = 30
# Step of the ellipse, px, below which the iteration ends; above which the result has not converged: a robust
# cycle of a few thousandths of a pixel is as good as convergence.
_STEP_TOLERANCE_PX = 1e-4
_MAX_LAST_STEP_PX = 0.01
# Largest |S_xy / S_xx| of a result: a flatter ellipse is a line.
_MAX_SHEAR = 20.0
# Fewest points of non-zero weight; least mean slope of psi over them, below which the scale is meaningless.
_MIN_KEPT = 8
_MIN_PSI_SLOPE = 0.3
# Var[psi'] / E[psi']^2 of Tukey's psi for a Gaussian error, by numerical integration.
PSI_SLOPE_VARIANCE = 0.1597
# Relative variance of the estimated scatter, times the number of points: 2 for least squares.
SCALE_VARIANCE = 2.33
# Largest relative standard deviation, squared, of an axis at which the second-order bias is subtracted: a
# hardly determined ellipse has no second-order expansion.
_MAX_EXPANDED_VARIANCE = 0.06
# Harmonics of an outline that is not an ellipse; lower orders would be another ellipse. Amplitudes fall with
# the order, as the spectra of crater outlines are red. HARMONIC_VARIANCE_SHARE is the variance of each
# component's amplitude over the outline's mean square deviation; the shares of the two components per order
# sum to 2, as the mean square of a cosine is 1/2.
FIRST_HARMONIC, LAST_HARMONIC = 3, 8
_HARMONIC_ORDERS = np.repeat(np.arange(FIRST_HARMONIC, LAST_HARMONIC + 1), 2)
HARMONIC_VARIANCE_SHARE = (1.0 / _HARMONIC_ORDERS**2) / np.sum(0.5 / _HARMONIC_ORDERS**2)
# Factor on the prior variance of the harmonics in the covariance: the variance is estimated from few, partly
# seen harmonics, so the mean of its inverse is larger than the inverse of its mean.
OUTLINE_VARIANCE_FACTOR = 1.4
# Largest root mean square deviation of an outline that is estimated, in radii.
_MAX_OUTLINE_RADII = 0.15
# Error of the estimated reference brightness, relative, per deviation of the outline from an ellipse in
# radii. On rendered ground it is 0.010 with outlines 2 % off an ellipse and worn rim crests, where the fits
# claim 0.004; it is 0.003 on ellipses.
BRIGHTNESS_ERROR_PER_OUTLINE = 0.5
# Bartlett window, points, for errors that neighbouring points share, and the largest variance factor for
# them.
_CORRELATION_WINDOW = 5
_MAX_CORRELATION_FACTOR = 4.0
# Indices of the unknowns: 5 of the ellipse, then the reference brightness, its slopes across and along the
# illumination direction, then the harmonics.
_BRIGHTNESS, _SLOPE_ACROSS, _SLOPE_ALONG, _OUTLINE = 5, 6, 7, 8
# Prior variance of an unknown that is held at zero.
_HELD_VARIANCE = 1e-12


@njit(cache=True, error_model="numpy")
def _point_row(
    px: float, py: float, motion: FloatArray, sun_px: FloatArray, y: FloatArray, n: FloatArray, w: FloatArray
) -> float:
    """Distance as `signed_distance`; writes its derivative (m,) in chart, brightness and outline, too.

    The reference brightness moves the point by `motion` (2,) per unit; it has slopes across and along the
    direction `sun_px` (2,) towards the sun. The outline deviates from the ellipse by harmonics of the angle
    in which that is a circle, as shares of the radius: a share moves a tangent by that share of its distance
    from the centre.
    """
    d = signed_distance(px, py, y, n, w)
    w[_BRIGHTNESS] = -(n[0] * motion[0] + n[1] * motion[1])
    ea, es = np.exp(y[2]), np.exp(y[4])
    x = px - y[0]
    u, v = x / ea, (py - y[1] - y[3] * x) / es
    r = np.sqrt(u * u + v * v)
    c1, s1 = u / r, v / r
    tu, tv = sun_px[0] / ea, (sun_px[1] - y[3] * sun_px[0]) / es
    t = np.sqrt(tu * tu + tv * tv) + 1e-300
    w[_SLOPE_ACROSS] = w[_BRIGHTNESS] * (c1 * tv - s1 * tu) / t
    w[_SLOPE_ALONG] = w[_BRIGHTNESS] * (c1 * tu + s1 * tv) / t
    h = n[0] * x + n[1] * (py - y[1]) - d
    c, s = c1, s1
    k = 1
    for j in range(_OUTLINE, len(w), 2):
        while k < FIRST_HARMONIC + (j - _OUTLINE) // 2:
            c, s = c * c1 - s * s1, s * c1 + c * s1
            k += 1
        w[j] = -h * c
        w[j + 1] = -h * s
    return d


@njit(cache=True, error_model="numpy")
def _normal_equations(
    rows: FloatArray, m: int, distance: FloatArray, base: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Build the normal matrix (m, m) and gradient (m,) from the first m derivatives of the distances."""
    N = np.zeros((m, m))
    grad = np.zeros(m)
    for i in range(rows.shape[0]):
        k = base[i] * weight[i]
        if k == 0.0:
            continue
        for a in range(m):
            ka = k * rows[i, a]
            grad[a] += ka * distance[i]
            for b in range(a + 1):
                N[a, b] += ka * rows[i, b]
    for a in range(m):
        for b in range(a):
            N[b, a] = N[a, b]
    return N, grad


@njit(cache=True, error_model="numpy")
def _covered(points: FloatArray, weight: FloatArray, y: FloatArray, max_gap_rad: float) -> float:
    """Share of the rim that points of non-zero weight cover, without gaps above `max_gap_rad`."""
    angles = np.empty(points.shape[0])
    k = 0
    for i in range(points.shape[0]):
        if weight[i] > 0.0:
            u, v = whiten_kernel(points[i, 0], points[i, 1], y[0], y[1], y[2], y[3], y[4])
            angles[k] = np.arctan2(v, u)
            k += 1
    if k < 2:
        return 0.0
    angles = ordered(angles[:k])
    open_rad = 0.0
    for i in range(k):
        gap = angles[i + 1] - angles[i] if i + 1 < k else angles[0] + 2.0 * np.pi - angles[i]
        if gap > max_gap_rad:
            open_rad += gap
    return 1.0 - open_rad / (2.0 * np.pi)


@njit(cache=True, error_model="numpy")
def _correlation_factor(r: FloatArray, weight: FloatArray) -> float:
    """Variance factor, at least 1, for errors that neighbouring points share (Bartlett's window)."""
    count = len(r)
    variance = 0.0
    for i in range(count):
        variance += weight[i] * r[i] * r[i]
    factor = 1.0
    for lag in range(1, _CORRELATION_WINDOW):
        product = 0.0
        for i in range(count):
            j = (i + lag) % count
            product += np.sqrt(weight[i] * weight[j]) * r[i] * r[j]
        factor += 2.0 * (1.0 - lag / _CORRELATION_WINDOW) * product / (variance + 1e-300)
    return min(max(factor, 1.0), _MAX_CORRELATION_FACTOR)


@njit(cache=True, error_model="numpy")
def _outline_variance(rows: FloatArray, r: FloatArray, base: FloatArray, sigma: float) -> float:
    """Variance of the outline's deviation from the ellipse, radii^2, that explains residuals r (n,).

    The mean square of the residuals is that of the points' own errors, estimated from the differences of
    neighbours, plus what a fit of the ellipse alone leaves of the harmonics.
    """
    count, m = rows.shape
    jump, power = np.empty(count - 1), 0.0
    for i in range(count):
        power += min(abs(r[i]), TUKEY_SIGMAS * sigma) ** 2
        if i > 0:
            jump[i - 1] = abs(r[i] - r[i - 1])
    own = 0.5 * (MAD_TO_SIGMA * ordered(jump)[(count - 1) // 2]) ** 2
    N, _ = _normal_equations(rows, m, r, base, np.ones(count))
    ellipse = np.ascontiguousarray(N[:5, :5])
    L = np.zeros((5, 5))
    if not factorised(ellipse, L):
        return 0.0
    left = 0.0
    for j in range(_OUTLINE, m):
        column = solved(L, N[j, :5])
        rest = N[j, j]
        for a in range(5):
            rest -= N[j, a] * column[a]
        left += HARMONIC_VARIANCE_SHARE[j - _OUTLINE] * rest
    # Two standard deviations of the points' own mean square are not taken for an outline.
    own *= count + 2.0 * np.sqrt(2.0 * count)
    return min(max(power - own, 0.0) / left, _MAX_OUTLINE_RADII**2)


@njit(cache=True, error_model="numpy")
def fit(
    points: FloatArray, ratio: FloatArray, motion: FloatArray, brightness_sigma: float, slope_sigma: float,
    sun_px: FloatArray, start: FloatArray, min_scatter: float, max_gap_rad: float, outline_share: float,
) -> tuple[bool, FloatArray, FloatArray, FloatArray, FloatArray, float, int, float, float]:  # fmt: skip
    """Fit an ellipse robustly.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Edge points, px.
    ratio : ndarray, shape (n,)
        Standard deviations of the points relative to one another.
    motion : ndarray, shape (n, 2)
        Motion of the points, px, per relative error of the reference brightness.
    brightness_sigma, slope_sigma : float
        Prior standard deviations of that error and of its change from the centre to the rim, per direction.
    sun_px : ndarray, shape (2,)
        Direction towards the sun in the image, of any length.
    start : ndarray, shape (5,)
        Chart in pixels.
    min_scatter : float
        Lower bound of the points' standard deviation, px.
    max_gap_rad : float
        Longest step between neighbouring points that counts as covered.
    outline_share : float
        Expected root mean square deviation of the outline from an ellipse, in radii; the estimate adds what
        the points show. 0 allows none.

    Returns
    -------
    ok : bool
        Whether the fit converged; nothing else is valid if it did not.
    y : ndarray, shape (5,)
        Chart in pixels, bias removed.
    covariance, outline_covariance : ndarray, shape (5, 5)
        Covariance, and the part of it from the slopes of the brightness and the outline.
    brightness_root : ndarray, shape (5,)
        Standard deviation of the chart, with sign, from the error that an irregular outline makes in the
        estimated brightness. The covariance does not contain it.
    rms : float
        Root mean square of the distances under the robust weights, px, without the outline's harmonics.
    kept : int
        Points of non-zero weight.
    arc_share : float
        Share of the rim that they cover.
    outline_share : float
        Root mean square deviation of the outline from an ellipse, in radii.
    """
    count = points.shape[0]
    size_all = _OUTLINE + (len(HARMONIC_VARIANCE_SHARE) if outline_share > 0.0 else 0)
    y = start.copy()
    cov = np.zeros((5, 5))
    base = 1.0 / (ratio * ratio)
    base *= count / np.sum(base)
    weight = np.ones(count)
    r, d = np.empty(count), np.empty(count)
    n = np.empty(2)
    rows = np.empty((count, size_all))
    # Unknowns beside the ellipse and their prior variances. A slope along the illumination direction has the
    # effect of a change of size: it enters the covariance, but is not estimated.
    nuisance = np.zeros(size_all)
    prior = np.full(size_all, _HELD_VARIANCE)
    prior[_BRIGHTNESS] = brightness_sigma * brightness_sigma
    prior[_SLOPE_ACROSS] = max(slope_sigma * slope_sigma, _HELD_VARIANCE)
    outline2 = outline_share * outline_share
    L = np.zeros((size_all, size_all))
    unit = np.zeros(size_all)
    sigma, length = 1.0, np.inf
    for iteration in range(_MAX_ITERATIONS):
        for i in range(count):
            d[i] = _point_row(points[i, 0], points[i, 1], motion[i], sun_px, y, n, rows[i])
            for j in range(_BRIGHTNESS, size_all):
                d[i] += rows[i, j] * nuisance[j]
            r[i] = d[i] * np.sqrt(base[i])
        # The scale is a median: with a scale that keeps changing, the weights may cycle for ever.
        if iteration < _SCALE_ITERATIONS:
            sigma = max(MAD_TO_SIGMA * ordered(np.abs(r))[count // 2], min_scatter)
        for i in range(count):
            t = r[i] / (TUKEY_SIGMAS * sigma)
            # The first weights are never zero: a poor start must not reject good points. The last iterations
            # leave the weights as they are.
            if iteration < _CAUCHY_ITERATIONS:
                weight[i] = 1.0 / (1.0 + (r[i] / sigma) ** 2)
            elif iteration < _WEIGHT_ITERATIONS:
                weight[i] = (1.0 - t * t) ** 2 if np.abs(t) < 1.0 else 0.0
        if size_all > _OUTLINE and iteration == _CAUCHY_ITERATIONS:
            outline2 += _outline_variance(rows, r, base, sigma)
            for j in range(_OUTLINE, size_all):
                prior[j] = outline2 * HARMONIC_VARIANCE_SHARE[j - _OUTLINE]
        # The harmonics are unknowns once their variance is known.
        used = _OUTLINE if iteration < _CAUCHY_ITERATIONS else size_all
        L = np.zeros((used, used))
        N, grad = _normal_equations(rows, used, d, base, weight)
        for j in range(_BRIGHTNESS, used):
            N[j, j] += sigma * sigma / prior[j]
            grad[j] += sigma * sigma / prior[j] * nuisance[j]
        if not factorised(N, L):
            return False, y, cov, cov, cov[0], 0.0, 0, 0.0, 0.0
        step = solved(L, -grad)
        size = np.exp(0.5 * (y[2] + y[4]))
        length = np.abs(step[0]) + np.abs(step[1])
        length += size * (np.abs(step[2]) + np.abs(step[3]) + np.abs(step[4]))
        damp = min(1.0, 0.5 * size / (length + 1e-300))
        for a in range(5):
            y[a] += damp * step[a]
        for j in range(_BRIGHTNESS, used):
            nuisance[j] += damp * step[j]
        if iteration > _CAUCHY_ITERATIONS and length < _STEP_TOLERANCE_PX:
            break
    if not (length < _MAX_LAST_STEP_PX and np.abs(y[3]) < _MAX_SHEAR):
        return False, y, cov, cov, cov[0], 0.0, 0, 0.0, 0.0
    kept = 0
    psi2, slope, square, mass = 0.0, 0.0, 0.0, 0.0
    unmoved = points.copy()
    for i in range(count):
        d[i] = _point_row(points[i, 0], points[i, 1], motion[i], sun_px, y, n, rows[i])
        if rows[i, _BRIGHTNESS] != 0.0:
            moved = (
                rows[i, _BRIGHTNESS] * nuisance[_BRIGHTNESS]
                + rows[i, _SLOPE_ACROSS] * nuisance[_SLOPE_ACROSS]
            )
            d[i] += moved
            unmoved[i] -= moved / rows[i, _BRIGHTNESS] * motion[i]
        whole = d[i] * np.sqrt(base[i])
        for j in range(_OUTLINE, size_all):
            d[i] += rows[i, j] * nuisance[j]
        r[i] = d[i] * np.sqrt(base[i])
        t = r[i] / (TUKEY_SIGMAS * sigma)
        weight[i] = (1.0 - t * t) ** 2 if np.abs(t) < 1.0 else 0.0
        if weight[i] > 0.0:
            kept += 1
            psi2 += (weight[i] * r[i]) ** 2
            slope += (1.0 - t * t) * (1.0 - 5.0 * t * t)
            square += weight[i] * whole * whole
            mass += weight[i]
    if kept < _MIN_KEPT or not slope > _MIN_PSI_SLOPE * kept:
        return False, y, cov, cov, cov[0], 0.0, kept, 0.0, 0.0
    rms = np.sqrt(square / mass)
    # Covariance of an M-estimate: the mean square of psi over the square of its mean slope.
    sigma2 = psi2 * count / (slope * slope)
    fitted = 5.0
    for j in range(_SLOPE_ACROSS, size_all):
        unit[:] = 0.0
        unit[j] = 1.0
        fitted += max(0.0, 1.0 - sigma2 * solved(L, unit)[j] / prior[j])
    white2 = sigma2 * count / (count - fitted) / PSI_VARIANCE
    # Huber's correction for few points; unbiased in its inverse, as the variance is itself an estimate.
    sigma2 *= count / (count - fitted - SCALE_VARIANCE) * (1.0 + fitted * PSI_SLOPE_VARIANCE / count) ** 2
    sigma2 = max(sigma2 * _correlation_factor(r, weight), min_scatter * min_scatter)
    N, _ = _normal_equations(rows, size_all, d, base, np.ones(count))
    prior[_SLOPE_ALONG] = prior[_SLOPE_ACROSS]
    for j in range(_BRIGHTNESS, size_all):
        N[j, j] += sigma2 / (prior[j] * (OUTLINE_VARIANCE_FACTOR if j >= _OUTLINE else 1.0))
    C, noise = np.empty((5, 5)), np.empty((5, 5))
    if not (inverse_block(N, C) and inverse_block(np.ascontiguousarray(N[:6, :6]), noise)):
        return False, y, cov, cov, cov[0], 0.0, kept, 0.0, 0.0
    L = np.zeros((size_all, size_all))
    if not factorised(N, L):
        return False, y, cov, cov, cov[0], 0.0, kept, 0.0, 0.0
    unit[:] = 0.0
    unit[_BRIGHTNESS] = 1.0
    joint = solved(L, unit)
    brightness_root = (
        min(BRIGHTNESS_ERROR_PER_OUTLINE * np.sqrt(outline2), brightness_sigma)
        / joint[_BRIGHTNESS]
        * joint[:5]
    )
    arc = _covered(points, weight, y, max_gap_rad)
    if sigma2 * max(C[2, 2], C[4, 4]) < _MAX_EXPANDED_VARIANCE:
        y = y - second_order_bias(unmoved, base, np.ones(count), y, noise, white2)
    return True, y, sigma2 * C, sigma2 * (C - noise), brightness_root, rms, kept, arc, np.sqrt(outline2)
