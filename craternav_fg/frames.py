"""Conversions between frames, and between the forms of a rotation.

Frames: g is fixed to the target body and rotates with it, b is the lander, c the camera (x right, y down, z
along the optical axis), l a crater (x along its major axis, z outward). aTb is the pose of b in a, aRb its
rotation, aPb its position; the letters cancel: aTc = aTb bTc.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from factors.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


# Below, the series of the right Jacobian to second order is exact to 1e-13; its closed form is not.
_SMALL_ANGLE_RAD = 1e-4
# Trace of a rotation by 90 deg: by less, the sine of its angle gives the axis exactly.
_LEAST_TRACE = 1.0


def pose(R: FloatArray, t: FloatArray) -> FloatArray:
    """Make a pose of a rotation and a translation.

    Parameters
    ----------
    R : ndarray, shape (3, 3)
        Rotation aRb, from frame b to a.
    t : ndarray, shape (3,)
        Position of the origin of b in a, m.

    Returns
    -------
    ndarray, shape (4, 4)
        Homogeneous matrix aTb.
    """
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: FloatArray) -> FloatArray:
    """Invert poses.

    Parameters
    ----------
    T : ndarray, shape (..., 4, 4)
        Poses aTb of frame b in a.

    Returns
    -------
    ndarray, shape (..., 4, 4)
        Poses bTa.
    """
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def _rotation() -> "type[Rotation]":
    """Import SciPy's rotations when they are first needed: they bring in a quarter of a second of modules."""
    from scipy.spatial.transform import Rotation

    return Rotation


def from_quaternion_wxyz(q: FloatArray) -> FloatArray:
    """Convert quaternions to rotation matrices.

    Parameters
    ----------
    q : ndarray, shape (..., 4)
        Hamilton quaternions, scalar first, of any length but zero.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Rotations between the same frames.

    Raises
    ------
    ValueError
        When a quaternion is zero or not a number.
    """
    q = np.asarray(q)
    if q.shape == (4,):
        # Commands on one image need one, and scipy takes long to import.
        if not q @ q > 0.0:
            raise ValueError(f"expected a quaternion, of any length but zero, found {q}")
        w, v = q[0], q[1:]
        W = cross_matrix(v)
        return np.asarray(np.eye(3) + 2.0 * (w * W + W @ W) / (q @ q))
    return np.asarray(_rotation().from_quat(q, scalar_first=True).as_matrix())


def to_quaternion_wxyz(R: FloatArray) -> FloatArray:
    """Convert rotation matrices to quaternions.

    Parameters
    ----------
    R : ndarray, shape (..., 3, 3)
        Rotations aRb, from frame b to a.

    Returns
    -------
    ndarray, shape (..., 4)
        Unit Hamilton quaternions, scalar first and not negative.

    Raises
    ------
    ValueError
        When a matrix mirrors, or is not a number.
    """
    R = np.asarray(R)
    if R.shape == (3, 3):
        # As above. Four times the products of each component with all: the largest row is never small.
        if not R[0] @ np.cross(R[1], R[2]) > 0.0:
            raise ValueError(f"expected a rotation, found {R.tolist()}")
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        products = np.empty((4, 4))
        products[1:, 1:] = R + R.T + (1.0 - np.trace(R)) * np.eye(3)
        products[0] = products[:, 0] = 1.0 + np.trace(R), x, y, z
        q = products[np.argmax(np.diag(products))]
        return np.asarray(math.copysign(1.0, q[0]) * q / math.sqrt(q @ q))
    return np.asarray(_rotation().from_matrix(R).as_quat(canonical=True, scalar_first=True))


def rotation_exp(w: FloatArray) -> FloatArray:
    """Convert rotation vectors to rotation matrices.

    Parameters
    ----------
    w : ndarray, shape (..., 3)
        Axis times angle, rad, in either frame: the axis is the same in both.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Rotations between these frames.
    """
    w = np.asarray(w)
    if w.shape == (3,):
        # Filters need one per update, which scipy's checks would make five times as long.
        angle = math.sqrt(w @ w)
        W = cross_matrix(w)
        small = angle < _SMALL_ANGLE_RAD
        first = 1.0 - angle**2 / 6.0 if small else math.sin(angle) / angle
        second = 0.5 if small else 2.0 * (math.sin(0.5 * angle) / angle) ** 2
        return np.asarray(np.eye(3) + first * W + second * (W @ W))
    return np.asarray(_rotation().from_rotvec(w).as_matrix())


def rotation_log(R: FloatArray) -> FloatArray:
    """Convert rotation matrices to rotation vectors.

    Parameters
    ----------
    R : ndarray, shape (..., 3, 3)
        Rotations aRb, from frame b to a.

    Returns
    -------
    ndarray, shape (..., 3)
        Axis times angle, rad, 0 to pi; the axis is the same in both frames.
    """
    R = np.asarray(R)
    if R.shape == (3, 3):
        # Estimators need one at a time, which scipy's checks would make ten times as long.
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
        trace = xx + yy + zz
        if trace > _LEAST_TRACE:
            # Axis times twice the sine.
            x, y, z = zy - yz, xz - zx, yx - xy
            length = math.sqrt(x * x + y * y + z * z)
            factor = math.atan2(length, trace - 1.0) / length if length > 0.0 else 0.5
            return np.array([factor * x, factor * y, factor * z])
    return np.asarray(_rotation().from_matrix(R).as_rotvec())


