"""Tilt of the sun in the image, eq. (24), in its perspective form."""

import numpy as np

from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import body_columns, camera_pose

# Length of the image direction (of a unit vector) below which the tilt is undefined: within 3 deg of the line
# of sight, where an attitude error of a degree turns it by tens of degrees.
FLOOR = 0.05


@njit(cache=True, error_model="numpy")
def sun_tilt(
    gTb: FloatArray, bTc: FloatArray, direction: FloatArray, u: float, v: float, J: FloatArray
) -> tuple[float, float]:
    """Predicted tilt of a direction at an image point, and its Jacobian.

    theta = atan2(s_y - v s_z, s_x - u s_z), s = gRc' direction. With u = v = 0 and the direction towards the
    sun this is eq. (24) as printed, with atan2 for atan. With the direction's part along the ground it is the
    tilt that brightness shows.

    Parameters
    ----------
    gTb, bTc : ndarray, shape (4, 4)
        Pose of the body in g, mounting of the camera.
    direction : ndarray, shape (3,)
        In g; its length does not matter.
    u, v : float
        Normalised image coordinates.
    J : ndarray, shape (1, 6)
        Written: derivative for the body's right twist [w, rho].

    Returns
    -------
    tilt_rad : float
    strength : float
        Length of the image direction (s_x - u s_z, s_y - v s_z) for a unit direction: 0 when the direction
        points along the line of sight, where the tilt is undefined; J is then zero.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (24); docs/equations.md.
    """
    R, _ = camera_pose(gTb, bTc)
    norm = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    s = np.empty(3)
    for i in range(3):
        s[i] = (R[0, i] * direction[0] + R[1, i] * direction[1] + R[2, i] * direction[2]) / norm
    x = s[0] - u * s[2]
    y = s[1] - v * s[2]
    r2 = x * x + y * y
    J[:] = 0.0
    if not r2 > FLOOR * FLOOR:
        return 0.0, 0.0
    # d s = [s]x w
    Jc = np.zeros((1, 6))
    g0, g1, g2 = -y / r2, x / r2, (y * u - x * v) / r2
    Jc[0, 0] = g1 * s[2] - g2 * s[1]
    Jc[0, 1] = g2 * s[0] - g0 * s[2]
    Jc[0, 2] = g0 * s[1] - g1 * s[0]
    body_columns(Jc, bTc, J)
    return np.arctan2(y, x), np.sqrt(r2)


@njit(cache=True, error_model="numpy")
def wrap(angle_rad: float) -> float:
    """Wrap an angle into (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle_rad, 2.0 * np.pi)


@njit(cache=True, error_model="numpy")
def tilt_residual(gTb: FloatArray, data: FloatArray, linearise: bool, out: FloatArray) -> float:
    """Sun tilt: zero when the predicted tilt is the measured one; in units of its sigma.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g.
    data : ndarray, shape (23,)
        Mounting bTc row by row, direction in g, image point (normalised), tilt and its sigma (rad).
    linearise : bool
        Whether the Jacobian is written.
    out : ndarray, shape (7, 1)
        Written: the Jacobian's columns for the body's right twist [w, rho], then the residual. Where the tilt
        is undefined the residual is the largest there is, and has no slope.

    Returns
    -------
    float
        A sum that is finite only where all that was written is.
    """
    J = np.empty((1, 6))
    predicted, strength = sun_tilt(gTb, data[:16].reshape(4, 4), data[16:19], data[19], data[20], J)
    sigma_rad = data[22]
    e = (wrap(predicted - data[21]) if strength > 0.0 else np.pi) / sigma_rad
    out[6, 0] = e
    total = e * e
    if linearise:
        for j in range(6):
            out[j, 0] = J[0, j] / sigma_rad
            total += out[j, 0]
    return total
