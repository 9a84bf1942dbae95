"""The target body: a sphere with central gravity that rotates about a fixed axis."""

from dataclasses import dataclass

import numpy as np

from factors.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Body:
    """Target body; the origin of the body-fixed frame g is its centre.

    Attributes
    ----------
    name : str
        Shown to the user, and compared with the catalogue's body.
    radius_m : float
        Radius of the sphere to which heights refer.
    mu_m3_s2 : float
        Gravitational parameter.
    spin_rad_s : tuple of float
        Angular velocity in inertial space, components in g.
    """

    name: str
    radius_m: float
    mu_m3_s2: float
    spin_rad_s: tuple[float, float, float]

    def gravity(self, gP: FloatArray) -> FloatArray:
        """Compute the Newtonian gravity, `U(P)` of eq. (26), without the centrifugal acceleration.

        Parameters
        ----------
        gP : ndarray, shape (..., 3)
            Positions in g, m.

        Returns
        -------
        ndarray, shape (..., 3)
            Accelerations in g, m/s^2.

        References
        ----------
        Tian et al. (2019), DOI 10.1017/S0373463318000966, eq. (26).
        """
        P = np.asarray(gP, dtype=np.float64)
        range_m = np.linalg.norm(P, axis=-1, keepdims=True)
        return -self.mu_m3_s2 * P / range_m**3

    def altitude_m(self, gP: FloatArray) -> FloatArray:
        """Compute altitudes above the sphere.

        Parameters
        ----------
        gP : ndarray, shape (..., 3)
            Positions in g, m.

        Returns
        -------
        ndarray, shape (...,)
            Altitudes, m.
        """
        return np.asarray(np.linalg.norm(gP, axis=-1) - self.radius_m)


def ground_points(
    gRc: FloatArray, gPc: FloatArray, points: FloatArray, radius_m: float
) -> tuple[FloatArray, BoolArray]:
    """Intersect lines of sight with the sphere.

    Parameters
    ----------
    gRc : ndarray, shape (3, 3)
        Attitude of the camera in g.
    gPc : ndarray, shape (3,)
        Position of the camera in g, m.
    points : ndarray, shape (n, 2)
        Image points, normalised image coordinates.
    radius_m : float
        Radius of the sphere about the origin of g.

    Returns
    -------
    ground : ndarray, shape (n, 3)
        The nearer intersections in g, m; without one, the point of the line nearest to the origin of g.
    hit : ndarray of bool, shape (n,)
        Whether the line meets the sphere in front of the camera.
    """
    rays = np.concatenate([points, np.ones((len(points), 1))], axis=-1) @ gRc.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ gPc)
    off2 = gPc @ gPc - along**2
    half_chord2 = radius_m**2 - off2
    hit = (half_chord2 > 0.0) & (along > 0.0)
    range_m = along - np.sqrt(np.maximum(half_chord2, 0.0))
    return gPc + range_m[:, None] * rays, np.asarray(hit)
