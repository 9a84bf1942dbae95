"""Robust least-squares ellipse on distances, its covariance and second-order bias; see `ellipse_fit`.

The ellipse is the chart y of pixel coordinates (see `factors.kernels.conic`).
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.ellipse import whiten_kernel

FloatArray = npt.NDArray[np.float64]

_TUKEY_SIGMAS = 4.685
_MAD_TO_SIGMA = 1.4826
_CAUCHY_ITERATIONS = 5
_SCALE_ITERATIONS = 15
_WEIGHT_ITERATIONS = 22
# Moments of Tukey's psi for a Gaussian error e of standard deviation 1, relative to m = E[psi']: of its
# variance E[psi^2]/m^2, E[psi' e^2]/m, E[psi psi' e]/m^2 and Var[psi']/m^2. All but the last are 1 for least
# squares.
_PSI_VARIANCE, _PSI_CURVATURE, _PSI_MIXED, _PSI_SLOPE_VARIANCE = 1.0526, 0.4428, 0.5720, 0.1597
# Relative variance of the scatter's estimate, times the number of points (2 for least squares).
_SCALE_VARIANCE = 2.33
# Harmonics of an outline that is no ellipse: lower ones would be another ellipse. Amplitudes fall with the
# order, as outlines of craters are red; this much of the variance is in each of the two of an order.
FIRST_HARMONIC, LAST_HARMONIC = 3, 8
_HARMONIC_ORDERS = np.repeat(np.arange(FIRST_HARMONIC, LAST_HARMONIC + 1), 2)
HARMONIC_VARIANCE_SHARE = (1.0 / _HARMONIC_ORDERS**2) / np.sum(0.5 / _HARMONIC_ORDERS**2)
# The outline's variance is told by few harmonics, partly seen: its inverse's mean is larger than its mean's.
_OUTLINE_VARIANCE_FACTOR = 1.4
_MAX_OUTLINE_RADII = 0.15
# What the points say of the lever's unknown, those of little gain most, is wrong by so many times the
# outline's deviation in radii: by 0.010 on rendered ground with outlines 2 % off an ellipse and worn crests,
# where the fits claim 0.004; by 0.003 on ellipses.
BRIGHTNESS_ERROR_PER_OUTLINE = 0.5
# Unknowns: 5 of the ellipse, the lever's, its slopes across and along the light, then harmonics.
_BRIGHTNESS, _SLOPE_ACROSS, _SLOPE_ALONG, _OUTLINE = 5, 6, 7, 8
# Variance of an unknown that is held.
_HELD_VARIANCE = 1e-12


@njit(cache=True, error_model="numpy")
def _factorised(N: FloatArray, L: FloatArray) -> bool:
    """Write the Cholesky factor of N, scaled by its diagonal; False when N is not well determined.

    Written out, as are `_solved` and `_ordered`: numba takes seconds to compile the library's.
    """
    n = N.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = N[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                # Also False for NaN.
                if not total > 1e-12 * N[i, i]:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
        for j in range(i + 1, n):
            L[i, j] = 0.0
    return True


@njit(cache=True, error_model="numpy")
def _solved(L: FloatArray, rhs: FloatArray) -> FloatArray:
    """Solve L L' x = rhs (n,)."""
    n = len(rhs)
    x = rhs.copy()
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x


@njit(cache=True, error_model="numpy")
def _inverse_block(N: FloatArray, C: FloatArray) -> bool:
    """Write the first rows and columns of the inverse of N into C; False when N is not well determined."""
    L = np.zeros_like(N)
    if not _factorised(N, L):
        return False
    unit = np.zeros(N.shape[0])
    for a in range(C.shape[0]):
        unit[:] = 0.0
        unit[a] = 1.0
        column = _solved(L, unit)
        for b in range(C.shape[0]):
            C[b, a] = column[b]
    return True


@njit(cache=True, error_model="numpy")
def _ordered(values: FloatArray) -> FloatArray:
    """Sort by insertion: few values, often almost in order."""
    out = values.copy()
    for i in range(1, len(out)):
        value = out[i]
        j = i
        while j > 0 and out[j - 1] > value:
            out[j] = out[j - 1]
            j -= 1
        out[j] = value
    return out


