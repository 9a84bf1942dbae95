"""Shape of a crater: depth, rim height, and the profile from the floor over the rim crest to the terrain.

Lengths are in radii where a name has no unit.

References
----------
Pike, R. J. (1977), Size-dependence in the shape of fresh impact craters on the Moon, in Impact and Explosion
Cratering, 489-509.
"""

import numpy as np

from craternav_fg.body import Body
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Diameter at which lunar craters change from simple bowls to shallow complex ones, km (Pike 1977).
COMPLEX_KM = 15.0
# A crater's flank has reached the surrounding terrain at this many radii.
REACH = 2.3
# Half-widths of the rounding of the crest's outer side, of a fresh crater, and of the floor. Chosen: with
# them the profile resembles fresh lunar craters, and a crest spans several grid cells.
CREST = 0.06
FLOOR = 0.35
# The most degraded crest is wider by 1 + this factor, the most degraded floor higher by this share of the
# depth.
DEGRADED_CREST = 3.0
DEGRADED_DEPTH = 0.5
# Height of a central peak over the depth, and its half-width. Chosen.
PEAK = 0.3
PEAK_WIDTH = 0.14
# Harmonics of an irregular outline: the first two would shift the ellipse and change its axes; those beyond
# the last are too short to be told from roughness.
FIRST_HARMONIC = 3
LAST_HARMONIC = 8
# Distance from a crest within which other craters' flanks are suppressed, and roughness within twice of it:
# the crest then lies exactly on the catalogue's rim.
PROTECTED = 0.25
# Roughness near a crest stays below this share of the radius: more would shift the crest.
ROUGHNESS = 0.04
# The flank is the crater's own up to this distance, and fades out from there to `REACH`.
_FULL_COVERAGE = 1.15
# Craters whose centres are further apart than 60 deg on the sphere do not overlap.
_NEAR_COSINE = 0.5


def rim_height_m(radius_m: FloatArray) -> FloatArray:
    """Height of a rim crest over the surrounding terrain (Pike 1977).

    Parameters
    ----------
    radius_m : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        Metres.
    """
    D = 2e-3 * np.asarray(radius_m)
    # The law of complex craters is scaled to be continuous with that of simple ones.
    return 1e3 * np.where(
        D < COMPLEX_KM, 0.036 * D**1.014, 0.036 * COMPLEX_KM**1.014 * (D / COMPLEX_KM) ** 0.399
    )


def depth_m(radius_m: FloatArray) -> FloatArray:
    """Depth of a crater's floor below its rim crest (Pike 1977).

    Parameters
    ----------
    radius_m : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        Metres.
    """
    D = 2e-3 * np.asarray(radius_m)
    return 1e3 * np.where(
        D < COMPLEX_KM, 0.196 * D**1.010, 0.196 * COMPLEX_KM**1.010 * (D / COMPLEX_KM) ** 0.301
    )


def crest_height_over_centre_ground_m(
    semi_major_m: FloatArray, semi_minor_m: FloatArray, body: Body
) -> FloatArray:
    """Height of the rim's plane, at its centre, over terrain that follows the reference sphere.

    The rim is planar and the sphere curves away below it: the height is that of the crest over the terrain
    minus the sagitta of the sphere at the mean rim radius.

    Parameters
    ----------
    semi_major_m, semi_minor_m : ndarray, shape (n,)
    body : Body

    Returns
    -------
    ndarray, shape (n,)
        Metres.
    """
    sagitta_m = (semi_major_m**2 + semi_minor_m**2) / (4.0 * body.radius_m)
    return rim_height_m(np.sqrt(semi_major_m * semi_minor_m)) - sagitta_m


