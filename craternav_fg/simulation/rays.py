"""Rays through the height field: intersections with the terrain, and its normals.

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
# Pixels along the side of a tile: its part of the grids stays in the processor's second cache.
_TILE = 32
# Columns of a ray: direction; distances at which it enters and leaves the terrain's range of heights, where
# it is, and where it was before or above the terrain, with its height over it then; where it was below, and
# that height, m.
_DX, _DY, _DZ, _BEGIN, _END, _NOW, _BEFORE, _F_BEFORE, _BELOW, _F_BELOW = range(10)


def tiles(width: int, height: int) -> IntArray:
    """Order of an image's pixels, tile after tile, in which the kernels are fast.

    Parameters
    ----------
    width, height : int
        Of the image, pixels.

    Returns
    -------
    ndarray of int, shape (width * height,)
        Indices into the pixels in row order.
    """
    pixels = np.arange(width * height).reshape(height, width)
    rows, columns = (range(0, size, _TILE) for size in (height, width))
    return np.concatenate([pixels[j : j + _TILE, i : i + _TILE].ravel() for j in rows for i in columns])


@njit(cache=True, nogil=True, error_model="numpy")
def height_at(x: float, y: float, heights: Float32Array, slots: IntArray, frames: FloatArray) -> float:
    """Bilinear height at a plane point from the finest grid around it.

    Beyond all grids the terrain is level at the lowest height of their border: at a higher one it would
    surround them as a wall.

    Parameters
    ----------
    x, y : float
        Plane coordinates, m.
    heights : ndarray of float32, shape (slots, cells, cells)
        See `Levels`, m.
    slots : ndarray of int, shape (m,)
        See `Levels`.
    frames : ndarray, shape (m, 5)
        See `Levels`.

    Returns
    -------
    float
        m over the sphere.
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
def height_and_slopes(
    x: float, y: float, heights: Float32Array, slots: IntArray, frames: FloatArray
) -> tuple[float, float, float, float]:
    """Height, slopes along x and y (bilinear between central differences), and the spacing of their grid.

    Parameters
    ----------
    x, y : float
        Plane coordinates, m.
    heights : ndarray of float32, shape (slots, cells, cells)
        See `Levels`, m.
    slots : ndarray of int, shape (m,)
        See `Levels`.
    frames : ndarray, shape (m, 5)
        See `Levels`.

    Returns
    -------
    height, slope_x, slope_y, cell : float
        m, m/m, and m.
    """
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
def surface(
    gx: float, gy: float, height: float, hx: float, hy: float, radius: float
) -> tuple[float, float, float, float, float, float]:
    """Ground point and its unit normal in the site frame.

    Parameters
    ----------
    gx, gy, height, hx, hy : float
        Plane coordinates, m; height there, m, and its slopes along x and y, m/m.
    radius : float
        The body's radius, m.

    Returns
    -------
    x, y, z, nx, ny, nz : float
        m, and unit length.
    """
    s = np.sqrt(gx * gx + gy * gy + radius * radius)
    # Gradient of |p| - R - h(x(p), y(p)), with grad x = k (e_x - x/R e_z).
    k = s / (radius + height)
    nx = gx / s - k * hx
    ny = gy / s - k * hy
    nz = radius / s + k * (hx * gx + hy * gy) / radius
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    return gx / k, gy / k, radius / k, nx / norm, ny / norm, nz / norm


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
            gx, gy = hits[r]
            height, hx, hy, _ = height_and_slopes(gx, gy, heights, slots, frames)
            px, py, pz, nx, ny, nz = surface(gx, gy, height, hx, hy, radius)
            points[r, 0], points[r, 1], points[r, 2] = px, py, pz
            normals[r, 0], normals[r, 1], normals[r, 2] = nx, ny, nz


