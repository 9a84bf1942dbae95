"""Time-correlated errors of rims: how errors on the ground move an image, and the residual with them."""

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.kernels.admission import sum_of_squares
from factors.kernels.compiled import njit
from factors.kernels.conic import camera_pose, moments, rim_in_camera
from factors.kernels.packed import CRATER, HEADER, shape_residuals
from factors.kernels.robust import NONE, loss_and_weight

# Direction in which each error moves the semi-axes a l1 and b l2: along l1, l2 or their normal; -1 for none.
_OF_AXES = np.array([[-1, -1, -1, 0, 1, -1, 2, -1], [-1, -1, -1, -1, 0, 1, -1, 2]])


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
    return _slopes(gTb, bTc, centres, axes, 0, 6)


@njit(cache=True, error_model="numpy")
def tilt_slopes(gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray) -> FloatArray:
    """Differentiate charts in the tilts of the rims' planes.

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
    ndarray, shape (n, 5, 2)
        Derivatives in the slopes of the plane along l1 and l2, per unit slope. Zero for a rim that the pose
        cannot see.
    """
    return _slopes(gTb, bTc, centres, axes, 6, 8)


@njit(cache=True, error_model="numpy")
def _slopes(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray, begin: int, end: int
) -> FloatArray:
    """Compute derivatives (n, 5, end - begin): columns of `ground_slopes`, then `tilt_slopes`."""
    R, P = camera_pose(gTb, bTc)
    out = np.zeros((centres.shape[0], 5, end - begin))
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
        for j in range(begin, end):
            for k in range(3):
                d[k] = radius * u[j, k] if j < 3 else 0.0
                # The map 1 + D moves a l1 to (1 + D) a l1.
                dc[0, k] = a * u[_OF_AXES[0, j], k] if _OF_AXES[0, j] >= 0 else 0.0
                dc[1, k] = b * u[_OF_AXES[1, j], k] if _OF_AXES[1, j] >= 0 else 0.0
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
            out[i, 0, j - begin], out[i, 1, j - begin] = dmx, dmy
            out[i, 2, j - begin] = 0.5 * dxx / sxx
            out[i, 3, j - begin] = (dxy - beta * dxx) / sxx
            out[i, 4, j - begin] = 0.5 * (dyy - 2.0 * beta * dxy + beta * beta * dxx) / s
    return out


@njit(cache=True, error_model="numpy")
def pack_apart(packed: FloatArray, charts: FloatArray, roots: FloatArray) -> FloatArray:
    """Pack the constants of rims with errors that are variables, each rim by itself.

    Parameters
    ----------
    packed : ndarray, shape (n_packed,)
        All rims, from `packed.pack`.
    charts : ndarray, shape (n, 5)
        Measured charts, normalised.
    roots : ndarray, shape (n, 5, m)
        Errors z of a rim add roots z to its predicted chart.

    Returns
    -------
    ndarray, shape (n, n_data)
        For each rim what `packed.pack` gives without a loss, its chart, its roots, its roots whitened, and
        the loss. Empty where a root is not finite.
    """
    n, m = roots.shape[0], roots.shape[2]
    if not np.isfinite(sum_of_squares(roots.reshape(-1))):
        return np.empty((0, 0))
    begin = HEADER + CRATER
    out = np.empty((n, begin + 5 + 10 * m + 2))
    for i in range(n):
        row = out[i]
        for k in range(12):
            row[k] = packed[k]
        row[12], row[13] = NONE, 1.0
        for k in range(CRATER):
            row[HEADER + k] = packed[HEADER + CRATER * i + k]
        for k in range(5):
            row[begin + k] = charts[i, k]
        W = begin - 15
        for r in range(5):
            for j in range(m):
                total = 0.0
                for k in range(r + 1):
                    total += row[W + k] * roots[i, k, j]
                row[begin + 5 + m * r + j] = roots[i, r, j]
                row[begin + 5 + m * (5 + r) + j] = total
            W += r + 1
        row[-2], row[-1] = packed[12], packed[13]
    return out


@njit(cache=True, error_model="numpy")
def shape_residuals_with_errors(
    gTb: FloatArray, z: FloatArray, data: FloatArray, linearise: bool, out: FloatArray
) -> float:
    """Conic shape with errors: zero when the predicted rim, moved by its errors, has the measured chart.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    z : ndarray, shape (m,)
        Errors of the rim, in the units of their roots.
    data : ndarray, shape (n_data,)
        Of the rim, from `pack_apart`; where the chart is packed, that moved by the errors is written.
    linearise : bool
        Whether the Jacobians are written.
    out : ndarray, shape (7 + m, 5)
        Written: the Jacobian's columns for the body's right twist [w, rho], then the residual, then the
        Jacobian's columns in z.

    Returns
    -------
    float
        Finite only where all that was written is.
    """
    m = z.shape[0]
    begin = HEADER + CRATER
    roots = begin + 5
    white = roots + 5 * m
    total = 0.0
    for i in range(5):
        moved = data[begin + i]
        for j in range(m):
            moved -= data[roots + m * i + j] * z[j]
        data[HEADER + 9 + i] = moved
        # A crater that cannot be seen hides errors that are not finite.
        total += moved
    total += shape_residuals(gTb, data[:begin], linearise, out[:7])
    d2, slope2 = 0.0, 0.0
    for r in range(5):
        d2 += out[6, r] * out[6, r]
        for j in range(6):
            slope2 += out[j, r] * out[j, r]
    loss, weight = loss_and_weight(d2, int(data[-2]), data[-1])
    factor = np.sqrt(weight) if linearise or d2 == 0.0 else np.sqrt(loss / d2)
    for r in range(5):
        out[6, r] *= factor
    if linearise:
        # A rim that the pose cannot see does not constrain its errors either.
        share = 0.0 if slope2 == 0.0 else factor
        for r in range(5):
            for j in range(6):
                out[j, r] *= factor
            for j in range(m):
                out[7 + j, r] = share * data[white + m * r + j]
    return total


@njit(cache=True, error_model="numpy")
def all_shape_residuals_with_errors(
    poses: FloatArray, of_pose: IntArray, errors: FloatArray, places: IntArray, data: FloatArray,
    linearise: bool, out: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """Conic shape of rims of many frames, each with errors.

    Parameters
    ----------
    poses : ndarray, shape (k, 4, 4)
        Transposed poses of the body in g. Each is then column-major as GTSAM's matrices are: a kernel is
        compiled for each order.
    of_pose : ndarray of int, shape (n,)
        Index of each rim's pose.
    errors : ndarray, shape (l,)
        All errors, in the units of their roots.
    places : ndarray of int, shape (n, m)
        Where among them each rim's are.
    data : ndarray, shape (n, n_data)
        From `pack_apart`.
    linearise : bool
        Whether the Jacobians are written.
    out : ndarray, shape (n, 7 + m, 5)
        Written as by `shape_residuals_with_errors`.

    Returns
    -------
    error : float
        Half the sum of squares of all residuals.
    bad : int
        First rim of which something written is not finite; -1 if there is none.
    """
    z = np.empty(places.shape[1])
    error, bad = 0.0, -1
    for i in range(len(data)):
        for j in range(len(z)):
            z[j] = errors[places[i, j]]
        total = shape_residuals_with_errors(poses[of_pose[i]].T, z, data[i], linearise, out[i])
        if bad < 0 and not np.isfinite(total):
            bad = i
        for r in range(5):
            error += 0.5 * out[i, 6, r] * out[i, 6, r]
    return error, bad
