"""Rays through the height field: intersections with the terrain, its normals, and its brightness.

All is in the site frame s of `relief`: a ground point is (x, y, R) times (R + height)/|(x, y, R)|
with x, y its coordinates in the gnomonic plane. Grids are passed as in `terrain.Levels`.
"""

import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray, IntArray
from factors.kernels.compiled import njit

Float32Array = npt.NDArray[np.float32]

# Steps along a ray before it is given up; most take under 50.
MAX_STEPS = 400
# Accuracy of an intersection, and distance from the terrain below which the secant method is used, in cells
# of the finest grid.
_TOLERANCE, _NEAR = 0.002, 0.5
# A secant step is at most this many `_NEAR` distances.
_LONGEST_SECANT = 4.0
# A ray is steeper than the terrain by this factor if it meets it only once: it may bend by 1 % further on.
_STEEPER = 1.01
# Secant steps from the intersection of the ray beside; three are usual.
_SECANT_STEPS = 8
# Shadow rays begin this far from their point, in cells, are taken this much higher, and step at least this
# far: the bilinear terrain between grid points may stand above the point itself.
_SHADOW_START, _SHADOW_LIFT, _SHADOW_STEP = 1.5, 0.04, 0.7
# Pixels whose shadow rays are stepped together: they stay in the processor's first cache.
_BLOCK = 64
# Least closing speed of a shadow ray with the terrain, height per length.
_MIN_CLOSING = 1e-3


