"""Frames g (body-fixed), b (lander), c (camera), l (crater-local), and conversions between them."""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.float64]


def pose(R: FloatArray, t: FloatArray) -> FloatArray:
    """Homogeneous matrix (4, 4) of a rotation (3, 3) and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: FloatArray) -> FloatArray:
    """Inverse of homogeneous matrices, shape (..., 4, 4): `bTa` from `aTb`."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def from_quaternion_wxyz(q: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of scalar-first Hamilton quaternions (..., 4)."""
    return np.asarray(Rotation.from_quat(np.asarray(q), scalar_first=True).as_matrix())


def to_quaternion_wxyz(R: FloatArray) -> FloatArray:
    """Scalar-first quaternions (..., 4), scalar part not negative, of rotation matrices (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True))


def rotation_exp(w: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    return np.asarray(Rotation.from_rotvec(w).as_matrix())


def rotation_log(R: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), rad, of rotation matrices (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def rotate_position_block(covariance: FloatArray, aRb: FloatArray) -> FloatArray:
    """Turn the position part of a pose covariance (6, 6) from axes b into a; the attitude's stays in b.

    With `gRb` from a right twist's, both parts in b, to (rotation vector in b, position in g); with its
    transpose back.
    """
    turn = np.eye(6)
    turn[3:, 3:] = aRb
    return np.asarray(turn @ covariance @ turn.T)


def up(lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Outward unit normals of the sphere in g, shape (..., 3), at latitude and east longitude."""
    return np.stack(
        [np.cos(lat_rad) * np.cos(lon_rad), np.cos(lat_rad) * np.sin(lon_rad), np.sin(lat_rad)], axis=-1
    )


def east_north_up(lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Rotations `gRe` (..., 3, 3) from the local east-north-up frame to g."""
    zero = np.zeros_like(lat_rad)
    east = np.stack([-np.sin(lon_rad), np.cos(lon_rad), zero], axis=-1)
    n = up(lat_rad, lon_rad)
    north = np.cross(n, east)
    return np.stack([east, north, n], axis=-1)


def latitude_longitude(gP: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Latitude and east longitude, rad, of positions (..., 3) in g."""
    P = np.asarray(gP)
    return np.arctan2(P[..., 2], np.hypot(P[..., 0], P[..., 1])), np.arctan2(P[..., 1], P[..., 0])


def right_jacobian(w: FloatArray) -> FloatArray:
    """Give the derivative of the rotation vector's exponential from the right.

    Parameters
    ----------
    w : ndarray, shape (3,)
        Rotation vector, rad.

    Returns
    -------
    ndarray, shape (3, 3)
        J with exp(w + d) = exp(w) exp(J d) for small d.
    """
    angle2 = float(w @ w)
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    if angle2 < 1e-8:
        return np.asarray(np.eye(3) - 0.5 * W + W @ W / 6.0)
    angle = np.sqrt(angle2)
    return np.asarray(
        np.eye(3) - (1.0 - np.cos(angle)) / angle2 * W + (angle - np.sin(angle)) / angle2 / angle * W @ W
    )
