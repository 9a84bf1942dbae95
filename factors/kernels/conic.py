"""Image of a rim: dual conic, ellipse chart, conic coefficients.

A rim is given in the camera frame by p (its centre), c1 = a l1 and c2 = b l2 (its semi-axes). Its dual
conic in normalised coordinates is Q* = c1 c1' + c2 c2' - p p'. The chart of an image ellipse
(u - m)' S^-1 (u - m) = 1 is

    y = [m_x, m_y, ln(S_xx)/2, S_xy/S_xx, ln(S_yy - S_xy^2/S_xx)/2],

a global, singularity-free parametrisation of all ellipses.
"""

import numpy as np

from factors.arrays import BoolArray, FloatArray
from factors.kernels.compiled import njit


@njit(cache=True, error_model="numpy")
def camera_pose(gTb: FloatArray, bTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pose of the camera from that of the body.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.

    Returns
    -------
    gRc : ndarray, shape (3, 3)
        Rotation of the camera.
    gPc : ndarray, shape (3,)
        Its position in g, m.
    """
    R = np.empty((3, 3))
    P = np.empty(3)
    for i in range(3):
        for j in range(3):
            R[i, j] = gTb[i, 0] * bTc[0, j] + gTb[i, 1] * bTc[1, j] + gTb[i, 2] * bTc[2, j]
        P[i] = gTb[i, 0] * bTc[0, 3] + gTb[i, 1] * bTc[1, 3] + gTb[i, 2] * bTc[2, 3] + gTb[i, 3]
    return R, P


@njit(cache=True, error_model="numpy")
def body_columns(J: FloatArray, bTc: FloatArray, out: FloatArray) -> None:
    """Turn a Jacobian for the camera's twist [w, rho] into one for the body's: J Ad(bTc^-1).

    Both twists perturb from the right, in GTSAM's order: R exp(w), t + R rho.

    Parameters
    ----------
    J : ndarray, shape (m, 6)
        Derivatives in the camera's twist, rad and m.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    out : ndarray, shape (m, 6)
        Written: derivatives in the body's twist. Another array than J.
    """
    for r in range(J.shape[0]):
        for j in range(3):
            w = 0.0
            rho = 0.0
            for i in range(3):
                w += J[r, i] * bTc[j, i]
                rho += J[r, 3 + i] * bTc[j, i]
            out[r, j] = w
            out[r, 3 + j] = rho
        # The camera's lever arm: rho_c = bRc' (rho_b + w_b x bPc).
        tx, ty, tz = bTc[0, 3], bTc[1, 3], bTc[2, 3]
        out[r, 0] += ty * out[r, 5] - tz * out[r, 4]
        out[r, 1] += tz * out[r, 3] - tx * out[r, 5]
        out[r, 2] += tx * out[r, 4] - ty * out[r, 3]


@njit(cache=True, error_model="numpy")
def rim_in_camera(
    R: FloatArray, P: FloatArray, centre: FloatArray, axes: FloatArray, p: FloatArray, c: FloatArray
) -> None:
    """Turn a rim into the camera's frame.

    Parameters
    ----------
    R : ndarray, shape (3, 3)
        gRc, rotation of the camera.
    P : ndarray, shape (3,)
        gPc, position of the camera, m.
    centre : ndarray, shape (3,)
        Rim centre in g, m.
    axes : ndarray, shape (2, 3)
        Semi-axes a l1 and b l2 in g, m.
    p : ndarray, shape (3,)
        Written: the centre in c, m.
    c : ndarray, shape (2, 3)
        Written: the semi-axes in c, m.
    """
    for i in range(3):
        p[i] = R[0, i] * (centre[0] - P[0]) + R[1, i] * (centre[1] - P[1]) + R[2, i] * (centre[2] - P[2])
        for k in range(2):
            c[k, i] = R[0, i] * axes[k, 0] + R[1, i] * axes[k, 1] + R[2, i] * axes[k, 2]


@njit(cache=True, error_model="numpy")
def moments(
    px: float, py: float, pz: float, ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[bool, float, float, float, float, float]:
    """Image ellipse of a rim, in scalars: for kernels that have no time for arrays.

    Parameters
    ----------
    px, py, pz : float
        Rim centre in c, m.
    ax, ay, az, bx, by, bz : float
        Semi-axes a l1 and b l2 in c, m.

    Returns
    -------
    visible : bool
        In front of the camera, wholly so (Q*_33 < 0), and seen from above (p.n < 0). Not: within the image.
    m_x, m_y : float
        Centre of the image ellipse, normalised.
    S_xx, S_xy, s : float
        Entries of its matrix S, with s = S_yy - S_xy^2/S_xx. All five are 0 where not visible.
    """
    q33 = az * az + bz * bz - pz * pz
    facing = px * (ay * bz - az * by) + py * (az * bx - ax * bz) + pz * (ax * by - ay * bx)
    # The negated form is also False for NaN.
    if not (pz > 0.0 and q33 < 0.0 and facing < 0.0):
        return False, 0.0, 0.0, 0.0, 0.0, 0.0
    i33 = 1.0 / q33
    mx = (ax * az + bx * bz - px * pz) * i33
    my = (ay * az + by * bz - py * pz) * i33
    sxx = mx * mx - (ax * ax + bx * bx - px * px) * i33
    sxy = mx * my - (ax * ay + bx * by - px * py) * i33
    syy = my * my - (ay * ay + by * by - py * py) * i33
    s = syy - sxy * sxy / sxx
    return sxx > 0.0 and s > 0.0, mx, my, sxx, sxy, s


@njit(cache=True, error_model="numpy")
def chart_slopes(
    mx: float, my: float, sxx: float, sxy: float, s: float, ux: float, uy: float, uz: float, J: FloatArray
) -> None:
    """Write the chart's Jacobian for the camera's right twist.

    With N = Q*/Q*_33 a turn gives dN = N [w]x - [w]x N and a shift dN = rho u' + u rho', minus N times its
    own last element.

    Parameters
    ----------
    mx, my, sxx, sxy, s : float
        From `moments`.
    ux, uy, uz : float
        p/Q*_33 in c, 1/m.
    J : ndarray, shape (5, 6)
        Written: derivatives of the chart in the camera's twist [w, rho], rad and m.
    """
    beta = sxy / sxx
    syy = s + beta * sxy
    xx, xy, yy = mx * mx + sxx, mx * my + sxy, my * my + syy
    J[0, 0], J[0, 1], J[0, 2] = xy, -1.0 - xx, my
    J[0, 3], J[0, 4], J[0, 5] = uz, 0.0, ux - 2.0 * mx * uz
    J[1, 0], J[1, 1], J[1, 2] = 1.0 + yy, -xy, -mx
    J[1, 3], J[1, 4], J[1, 5] = 0.0, uz, uy - 2.0 * my * uz
    # First of S_xx, S_xy, S_yy; then the chart's last three rows of these.
    J[2, 0], J[2, 1], J[2, 2] = 2.0 * (mx * sxy + my * sxx), -4.0 * mx * sxx, 2.0 * sxy
    J[2, 3], J[2, 4], J[2, 5] = 2.0 * (mx * uz - ux), 0.0, 2.0 * (mx * ux - xx * uz)
    J[3, 0], J[3, 1], J[3, 2] = mx * syy + 3.0 * my * sxy, -my * sxx - 3.0 * mx * sxy, syy - sxx
    J[3, 3], J[3, 4], J[3, 5] = my * uz - uy, mx * uz - ux, mx * uy + my * ux - 2.0 * xy * uz
    J[4, 0], J[4, 1], J[4, 2] = 4.0 * my * syy, -2.0 * (my * sxy + mx * syy), -2.0 * sxy
    J[4, 3], J[4, 4], J[4, 5] = 0.0, 2.0 * (my * uz - uy), 2.0 * (my * uy - yy * uz)
    ixx, half = 1.0 / sxx, 0.5 / s
    for j in range(6):
        dxx, dxy, dyy = J[2, j], J[3, j], J[4, j]
        J[2, j] = 0.5 * ixx * dxx
        J[3, j] = ixx * (dxy - beta * dxx)
        J[4, j] = half * (dyy + beta * (beta * dxx - 2.0 * dxy))


@njit(cache=True, error_model="numpy")
def chart(p: FloatArray, c: FloatArray, y: FloatArray) -> bool:
    """Write the chart of a rim's image.

    Parameters
    ----------
    p : ndarray, shape (3,)
        Rim centre in c, m.
    c : ndarray, shape (2, 3)
        Semi-axes in c, m.
    y : ndarray, shape (5,)
        Written: the chart, normalised. Untouched where the image is no visible ellipse.

    Returns
    -------
    bool
        Whether it is, see `moments`.
    """
    visible, mx, my, sxx, sxy, s = moments(
        p[0], p[1], p[2], c[0, 0], c[0, 1], c[0, 2], c[1, 0], c[1, 1], c[1, 2]
    )
    if visible:
        y[0], y[1], y[2], y[3], y[4] = mx, my, 0.5 * np.log(sxx), sxy / sxx, 0.5 * np.log(s)
    return visible


@njit(cache=True, error_model="numpy")
def chart_and_jacobian(p: FloatArray, c: FloatArray, y: FloatArray, J: FloatArray) -> bool:
    """Write the chart of a rim's image and its Jacobian.

    Parameters
    ----------
    p : ndarray, shape (3,)
        Rim centre in c, m.
    c : ndarray, shape (2, 3)
        Semi-axes in c, m.
    y : ndarray, shape (5,)
        Written: the chart, normalised. Untouched where the image is no visible ellipse.
    J : ndarray, shape (5, 6)
        Written: derivatives in the camera's right twist [w, rho], rad and m. Untouched likewise.

    Returns
    -------
    bool
        Whether the image is a visible ellipse, see `moments`.
    """
    visible, mx, my, sxx, sxy, s = moments(
        p[0], p[1], p[2], c[0, 0], c[0, 1], c[0, 2], c[1, 0], c[1, 1], c[1, 2]
    )
    if visible:
        y[0], y[1], y[2], y[3], y[4] = mx, my, 0.5 * np.log(sxx), sxy / sxx, 0.5 * np.log(s)
        i33 = 1.0 / (c[0, 2] * c[0, 2] + c[1, 2] * c[1, 2] - p[2] * p[2])
        chart_slopes(mx, my, sxx, sxy, s, p[0] * i33, p[1] * i33, p[2] * i33, J)
    return visible


@njit(cache=True, error_model="numpy")
def project_rims(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Project rims into the image of a camera.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres : ndarray, shape (n, 3)
        Rim centres in g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes a l1 and b l2 in g, m; n = l1 x l2 is outward.

    Returns
    -------
    charts : ndarray, shape (n, 5)
        Ellipse charts, normalised; NaN where not visible.
    visible : ndarray of bool, shape (n,)
        In front of the camera, wholly so, and seen from above. Not: within the image.
    """
    n = centres.shape[0]
    R, P = camera_pose(gTb, bTc)
    out = np.full((n, 5), np.nan)
    visible = np.zeros(n, dtype=np.bool_)
    p = np.empty(3)
    c = np.empty((2, 3))
    for i in range(n):
        rim_in_camera(R, P, centres[i], axes[i], p, c)
        visible[i] = chart(p, c, out[i])
    return out, visible


@njit(cache=True, error_model="numpy")
def chart_jacobian(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Project rims into the image of a camera, with derivatives in the body's pose.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres : ndarray, shape (n, 3)
        Rim centres in g, m.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes a l1 and b l2 in g, m; n = l1 x l2 is outward.

    Returns
    -------
    charts : ndarray, shape (n, 5)
        Ellipse charts, normalised; NaN where not visible.
    jacobians : ndarray, shape (n, 5, 6)
        Derivatives in the body's right twist [w, rho], rad and m; zero where not visible.
    visible : ndarray of bool, shape (n,)
        As `project_rims` gives it.
    """
    n = centres.shape[0]
    R, P = camera_pose(gTb, bTc)
    out = np.full((n, 5), np.nan)
    jac = np.zeros((n, 5, 6))
    visible = np.zeros(n, dtype=np.bool_)
    p = np.empty(3)
    c = np.empty((2, 3))
    J = np.empty((5, 6))
    for i in range(n):
        rim_in_camera(R, P, centres[i], axes[i], p, c)
        visible[i] = chart_and_jacobian(p, c, out[i], J)
        if visible[i]:
            body_columns(J, bTc, jac[i])
    return out, jac, visible


@njit(cache=True, error_model="numpy")
def chart_to_conic(y: FloatArray) -> FloatArray:
    """Conic of an ellipse, of unit norm: eq. (3).

    Parameters
    ----------
    y : ndarray, shape (5,)
        Ellipse chart.

    Returns
    -------
    ndarray, shape (6,)
        Coefficients (A, B, C, D, E, F), |q| = 1, in the units of the chart; negative inside the ellipse.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (3); docs/equations.md.
    """
    a = np.exp(2.0 * y[2])
    s = np.exp(2.0 * y[4])
    beta = y[3]
    # S^-1 for S = [[a, a beta], [a beta, s + a beta^2]]
    ixx = 1.0 / a + beta * beta / s
    ixy = -beta / s
    iyy = 1.0 / s
    q = np.empty(6)
    q[0] = ixx
    q[1] = 2.0 * ixy
    q[2] = iyy
    q[3] = -2.0 * (ixx * y[0] + ixy * y[1])
    q[4] = -2.0 * (ixy * y[0] + iyy * y[1])
    q[5] = ixx * y[0] * y[0] + 2.0 * ixy * y[0] * y[1] + iyy * y[1] * y[1] - 1.0
    norm = 0.0
    for i in range(6):
        norm += q[i] * q[i]
    return q / np.sqrt(norm)


@njit(cache=True, error_model="numpy")
def chart_to_conic_jacobian(y: FloatArray) -> FloatArray:
    """Jacobian of `chart_to_conic`.

    Parameters
    ----------
    y : ndarray, shape (5,)
        Ellipse chart.

    Returns
    -------
    ndarray, shape (6, 5)
        Derivatives of the unit-norm conic in the chart. Its columns are orthogonal to the conic.
    """
    a = np.exp(2.0 * y[2])
    s = np.exp(2.0 * y[4])
    beta, mx, my = y[3], y[0], y[1]
    ixx = 1.0 / a + beta * beta / s
    ixy = -beta / s
    iyy = 1.0 / s
    # Derivatives of (ixx, ixy, iyy) in y[2], y[3], y[4].
    dxx = np.array([-2.0 / a, 2.0 * beta / s, -2.0 * beta * beta / s])
    dxy = np.array([0.0, -1.0 / s, 2.0 * beta / s])
    dyy = np.array([0.0, 0.0, -2.0 / s])
    J = np.zeros((6, 5))
    J[3, 0] = -2.0 * ixx
    J[3, 1] = -2.0 * ixy
    J[4, 0] = -2.0 * ixy
    J[4, 1] = -2.0 * iyy
    J[5, 0] = 2.0 * (ixx * mx + ixy * my)
    J[5, 1] = 2.0 * (ixy * mx + iyy * my)
    for k in range(3):
        J[0, 2 + k] = dxx[k]
        J[1, 2 + k] = 2.0 * dxy[k]
        J[2, 2 + k] = dyy[k]
        J[3, 2 + k] = -2.0 * (dxx[k] * mx + dxy[k] * my)
        J[4, 2 + k] = -2.0 * (dxy[k] * mx + dyy[k] * my)
        J[5, 2 + k] = dxx[k] * mx * mx + 2.0 * dxy[k] * mx * my + dyy[k] * my * my
    q = np.empty(6)
    q[0] = ixx
    q[1] = 2.0 * ixy
    q[2] = iyy
    q[3] = -2.0 * (ixx * mx + ixy * my)
    q[4] = -2.0 * (ixy * mx + iyy * my)
    q[5] = ixx * mx * mx + 2.0 * ixy * mx * my + iyy * my * my - 1.0
    norm = np.sqrt(np.sum(q * q))
    u = q / norm
    # Written out: numba takes seconds to compile an outer product.
    for k in range(5):
        along = 0.0
        for i in range(6):
            along += u[i] * J[i, k]
        for i in range(6):
            J[i, k] = (J[i, k] - along * u[i]) / norm
    return J
