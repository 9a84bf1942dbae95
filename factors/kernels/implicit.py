"""Conic-shape residual of eq. (19), whitened by its own covariance J_q S_q J_q' at every pose.

With D = J_q(pose), h = D q (eq. (19) is linear in q), S_q = A S_y A' and A = dq/dy of the unit-norm conic,
the covariance is D A S_y A' D', and (D A L)^-1, with S_y = L L', whitens h. D vanishes on the predicted conic
p alone, and q' A = 0; so D A z = D q has the solution

    z = -A+ p / (q.p),    A+ = (A' A)^-1 A',    e = -L^-1 z

(the sign is that of predicted minus measured): the predicted conic against the measured one, projected from
the origin onto the plane that touches the unit sphere at q. No step is an approximation: |e|^2 =
h' (D S_q D')^-1 h at every pose where p is an ellipse, and the noise L is constant. The derivative in the
pose is that of p alone. Formed as printed, D S_q D' has a condition number of up to 2e14.
"""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import (
    body_columns,
    camera_pose,
    chart,
    chart_and_jacobian,
    chart_to_conic,
    chart_to_conic_jacobian,
    rim_in_camera,
)
from factors.kernels.robust import apply_loss
from factors.kernels.validity import unseen

# Cosine of the largest angle between the measured and the predicted conic, as vectors of R^6: 84 deg, near
# the residual's pole at 90 deg.
LEAST_COSINE = 0.1


@njit(cache=True, error_model="numpy")
def implicit_residuals(
    gTb: FloatArray, bTc: FloatArray, centres: FloatArray, axes: FloatArray, conics: FloatArray,
    projections: FloatArray, kind: int, scale: float, linearise: bool, e: FloatArray, J: FloatArray,
) -> None:  # fmt: skip
    """Whitened eq. (19): zero when every measured conic is the image of its rim.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    centres, axes : ndarray, shape (n, 3), (n, 2, 3)
        Rims in g, m.
    conics : ndarray, shape (n, 6)
        Measured conics, as `chart_to_conic` gives them.
    projections : ndarray, shape (n, m, 6)
        P = L^-1 A+ of every rim, which whitens its conic, see above; or m combinations of its
        five rows.
    kind, scale : int, float
        Loss, see `robust`.
    linearise : bool
        Whether J is written.
    e, J : ndarray, shape (rows,), (rows, 6)
        Written, m rows for each rim; J for the body's right twist [w, rho].

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (19); docs/equations.md.
    """
    R, P = camera_pose(gTb, bTc)
    p = np.empty(3)
    c = np.empty((2, 3))
    y = np.empty(5)
    Jy = np.empty((5, 6))
    rows = projections.shape[1]
    Jc = np.empty((rows, 6))
    for i in range(centres.shape[0]):
        rim_in_camera(R, P, centres[i], axes[i], p, c)
        seen = chart_and_jacobian(p, c, y, Jy) if linearise else chart(p, c, y)
        ei, Ji = e[rows * i : rows * (i + 1)], J[rows * i : rows * (i + 1)]
        dot = 0.0
        if seen:
            q = chart_to_conic(y)
            for k in range(6):
                dot += conics[i, k] * q[k]
        if not dot > LEAST_COSINE:
            unseen(ei, Ji, kind, scale, linearise)
            continue
        for r in range(rows):
            ei[r] = 0.0
            for k in range(6):
                # Subtracting the measured conic, which P maps to 0, keeps the digits of a small residual.
                ei[r] += projections[i, r, k] * (q[k] / dot - conics[i, k])
        if linearise:
            A = chart_to_conic_jacobian(y)
            for m in range(5):
                along = 0.0
                for k in range(6):
                    along += conics[i, k] * A[k, m]
                for k in range(6):
                    A[k, m] = (A[k, m] - q[k] * along / dot) / dot
            for r in range(rows):
                for d in range(6):
                    Jc[r, d] = 0.0
                for m in range(5):
                    slope = 0.0
                    for k in range(6):
                        slope += projections[i, r, k] * A[k, m]
                    for d in range(6):
                        Jc[r, d] += slope * Jy[m, d]
            body_columns(Jc, bTc, Ji)
        apply_loss(ei, Ji, kind, scale, linearise)