@njit(cache=True, error_model="numpy")
def signed_distance(px: float, py: float, y: FloatArray, n: FloatArray, w: FloatArray) -> float:
    """Distance of a point to the ellipse, positive outside; writes its normal (2,) and derivative (5,).

    The derivative is the rim's: the part that vanishes with the distance is left out.
    """
    x, z = px - y[0], py - y[1]
    ea, es, beta = np.exp(y[2]), np.exp(y[4]), y[3]
    # Whitened point: S = L L', L = [[ea, 0], [beta ea, es]].
    u = x / ea
    v = (z - beta * x) / es
    r = np.sqrt(u * u + v * v)
    if r < 1e-9:
        r = 1e-9
    nx = (u / ea - beta * v / es) / r
    ny = v / es / r
    g = np.sqrt(nx * nx + ny * ny)
    n[0] = nx / g
    n[1] = ny / g
    # df = (u du + v dv) / r, divided by |grad f|.
    ig = 1.0 / g
    w[0] = -n[0]
    w[1] = -n[1]
    w[2] = -u * u / r * ig
    w[3] = -v * x / es / r * ig
    w[4] = -v * v / r * ig
    return (r - 1.0) * ig


@njit(cache=True, error_model="numpy")
def _point_row(
    px: float, py: float, lever: FloatArray, toward: FloatArray, y: FloatArray, n: FloatArray, w: FloatArray
) -> float:
    """Distance as `signed_distance`; writes its derivative (m,) for chart, lever's unknowns and outline, too.

    The lever's unknown has slopes across `toward` and along it. The outline deviates from the ellipse by
    harmonics of the angle in which that is a circle, as shares of the radius: a share moves a tangent by as
    much of its distance from the centre.
    """
    d = signed_distance(px, py, y, n, w)
    w[_BRIGHTNESS] = -(n[0] * lever[0] + n[1] * lever[1])
    ea, es = np.exp(y[2]), np.exp(y[4])
    x = px - y[0]
    u, v = x / ea, (py - y[1] - y[3] * x) / es
    r = np.sqrt(u * u + v * v)
    c1, s1 = u / r, v / r
    tu, tv = toward[0] / ea, (toward[1] - y[3] * toward[0]) / es
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
    """Build the normal matrix (m, m) and gradient (m,) from the points' first m derivatives."""
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
def _second_order_bias(
    points: FloatArray, base: FloatArray, weight: FloatArray, y: FloatArray, C: FloatArray, sigma2: float
) -> FloatArray:
    """Bias (5,) of the estimate from Gaussian errors of variance sigma2 / base along the normals.

    The estimate solves sum k psi(r) J = 0, r = e + J d + d'Hd/2 + e K d + c e^2/2, J's own change with r
    being M. To second order its mean is

        -sigma^2 C sum k {J [v tr(HC)/2 - x K'CJ + u c/2] + M (1 - x J'CJ)},    C = (sum k J J')^-1,

    v, u, x = E[psi^2]/m^2, E[psi' e^2]/m, E[psi psi' e]/m^2 with m = E[psi'], 1 for least squares. The
    derivatives are taken by differences at the points' feet.
    """
    n, J, Jp, Jm, Jx = np.empty(2), np.empty(5), np.empty(5), np.empty(5), np.empty(5)
    nx = np.empty(2)
    K, M = np.empty(5), np.empty(5)
    root = np.zeros((5, 5))
    if not _factorised(C, root):
        return np.zeros(5)
    size = np.exp(0.5 * (y[2] + y[4]))
    h = 0.02 * size
    total = np.zeros(5)
    moved = np.empty(5)
    steps = np.empty(5)
    for j in range(5):
        # A step of each column that moves the rim by about h.
        steps[j] = h / max(
            np.abs(root[0, j]) + np.abs(root[1, j])
            + size * (np.abs(root[2, j]) + np.abs(root[3, j]) + np.abs(root[4, j])), 1e-12,
        )  # fmt: skip
    for i in range(points.shape[0]):
        fx, fy = points[i, 0], points[i, 1]
        for _ in range(3):
            d = signed_distance(fx, fy, y, n, J)
            fx -= d * n[0]
            fy -= d * n[1]
        r0 = signed_distance(fx, fy, y, n, J)
        rp = signed_distance(fx + h * n[0], fy + h * n[1], y, nx, Jp)
        rm = signed_distance(fx - h * n[0], fy - h * n[1], y, nx, Jm)
        c = (rp + rm - 2.0 * r0) / (h * h)
        for a in range(5):
            M[a] = (Jp[a] - Jm[a]) / (2.0 * h)
            # K, the mixed derivative of the distance itself, not of the simplified J.
            e = h if a < 2 else h / size
            for b in range(5):
                moved[b] = y[b]
            moved[a] = y[a] + e
            up = signed_distance(fx + h * n[0], fy + h * n[1], moved, nx, Jx)
            um = signed_distance(fx - h * n[0], fy - h * n[1], moved, nx, Jx)
            moved[a] = y[a] - e
            dp = signed_distance(fx + h * n[0], fy + h * n[1], moved, nx, Jx)
            dm = signed_distance(fx - h * n[0], fy - h * n[1], moved, nx, Jx)
            K[a] = (up - um - dp + dm) / (4.0 * h * e)
        trace = 0.0
        for j in range(5):
            for b in range(5):
                moved[b] = y[b] + steps[j] * root[b, j]
            up = signed_distance(fx, fy, moved, nx, Jx)
            for b in range(5):
                moved[b] = y[b] - steps[j] * root[b, j]
            dm = signed_distance(fx, fy, moved, nx, Jx)
            trace += (up + dm - 2.0 * r0) / (steps[j] * steps[j])
        leverage, KCJ = 0.0, 0.0
        for a in range(5):
            for b in range(5):
                leverage += base[i] * weight[i] * J[a] * C[a, b] * J[b]
                KCJ += K[a] * C[a, b] * J[b]
        variance = 1.0 / base[i]
        scale = 0.5 * _PSI_VARIANCE * trace - _PSI_MIXED * KCJ + 0.5 * _PSI_CURVATURE * c * variance
        for a in range(5):
            total[a] += base[i] * weight[i] * (J[a] * scale + M[a] * variance * (1.0 - _PSI_MIXED * leverage))
    out = np.zeros(5)
    for a in range(5):
        for b in range(5):
            out[a] -= sigma2 * C[a, b] * total[b]
    return out