def pose_log(T: FloatArray) -> FloatArray:
    """Convert a pose to the twist whose exponential it is.

    That of inverse(gTb) gTb' is the change from gTb to gTb'.

    Parameters
    ----------
    T : ndarray, shape (4, 4)
        Pose aTb of frame b in a.

    Returns
    -------
    ndarray, shape (6,)
        Right twist [w, rho], rad and m.
    """
    w = rotation_log(T[:3, :3])
    return np.concatenate([w, np.linalg.solve(right_jacobian(-w), T[:3, 3])])


def rotate_position_block(covariance: FloatArray, aRb: FloatArray) -> FloatArray:
    """Rotate the position block of a pose covariance from axes b to axes a; the attitude block stays.

    GTSAM gives the covariance of a right twist, both parts in b. With `gRb` it becomes that of (rotation
    vector in b, position in g), which estimators report; the transpose of `gRb` turns it back.

    Parameters
    ----------
    covariance : ndarray, shape (6, 6)
        Covariance of (rotation vector, rad; position in b, m).
    aRb : ndarray, shape (3, 3)
        Rotation from b to a.

    Returns
    -------
    ndarray, shape (6, 6)
        For the twist (the same rotation vector; position in a).
    """
    turn = np.eye(6)
    turn[3:, 3:] = aRb
    return np.asarray(turn @ covariance @ turn.T)


def up(lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Compute outward unit normals of the sphere.

    Parameters
    ----------
    lat_rad, lon_rad : ndarray, shape (...,)
        Latitude and east longitude.

    Returns
    -------
    ndarray, shape (..., 3)
        Unit vectors in g.
    """
    return np.stack(
        [np.cos(lat_rad) * np.cos(lon_rad), np.cos(lat_rad) * np.sin(lon_rad), np.sin(lat_rad)], axis=-1
    )


def east_north_up(lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Compute the rotations from local east-north-up frames to g.

    Parameters
    ----------
    lat_rad, lon_rad : ndarray, shape (...,)
        Latitude and east longitude.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Rotations gRe; their columns are east, north and up in g.
    """
    zero = np.zeros_like(lat_rad)
    east = np.stack([-np.sin(lon_rad), np.cos(lon_rad), zero], axis=-1)
    n = up(lat_rad, lon_rad)
    north = np.cross(n, east)
    return np.stack([east, north, n], axis=-1)


def latitude_longitude(gP: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute planetocentric latitude and longitude.

    Parameters
    ----------
    gP : ndarray, shape (..., 3)
        Positions in g, m.

    Returns
    -------
    latitude_rad : ndarray, shape (...,)
        -pi/2 to pi/2.
    longitude_rad : ndarray, shape (...,)
        To the east, -pi to pi.
    """
    P = np.asarray(gP)
    return np.arctan2(P[..., 2], np.hypot(P[..., 0], P[..., 1])), np.arctan2(P[..., 1], P[..., 0])


def cross_matrix(v: FloatArray) -> FloatArray:
    """Make the matrices that multiply like a cross product from the left.

    Parameters
    ----------
    v : ndarray, shape (..., 3)
        In any unit and any axes.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        [v]x with [v]x u = v x u, in the unit and axes of v.
    """
    v = np.asarray(v)
    # Filled in place: filters need one per update, and stacking costs five times as much.
    out = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., j, i] = v[..., k]
        out[..., i, j] = -v[..., k]
    return out


def adjoint(T: FloatArray) -> FloatArray:
    """Compute the adjoint of a pose, which takes twists from one frame to another.

    Parameters
    ----------
    T : ndarray, shape (4, 4)
        Pose aTb of frame b in a.

    Returns
    -------
    ndarray, shape (6, 6)
        A with w_a = A w_b, right twists [w, rho] of gTa and of gTb = gTa aTb for the same motion, rad and m.
    """
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T[:3, :3]
    out[3:, :3] = cross_matrix(T[:3, 3]) @ T[:3, :3]
    return out


def right_jacobian(w: FloatArray) -> FloatArray:
    """Differentiate the exponential of a rotation vector from the right.

    Parameters
    ----------
    w : ndarray, shape (3,)
        Rotation vector from a to b, rad, in the axes of b.

    Returns
    -------
    ndarray, shape (3, 3)
        J with exp(w + d) = exp(w) exp(J d) for small d.
    """
    angle2 = float(w @ w)
    W = cross_matrix(w)
    if angle2 < _SMALL_ANGLE_RAD**2:
        return np.asarray(np.eye(3) - 0.5 * W + W @ W / 6.0)
    angle = np.sqrt(angle2)
    return np.asarray(
        np.eye(3) - (1.0 - np.cos(angle)) / angle2 * W + (angle - np.sin(angle)) / angle2 / angle * W @ W
    )
