"""How bright level ground is, and how a slope changes it: the Lunar-Lambert law.

I = 2 L mu0 / (mu0 + mu) + (1 - L) mu0, mu0 and mu the cosines of incidence and emission, L falling
with the phase angle (McEwen 1991, Icarus 92, 298).
"""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def lunar_lambert_share(phase_rad: FloatArray) -> FloatArray:
    """Share L of the Lommel-Seeliger term at a phase angle, McEwen's cubic."""
    g = np.rad2deg(phase_rad)
    return np.asarray(np.clip(1.0 - 0.019 * g + 2.42e-4 * g**2 - 1.46e-6 * g**3, 0.0, 1.0))


def level_ground(normals: FloatArray, sun: FloatArray, view: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Brightness of level ground and the slope's effect on it.

    Parameters
    ----------
    normals : ndarray, shape (n, 3)
        Outward unit normals of the ground.
    sun : ndarray, shape (3,)
        Unit vector towards the sun, same frame.
    view : ndarray, shape (n, 3)
        Unit vectors from the ground to the camera.

    Returns
    -------
    brightness : ndarray, shape (n,)
        Of level ground, up to a common factor; 0 where the sun is down.
    gain : ndarray, shape (n, 3)
        Tangent vectors G = (dI/dmu0 s + dI/dmu v) / I: a height gradient grad h changes the
        brightness by the share -G . grad h. Zero where the sun is down.
    """
    mu0 = normals @ sun
    mu = np.sum(normals * view, axis=-1)
    lit = (mu0 > 0.01) & (mu > 0.01)
    m0, m = np.where(lit, mu0, 1.0), np.where(lit, mu, 1.0)
    share = lunar_lambert_share(np.arccos(np.clip(view @ sun, -1.0, 1.0)))
    total = m0 + m
    brightness = 2.0 * share * m0 / total + (1.0 - share) * m0
    d0 = 2.0 * share * m / total**2 + (1.0 - share)
    d1 = -2.0 * share * m0 / total**2
    s_t = sun - mu0[:, None] * normals
    v_t = view - mu[:, None] * normals
    gain = (d0[:, None] * s_t + d1[:, None] * v_t) / brightness[:, None]
    return np.where(lit, brightness, 0.0), np.where(lit[:, None], gain, 0.0)
