"""Brightness of the terrain: its reflectance, and the shadows on it.

Frame and grids are those of `rays`.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.simulation.rays import MAX_STEPS, height_and_slopes, height_at, surface
from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

# Shadow rays begin this far from their point, in cells, are taken this much higher, and step at least this
# far: the bilinear terrain between grid points may stand above the point itself.
_SHADOW_START, _SHADOW_LIFT, _SHADOW_STEP = 1.5, 0.04, 0.7
# Pixels whose shadow rays are stepped together: they stay in the processor's first cache.
_BLOCK = 64
# Columns of a block, one behind the other so that the processor takes several pixels at once: the point, in
# the plane and then in the site frame, spacing of its grid, height, m; slopes, m/m; cosines of incidence,
# emission and phase. Then of a shadow ray closing speed, distance, m, least height over the terrain relative
# to the radius of the light's cone, plane coordinates and height, m.
_X, _Y, _Z, _CELL, _HEIGHT, _SLOPE_X, _SLOPE_Y, _MU0, _MU, _PHASE = (_BLOCK * k for k in range(10))
_CLOSING, _T, _LEAST, _RAY_X, _RAY_Y, _RAY_HEIGHT = (_BLOCK * k for k in range(4, 10))
_COLUMNS = 10
# Least closing speed of a shadow ray with the terrain, height per length.
_MIN_CLOSING = 1e-3


@njit(cache=True, nogil=True, error_model="numpy")
def reflectance(mu0: float, mu: float, cos_phase: float, law: FloatArray) -> float:
    """Brightness of the terrain over the cosine of incidence.

    Parameters
    ----------
    mu0, mu, cos_phase : float
        Cosines of incidence, emission and phase angle.
    law : ndarray, shape (5,)
        Share of Lommel-Seeliger in the Lunar-Lambert law; Hapke's single-scattering albedo w, which is 0 for
        Lunar-Lambert, asymmetry, opposition amplitude B0 and width h: dimensionless.

    Returns
    -------
    float

    References
    ----------
    Hapke, B. (2012), Theory of Reflectance and Emittance Spectroscopy, section 8, for a smooth surface.
    """
    lommel, w = law[0], law[1]
    if w == 0.0:
        return 2.0 * lommel / (mu0 + mu) + 1.0 - lommel
    asymmetry, amplitude, width = law[2], law[3], law[4]
    cosine = min(max(cos_phase, -1.0), 1.0)
    # tan(g / 2) from cos g.
    half = np.sqrt((1.0 - cosine) / max(1.0 + cosine, 1e-9))
    scattered = (1.0 - asymmetry**2) / (1.0 + 2.0 * asymmetry * cosine + asymmetry**2) ** 1.5
    gamma = np.sqrt(1.0 - w)
    multiple = (1.0 + 2.0 * mu0) / (1.0 + 2.0 * mu0 * gamma) * (1.0 + 2.0 * mu) / (1.0 + 2.0 * mu * gamma)
    opposition = 1.0 + amplitude / (1.0 + half / width)
    return 0.25 * w / (mu0 + mu) * (opposition * scattered + multiple - 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _incidence(block: FloatArray, count: int, P: FloatArray, sun: FloatArray, radius: float) -> None:
    """Write ground points, and the cosines of incidence, emission and phase angle there."""
    Px, Py, Pz = P
    sx, sy, sz = sun
    for k in range(count):
        gx, gy = block[_X + k], block[_Y + k]
        hx, hy = block[_SLOPE_X + k], block[_SLOPE_Y + k]
        x, y, z, nx, ny, nz = surface(gx, gy, block[_HEIGHT + k], hx, hy, radius)
        vx, vy, vz = Px - x, Py - y, Pz - z
        range_m = np.sqrt(vx * vx + vy * vy + vz * vz)
        block[_X + k] = x
        block[_Y + k] = y
        block[_Z + k] = z
        block[_MU0 + k] = nx * sx + ny * sy + nz * sz
        block[_MU + k] = max((nx * vx + ny * vy + nz * vz) / range_m, 0.0)
        block[_PHASE + k] = (sx * vx + sy * vy + sz * vz) / range_m


@njit(cache=True, nogil=True, error_model="numpy")
def _shadow_rays(block: FloatArray, count: int, sun: FloatArray, radius: float, slope: float) -> None:
    """Write where shadow rays begin, and how fast they close with the steepest terrain."""
    sx, sy, sz = sun
    for k in range(count):
        x, y, z = block[_X + k], block[_Y + k], block[_Z + k]
        # How fast the ray climbs, and moves over the ground: further on it climbs faster.
        climb = (x * sx + y * sy + z * sz) / np.sqrt(x * x + y * y + z * z)
        run = radius / z * np.sqrt((sx - x * sz / z) ** 2 + (sy - y * sz / z) ** 2)
        block[_CLOSING + k] = slope * run - climb
        block[_T + k] = _SHADOW_START * block[_CELL + k]
        block[_LEAST + k] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _stepped(block: FloatArray, count: int, sun: FloatArray, radius: float) -> None:
    """Write the plane coordinates of shadow rays at their distances, and their heights over the sphere."""
    sx, sy, sz = sun
    for k in range(count):
        t = block[_T + k]
        x, y, z = block[_X + k] + t * sx, block[_Y + k] + t * sy, block[_Z + k] + t * sz
        scale = radius / z
        block[_RAY_X + k] = x * scale
        block[_RAY_Y + k] = y * scale
        height = np.sqrt(x * x + y * y + z * z) - radius
        block[_RAY_HEIGHT + k] = height if z > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _sunlight(
    block: FloatArray,
    count: int,
    sun: FloatArray,
    sun_radius: float,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    top: float,
    slope: float,
    seen: IntArray,
    light: Float32Array,
) -> None:
    """Multiply brightness by the share of the sun's disc that is visible from each of `count` ground points.

    All rays take a step before any takes the next: the steps of one ray wait for each other, those of
    different rays do not. Rays at their ends give their places to others.
    """
    _shadow_rays(block, count, sun, radius, slope)
    for _ in range(MAX_STEPS):
        if count == 0:
            break
        _stepped(block, count, sun, radius)
        going = 0
        for k in range(count):
            cell, closing, t, least = block[_CELL + k], block[_CLOSING + k], block[_T + k], block[_LEAST + k]
            ends = block[_RAY_HEIGHT + k] > top
            if not ends:
                ground = height_at(block[_RAY_X + k], block[_RAY_Y + k], heights, slots, frames)
                f = block[_RAY_HEIGHT + k] - ground + _SHADOW_LIFT * cell
                cone = t * sun_radius
                # The least height over the terrain, relative to the radius of the light's cone.
                if f < least * cone:
                    least = max(f / cone, -1.0)
                ends = f <= -cone or (closing <= 0.0 and f > cone)
                t += max(_SHADOW_STEP * cell, f / max(closing, _MIN_CLOSING))
            if ends:
                light[seen[k]] *= 0.5 + 0.5 * least
                continue
            block[_T + going], block[_LEAST + going] = t, least
            if going < k:
                for column in (_X, _Y, _Z, _CELL, _CLOSING):
                    block[column + going] = block[column + k]
                seen[going] = seen[k]
            going += 1
        count = going
    for k in range(count):
        light[seen[k]] *= 0.5 + 0.5 * block[_LEAST + k]


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    P: FloatArray,
    hits: FloatArray,
    sun: FloatArray,
    sun_radius: float,
    law: FloatArray,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    top: float,
    slope: float,
    light: Float32Array,
) -> None:
    """Write the brightness of ground points.

    Parameters
    ----------
    P : ndarray, shape (3,)
        Position of the camera in the site frame, m.
    hits : ndarray, shape (n, 2)
        Plane coordinates, m; NaN in the sky.
    sun : ndarray, shape (3,)
        Unit vector towards the sun in the site frame.
    sun_radius : float
        Half the angle under which the sun appears, rad.
    law : ndarray, shape (5,)
        Parameters of `reflectance`.
    heights : ndarray of float32, shape (slots, cells, cells)
        See `Levels`, m.
    slots : ndarray of int, shape (m,)
        See `Levels`.
    frames : ndarray, shape (m, 5)
        See `Levels`.
    radius : float
        The body's radius, m.
    top, slope : float
        See `Levels`, m and m/m.
    light : ndarray of float32, shape (n,)
        Brightness, written; 0 in the sky.
    """
    block = np.empty(_COLUMNS * _BLOCK)
    seen = np.empty(_BLOCK, np.int64)
    for first in range(0, hits.shape[0], _BLOCK):
        count = 0
        for r in range(first, min(first + _BLOCK, hits.shape[0])):
            light[r] = 0.0
            gx, gy = hits[r, 0], hits[r, 1]
            if not np.isnan(gx):
                height, hx, hy, cell = height_and_slopes(gx, gy, heights, slots, frames)
                block[_X + count], block[_Y + count], block[_HEIGHT + count] = gx, gy, height
                block[_SLOPE_X + count], block[_SLOPE_Y + count], block[_CELL + count] = hx, hy, cell
                seen[count] = r
                count += 1
        _incidence(block, count, P, sun, radius)
        lit = 0
        for k in range(count):
            mu0 = block[_MU0 + k]
            if mu0 > 0.0:
                light[seen[k]] = mu0 * reflectance(mu0, block[_MU + k], block[_PHASE + k], law)
                for column in (_X, _Y, _Z, _CELL):
                    block[column + lit] = block[column + k]
                seen[lit] = seen[k]
                lit += 1
        _sunlight(block, lit, sun, sun_radius, heights, slots, frames, radius, top, slope, seen, light)
