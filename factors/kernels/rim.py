"""Distances of edge points from the predicted rim.

The distance is Sampson's, to first order in the level function f = sqrt((u - m)' S^-1 (u - m)) - 1:
d = f / |grad f|, positive outside. The conic's own level function f^2 + 2 f would give a distance that falls
short by d^2 / 2R and shrinks small rims; this one is exact for circles, and is the distance that ellipses are
fitted with.
"""

import numpy as np

from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit
from factors.kernels.conic import body_columns, camera_pose, chart, chart_and_jacobian, rim_in_camera
from factors.kernels.robust import apply_loss
from factors.kernels.validity import unseen

# Radius, in units of the rim's, within which a point counts as its centre, where the distance has no
# derivative.
_CENTRE = 1e-9


@njit(cache=True, error_model="numpy")
def rim_distance(u: float, v: float, y: FloatArray, D: FloatArray) -> float:
    """Distance of a point from an ellipse.

    Parameters
    ----------
    u, v : float
        The point, in the chart's coordinates.
    y : ndarray, shape (5,)
        Ellipse chart.
    D : ndarray, shape (5,)
        Written: derivatives of the distance in the chart.

    Returns
    -------
    float
        Positive outside, in the unit of the coordinates.
    """
    ea, es, beta = np.exp(y[2]), np.exp(y[4]), y[3]
    x = u - y[0]
    # The point in the ellipse's own coordinates: S = L L', L = [[ea, 0], [beta ea, es]].
    s = x / ea
    t = (v - y[1] - beta * x) / es
    r = np.sqrt(s * s + t * t)
    if not r > _CENTRE:
        D[:] = 0.0
        return -np.sqrt(ea * es)
    # (a, b) = S^-1 (u - m), of length r |grad f|.
    b = t / es
    a = s / ea - beta * b
    g = np.sqrt(a * a + b * b)
    d = (r - 1.0) * r / g
    for k in range(5):
        ds, dt, db, da = 0.0, 0.0, 0.0, 0.0
        if k == 0:
            ds, dt = -1.0 / ea, beta / es
        elif k == 1:
            dt = -1.0 / es
        elif k == 2:
            ds = -s
            da = -s / ea
        elif k == 3:
            dt = -x / es
            da = -b
        else:
            dt = -t
            db = -b
        db += dt / es
        da += ds / ea - beta * db
        dr = (s * ds + t * dt) / r
        D[k] = ((2.0 * r - 1.0) * dr - d * (a * da + b * db) / g) / g
    return d


@njit(cache=True, error_model="numpy")
def rim_residuals(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray, offsets: IntArray,
    points: FloatArray, sigmas: FloatArray, roots: FloatArray, z: FloatArray, kind: int, scale: float,
    linearise: bool, e: FloatArray, J: FloatArray,
) -> None:  # fmt: skip
    """Rim points: zero when every edge point lies on its predicted rim, moved by an error that rims share.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres, axes : ndarray, shape (n, 3), (n, 2, 3)
        Rims in g, m.
    offsets : ndarray of int, shape (n + 1,)
        Points offsets[i] to offsets[i + 1] are those of rim i.
    points, sigmas : ndarray, shape (m, 2), (m,)
        Normalised, with standard deviations along the rim's normal.
    roots : ndarray, shape (n, 5, k)
        The error adds roots z to the predicted charts.
    z : ndarray, shape (k,)
        The error, in the units of its roots; none with k = 0.
    kind, scale : int, float
        Loss, see `robust`: on the norm of a rim's residuals; `scale` refers to their root mean square.
    linearise : bool
        Whether J is written.
    e, J : ndarray, shape (m,), (m, 6 + k)
        Written; J for the body's right twist [w, rho], then for z.
    """
    R, P = camera_pose(gTb, bTc)
    p = np.empty(3)
    c = np.empty((2, 3))
    y = np.empty(5)
    D = np.empty(5)
    Jc = np.empty((5, 6))
    slopes = np.empty((5, J.shape[1]))
    Jb = slopes[:, :6]
    for i in range(centres.shape[0]):
        begin, end = offsets[i], offsets[i + 1]
        ei, Ji = e[begin:end], J[begin:end]
        # Of n residuals of one sigma the norm is sqrt(n).
        rim_scale = scale * np.sqrt(float(end - begin))
        rim_in_camera(R, P, centres[i], axes[i], p, c)
        seen = chart_and_jacobian(p, c, y, Jc) if linearise else chart(p, c, y)
        if not seen:
            unseen(ei, Ji, kind, rim_scale, linearise)
            continue
        if linearise:
            body_columns(Jc, bTc, Jb)
        for k in range(5):
            for j in range(len(z)):
                y[k] += roots[i, k, j] * z[j]
                slopes[k, 6 + j] = roots[i, k, j]
        for k in range(begin, end):
            weight = 1.0 / sigmas[k]
            e[k] = weight * rim_distance(points[k, 0], points[k, 1], y, D)
            if linearise:
                for j in range(J.shape[1]):
                    total = 0.0
                    for m in range(5):
                        total += D[m] * slopes[m, j]
                    J[k, j] = weight * total
        apply_loss(ei, Ji, kind, rim_scale, linearise)
