"""The conic-shape residual of a frame: one array in, one array out.

A call from Python pays for every array it hands over, and an array made inside costs more than a crater. So a
frame's constants are packed into one array, residual and Jacobian are written into one that lives as long as
the factor, and in between everything is a scalar.
"""

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.kernels.admission import (
    SOUND,
    first_bad_axes,
    first_bad_chart,
    is_rotation,
    sum_of_squares,
    whiten_all,
)
from factors.kernels.compiled import njit
from factors.kernels.conic import chart_slopes, moments
from factors.kernels.robust import loss_and_weight
from factors.kernels.validity import UNSEEN

# Sums may be fused and reordered; NaN and infinity keep their meaning, but are not to be tested for in here.
_FUSED = {"contract", "reassoc", "arcp", "nsz"}
# bTc (3 x 4), kind and scale of the loss; then per crater: centre, axes, chart, whitening (lower triangle).
HEADER = 14
CRATER = 3 + 6 + 5 + 15
# Numbers that `_rows_of_camera` works with: the camera's attitude and position, slopes of a chart.
_WORK = 9 + 3 + 30


@njit(cache=True, error_model="numpy")
def pack(
    bTc: FloatArray, centres: FloatArray, axes: FloatArray, charts: FloatArray, W: FloatArray,
    kind: int, scale: float,
) -> FloatArray:  # fmt: skip
    """Pack the constants of a frame into one array.

    Parameters
    ----------
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes : ndarray, shape (n, 3), (n, 2, 3)
        Rims in g, m.
    charts : ndarray, shape (n, 5)
        Measured charts.
    W : ndarray, shape (n, 5, 5)
        Whitening matrices of the charts: lower triangular, with W S W' = 1.
    kind, scale : int, float
        Loss, see `robust`.

    Returns
    -------
    ndarray, shape (n_data,)
        14 + 29 n numbers, in the order of `HEADER` and `CRATER`, in the units of what is packed.
    """
    data = np.empty(HEADER + CRATER * len(charts))
    for i in range(3):
        for j in range(4):
            data[4 * i + j] = bTc[i, j]
    data[12], data[13] = kind, scale
    k = HEADER
    for crater in range(len(charts)):
        for i in range(3):
            data[k + i] = centres[crater, i]
            data[k + 3 + i] = axes[crater, 0, i]
            data[k + 6 + i] = axes[crater, 1, i]
        k += 9
        for i in range(5):
            data[k + i] = charts[crater, i]
        k += 5
        for i in range(5):
            for j in range(i + 1):
                data[k] = W[crater, i, j]
                k += 1
    return data


@njit(cache=True, error_model="numpy")
def pack_if_sound(
    bTc: FloatArray, centres: FloatArray, axes: FloatArray, charts: FloatArray, S: FloatArray,
    kind: int, scale: float,
) -> FloatArray:  # fmt: skip
    """Pack the constants of a frame as `pack` does, if all are what a factor can be built from.

    Parameters
    ----------
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes : ndarray, shape (n, 3), (n, 2, 3)
        Rims in g, m.
    charts : ndarray, shape (n, 5)
        Measured charts.
    S : ndarray, shape (n, 5, 5)
        Covariances of the charts.
    kind, scale : int, float
        Loss, see `robust`.

    Returns
    -------
    ndarray, shape (n_data,)
        Empty where one of the checks of `admission` fails, or a number is not finite.
    """
    none = np.empty(0)
    last = (bTc[3, 0] == 0.0) & (bTc[3, 1] == 0.0) & (bTc[3, 2] == 0.0) & (bTc[3, 3] == 1.0)
    if not (last and is_rotation(bTc) and first_bad_axes(axes)[0] < 0 and first_bad_chart(charts) < 0):
        return none
    W = np.empty(S.shape)
    if whiten_all(S, W)[0] != SOUND:
        return none
    total = sum_of_squares(W.reshape(-1)) + sum_of_squares(S.reshape(-1)) + sum_of_squares(bTc.reshape(-1))
    total += sum_of_squares(centres.reshape(-1)) + sum_of_squares(axes.reshape(-1))
    return pack(bTc, centres, axes, charts, W, kind, scale) if np.isfinite(total) else none


@njit(cache=True, error_model="numpy", fastmath=_FUSED)
def shape_residuals(gTb: FloatArray, data: FloatArray, linearise: bool, out: FloatArray) -> float:
    """Conic shape: zero when every predicted rim has the measured chart.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    data : ndarray, shape (n_data,)
        From `pack`.
    linearise : bool
        Whether the Jacobian is written.
    out : ndarray, shape (7, 5 n)
        Written: the Jacobian's columns for the body's right twist [w, rho], then the residual.

    Returns
    -------
    float
        A sum that is finite only where all that was written is. `validity` says what is written for a crater
        that the pose cannot see.
    """
    total = _rows_of_camera(gTb, data, linearise, out, np.empty(_WORK))
    return total + _of_body(data, out, out.shape[1]) if linearise else total