@njit(cache=True, nogil=True, error_model="numpy")
def _directions(P: FloatArray, R: FloatArray, points: FloatArray, top: float, rays: FloatArray) -> None:
    """Write the directions of rays, and where they enter and leave the sphere `top`, which holds all terrain.

    Rays that miss it get an end of -1.
    """
    pp = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    for k in range(points.shape[0]):
        u, v = points[k]
        dx = R[0, 0] * u + R[0, 1] * v + R[0, 2]
        dy = R[1, 0] * u + R[1, 1] * v + R[1, 2]
        dz = R[2, 0] * u + R[2, 1] * v + R[2, 2]
        norm = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx /= norm
        dy /= norm
        dz /= norm
        pd = P[0] * dx + P[1] * dy + P[2] * dz
        root = pd * pd - pp + top * top
        rays[k, _DX], rays[k, _DY], rays[k, _DZ] = dx, dy, dz
        rays[k, _BEGIN], rays[k, _END] = 0.0, -1.0
        if root >= 0.0 and pd < 0.0:
            half = np.sqrt(root)
            rays[k, _BEGIN], rays[k, _END] = max(0.0, -pd - half), half - pd


@njit(cache=True, nogil=True, error_model="numpy")
def _beside(
    P: FloatArray,
    rays: FloatArray,
    met: FloatArray,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    slope: float,
    hits: FloatArray,
) -> None:
    """Write the plane coordinates at which rays meet the terrain near their neighbours' intersections.

    The search begins at the height and the closing speed in `met`, which become the ray's own. A ray that is
    steeper than all terrain meets it only once: where the secant method ends, it is the first intersection.
    Flatter rays, and those for which the method leaves the terrain or does not end, are left as they are.
    All rays take a step before any takes the next: the steps of one ray wait for each other, those of
    different rays do not.
    """
    tolerance = _TOLERANCE * frames[0, 0]
    pp = P[0] * P[0] + P[1] * P[1] + P[2] * P[2]
    active = np.empty(rays.shape[0], np.int64)
    left = 0
    for k in range(rays.shape[0]):
        pd = P[0] * rays[k, _DX] + P[1] * rays[k, _DY] + P[2] * rays[k, _DZ]
        root = pd * pd - pp + (radius + met[k, 0]) ** 2
        # False also for rays whose neighbour met nothing.
        if root >= 0.0 and rays[k, _END] >= 0.0:
            rays[k, _NOW] = -pd - np.sqrt(root)
            active[left] = k
            left += 1
    for step in range(_SECANT_STEPS):
        going = 0
        for a in range(left):
            k = active[a]
            dx, dy, dz, t = rays[k, _DX], rays[k, _DY], rays[k, _DZ], rays[k, _NOW]
            x, y, z = P[0] + t * dx, P[1] + t * dy, P[2] + t * dz
            if t < rays[k, _BEGIN] or z <= 0.0:
                continue
            scale = radius / z
            p = np.sqrt(x * x + y * y + z * z)
            if step == 0:
                # Above the terrain a ray is steeper than where it meets it.
                sink = -(x * dx + y * dy + z * dz) / p
                run = scale * np.sqrt((dx - x * dz / z) ** 2 + (dy - y * dz / z) ** 2)
                if sink < _STEEPER * slope * run:
                    continue
            gx, gy = x * scale, y * scale
            height = height_at(gx, gy, heights, slots, frames)
            f = p - radius - height
            rate = met[k, 1]
            if step > 0:
                rate = (rays[k, _F_BEFORE] - f) / (t - rays[k, _BEFORE])
            if abs(f) < tolerance:
                hits[k, 0], hits[k, 1] = gx, gy
                met[k, 0], met[k, 1] = height, rate
            elif rate > 0.0:
                rays[k, _BEFORE], rays[k, _F_BEFORE] = t, f
                rays[k, _NOW] = t + f / rate
                active[going] = k
                going += 1
        left = going
        if left == 0:
            break