@njit(cache=True, nogil=True, error_model="numpy")
def _height(x: float, y: float, heights: Float32Array, slots: IntArray, frames: FloatArray) -> float:
    """Bilinear height at a plane point from the finest grid around it.

    Beyond all grids the terrain is level at the lowest height of their border: at a higher one it would
    surround them as a wall.
    """
    n = heights.shape[1]
    for k in range(slots.shape[0]):
        u = (x - frames[k, 1]) * frames[k, 4]
        v = (y - frames[k, 2]) * frames[k, 4]
        if u >= 1.0 and v >= 1.0 and u < n - 2 and v < n - 2:
            i = int(u)
            j = int(v)
            u -= i
            v -= j
            s = slots[k]
            return (1.0 - v) * ((1.0 - u) * heights[s, j, i] + u * heights[s, j, i + 1]) + v * (
                (1.0 - u) * heights[s, j + 1, i] + u * heights[s, j + 1, i + 1]
            )
    return frames[slots.shape[0] - 1, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _height_and_slopes(
    x: float, y: float, heights: Float32Array, slots: IntArray, frames: FloatArray
) -> tuple[float, float, float, float]:
    """Height, slopes along x and y (bilinear between central differences), and the spacing of their grid."""
    n = heights.shape[1]
    for k in range(slots.shape[0]):
        per_cell = frames[k, 4]
        u = (x - frames[k, 1]) * per_cell
        v = (y - frames[k, 2]) * per_cell
        if u >= 1.0 and v >= 1.0 and u < n - 2 and v < n - 2:
            i = int(u)
            j = int(v)
            u -= i
            v -= j
            h, s = heights, slots[k]
            # The 12 points around: rows j - 1 to j + 2.
            b1, b2 = h[s, j - 1, i], h[s, j - 1, i + 1]
            c0, c1, c2, c3 = h[s, j, i - 1], h[s, j, i], h[s, j, i + 1], h[s, j, i + 2]
            d0, d1, d2, d3 = h[s, j + 1, i - 1], h[s, j + 1, i], h[s, j + 1, i + 1], h[s, j + 1, i + 2]
            e1, e2 = h[s, j + 2, i], h[s, j + 2, i + 1]
            gx = (1.0 - v) * ((1.0 - u) * (c2 - c0) + u * (c3 - c1)) + v * (
                (1.0 - u) * (d2 - d0) + u * (d3 - d1)
            )
            gy = (1.0 - v) * ((1.0 - u) * (d1 - b1) + u * (d2 - b2)) + v * (
                (1.0 - u) * (e1 - c1) + u * (e2 - c2)
            )
            height = (1.0 - v) * ((1.0 - u) * c1 + u * c2) + v * ((1.0 - u) * d1 + u * d2)
            return height, 0.5 * gx * per_cell, 0.5 * gy * per_cell, frames[k, 0]
    last = slots.shape[0] - 1
    return frames[last, 3], 0.0, 0.0, 2.0 * frames[last, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _surface(
    gx: float, gy: float, heights: Float32Array, slots: IntArray, frames: FloatArray, radius: float
) -> tuple[float, float, float, float, float, float, float]:
    """Ground point and its unit normal (three numbers each, site frame), and the spacing of its grid."""
    height, hx, hy, cell = _height_and_slopes(gx, gy, heights, slots, frames)
    s = np.sqrt(gx * gx + gy * gy + radius * radius)
    # Gradient of |p| - R - h(x(p), y(p)), with grad x = k (e_x - x/R e_z).
    k = s / (radius + height)
    nx = gx / s - k * hx
    ny = gy / s - k * hy
    nz = radius / s + k * (hx * gx + hy * gy) / radius
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    return gx / k, gy / k, radius / k, nx / norm, ny / norm, nz / norm, cell


@njit(cache=True, nogil=True, error_model="numpy")
def surfaces(
    hits: FloatArray,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    points: FloatArray,
    normals: FloatArray,
) -> None:
    """Write the ground points and unit normals of plane points.

    Parameters
    ----------
    hits : ndarray, shape (n, 2)
        Plane coordinates, m; NaN in the sky.
    heights : ndarray of float32, shape (slots, cells, cells)
        See `Levels`, m.
    slots : ndarray of int, shape (m,)
        See `Levels`.
    frames : ndarray, shape (m, 5)
        See `Levels`.
    radius : float
        The body's radius, m.
    points, normals : ndarray, shape (n, 3)
        Written, in the site frame, m and unit length; NaN in the sky.
    """
    for r in range(hits.shape[0]):
        if np.isnan(hits[r, 0]):
            points[r, :] = np.nan
            normals[r, :] = np.nan
        else:
            px, py, pz, nx, ny, nz, _ = _surface(hits[r, 0], hits[r, 1], heights, slots, frames, radius)
            points[r, 0], points[r, 1], points[r, 2] = px, py, pz
            normals[r, 0], normals[r, 1], normals[r, 2] = nx, ny, nz


@njit(cache=True, nogil=True, error_model="numpy")
def _beside(
    P: FloatArray,
    dx: float,
    dy: float,
    dz: float,
    begin: float,
    guess: float,
    rate: float,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    slope: float,
) -> tuple[float, float, float, float]:
    """Plane coordinates at which a ray meets the terrain, the height there, and the ray's closing speed.

    The search begins at the height `guess` and the closing speed `rate` of the ray beside it. A ray that is
    steeper than all terrain meets it only once: where the secant method ends, it is the first intersection.
    NaN for flatter rays, and where the method leaves the terrain or does not end.
    """
    tolerance = _TOLERANCE * frames[0, 0]
    pd = P[0] * dx + P[1] * dy + P[2] * dz
    root = pd * pd - (P[0] * P[0] + P[1] * P[1] + P[2] * P[2]) + (radius + guess) ** 2
    if root < 0.0:
        return np.nan, np.nan, guess, rate
    t = -pd - np.sqrt(root)
    t_before, f_before = t, 0.0
    for step in range(_SECANT_STEPS):
        x, y, z = P[0] + t * dx, P[1] + t * dy, P[2] + t * dz
        if t < begin or z <= 0.0:
            break
        scale = radius / z
        p = np.sqrt(x * x + y * y + z * z)
        if step == 0:
            # Above the terrain a ray is steeper than where it meets it.
            sink = -(x * dx + y * dy + z * dz) / p
            run = scale * np.sqrt((dx - x * dz / z) ** 2 + (dy - y * dz / z) ** 2)
            if sink < _STEEPER * slope * run:
                break
        gx, gy = x * scale, y * scale
        height = _height(gx, gy, heights, slots, frames)
        f = p - radius - height
        if step > 0:
            rate = (f_before - f) / (t - t_before)
        if abs(f) < tolerance:
            return gx, gy, height, rate
        if rate <= 0.0:
            break
        t_before, f_before = t, f
        t += f / rate
    return np.nan, np.nan, guess, rate


@njit(cache=True, nogil=True, error_model="numpy")
def trace(
    P: FloatArray,
    R: FloatArray,
    points: FloatArray,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    top: float,
    slope: float,
    hits: FloatArray,
) -> None:
    """Write the plane coordinates at which rays meet the terrain.

    Rays are best in the order of an image: each begins where the one before it met the terrain. Where that is
    not safe or not enough, steps from above are as long as the steepest slope allows.

    Parameters
    ----------
    P : ndarray, shape (3,)
        Position of the camera in the site frame, m.
    R : ndarray, shape (3, 3)
        Rotation from the camera to the site frame.
    points : ndarray, shape (n, 2)
        Normalised image coordinates of the rays.
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
    hits : ndarray, shape (n, 2)
        Written, m; NaN in the sky.
    """
    tolerance = _TOLERANCE * frames[0, 0]
    near = _NEAR * frames[0, 0]
    pp = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    # Height at which the ray before met the terrain, and its closing speed there.
    guess, rate = np.nan, 1.0
    for r in range(points.shape[0]):
        hits[r, 0] = np.nan
        hits[r, 1] = np.nan
        u = points[r, 0]
        v = points[r, 1]
        dx = R[0, 0] * u + R[0, 1] * v + R[0, 2]
        dy = R[1, 0] * u + R[1, 1] * v + R[1, 2]
        dz = R[2, 0] * u + R[2, 1] * v + R[2, 2]
        norm = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx /= norm
        dy /= norm
        dz /= norm
        pd = P[0] * dx + P[1] * dy + P[2] * dz
        root = pd * pd - pp + (radius + top) ** 2
        if root < 0.0 or pd >= 0.0:
            continue
        end = -pd + np.sqrt(root)
        t = max(0.0, -pd - np.sqrt(root))
        if not np.isnan(guess):
            gx, gy, guess, rate = _beside(
                P, dx, dy, dz, t, guess, rate, heights, slots, frames, radius, slope
            )
            if not np.isnan(gx):
                hits[r, 0] = gx
                hits[r, 1] = gy
                continue
        # Last points known to be above and below the terrain, and their heights over it.
        t_above, f_above = t, 0.0
        t_below, f_below = -1.0, 0.0
        for step in range(MAX_STEPS):
            x, y, z = P[0] + t * dx, P[1] + t * dy, P[2] + t * dz
            if t > end or z <= 0.0:
                break
            scale = radius / z
            p = np.sqrt(x * x + y * y + z * z)
            gx, gy = x * scale, y * scale
            height = _height(gx, gy, heights, slots, frames)
            f = p - radius - height
            # Where two grids meet, the terrain may have a step: then the bracket ends the search.
            if abs(f) < tolerance or (t_below >= 0.0 and t_below - t_above < tolerance):
                hits[r, 0] = gx
                hits[r, 1] = gy
                guess, rate = height, -(x * dx + y * dy + z * dz) / p
                break
            if f < 0.0:
                if step == 0:
                    break
                t_below, f_below = t, f
            elif t_below < 0.0:
                t_next = t
                if step > 0 and f < near and f < f_above:
                    t_next = t + f * (t - t_above) / (f_above - f)
                if t_next <= t or t_next > t + _LONGEST_SECANT * near:
                    sink = abs(x * dx + y * dy + z * dz) / p
                    run = scale * np.sqrt((dx - x * dz / z) ** 2 + (dy - y * dz / z) ** 2)
                    t_next = t + f / (sink + slope * run)
                t_above, f_above = t, f
                t = t_next
                continue
            else:
                t_above, f_above = t, f
            # Bracketed: false position, with a bisection every third step as it can stall.
            share = 0.5 if step % 3 == 2 else f_above / (f_above - f_below)
            t = t_above + share * (t_below - t_above)


@njit(cache=True, nogil=True, error_model="numpy")
def _sunlight(
    points: FloatArray,
    march: FloatArray,
    count: int,
    sun: FloatArray,
    sun_radius: float,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    top: float,
    slope: float,
) -> None:
    """Write the share of the sun's disc that is visible from each of `count` ground points, into `march`.

    All rays take a step before any takes the next: the steps of one ray wait for each other, those of
    different rays do not. Columns of `points` are x, y, z in the site frame, m; columns of `march` are the
    spacing of the point's grid, m, the closing speed, the distance from the point, m, and the share.
    """
    active = np.arange(count)
    for k in range(count):
        x, y, z = points[k]
        # How fast the ray climbs, and moves over the ground: further on it climbs faster.
        climb = (x * sun[0] + y * sun[1] + z * sun[2]) / np.sqrt(x * x + y * y + z * z)
        run = radius / z * np.sqrt((sun[0] - x * sun[2] / z) ** 2 + (sun[1] - y * sun[2] / z) ** 2)
        march[k, 1] = slope * run - climb
        march[k, 2] = _SHADOW_START * march[k, 0]
        # Until the end, the least height over the terrain, relative to the radius of the light's cone.
        march[k, 3] = 1.0
    left = count
    for _ in range(MAX_STEPS):
        going = 0
        for a in range(left):
            k = active[a]
            cell, closing, t, least = march[k]
            qx, qy, qz = points[k, 0] + t * sun[0], points[k, 1] + t * sun[1], points[k, 2] + t * sun[2]
            p = np.sqrt(qx * qx + qy * qy + qz * qz)
            if qz <= 0.0 or p > radius + top:
                continue
            scale = radius / qz
            f = p - radius - _height(qx * scale, qy * scale, heights, slots, frames) + _SHADOW_LIFT * cell
            cone = t * sun_radius
            if f < least * cone:
                march[k, 3] = max(f / cone, -1.0)
                if f <= -cone:
                    continue
            if closing <= 0.0 and f > cone:
                continue
            march[k, 2] = t + max(_SHADOW_STEP * cell, f / max(closing, _MIN_CLOSING))
            active[going] = k
            going += 1
        left = going
        if left == 0:
            break
    for k in range(count):
        march[k, 3] = 0.5 + 0.5 * march[k, 3]


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
    points, march = np.empty((_BLOCK, 3)), np.empty((_BLOCK, 4))
    lit = np.empty(_BLOCK, np.int64)
    for first in range(0, hits.shape[0], _BLOCK):
        count = 0
        for r in range(first, min(first + _BLOCK, hits.shape[0])):
            light[r] = 0.0
            if np.isnan(hits[r, 0]):
                continue
            x, y, z, nx, ny, nz, cell = _surface(hits[r, 0], hits[r, 1], heights, slots, frames, radius)
            mu0 = nx * sun[0] + ny * sun[1] + nz * sun[2]
            if mu0 <= 0.0:
                continue
            vx, vy, vz = P[0] - x, P[1] - y, P[2] - z
            range_m = np.sqrt(vx * vx + vy * vy + vz * vz)
            mu = max((nx * vx + ny * vy + nz * vz) / range_m, 0.0)
            cos_phase = (sun[0] * vx + sun[1] * vy + sun[2] * vz) / range_m
            light[r] = mu0 * reflectance(mu0, mu, cos_phase, law)
            points[count, 0], points[count, 1], points[count, 2] = x, y, z
            march[count, 0] = cell
            lit[count] = r
            count += 1
        _sunlight(points, march, count, sun, sun_radius, heights, slots, frames, radius, top, slope)
        for k in range(count):
            light[lit[k]] *= march[k, 3]