@njit(cache=True, error_model="numpy", fastmath=_FUSED)
def reduced_shape_residuals(gTb: FloatArray, data: FloatArray, linearise: bool, out: FloatArray) -> float:
    """Conic shape of a frame in seven rows that its 5 n were turned into: J' J, J' e and e' e are the same.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    data : ndarray, shape (n_data,)
        From `pack`, with n > 1.
    linearise : bool
        Whether the Jacobian is written.
    out : ndarray, shape (7, 7)
        Written as by `shape_residuals`; the last row's Jacobian is zero. Without a Jacobian, the norm of the
        residual stands for it, in the last row.

    Returns
    -------
    float
        A sum that is finite only where all that was written is.
    """
    m = 5 * ((data.shape[0] - HEADER) // CRATER)
    # One array: making one costs a tenth of a crater's residual.
    memory = np.empty(_WORK + 7 * m)
    rows = memory[_WORK:].reshape(7, m)
    total = _rows_of_camera(gTb, data, linearise, rows, memory)
    if linearise:
        triangularise(rows, out)
        return total + _of_body(data, out, 6)
    out[:] = 0.0
    e2 = 0.0
    for i in range(rows.shape[1]):
        e2 += rows[6, i] * rows[6, i]
    out[6, 6] = np.sqrt(e2)
    return total


@njit(cache=True, error_model="numpy")
def all_reduced_shape_residuals(
    poses: FloatArray, rows: IntArray, data: FloatArray, offsets: IntArray, linearise: bool, out: FloatArray
) -> int:
    """Conic shape of many frames, each as by `reduced_shape_residuals`.

    Parameters
    ----------
    poses : ndarray, shape (m, 12)
        Poses gTb: the rotation's rows, then the position in g, m.
    rows : ndarray of int, shape (n,)
        Row of each frame's pose.
    data : ndarray, shape (n_data,)
        From `pack`, of one frame after the other.
    offsets : ndarray of int, shape (n + 1,)
        Where each frame's begins, and the end.
    linearise : bool
        Whether Jacobians are written.
    out : ndarray, shape (n, 7, 7)
        Written.

    Returns
    -------
    int
        The first frame of which something is not finite, or -1.
    """
    # Column-major as GTSAM's matrices are: the kernels below are compiled for each order.
    gTb = np.zeros((4, 4)).T
    gTb[3, 3] = 1.0
    for k in range(len(rows)):
        for i in range(3):
            for j in range(3):
                gTb[i, j] = poses[rows[k], 3 * i + j]
            gTb[i, 3] = poses[rows[k], 9 + i]
        if not np.isfinite(
            reduced_shape_residuals(gTb, data[offsets[k] : offsets[k + 1]], linearise, out[k])
        ):
            return k
    return -1


@njit(cache=True, error_model="numpy", fastmath=_FUSED)
def _rows_of_camera(
    gTb: FloatArray, data: FloatArray, linearise: bool, out: FloatArray, work: FloatArray
) -> float:
    """Write residuals, and the Jacobian's columns for the twist of the camera; see `shape_residuals`."""
    B = data[:12]
    R, P, G = work[:9], work[9:12], work[12:_WORK].reshape(5, 6)
    for i in range(3):
        for j in range(3):
            R[3 * j + i] = gTb[i, 0] * B[j] + gTb[i, 1] * B[4 + j] + gTb[i, 2] * B[8 + j]
        P[i] = gTb[i, 0] * B[3] + gTb[i, 1] * B[7] + gTb[i, 2] * B[11] + gTb[i, 3]
    kind = int(data[12])
    scale = data[13]
    total = 0.0
    for crater in range((data.shape[0] - HEADER) // CRATER):
        k = HEADER + CRATER * crater
        row = 5 * crater
        dx, dy, dz = data[k] - P[0], data[k + 1] - P[1], data[k + 2] - P[2]
        px = R[0] * dx + R[1] * dy + R[2] * dz
        py = R[3] * dx + R[4] * dy + R[5] * dz
        pz = R[6] * dx + R[7] * dy + R[8] * dz
        ax = R[0] * data[k + 3] + R[1] * data[k + 4] + R[2] * data[k + 5]
        ay = R[3] * data[k + 3] + R[4] * data[k + 4] + R[5] * data[k + 5]
        az = R[6] * data[k + 3] + R[7] * data[k + 4] + R[8] * data[k + 5]
        bx = R[0] * data[k + 6] + R[1] * data[k + 7] + R[2] * data[k + 8]
        by = R[3] * data[k + 6] + R[4] * data[k + 7] + R[5] * data[k + 8]
        bz = R[6] * data[k + 6] + R[7] * data[k + 7] + R[8] * data[k + 8]
        visible, mx, my, sxx, sxy, s = moments(px, py, pz, ax, ay, az, bx, by, bz)
        if not visible:
            loss, weight = loss_and_weight(5.0 * UNSEEN * UNSEEN, kind, scale)
            factor = np.sqrt(weight) if linearise else np.sqrt(loss / 5.0) / UNSEEN
            for r in range(5):
                out[6, row + r] = factor * UNSEEN
                for j in range(6):
                    out[j, row + r] = 0.0
            continue
        y0 = mx - data[k + 9]
        y1 = my - data[k + 10]
        y2 = 0.5 * np.log(sxx) - data[k + 11]
        y3 = sxy / sxx - data[k + 12]
        y4 = 0.5 * np.log(s) - data[k + 13]
        w = k + 14
        e0 = data[w] * y0
        e1 = data[w + 1] * y0 + data[w + 2] * y1
        e2 = data[w + 3] * y0 + data[w + 4] * y1 + data[w + 5] * y2
        e3 = data[w + 6] * y0 + data[w + 7] * y1 + data[w + 8] * y2 + data[w + 9] * y3
        e4 = data[w + 10] * y0 + data[w + 11] * y1 + data[w + 12] * y2 + data[w + 13] * y3 + data[w + 14] * y4
        d2 = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3 + e4 * e4
        total += d2
        loss, weight = loss_and_weight(d2, kind, scale)
        factor = np.sqrt(weight) if linearise or d2 == 0.0 else np.sqrt(loss / d2)
        out[6, row] = factor * e0
        out[6, row + 1] = factor * e1
        out[6, row + 2] = factor * e2
        out[6, row + 3] = factor * e3
        out[6, row + 4] = factor * e4
        if not linearise:
            continue
        i33 = 1.0 / (az * az + bz * bz - pz * pz)
        chart_slopes(mx, my, sxx, sxy, s, px * i33, py * i33, pz * i33, G)
        for j in range(6):
            g0, g1, g2, g3, g4 = (
                factor * G[0, j],
                factor * G[1, j],
                factor * G[2, j],
                factor * G[3, j],
                factor * G[4, j],
            )
            column = out[j]
            column[row] = data[w] * g0
            column[row + 1] = data[w + 1] * g0 + data[w + 2] * g1
            column[row + 2] = data[w + 3] * g0 + data[w + 4] * g1 + data[w + 5] * g2
            column[row + 3] = data[w + 6] * g0 + data[w + 7] * g1 + data[w + 8] * g2 + data[w + 9] * g3
            column[row + 4] = (
                data[w + 10] * g0 + data[w + 11] * g1 + data[w + 12] * g2
                + data[w + 13] * g3 + data[w + 14] * g4
            )  # fmt: skip
    return total


@njit(cache=True, error_model="numpy", fastmath=_FUSED)
def triangularise(columns: FloatArray, R: FloatArray) -> None:
    """Turn the rows of a matrix so that it becomes upper triangular, by Householder's reflections.

    Reflections keep lengths and angles: nothing is squared, however unequal the columns' units are.

    Parameters
    ----------
    columns : ndarray, shape (k, m)
        Columns of the matrix (m, k), m >= k, in any units; overwritten.
    R : ndarray, shape (k, k)
        Written: columns of the upper triangular matrix. The last diagonal entry is not negative.
    """
    k, m = columns.shape
    R[:] = 0.0
    for c in range(k):
        v = columns[c]
        squared = 0.0
        # Rows above the diagonal are zero by then; loops of one length are the fastest.
        for i in range(m):
            squared += v[i] * v[i]
        length, first = np.sqrt(squared), v[c]
        R[c, c] = length
        if c == k - 1 or squared == 0.0:
            continue
        v[c] = first + length if first > 0.0 else first - length
        R[c, c] = first - v[c]
        scale = 1.0 / (length * abs(v[c]))
        for j in range(c + 1, k):
            w = columns[j]
            product = 0.0
            for i in range(m):
                product += v[i] * w[i]
            product *= scale
            for i in range(m):
                w[i] -= product * v[i]
            R[j, c] = w[c]
            w[c] = 0.0


@njit(cache=True, error_model="numpy", fastmath=_FUSED)
def _of_body(data: FloatArray, out: FloatArray, rows: int) -> float:
    """Turn a Jacobian for the camera's twist into one for the body's, as `conic.body_columns`; sum of it."""
    B = data[:12]
    total = 0.0
    for r in range(rows):
        c3, c4, c5 = out[3, r], out[4, r], out[5, r]
        r0 = c3 * B[0] + c4 * B[1] + c5 * B[2]
        r1 = c3 * B[4] + c4 * B[5] + c5 * B[6]
        r2 = c3 * B[8] + c4 * B[9] + c5 * B[10]
        c0, c1, c2 = out[0, r], out[1, r], out[2, r]
        w0 = c0 * B[0] + c1 * B[1] + c2 * B[2] + B[7] * r2 - B[11] * r1
        w1 = c0 * B[4] + c1 * B[5] + c2 * B[6] + B[11] * r0 - B[3] * r2
        w2 = c0 * B[8] + c1 * B[9] + c2 * B[10] + B[3] * r1 - B[7] * r0
        out[0, r], out[1, r], out[2, r] = w0, w1, w2
        out[3, r], out[4, r], out[5, r] = r0, r1, r2
        total += w0 + w1 + w2 + r0 + r1 + r2
    return total
