"""Brightness of the ground and how a slope changes it: the Lunar-Lambert law.

I = 2 L mu0 / (mu0 + mu) + (1 - L) mu0, where mu0 and mu are the cosines of incidence and emission and L falls
with the phase angle (McEwen 1991, Icarus 92, 298).

The slope contrast is the relative change of brightness per unit slope (rise over run), dI / (I dslope). As a
vector G along the ground it points towards the light: ground that rises along G faces away and is darker.
To the second order in the slope, brightness also changes whichever way a slope faces.
"""

from typing import NamedTuple

import numpy as np

from factors.arrays import BoolArray, FloatArray

# Minimum cosine of incidence and of emission: nearer to grazing the law divides by next to nothing.
_LEAST_COSINE = 0.01


class LunarLambert(NamedTuple):
    """Lunar-Lambert law: McEwen's, one whose share L does not change with the phase angle, or one between.

    Attributes
    ----------
    middle_share : float or ndarray, shape (...,)
        L where McEwen's is 1/2, at a phase angle of some 40 deg.
    phase_factor : float or ndarray, shape (...,)
        Change of L with the phase angle over that of McEwen's, dimensionless: 1 for his, 0 for none.
    """

    middle_share: float | FloatArray = 0.5
    phase_factor: float | FloatArray = 1.0


MCEWEN = LunarLambert()


def lunar_lambert_share(phase_rad: FloatArray, law: LunarLambert = MCEWEN) -> FloatArray:
    """Compute the share L of the Lommel-Seeliger term, by McEwen's cubic.

    Parameters
    ----------
    phase_rad : ndarray, shape (...,)
        Phase angle: between the directions towards the sun and towards the camera.
    law : LunarLambert

    Returns
    -------
    ndarray, shape (...,)
        0 to 1.
    """
    g = np.rad2deg(phase_rad)
    mcewen = np.clip(1.0 + g * (-0.019 + g * (2.42e-4 - 1.46e-6 * g)), 0.0, 1.0)
    return np.asarray(np.clip(law.middle_share + law.phase_factor * (mcewen - 0.5), 0.0, 1.0))


def flat_terrain_brightness(
    normals: FloatArray, sun: FloatArray, view: FloatArray, law: LunarLambert = MCEWEN
) -> tuple[FloatArray, FloatArray]:
    """Compute the brightness of locally flat terrain and its slope contrast.

    Parameters
    ----------
    normals : ndarray, shape (n, 3)
        Outward unit normals of the ground, in any frame.
    sun : ndarray, shape (3,)
        Unit vector towards the sun, same frame.
    view : ndarray, shape (n, 3)
        Unit vectors from the ground towards the camera, same frame.
    law : LunarLambert

    Returns
    -------
    brightness : ndarray, shape (n,)
        Brightness of flat terrain, up to a common factor; 0 where the sun or the camera is below the horizon.
    slope_contrast : ndarray, shape (n, 3)
        Vectors G = (dI/dmu0 s + dI/dmu v) / I, tangent to the ground: a height gradient grad h changes the
        brightness by the share -G . grad h. Zero where the brightness is.
    """
    lit, m0, m, share, brightness = _flat_ground(normals, sun, view, law)
    total = m0 + m
    d0 = 2.0 * share * m / total**2 + (1.0 - share)
    d1 = -2.0 * share * m0 / total**2
    s_t = sun - m0[:, None] * normals
    v_t = view - m[:, None] * normals
    contrast = (d0[:, None] * s_t + d1[:, None] * v_t) / brightness[:, None]
    return np.where(lit, brightness, 0.0), np.where(lit[:, None], contrast, 0.0)


def slope_curvature(
    normals: FloatArray, sun: FloatArray, view: FloatArray, law: LunarLambert = MCEWEN
) -> FloatArray:
    """Compute the second-order change of brightness with slope.

    Parameters
    ----------
    normals : ndarray, shape (n, 3)
        Outward unit normals of the ground, in any frame.
    sun : ndarray, shape (3,)
        Unit vector towards the sun, same frame.
    view : ndarray, shape (n, 3)
        Unit vectors from the ground towards the camera, same frame.
    law : LunarLambert

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Symmetric K, tangent to the ground: a slope s along the unit vector u changes the brightness by the
        share -(G . u) s + (u . K u) s^2, with the slope contrast G of `flat_terrain_brightness`. On
        Lambertian ground u . K u is -1/2. Zero where the brightness is.
    """
    lit, m0, m, share, brightness = _flat_ground(normals, sun, view, law)
    total = m0 + m
    s_t = sun - m0[:, None] * normals
    both = (s_t + view - m[:, None] * normals) / total[:, None]
    # The Lommel-Seeliger term is a ratio, from which the length of the sloping normal cancels.
    mixed = s_t[:, :, None] * both[:, None, :]
    ratio = m0[:, None, None] * both[:, :, None] * both[:, None, :]
    ratio -= 0.5 * (mixed + np.swapaxes(mixed, 1, 2))
    flat = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    K = (2.0 * share / total)[:, None, None] * ratio - (0.5 * (1.0 - share) * m0)[:, None, None] * flat
    return np.where(lit[:, None, None], K / brightness[:, None, None], 0.0)


def _flat_ground(
    normals: FloatArray, sun: FloatArray, view: FloatArray, law: LunarLambert
) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of flat ground, each (n,): lit and seen or not, cosines of incidence and emission, share L, brightness.

    Both cosines are 1 where it is not: nothing divides by zero.
    """
    mu0, mu = normals @ sun, np.sum(normals * view, axis=-1)
    lit = (mu0 > _LEAST_COSINE) & (mu > _LEAST_COSINE)
    mu0, mu = np.where(lit, mu0, 1.0), np.where(lit, mu, 1.0)
    share = lunar_lambert_share(np.arccos(np.clip(view @ sun, -1.0, 1.0)), law)
    return lit, mu0, mu, share, 2.0 * share * mu0 / (mu0 + mu) + (1.0 - share) * mu0