@njit(cache=True, nogil=True, error_model="numpy")
def _march(
    P: FloatArray,
    rays: FloatArray,
    met: FloatArray,
    heights: Float32Array,
    slots: IntArray,
    frames: FloatArray,
    radius: float,
    slope: float,
    hits: FloatArray,
) -> None:
    """Write the plane coordinates at which rays without any first meet the terrain, by steps from above.

    The steps are as long as the steepest slope allows; all rays take one before any takes the next.
    """
    tolerance = _TOLERANCE * frames[0, 0]
    near = _NEAR * frames[0, 0]
    active = np.empty(rays.shape[0], np.int64)
    left = 0
    for k in range(rays.shape[0]):
        if np.isnan(hits[k, 0]) and rays[k, _END] >= 0.0:
            # Last points known to be above and below the terrain, and their heights over it.
            rays[k, _NOW] = rays[k, _BEFORE] = rays[k, _BEGIN]
            rays[k, _F_BEFORE], rays[k, _BELOW], rays[k, _F_BELOW] = 0.0, -1.0, 0.0
            active[left] = k
            left += 1
    for step in range(MAX_STEPS):
        going = 0
        for a in range(left):
            k = active[a]
            dx, dy, dz, t = rays[k, _DX], rays[k, _DY], rays[k, _DZ], rays[k, _NOW]
            t_above, f_above = rays[k, _BEFORE], rays[k, _F_BEFORE]
            t_below, f_below = rays[k, _BELOW], rays[k, _F_BELOW]
            x, y, z = P[0] + t * dx, P[1] + t * dy, P[2] + t * dz
            if t > rays[k, _END] or z <= 0.0:
                continue
            scale = radius / z
            p = np.sqrt(x * x + y * y + z * z)
            gx, gy = x * scale, y * scale
            height = height_at(gx, gy, heights, slots, frames)
            f = p - radius - height
            # Where two grids meet, the terrain may have a step: then the bracket ends the search.
            if abs(f) < tolerance or (t_below >= 0.0 and t_below - t_above < tolerance):
                hits[k, 0], hits[k, 1] = gx, gy
                met[k, 0], met[k, 1] = height, -(x * dx + y * dy + z * dz) / p
                continue
            if f < 0.0 and step == 0:
                continue
            if f >= 0.0 and t_below < 0.0:
                t_next = t
                if step > 0 and f < near and f < f_above:
                    t_next = t + f * (t - t_above) / (f_above - f)
                if t_next <= t or t_next > t + _LONGEST_SECANT * near:
                    sink = abs(x * dx + y * dy + z * dz) / p
                    run = scale * np.sqrt((dx - x * dz / z) ** 2 + (dy - y * dz / z) ** 2)
                    t_next = t + f / (sink + slope * run)
                t_above, f_above = t, f
            else:
                if f < 0.0:
                    t_below, f_below = t, f
                else:
                    t_above, f_above = t, f
                # Bracketed: false position, with a bisection every third step as it can stall.
                share = 0.5 if step % 3 == 2 else f_above / (f_above - f_below)
                t_next = t_above + share * (t_below - t_above)
            rays[k, _NOW], rays[k, _BEFORE], rays[k, _F_BEFORE] = t_next, t_above, f_above
            rays[k, _BELOW], rays[k, _F_BELOW] = t_below, f_below
            active[going] = k
            going += 1
        left = going
        if left == 0:
            break


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

    Rays are best in the order of `tiles`: each begins where the ray a row above it met the terrain. Where
    that is not safe or not enough, steps from above are as long as the steepest slope allows.

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
    rays = np.empty((_TILE, 10))
    # Height at which the ray of each column met the terrain last, and its closing speed there.
    met = np.full((_TILE, 2), np.nan)
    hits[:] = np.nan
    for first in range(0, points.shape[0], _TILE):
        row = points[first : first + _TILE]
        found = hits[first : first + _TILE]
        _directions(P, R, row, radius + top, rays)
        count = row.shape[0]
        _beside(P, rays[:count], met[:count], heights, slots, frames, radius, slope, found)
        _march(P, rays[:count], met[:count], heights, slots, frames, radius, slope, found)