@njit(cache=True, nogil=True, error_model="numpy")
def smoothstep(t: float) -> float:
    """0 below 0, 1 above 1, smooth between."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(cache=True, nogil=True, error_model="numpy")
def protection(x: float) -> float:
    """0 with zero slope on a crest, 1 from `PROTECTED` radii away from it."""
    return smoothstep(abs(x) / PROTECTED)


@njit(cache=True, nogil=True, error_model="numpy")
def roughness(x: float, rough: float, radius: float) -> float:
    """Limit a roughness height at x radii from a crest: 0 with zero slope on the crest."""
    limited = rough / np.sqrt(1.0 + (rough / (ROUGHNESS * radius)) ** 2)
    return smoothstep(0.5 * abs(x) / PROTECTED) * limited


@njit(cache=True, nogil=True, error_model="numpy")
def crater_profile(rho: float, depth: float, rim: float, crest: float) -> float:
    """Height over the crest's plane at a distance rho, in radii, from the centre of a crater.

    `crest` is the half-width of the rounding of the crest's outer side, in radii. On the crest, rho = 1, the
    slope is zero and the curvature continuous: a grid then locates the crest without bias.
    """
    # Both sides everywhere, and no branch: loops over it take several points at once.
    outward, inward = max(rho - 1.0, 0.0), min(rho - 1.0, 0.0)
    flank = 1.0 + np.sqrt(outward * outward + crest * crest) - crest
    # The width c of the crest's inner side for which both sides have the same curvature.
    floor = np.sqrt(1.0 + FLOOR * FLOOR) - FLOOR
    q = depth / (floor * np.sqrt(1.0 + FLOOR * FLOOR)) * crest / (3.0 * rim)
    c = q / np.sqrt(1.0 - 2.0 * q)
    y = 1.0 - (np.sqrt(inward * inward + c * c) - c) / (np.sqrt(1.0 + c * c) - c)
    outside = -rim * (1.0 - 1.0 / (flank * flank * flank))
    inside = -depth * (1.0 - (np.sqrt(y * y + FLOOR * FLOOR) - FLOOR) / floor)
    return outside if rho > 1.0 else inside


@njit(cache=True, nogil=True, error_model="numpy")
def crest_height(distance_m: float, offset2_m2: float, rho: float, radius_m: float) -> float:
    """Height over the sphere that the crest has in a direction, bent so that it is level there.

    Level ground is the sphere's: a crest is its highest line, not that over the rim's plane, which lies lower
    by the radius over the sphere's times the half-width of the crest.

    Parameters
    ----------
    distance_m : float
        Distance of the rim's plane from the centre of the sphere.
    offset2_m2 : float
        Square of the distance from the rim's centre to where the direction meets the plane.
    rho : float
        The same distance in radii of the crater.
    radius_m : float
        The sphere's radius.

    Returns
    -------
    float
        m: that of the rim's plane on the crest, rho = 1, and of the plane at the centre.
    """
    # Inside, 1 - (1 - rho^2)^3 of the square of the crest's distance: no edge in slope or curvature.
    rho2 = rho * rho
    outside, inside = 1.0 / max(rho2, 1.0), 3.0 - rho2 * (3.0 - rho2)
    share = outside if rho > 1.0 else inside
    return np.sqrt(distance_m * distance_m + share * offset2_m2) - radius_m


@njit(cache=True, nogil=True, error_model="numpy")
def outline(x: float, y: float, harmonics: FloatArray) -> float:
    """Radius of an irregular crater in the direction (x, y) over that of its ellipse; 1 at the centre.

    The full outline applies from the rim outwards; towards the centre it becomes the ellipse.

    Parameters
    ----------
    x, y : float
        Along the ellipse's axes, in radii.
    harmonics : ndarray, shape (2 n,)
        Cosine and sine amplitudes from `FIRST_HARMONIC` on, as shares of the radius, of the angle in which
        the ellipse is a circle.

    Returns
    -------
    float
    """
    r = np.sqrt(x * x + y * y)
    if r == 0.0:
        return 1.0
    # With the outline's shape the floor would have creases at its centre.
    share = smoothstep(r)
    c1, s1 = x / r, y / r
    c, s = c1, s1
    for _ in range(FIRST_HARMONIC - 1):
        c, s = c * c1 - s * s1, s * c1 + c * s1
    total = 1.0
    for k in range(harmonics.shape[0] // 2):
        total += share * (harmonics[2 * k] * c + harmonics[2 * k + 1] * s)
        c, s = c * c1 - s * s1, s * c1 + c * s1
    return total


def random_outlines(rng: np.random.Generator, count: int, irregularity: float) -> FloatArray:
    """Draw harmonics for `outline`.

    Parameters
    ----------
    rng : Generator
    count : int
    irregularity : float
        Expected RMS deviation of the outline from 1.

    Returns
    -------
    ndarray, shape (count, 2 n)
        Shares of the radius.
    """
    order = np.repeat(np.arange(FIRST_HARMONIC, LAST_HARMONIC + 1), 2)
    scale = 1.0 / order
    return np.asarray(
        irregularity / np.sqrt(0.5 * np.sum(scale**2)) * scale * rng.standard_normal((count, len(order)))
    )


@njit(cache=True, nogil=True, error_model="numpy")
def coverage(rho: float) -> float:
    """Share by which a crater replaces the terrain at rho radii: 1 up to the crest, 0 from `REACH`."""
    return 1.0 - smoothstep((rho - _FULL_COVERAGE) / (REACH - _FULL_COVERAGE))


@njit(cache=True, error_model="numpy")
def ground_levels(
    normals: FloatArray,
    axes: FloatArray,
    shape: FloatArray,
    crest: FloatArray,
    tangent: FloatArray,
    radius_m: float,
    heights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Express the terrain at each crater's centre below the flanks of larger ones: share * relief + flank.

    Parameters
    ----------
    normals : ndarray, shape (n, 3)
        Outward unit normals at the centres in the site frame, largest crater first.
    axes : ndarray, shape (n, 2, 3)
        Semi-axes a l1 and b l2, m, in the frame of `normals`.
    shape : ndarray, shape (n, 2)
        Depth, and height of the crest over the terrain, m.
    crest : ndarray, shape (n,)
        Height of the rim's plane over the terrain at the centre, m.
    tangent : ndarray, shape (n, 5)
        Plane coordinates x, y of the centres, m, the relief there, m, and its gradient, m/m (two columns).
    radius_m : float
        The sphere's radius.
    heights : ndarray, shape (n,)
        Heights of the rim planes over the sphere, m. Where NaN, the height at which the crater stands in its
        terrain is written.

    Returns
    -------
    share, flank : ndarray, shape (n,)
        Share 1 and flank 0 away from larger craters.
    """
    n = normals.shape[0]
    share = np.ones(n)
    flank = np.zeros(n)
    for i in range(n):
        for j in range(i):
            cosine = 0.0
            X = 0.0
            Y = 0.0
            aa = 0.0
            bb = 0.0
            for k in range(3):
                cosine += normals[j, k] * normals[i, k]
                X += axes[j, 0, k] * normals[i, k]
                Y += axes[j, 1, k] * normals[i, k]
                aa += axes[j, 0, k] ** 2
                bb += axes[j, 1, k] ** 2
            if cosine <= _NEAR_COSINE:
                continue
            p = radius_m + heights[j]
            # X and Y carry one factor of a and b already.
            rho = p / cosine * np.sqrt((X / aa) ** 2 + (Y / bb) ** 2)
            if rho >= REACH:
                continue
            offset2 = p * p * (1.0 / (cosine * cosine) - 1.0)
            w = coverage(rho)
            share[i] *= 1.0 - w
            rough = tangent[i, 2] - tangent[j, 2]
            for k in range(2):
                rough -= tangent[j, 3 + k] * (tangent[i, k] - tangent[j, k])
            rough = roughness(rho - 1.0, rough, (aa * bb) ** 0.25)
            target = crest_height(p, offset2, rho, radius_m) + rough
            target += crater_profile(rho, shape[j, 0], shape[j, 1], CREST)
            flank[i] += w * (target - flank[i])
        if np.isnan(heights[i]):
            heights[i] = share[i] * tangent[i, 2] + flank[i] + crest[i]
    return share, flank
