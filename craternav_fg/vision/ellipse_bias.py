"""Second-order bias of the robust ellipse fit; compiled."""

import numpy as np
import numpy.typing as npt
from numba import njit

from craternav_fg.vision.dense_kernel import factorised
from craternav_fg.vision.ellipse_distance import signed_distance

FloatArray = npt.NDArray[np.float64]

# Moments of Tukey's psi, cut off at 4.685 standard deviations, for a Gaussian error e of standard deviation
# 1, relative to m = E[psi'] (by numerical integration): E[psi^2]/m^2, E[psi' e^2]/m and E[psi psi' e]/m^2.
# All are 1 for least squares.
PSI_VARIANCE, PSI_CURVATURE, PSI_MIXED = 1.0526, 0.4428, 0.5720
# Steps of the central differences, in radii.
_DIFFERENCE_STEP_RADII = 0.02


@njit(cache=True, error_model="numpy")
def second_order_bias(
    points: FloatArray, base: FloatArray, weight: FloatArray, y: FloatArray, C: FloatArray, sigma2: float
) -> FloatArray:
    """Compute the bias of the fit from Gaussian errors of the points along the normals.

    The estimate solves sum k psi(r) J = 0 with r = e + J d + d'Hd/2 + e K d + c e^2/2 and the derivative M of
    J in r. To second order its mean is

        -sigma^2 C sum k {J [v tr(HC)/2 - x K'CJ + u c/2] + M (1 - x J'CJ)},    C = (sum k J J')^-1,

    with v, u, x = E[psi^2]/m^2, E[psi' e^2]/m, E[psi psi' e]/m^2 and m = E[psi']; all are 1 for least
    squares. The derivatives are differences at the feet of the points.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Edge points, px.
    base, weight : ndarray, shape (n,)
        Inverse relative variances of the points, and further weights; k is their product.
    y : ndarray, shape (5,)
        Estimated chart in pixels.
    C : ndarray, shape (5, 5)
        Inverse normal matrix, see above: covariance of the chart for sigma2 = 1.
    sigma2 : float
        The points' errors have the variance sigma2 / base, px^2.

    Returns
    -------
    ndarray, shape (5,)
        To subtract from the chart.
    """
    n, J, Jp, Jm, Jx = np.empty(2), np.empty(5), np.empty(5), np.empty(5), np.empty(5)
    nx = np.empty(2)
    K, M = np.empty(5), np.empty(5)
    root = np.zeros((5, 5))
    if not factorised(C, root):
        return np.zeros(5)
    size = np.exp(0.5 * (y[2] + y[4]))
    h = _DIFFERENCE_STEP_RADII * size
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
        scale = 0.5 * PSI_VARIANCE * trace - PSI_MIXED * KCJ + 0.5 * PSI_CURVATURE * c * variance
        for a in range(5):
            total[a] += base[i] * weight[i] * (J[a] * scale + M[a] * variance * (1.0 - PSI_MIXED * leverage))
    out = np.zeros(5)
    for a in range(5):
        for b in range(5):
            out[a] -= sigma2 * C[a, b] * total[b]
    return out
