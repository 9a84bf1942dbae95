"""The target body: a sphere with central gravity that spins about a fixed axis."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Body:
    """Target body, with the body-fixed frame g at its centre.

    Attributes
    ----------
    name : str
        For people.
    radius_m : float
        Reference sphere of the catalogue's heights.
    mu_m3_s2 : float
        Gravitational parameter.
    spin_rad_s : tuple of float
        Spin vector in g, rad/s.
    """

    name: str
    radius_m: float
    mu_m3_s2: float
    spin_rad_s: tuple[float, float, float]

    def gravity(self, gP: FloatArray) -> FloatArray:
        """Newtonian gravity at positions in g, `U(P)` of eq. (26), without the centrifugal term.

        Parameters
        ----------
        gP : ndarray, shape (..., 3)
            Positions in g, m.

        Returns
        -------
        ndarray, shape (..., 3)
            Acceleration in g, m/s^2.
        """
        P = np.asarray(gP, dtype=np.float64)
        range_m = np.linalg.norm(P, axis=-1, keepdims=True)
        return -self.mu_m3_s2 * P / range_m**3

    def altitude_m(self, gP: FloatArray) -> FloatArray:
        """Height of positions (..., 3) above the reference sphere, m."""
        return np.asarray(np.linalg.norm(gP, axis=-1) - self.radius_m)


def ground_points(
    gRc: FloatArray, gPc: FloatArray, points: FloatArray, radius_m: float
) -> tuple[FloatArray, BoolArray]:
    """Where lines of sight meet the sphere.

    Parameters
    ----------
    gRc, gPc : ndarray, shape (3, 3) and (3,)
        Pose of the camera in g.
    points : ndarray, shape (n, 2)
        Normalised image coordinates.
    radius_m : float
        Of the sphere about the origin of g.

    Returns
    -------
    ground : ndarray, shape (n, 3)
        The nearer intersections in g; the point nearest to the sphere where there is none.
    hit : ndarray of bool, shape (n,)
        Whether the line meets the sphere ahead of the camera.
    """
    rays = np.concatenate([points, np.ones((len(points), 1))], axis=-1) @ gRc.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ gPc)
    off2 = gPc @ gPc - along**2
    root2 = radius_m**2 - off2
    hit = (root2 > 0.0) & (along > 0.0)
    range_m = along - np.sqrt(np.maximum(root2, 0.0))
    return gPc + range_m[:, None] * rays, np.asarray(hit)
