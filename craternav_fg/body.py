"""The target body: a sphere with central gravity that spins about a fixed axis."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


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
