"""Robust least-squares ellipse on distances, its covariance and second-order bias; see `ellipse_fit`.

The ellipse is the chart y of pixel coordinates (see `factors.kernels.conic`).
"""

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

_TUKEY = 4.685
_MAD_TO_SIGMA = 1.4826
_GENTLE_ROUNDS = 5
_SCALE_ROUNDS = 15
# Moments of Tukey's psi for a Gaussian error e of standard deviation 1, relative to m = E[psi']: of its
# variance E[psi^2]/m^2, E[psi' e^2]/m, E[psi psi' e]/m^2 and Var[psi']/m^2. All but the last are 1 for least
# squares.
_SPREAD, _CURVED, _MIXED, _UNEVEN = 1.0526, 0.4428, 0.5720, 0.1597
# Relative variance of the scatter's estimate, times the number of points (2 for least squares).
_SCATTER = 2.33


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
def _distance(px: float, py: float, y: FloatArray, n: FloatArray, w: FloatArray) -> float:
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
def _normal_equations(
    points: FloatArray, lever: FloatArray, base: FloatArray, weight: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Build the normal matrix (6, 6) and gradient (6,): of the chart, then of the lever's unknown."""
    N = np.zeros((6, 6))
    grad = np.zeros(6)
    n, w = np.empty(2), np.empty(6)
    for i in range(points.shape[0]):
        d = _distance(points[i, 0], points[i, 1], y, n, w)
        w[5] = -(n[0] * lever[i, 0] + n[1] * lever[i, 1])
        k = base[i] * weight[i]
        for a in range(6):
            grad[a] += k * w[a] * d
            for b in range(6):
                N[a, b] += k * w[a] * w[b]
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
            d = _distance(fx, fy, y, n, J)
            fx -= d * n[0]
            fy -= d * n[1]
        r0 = _distance(fx, fy, y, n, J)
        rp = _distance(fx + h * n[0], fy + h * n[1], y, nx, Jp)
        rm = _distance(fx - h * n[0], fy - h * n[1], y, nx, Jm)
        c = (rp + rm - 2.0 * r0) / (h * h)
        for a in range(5):
            M[a] = (Jp[a] - Jm[a]) / (2.0 * h)
            # K, the mixed derivative of the distance itself, not of the simplified J.
            e = h if a < 2 else h / size
            for b in range(5):
                moved[b] = y[b]
            moved[a] = y[a] + e
            up = _distance(fx + h * n[0], fy + h * n[1], moved, nx, Jx)
            um = _distance(fx - h * n[0], fy - h * n[1], moved, nx, Jx)
            moved[a] = y[a] - e
            dp = _distance(fx + h * n[0], fy + h * n[1], moved, nx, Jx)
            dm = _distance(fx - h * n[0], fy - h * n[1], moved, nx, Jx)
            K[a] = (up - um - dp + dm) / (4.0 * h * e)
        trace = 0.0
        for j in range(5):
            for b in range(5):
                moved[b] = y[b] + steps[j] * root[b, j]
            up = _distance(fx, fy, moved, nx, Jx)
            for b in range(5):
                moved[b] = y[b] - steps[j] * root[b, j]
            dm = _distance(fx, fy, moved, nx, Jx)
            trace += (up + dm - 2.0 * r0) / (steps[j] * steps[j])
        leverage, KCJ = 0.0, 0.0
        for a in range(5):
            for b in range(5):
                leverage += base[i] * weight[i] * J[a] * C[a, b] * J[b]
                KCJ += K[a] * C[a, b] * J[b]
        variance = 1.0 / base[i]
        scale = 0.5 * _SPREAD * trace - _MIXED * KCJ + 0.5 * _CURVED * c * variance
        for a in range(5):
            total[a] += base[i] * weight[i] * (J[a] * scale + M[a] * variance * (1.0 - _MIXED * leverage))
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
    ea, es = np.exp(y[2]), np.exp(y[4])
    for i in range(points.shape[0]):
        if weight[i] > 0.0:
            x = points[i, 0] - y[0]
            angles[k] = np.arctan2((points[i, 1] - y[1] - y[3] * x) / es, x / ea)
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
def fit(
    points: FloatArray, ratio: FloatArray, lever: FloatArray, lever_sigma: float, start: FloatArray,
    min_scatter: float, max_gap_rad: float,
) -> tuple[bool, FloatArray, FloatArray, float, int, float]:  # fmt: skip
    """Robust fit: whether it converged, chart (5,), covariance (5, 5), rms, points kept, arc share."""
    count = points.shape[0]
    y = start.copy()
    cov = np.zeros((5, 5))
    base = 1.0 / (ratio * ratio)
    base *= count / np.sum(base)
    weight = np.ones(count)
    r = np.empty(count)
    n, w = np.empty(2), np.empty(5)
    moved = points.copy()
    L = np.zeros((6, 6))
    unknown, sigma, length = 0.0, 1.0, np.inf
    for iteration in range(30):
        for i in range(count):
            moved[i, 0] = points[i, 0] - unknown * lever[i, 0]
            moved[i, 1] = points[i, 1] - unknown * lever[i, 1]
            r[i] = _distance(moved[i, 0], moved[i, 1], y, n, w) * np.sqrt(base[i])
        # With a scale that follows the points' order the weights can go round for ever.
        if iteration < _SCALE_ROUNDS:
            sigma = max(_MAD_TO_SIGMA * _ordered(np.abs(r))[count // 2], min_scatter)
        for i in range(count):
            t = r[i] / (_TUKEY * sigma)
            # The first rounds down-weigh only: a poor start must not throw the good points away.
            if iteration < _GENTLE_ROUNDS:
                weight[i] = 1.0 / (1.0 + (r[i] / sigma) ** 2)
            else:
                weight[i] = (1.0 - t * t) ** 2 if np.abs(t) < 1.0 else 0.0
        N, grad = _normal_equations(moved, lever, base, weight, y)
        N[5, 5] += (sigma / lever_sigma) ** 2
        grad[5] += (sigma / lever_sigma) ** 2 * unknown
        if not _factorised(N, L):
            return False, y, cov, 0.0, 0, 0.0
        step = _solved(L, -grad)
        size = np.exp(0.5 * (y[2] + y[4]))
        length = np.abs(step[0]) + np.abs(step[1])
        length += size * (np.abs(step[2]) + np.abs(step[3]) + np.abs(step[4]))
        damp = min(1.0, 0.5 * size / (length + 1e-300))
        for a in range(5):
            y[a] += damp * step[a]
        unknown += damp * step[5]
        if iteration > _GENTLE_ROUNDS and length < 1e-4:
            break
    # A robust cycle of a few thousandths of a pixel is as good as convergence.
    if not (length < 0.01 and np.abs(y[3]) < 20.0):
        return False, y, cov, 0.0, 0, 0.0
    kept = 0
    psi2, slope, square, mass = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        moved[i, 0] = points[i, 0] - unknown * lever[i, 0]
        moved[i, 1] = points[i, 1] - unknown * lever[i, 1]
        r[i] = _distance(moved[i, 0], moved[i, 1], y, n, w) * np.sqrt(base[i])
        t = r[i] / (_TUKEY * sigma)
        weight[i] = (1.0 - t * t) ** 2 if np.abs(t) < 1.0 else 0.0
        if weight[i] > 0.0:
            kept += 1
            psi2 += (weight[i] * r[i]) ** 2
            slope += (1.0 - t * t) * (1.0 - 5.0 * t * t)
            square += weight[i] * r[i] * r[i]
            mass += weight[i]
    if kept < 8 or not slope > 0.3 * kept:
        return False, y, cov, 0.0, kept, 0.0
    rms = np.sqrt(square / mass)
    # Covariance of an M-estimate: psi's mean square over its mean slope squared.
    sigma2 = psi2 * count / (slope * slope)
    white2 = sigma2 * count / (count - 5.0) / _SPREAD
    # With Huber's correction for few points, and right in its inverse's mean: it is itself an estimate.
    sigma2 *= count / (count - 5.0 - _SCATTER) * (1.0 + 5.0 * _UNEVEN / count) ** 2
    sigma2 = max(sigma2 * _run_length(r, weight), min_scatter * min_scatter)
    plain = np.ones(count)
    N, _ = _normal_equations(moved, lever, base, plain, y)
    N[5, 5] += sigma2 / lever_sigma**2
    if not _factorised(N, L):
        return False, y, cov, 0.0, kept, 0.0
    C = np.empty((5, 5))
    unit = np.zeros(6)
    for a in range(5):
        unit[:] = 0.0
        unit[a] = 1.0
        column = _solved(L, unit)
        for b in range(5):
            C[b, a] = column[b]
    arc = _covered(moved, weight, y, max_gap_rad)
    # A hardly determined ellipse has no second-order expansion; it is refused by its covariance.
    if sigma2 * max(C[2, 2], C[4, 4]) < 0.06:
        y = y - _second_order_bias(moved, base, plain, y, C, white2)
    return True, y, sigma2 * C, rms, kept, arc
