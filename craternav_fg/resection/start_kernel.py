"""Initial poses in closed form, without a prior.

Turn the camera to a frame v that points at a rim. There the rim's plane is imaged, near the rim's centre, by
an affine map A = B / d: B is the upper left 2 x 2 part of the rotation vRl, d the depth.

- The rim's image S = A C A', C = diag(a^2, b^2), gives A up to one angle: A = S^(1/2) U C^(-1/2) with U
  orthogonal.
- The direction to another crater's centre gives that angle, because lines through the line of sight stay
  straight.
- B'B = I - r r', r the first two elements of the third row of vRl: its eigenvalue 1 gives d, the other one r
  except for the sign. Each A thus stands for two poses, which are mirror images of each other in a distant
  view.
"""

import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import moments_kernel
from factors.arrays import FloatArray
from factors.kernels.compiled import njit
from factors.kernels.conic import chart_to_conic
from factors.kernels.los import line_of_sight


@njit(cache=True, error_model="numpy")
def looking(chart: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn a camera to point at the centre of an image ellipse.

    Parameters
    ----------
    chart : ndarray, shape (5,)
        Ellipse chart in normalised image coordinates of c.

    Returns
    -------
    vRc : ndarray, shape (3, 3)
        Rotation from c to the turned frame v.
    m : ndarray, shape (2,)
        Centre of the ellipse in normalised image coordinates of v: near 0.
    root : ndarray, shape (2, 2)
        Lower triangular square root of that ellipse's S, normalised image coordinates of v.
    """
    vRc = np.empty((3, 3))
    norm = np.sqrt(chart[0] * chart[0] + chart[1] * chart[1] + 1.0)
    z0, z1, z2 = chart[0] / norm, chart[1] / norm, 1.0 / norm
    side = np.sqrt(z2 * z2 + z0 * z0)
    vRc[2, 0], vRc[2, 1], vRc[2, 2] = z0, z1, z2
    vRc[0, 0], vRc[0, 1], vRc[0, 2] = z2 / side, 0.0, -z0 / side
    # y = z x x
    vRc[1, 0] = z1 * vRc[0, 2]
    vRc[1, 1] = z2 * vRc[0, 0] - z0 * vRc[0, 2]
    vRc[1, 2] = -z1 * vRc[0, 0]
    sxx, sxy, syy = moments_kernel(chart[2], chart[3], chart[4])
    Q = np.empty((3, 3))
    Q[0, 0] = chart[0] * chart[0] - sxx
    Q[0, 1] = chart[0] * chart[1] - sxy
    Q[1, 1] = chart[1] * chart[1] - syy
    Q[0, 2], Q[1, 2], Q[2, 2] = chart[0], chart[1], 1.0
    Q[1, 0], Q[2, 0], Q[2, 1] = Q[0, 1], Q[0, 2], Q[1, 2]
    V = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for r in range(3):
                    V[i, j] += vRc[i, k] * Q[k, r] * vRc[j, r]
    m = np.empty(2)
    m[0], m[1] = V[0, 2] / V[2, 2], V[1, 2] / V[2, 2]
    root = np.zeros((2, 2))
    root[0, 0] = np.sqrt(m[0] * m[0] - V[0, 0] / V[2, 2])
    root[1, 0] = (m[0] * m[1] - V[0, 1] / V[2, 2]) / root[0, 0]
    root[1, 1] = np.sqrt(m[1] * m[1] - V[1, 1] / V[2, 2] - root[1, 0] * root[1, 0])
    return vRc, m, root


@njit(cache=True, error_model="numpy")
def rim_frame(axes: FloatArray) -> tuple[FloatArray, float, float]:
    """Split the semi-axes of a rim into rotation and lengths.

    Parameters
    ----------
    axes : ndarray, shape (2, 3)
        Semi-axes a l1 and b l2 in g, m.

    Returns
    -------
    gRl : ndarray, shape (3, 3)
        Rotation from the crater's frame to g.
    a, b : float
        Lengths, m.
    """
    gRl = np.empty((3, 3))
    a = np.sqrt(axes[0, 0] ** 2 + axes[0, 1] ** 2 + axes[0, 2] ** 2)
    b = np.sqrt(axes[1, 0] ** 2 + axes[1, 1] ** 2 + axes[1, 2] ** 2)
    for i in range(3):
        gRl[i, 0] = axes[0, i] / a
        gRl[i, 1] = axes[1, i] / b
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        gRl[i, 2] = gRl[j, 0] * gRl[k, 1] - gRl[k, 0] * gRl[j, 1]
    return gRl, a, b


@njit(cache=True, error_model="numpy")
def place(gRc: FloatArray, p: FloatArray, centre: FloatArray, bTc: FloatArray, gTb: FloatArray) -> None:
    """Compute the body's pose for which the camera sees a point at a given place.

    Parameters
    ----------
    gRc : ndarray, shape (3, 3)
        Rotation of the camera.
    p : ndarray, shape (3,)
        The point in c, m.
    centre : ndarray, shape (3,)
        The point in g, m.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    gTb : ndarray, shape (4, 4)
        Written: the pose.
    """
    gTb[:] = 0.0
    gTb[3, 3] = 1.0
    for i in range(3):
        gTb[i, 3] = centre[i]
        for j in range(3):
            gTb[i, 3] -= gRc[i, j] * p[j]
            for k in range(3):
                gTb[i, j] += gRc[i, k] * bTc[j, k]
    for i in range(3):
        for j in range(3):
            gTb[i, 3] -= gTb[i, j] * bTc[j, 3]


@njit(cache=True, error_model="numpy")
def _roll(
    i: int, j: int, vRc: FloatArray, m: FloatArray, root: FloatArray, gRl: FloatArray, a: float, b: float,
    centres: FloatArray, charts: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Vector in the direction of the angle of U for which the centre of crater j is seen where it is."""
    x = y = 0.0
    for k in range(3):
        x += gRl[k, 0] * (centres[j, k] - centres[i, k])
        y += gRl[k, 1] * (centres[j, k] - centres[i, k])
    x, y = x / a, -y / b
    q = np.empty(3)
    for k in range(3):
        q[k] = vRc[k, 0] * charts[j, 0] + vRc[k, 1] * charts[j, 1] + vRc[k, 2]
    s = (q[0] / q[2] - m[0]) / root[0, 0]
    t = (q[1] / q[2] - m[1] - root[1, 0] * s) / root[1, 1]
    length = np.sqrt(s * s + t * t)
    return (s * x + t * y) / length, (t * x - s * y) / length


@njit(cache=True, error_model="numpy")
def two_poses(
    angle: float, vRc: FloatArray, root: FloatArray, gRl: FloatArray, a: float, b: float,
    chart: FloatArray, centre: FloatArray, bTc: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Compute the two poses of one rim for one angle of U; see the module's docstring.

    Parameters
    ----------
    angle : float
        Rotation angle of U, rad.
    vRc : ndarray, shape (3, 3)
        Rotation from `looking`.
    root : ndarray, shape (2, 2)
        From `looking`.
    gRl : ndarray, shape (3, 3)
        Rotation from `rim_frame`.
    a, b : float
        Semi-axes, m.
    chart : ndarray, shape (5,)
        Chart of the rim, normalised image coordinates.
    centre : ndarray, shape (3,)
        Centre of the rim in g, m.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    out : ndarray, shape (2, 4, 4)
        Written: poses gTb.
    """
    c, s = np.cos(angle), np.sin(angle)
    # U = Rot(angle) diag(1, -1): the outward normal points to the camera.
    A = np.empty((2, 2))
    A[0, 0], A[0, 1] = root[0, 0] * c / a, root[0, 0] * s / b
    A[1, 0] = (root[1, 0] * c + root[1, 1] * s) / a
    A[1, 1] = (root[1, 0] * s - root[1, 1] * c) / b
    m00 = A[0, 0] ** 2 + A[1, 0] ** 2
    m01 = A[0, 0] * A[0, 1] + A[1, 0] * A[1, 1]
    m11 = A[0, 1] ** 2 + A[1, 1] ** 2
    half, mean = 0.5 * (m00 - m11), 0.5 * (m00 + m11)
    spread = np.sqrt(half * half + m01 * m01)
    large, small = mean + spread, mean - spread
    d = 1.0 / np.sqrt(large)
    # Angle of the eigenvector of the smaller eigenvalue.
    axis = 0.5 * np.arctan2(m01, half) + 0.5 * np.pi
    length = np.sqrt(max(1.0 - small / large, 0.0))
    q = chart_to_conic(chart)
    vRl = np.empty((3, 3))
    cRl = np.empty((3, 3))
    gRc = np.empty((3, 3))
    for sign in range(2):
        r = length if sign == 0 else -length
        vRl[0, 0], vRl[0, 1], vRl[1, 0], vRl[1, 1] = d * A[0, 0], d * A[0, 1], d * A[1, 0], d * A[1, 1]
        vRl[2, 0], vRl[2, 1] = r * np.cos(axis), r * np.sin(axis)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            vRl[i, 2] = vRl[j, 0] * vRl[k, 1] - vRl[k, 0] * vRl[j, 1]
        for i in range(3):
            for j in range(3):
                cRl[i, j] = vRc[0, i] * vRl[0, j] + vRc[1, i] * vRl[1, j] + vRc[2, i] * vRl[2, j]
        for i in range(3):
            for j in range(3):
                gRc[i, j] = gRl[i, 0] * cRl[j, 0] + gRl[i, 1] * cRl[j, 1] + gRl[i, 2] * cRl[j, 2]
        u = line_of_sight(q, np.ascontiguousarray(cRl[:, 2]))
        depth = vRc[2, 0] * u[0] + vRc[2, 1] * u[1] + vRc[2, 2] * u[2]
        place(gRc, u * (d / depth), centre, bTc, out[sign])


@njit(cache=True, error_model="numpy")
def starts_of_one(
    rolls: int, bTc: FloatArray, centre: FloatArray, axes: FloatArray, chart: FloatArray
) -> FloatArray:
    """Sample the poses of a single rim: both planes, at equal steps of the angle that it leaves free.

    Parameters
    ----------
    rolls : int
        Number of steps.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centre : ndarray, shape (3,)
        Centre of the rim in g, m.
    axes : ndarray, shape (2, 3)
        Semi-axes in g, m.
    chart : ndarray, shape (5,)
        Chart of the rim, normalised image coordinates.

    Returns
    -------
    ndarray, shape (2 rolls, 4, 4)
        Poses gTb; the two planes alternate.
    """
    out = np.empty((2 * rolls, 4, 4))
    vRc, _, root = looking(chart)
    gRl, a, b = rim_frame(axes)
    for k in range(rolls):
        two_poses(2.0 * np.pi * k / rolls, vRc, root, gRl, a, b, chart, centre, bTc, out[2 * k : 2 * k + 2])
    return out


@njit(cache=True, error_model="numpy")
def start_pair(
    i: int, partners: npt.NDArray[np.int64], bTc: FloatArray, centres: FloatArray, axes: FloatArray,
    charts: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Compute the two poses that one rim and the centres of others give.

    Parameters
    ----------
    i : int
        The rim.
    partners : ndarray of int, shape (m,)
        The others; i itself is ignored.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centres, axes, charts : ndarray, shapes (n, 3), (n, 2, 3), (n, 5)
        See `MatchedRims`.
    out : ndarray, shape (2, 4, 4)
        Written: poses gTb.
    """
    vRc, m, root = looking(charts[i])
    gRl, a, b = rim_frame(axes[i])
    x = y = 0.0
    for j in partners:
        if j != i:
            dx, dy = _roll(i, j, vRc, m, root, gRl, a, b, centres, charts)
            x += dx
            y += dy
    two_poses(np.arctan2(y, x), vRc, root, gRl, a, b, charts[i], centres[i], bTc, out)


@njit(cache=True, error_model="numpy")
def start_at_attitude(
    gRb: FloatArray, bTc: FloatArray, centre: FloatArray, axes: FloatArray, chart: FloatArray,
    gTb: FloatArray,
) -> None:  # fmt: skip
    """Compute the pose that a single rim gives with a known attitude.

    Parameters
    ----------
    gRb : ndarray, shape (3, 3)
        Known rotation of the body.
    bTc : ndarray, shape (4, 4)
        Mounting of the camera.
    centre : ndarray, shape (3,)
        Centre of the rim in g, m.
    axes : ndarray, shape (2, 3)
        Semi-axes in g, m.
    chart : ndarray, shape (5,)
        Chart of the rim, normalised image coordinates.
    gTb : ndarray, shape (4, 4)
        Written: the pose.
    """
    vRc, _, root = looking(chart)
    gRl, a, b = rim_frame(axes)
    gRc = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                gRc[i, j] += gRb[i, k] * bTc[k, j]
    n_c = np.zeros(3)
    B = np.zeros((2, 2))
    for i in range(3):
        for k in range(3):
            n_c[i] += gRc[k, i] * gRl[k, 2]
    for i in range(2):
        for j in range(2):
            for k in range(3):
                for r in range(3):
                    B[i, j] += vRc[i, k] * gRc[r, k] * gRl[r, j]
    area = np.abs(B[0, 0] * B[1, 1] - B[0, 1] * B[1, 0]) * a * b
    d = np.sqrt(area / (root[0, 0] * root[1, 1]))
    u = line_of_sight(chart_to_conic(chart), n_c)
    depth = vRc[2, 0] * u[0] + vRc[2, 1] * u[1] + vRc[2, 2] * u[2]
    place(gRc, u * (d / depth), centre, bTc, gTb)