@njit(cache=True, error_model="numpy")
def _covered(points: FloatArray, weight: FloatArray, y: FloatArray, max_gap_rad: float) -> float:
    """Part of the rim that points of non-zero weight cover, gaps above `max_gap_rad` left out."""
    angles = np.empty(points.shape[0])
    k = 0
    for i in range(points.shape[0]):
        if weight[i] > 0.0:
            u, v = whiten_kernel(points[i, 0], points[i, 1], y[0], y[1], y[2], y[3], y[4])
            angles[k] = np.arctan2(v, u)
            k += 1
    if k < 2:
        return 0.0
    angles = _ordered(angles[:k])
    open_rad = 0.0
    for i in range(k):
        gap = angles[i + 1] - angles[i] if i + 1 < k else angles[0] + 2.0 * np.pi - angles[i]
        if gap > max_gap_rad:
            open_rad += gap
    return 1.0 - open_rad / (2.0 * np.pi)


@njit(cache=True, error_model="numpy")
def _run_length(r: FloatArray, weight: FloatArray) -> float:
    """Variance factor, 1 to 4, of neighbouring points' common errors (Bartlett's window, five points)."""
    count = len(r)
    variance = 0.0
    for i in range(count):
        variance += weight[i] * r[i] * r[i]
    factor = 1.0
    for lag in range(1, 5):
        product = 0.0
        for i in range(count):
            j = (i + lag) % count
            product += np.sqrt(weight[i] * weight[j]) * r[i] * r[j]
        factor += 2.0 * (1.0 - lag / 5.0) * product / (variance + 1e-300)
    return min(max(factor, 1.0), 4.0)


