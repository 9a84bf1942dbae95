"""Time-correlated errors of rims: how errors on the ground move an image, and the residual with them."""

import numpy as np
import numpy.typing as npt

from factors.kernels.compiled import njit
from factors.kernels.conic import camera_pose, moments, rim_in_camera
from factors.kernels.packed import CRATER, HEADER, shape_residuals
from factors.kernels.robust import loss_and_weight

FloatArray = npt.NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def ground_slopes(gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray) -> FloatArray:
    """Differentiate charts in errors of the rims on the ground.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres : ndarray, shape (n, 3)
        Rim centres in g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes a l1 and b l2 in g, m.

    Returns
    -------
    ndarray, shape (n, 5, 6)
        Derivatives in the centre's shift along l1, l2 and their normal; then in the growth of the rim along
        l1, its shear (l1 moves towards l2 and l2 towards l1) and its growth along l2. The shifts are in units
        of the rim's mean radius sqrt(a b). Zero for a rim that the pose cannot see.
    """
    R, P = camera_pose(gTb, bTc)
    out = np.zeros((centres.shape[0], 5, 6))
    p, c, u = np.empty(3), np.empty((2, 3)), np.empty((3, 3))
    d, dc = np.empty(3), np.empty((2, 3))
    for i in range(centres.shape[0]):
        rim_in_camera(R, P, centres[i], axes[i], p, c)
        visible, mx, my, sxx, sxy, s = moments(
            p[0], p[1], p[2], c[0, 0], c[0, 1], c[0, 2], c[1, 0], c[1, 1], c[1, 2]
        )
        if not visible:
            continue
        a = np.sqrt(c[0, 0] ** 2 + c[0, 1] ** 2 + c[0, 2] ** 2)
        b = np.sqrt(c[1, 0] ** 2 + c[1, 1] ** 2 + c[1, 2] ** 2)
        radius = np.sqrt(a * b)
        for k in range(3):
            u[0, k], u[1, k] = c[0, k] / a, c[1, k] / b
        for k in range(3):
            e, f = (k + 1) % 3, (k + 2) % 3
            u[2, k] = u[0, e] * u[1, f] - u[0, f] * u[1, e]
        beta = sxy / sxx
        syy = s + beta * sxy
        m = np.array([mx, my, 1.0])
        w = c[0, 2] * c[0, 2] + c[1, 2] * c[1, 2] - p[2] * p[2]
        # Q*/w beside m m': S, without a third row.
        N = np.array([[mx * mx - sxx, mx * my - sxy], [mx * my - sxy, my * my - syy]])
        for j in range(6):
            for k in range(3):
                d[k] = radius * u[j, k] if j < 3 else 0.0
                # The in-plane map 1 + D moves a l1 to (1 + D) a l1.
                dc[0, k] = a * u[0, k] if j == 3 else (a * u[1, k] if j == 4 else 0.0)
                dc[1, k] = b * u[1, k] if j == 5 else (b * u[0, k] if j == 4 else 0.0)
            dQ = np.zeros((3, 3))
            for k in range(3):
                for n in range(3):
                    dQ[k, n] = (
                        dc[0, k] * c[0, n] + c[0, k] * dc[0, n] + dc[1, k] * c[1, n] + c[1, k] * dc[1, n]
                        - d[k] * p[n] - p[k] * d[n]
                    ) / w  # fmt: skip
            dw = dQ[2, 2]
            dmx, dmy = dQ[0, 2] - m[0] * dw, dQ[1, 2] - m[1] * dw
            dxx = 2.0 * mx * dmx - (dQ[0, 0] - N[0, 0] * dw)
            dxy = dmx * my + mx * dmy - (dQ[0, 1] - N[0, 1] * dw)
            dyy = 2.0 * my * dmy - (dQ[1, 1] - N[1, 1] * dw)
            out[i, 0, j], out[i, 1, j] = dmx, dmy
            out[i, 2, j] = 0.5 * dxx / sxx
            out[i, 3, j] = (dxy - beta * dxx) / sxx
            out[i, 4, j] = 0.5 * (dyy - 2.0 * beta * dxy + beta * beta * dxx) / s
    return out


@njit(cache=True, error_model="numpy")
def shape_residuals_with_errors(
    gTb: FloatArray, z: FloatArray, data: FloatArray, charts: FloatArray, roots: FloatArray,
    white: FloatArray, kind: int, scale: float, linearise: bool, out: FloatArray, slopes: FloatArray,
) -> float:  # fmt: skip
    """Conic shape with errors: zero when every predicted rim, moved by its errors, has the measured chart.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    z : ndarray, shape (m,)
        Errors of all rims, in the units of `roots`.
    data : ndarray, shape (n_data,)
        From `packed.pack`, without a loss; its charts are overwritten.
    charts : ndarray, shape (n, 5)
        Measured charts.
    roots : ndarray, shape (5 n, m)
        The errors add roots z to the predicted charts.
    white : ndarray, shape (5 n, m)
        The roots, whitened.
    kind, scale : int, float
        Loss, see `robust`.
    linearise : bool
        Whether the Jacobians are written.
    out : ndarray, shape (7, 5 n)
        Written as by `packed.shape_residuals`.
    slopes : ndarray, shape (5 n, m)
        Written: the Jacobian in z.

    Returns
    -------
    float
        Finite only where all that was written is.
    """
    n = charts.shape[0]
    for crater in range(n):
        k = HEADER + CRATER * crater + 9
        for i in range(5):
            moved = charts[crater, i]
            for j in range(z.shape[0]):
                moved -= roots[5 * crater + i, j] * z[j]
            data[k + i] = moved
    total = shape_residuals(gTb, data, linearise, out)
    for crater in range(n):
        row = 5 * crater
        d2, slope2 = 0.0, 0.0
        for r in range(row, row + 5):
            d2 += out[6, r] * out[6, r]
            for j in range(6):
                slope2 += out[j, r] * out[j, r]
        loss, weight = loss_and_weight(d2, kind, scale)
        factor = np.sqrt(weight) if linearise or d2 == 0.0 else np.sqrt(loss / d2)
        # A rim that the pose cannot see does not constrain its errors either.
        share = 0.0 if slope2 == 0.0 else factor
        for r in range(row, row + 5):
            out[6, r] *= factor
            if linearise:
                for j in range(6):
                    out[j, r] *= factor
                for j in range(z.shape[0]):
                    slopes[r, j] = share * white[r, j]
    for j in range(z.shape[0]):
        total += z[j]
    return total