@njit(cache=True, error_model="numpy")
def _outline_variance(rows: FloatArray, r: FloatArray, base: FloatArray, sigma: float) -> float:
    """Variance, in radii, of the outline's deviation from the ellipse that explains residuals r (n,).

    Their mean square is that of the points' own errors, which differ from neighbour to neighbour, and what a
    fit of the ellipse alone leaves of the harmonics.
    """
    count, m = rows.shape
    jump, power = np.empty(count - 1), 0.0
    for i in range(count):
        power += min(abs(r[i]), _TUKEY_SIGMAS * sigma) ** 2
        if i > 0:
            jump[i - 1] = abs(r[i] - r[i - 1])
    own = 0.5 * (_MAD_TO_SIGMA * _ordered(jump)[(count - 1) // 2]) ** 2
    N, _ = _normal_equations(rows, m, r, base, np.ones(count))
    ellipse = np.ascontiguousarray(N[:5, :5])
    L = np.zeros((5, 5))
    if not _factorised(ellipse, L):
        return 0.0
    left = 0.0
    for j in range(_OUTLINE, m):
        column = _solved(L, N[j, :5])
        rest = N[j, j]
        for a in range(5):
            rest -= N[j, a] * column[a]
        left += HARMONIC_VARIANCE_SHARE[j - _OUTLINE] * rest
    # What the errors' own mean square may be by chance is no outline.
    own *= count + 2.0 * np.sqrt(2.0 * count)
    return min(max(power - own, 0.0) / left, _MAX_OUTLINE_RADII**2)


@njit(cache=True, error_model="numpy")
def fit(
    points: FloatArray, ratio: FloatArray, lever: FloatArray, lever_sigma: float, lever_slope: float,
    toward: FloatArray, start: FloatArray, min_scatter: float, max_gap_rad: float, outline_share: float,
) -> tuple[bool, FloatArray, FloatArray, FloatArray, FloatArray, float, int, float, float]:  # fmt: skip
    """Robust fit.

    Returns whether it converged, chart (5,), covariance (5, 5) and the part of it (5, 5) that is from the
    lever's slope and the outline; a standard deviation of the chart (5,) from what an outline makes of the
    lever's unknown, which the covariance has not; rms of the distances, points kept, arc share and the
    outline's rms deviation from the ellipse in radii. `outline_share`, that expected, is corrected by what
    the points say; 0 leaves no room for any.
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
    # The unknowns beside the ellipse and their prior variances. A slope along the light does what a change of
    # size does: it is an uncertainty, but what would be found of it were other errors.
    other = np.zeros(size_all)
    prior = np.full(size_all, _HELD_VARIANCE)
    prior[_BRIGHTNESS] = lever_sigma * lever_sigma
    prior[_SLOPE_ACROSS] = max(lever_slope * lever_slope, _HELD_VARIANCE)
    outline2 = outline_share * outline_share
    L = np.zeros((size_all, size_all))
    unit = np.zeros(size_all)
    sigma, length = 1.0, np.inf
    for iteration in range(30):
        for i in range(count):
            d[i] = _point_row(points[i, 0], points[i, 1], lever[i], toward, y, n, rows[i])
            for j in range(_BRIGHTNESS, size_all):
                d[i] += rows[i, j] * other[j]
            r[i] = d[i] * np.sqrt(base[i])
        # With a scale that follows the points' order the weights can go round for ever.
        if iteration < _SCALE_ITERATIONS:
            sigma = max(_MAD_TO_SIGMA * _ordered(np.abs(r))[count // 2], min_scatter)
        for i in range(count):
            t = r[i] / (_TUKEY_SIGMAS * sigma)
            # The first rounds down-weigh only: a poor start must not throw the good points away. The last
            # leave the weights as they are.
            if iteration < _CAUCHY_ITERATIONS:
                weight[i] = 1.0 / (1.0 + (r[i] / sigma) ** 2)
            elif iteration < _WEIGHT_ITERATIONS:
                weight[i] = (1.0 - t * t) ** 2 if np.abs(t) < 1.0 else 0.0
        if size_all > _OUTLINE and iteration == _CAUCHY_ITERATIONS:
            outline2 += _outline_variance(rows, r, base, sigma)
            for j in range(_OUTLINE, size_all):
                prior[j] = outline2 * HARMONIC_VARIANCE_SHARE[j - _OUTLINE]
        # The outline's variance is known from here on.
        used = _OUTLINE if iteration < _CAUCHY_ITERATIONS else size_all
        L = np.zeros((used, used))
        N, grad = _normal_equations(rows, used, d, base, weight)
        for j in range(_BRIGHTNESS, used):
            N[j, j] += sigma * sigma / prior[j]
            grad[j] += sigma * sigma / prior[j] * other[j]
        if not _factorised(N, L):
            return False, y, cov, cov, cov[0], 0.0, 0, 0.0, 0.0
        step = _solved(L, -grad)
        size = np.exp(0.5 * (y[2] + y[4]))
        length = np.abs(step[0]) + np.abs(step[1])
        length += size * (np.abs(step[2]) + np.abs(step[3]) + np.abs(step[4]))
        damp = min(1.0, 0.5 * size / (length + 1e-300))
        for a in range(5):
            y[a] += damp * step[a]
        for j in range(_BRIGHTNESS, used):
            other[j] += damp * step[j]
        if iteration > _CAUCHY_ITERATIONS and length < 1e-4:
            break
    # A robust cycle of a few thousandths of a pixel is as good as convergence.
    if not (length < 0.01 and np.abs(y[3]) < 20.0):
        return False, y, cov, cov, cov[0], 0.0, 0, 0.0, 0.0
    kept = 0
    psi2, slope, square, mass = 0.0, 0.0, 0.0, 0.0
    level = points.copy()
    for i in range(count):
        d[i] = _point_row(points[i, 0], points[i, 1], lever[i], toward, y, n, rows[i])
        if rows[i, _BRIGHTNESS] != 0.0:
            moved = rows[i, _BRIGHTNESS] * other[_BRIGHTNESS] + rows[i, _SLOPE_ACROSS] * other[_SLOPE_ACROSS]
            d[i] += moved
            level[i] -= moved / rows[i, _BRIGHTNESS] * lever[i]
        whole = d[i] * np.sqrt(base[i])
        for j in range(_OUTLINE, size_all):
            d[i] += rows[i, j] * other[j]
        r[i] = d[i] * np.sqrt(base[i])
        t = r[i] / (_TUKEY_SIGMAS * sigma)
        weight[i] = (1.0 - t * t) ** 2 if np.abs(t) < 1.0 else 0.0
        if weight[i] > 0.0:
            kept += 1
            psi2 += (weight[i] * r[i]) ** 2
            slope += (1.0 - t * t) * (1.0 - 5.0 * t * t)
            square += weight[i] * whole * whole
            mass += weight[i]
    if kept < 8 or not slope > 0.3 * kept:
        return False, y, cov, cov, cov[0], 0.0, kept, 0.0, 0.0
    rms = np.sqrt(square / mass)
    # Covariance of an M-estimate: psi's mean square over its mean slope squared.
    sigma2 = psi2 * count / (slope * slope)
    fitted = 5.0
    for j in range(_SLOPE_ACROSS, size_all):
        unit[:] = 0.0
        unit[j] = 1.0
        fitted += max(0.0, 1.0 - sigma2 * _solved(L, unit)[j] / prior[j])
    white2 = sigma2 * count / (count - fitted) / _PSI_VARIANCE
    # With Huber's correction for few points, and right in its inverse's mean: it is itself an estimate.
    sigma2 *= count / (count - fitted - _SCALE_VARIANCE) * (1.0 + fitted * _PSI_SLOPE_VARIANCE / count) ** 2
    sigma2 = max(sigma2 * _run_length(r, weight), min_scatter * min_scatter)
    N, _ = _normal_equations(rows, size_all, d, base, np.ones(count))
    prior[_SLOPE_ALONG] = prior[_SLOPE_ACROSS]
    for j in range(_BRIGHTNESS, size_all):
        N[j, j] += sigma2 / (prior[j] * (_OUTLINE_VARIANCE_FACTOR if j >= _OUTLINE else 1.0))
    C, noise = np.empty((5, 5)), np.empty((5, 5))
    if not (_inverse_block(N, C) and _inverse_block(np.ascontiguousarray(N[:6, :6]), noise)):
        return False, y, cov, cov, cov[0], 0.0, kept, 0.0, 0.0
    L = np.zeros((size_all, size_all))
    if not _factorised(N, L):
        return False, y, cov, cov, cov[0], 0.0, kept, 0.0, 0.0
    unit[:] = 0.0
    unit[_BRIGHTNESS] = 1.0
    joint = _solved(L, unit)
    misled = (
        min(BRIGHTNESS_ERROR_PER_OUTLINE * np.sqrt(outline2), lever_sigma) / joint[_BRIGHTNESS] * joint[:5]
    )
    arc = _covered(points, weight, y, max_gap_rad)
    # A hardly determined ellipse has no second-order expansion; it is refused by its covariance.
    if sigma2 * max(C[2, 2], C[4, 4]) < 0.06:
        y = y - _second_order_bias(level, base, np.ones(count), y, noise, white2)
    return True, y, sigma2 * C, sigma2 * (C - noise), misled, rms, kept, arc, np.sqrt(outline2)
