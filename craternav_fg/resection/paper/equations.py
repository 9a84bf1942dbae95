"""Residuals of the paper's static methods, with their derivatives: eqs. (10), (13), (19), (23), (25).

Each gives the residual e (m,) and its Jacobian J (m, 6) for the camera's right twist [w, rho]. The
`*_noise` give the covariance (m, m) of e by the charts' noise, which an unweighted estimate does not use but
has its own covariance from. The conics are scaled to |q| = 1 and (19), (23) take lengths in km, the paper's
unit: both matter, since nothing weighs the rows against one another.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from craternav_fg.ellipse import conic_jacobians, conics_of_charts
from craternav_fg.measurements import SunTilt
from craternav_fg.resection.problem import MatchedRims
from factors.kernels import los, shape
from factors.kernels.sun import sun_tilt, wrap

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_UNIT_M = 1e3


@dataclass(frozen=True)
class PaperRims:
    """Matched rims in the quantities that the paper's equations are written in."""

    rims: MatchedRims

    @cached_property
    def conics(self) -> FloatArray:
        """Conics q (n, 6) of eq. (2), |q| = 1."""
        return conics_of_charts(self.rims.chart)

    @cached_property
    def conic_slopes(self) -> FloatArray:
        """Derivatives (n, 6, 5) of the conics in the charts."""
        return conic_jacobians(self.rims.chart)

    @cached_property
    def semi_axes(self) -> FloatArray:
        """Rim semi-axes a and b (n, 2), m."""
        return np.linalg.norm(self.rims.axes, axis=2)

    @cached_property
    def gRl(self) -> FloatArray:
        """Attitudes (n, 3, 3) of the crater-local frames."""
        units = self.rims.axes / self.semi_axes[:, :, None]
        return np.stack([units[:, 0], units[:, 1], self.normals], axis=-1)

    @cached_property
    def normals(self) -> FloatArray:
        """Outward unit normals (n, 3) of the rims' planes in g."""
        return self.rims.normals

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """First and second rim of each pair."""
        return np.triu_indices(len(self.rims), 1)

    @cached_property
    def image_centres(self) -> FloatArray:
        """Directions (n, 3) in c to the centres of the image ellipses, eq. (4)."""
        v = np.column_stack([self.rims.chart[:, :2], np.ones(len(self.rims))])
        return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))

    def true_centres(self, gRc: FloatArray) -> FloatArray:
        """Directions (n, 3) in c to the craters' centres, eq. (9), for an attitude of the camera."""
        normals = self.normals @ gRc
        return np.array([los.line_of_sight(q, n) for q, n in zip(self.conics, normals, strict=True)])


def angles(seen: PaperRims, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eq. (10): cosines between craters seen from a position less those between their image centres.

    Each pair stands twice in the sum.

    Parameters
    ----------
    seen : PaperRims
    position : ndarray, shape (3,)
        Of the camera in g, m.

    Returns
    -------
    e : ndarray, shape (pairs,)
    J : ndarray, shape (pairs, 3)
        In the position.
    """
    i, j = seen.pairs
    d = position - seen.rims.centres
    length = np.linalg.norm(d, axis=1)
    u = d / length[:, None]
    cosine = np.sum(u[i] * u[j], axis=1)
    slope_i = (u[j] - cosine[:, None] * u[i]) / length[i, None]
    slope_j = (u[i] - cosine[:, None] * u[j]) / length[j, None]
    v = seen.image_centres
    measured = np.sum(v[i] * v[j], axis=1)
    return np.sqrt(2.0) * (cosine - measured), np.sqrt(2.0) * (slope_i + slope_j)


def angle_slopes(seen: PaperRims) -> FloatArray:
    """Give the derivatives (n, pairs, 3) of eq. (10)'s residual in each image centre."""
    i, j = seen.pairs
    v = seen.image_centres
    out = np.zeros((len(v), len(i), 3))
    pair = np.arange(len(i))
    out[i, pair] -= np.sqrt(2.0) * v[j]
    out[j, pair] -= np.sqrt(2.0) * v[i]
    return out


def lines_of_sight(
    seen: PaperRims, gTc: FloatArray, *, printed_sign: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Eq. (11): direction to each crater's centre less K n_c / |K n_c|.

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
    printed_sign : bool
        Take P - L as printed: with outward normals no pose that sees the rims from outside fulfils it. Two
        craters on one plane are seen so from beneath it, from the pose turned by half a turn about the line
        through their centres.

    Returns
    -------
    e : ndarray, shape (n, 3)
    J : ndarray, shape (n, 3, 6)
    """
    sign = -1.0 if printed_sign else 1.0
    R, P = gTc[:3, :3], gTc[:3, 3]
    p = (seen.rims.centres - P) @ R
    normals = seen.normals @ R
    range_m = np.linalg.norm(p, axis=1)[:, None]
    pu = p / range_m
    K = _line_matrices(seen.conics)
    v = np.einsum("nij,nj->ni", K, normals)
    length = np.linalg.norm(v, axis=1)[:, None]
    vu = v / length
    # dp = [p]x w - rho, dn = [n]x w
    dp = np.concatenate([cross(p), np.broadcast_to(-np.eye(3), (len(p), 3, 3))], axis=2)
    dv = K @ cross(normals)
    J = sign * (dp - pu[:, :, None] * np.einsum("ni,nij->nj", pu, dp)[:, None, :]) / range_m[:, :, None]
    turned = (dv - vu[:, :, None] * np.einsum("ni,nij->nj", vu, dv)[:, None, :]) / length[:, :, None]
    J[:, :, :3] -= turned
    return sign * pu - vu, J


def line_slopes(seen: PaperRims, gRc: FloatArray) -> FloatArray:
    """Give the derivatives (n, 3, 5) of the directions K n_c / |K n_c| in the charts."""
    normals = seen.normals @ gRc
    slopes = [los.line_of_sight_jacobian(q, n) for q, n in zip(seen.conics, normals, strict=True)]
    return np.array(slopes) @ seen.conic_slopes


def shapes(seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eq. (19), lengths in km: residuals (n, 5), Jacobians (n, 5, 6), derivatives in the charts (n, 5, 5)."""
    scaled = gTc.copy()
    scaled[:3, 3] /= _UNIT_M
    h, H, D, _ = shape.shape_jacobian(
        scaled, np.eye(4), seen.rims.centres / _UNIT_M, seen.gRl, seen.semi_axes / _UNIT_M, seen.conics
    )
    H[:, :, 3:] /= _UNIT_M
    return h, H, D @ seen.conic_slopes


def edges(seen: PaperRims, gTc: FloatArray, *, printed_sign: bool = False) -> tuple[FloatArray, FloatArray]:
    """Eq. (13): the lines of sight of all craters."""
    e, J = lines_of_sight(seen, gTc, printed_sign=printed_sign)
    return e.ravel(), J.reshape(-1, 6)


def edges_noise(seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Covariance of the residual of (13)."""
    return _noise(seen, -line_slopes(seen, gTc[:3, :3]))


def two_craters(
    seen: PaperRims, gTc: FloatArray, *, printed_sign: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Eq. (23): the lines of sight and the first two rows of (19), of any number of craters."""
    e, J = lines_of_sight(seen, gTc, printed_sign=printed_sign)
    h, H, _ = shapes(seen, gTc)
    return np.concatenate([e, h[:, :2]], axis=1).ravel(), np.concatenate([J, H[:, :2]], axis=1).reshape(-1, 6)


def two_craters_noise(seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Covariance of the residual of (23)."""
    _, _, D = shapes(seen, gTc)
    return _noise(seen, np.concatenate([-line_slopes(seen, gTc[:3, :3]), D[:, :2]], axis=1))


def conic_shapes(seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eq. (19) of all craters."""
    h, H, _ = shapes(seen, gTc)
    return h.ravel(), H.reshape(-1, 6)


def conic_shapes_noise(seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Covariance of the residual of (19)."""
    _, _, D = shapes(seen, gTc)
    return _noise(seen, D)


def with_sun(sun: SunTilt, seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eq. (25): (19) and the sun's tilt (24), in perspective and with atan2."""
    e, J = conic_shapes(seen, gTc)
    J_sun = np.empty((1, 6))
    tilt, _ = sun_tilt(gTc, np.eye(4), sun.direction, sun.point[0], sun.point[1], J_sun)
    return np.append(e, wrap(tilt - sun.tilt_rad)), np.concatenate([J, J_sun])


def with_sun_noise(sun: SunTilt, seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Covariance of the residual of (25)."""
    noise = np.pad(conic_shapes_noise(seen, gTc), (0, 1))
    noise[-1, -1] = sun.sigma_rad**2
    return noise


def cross(v: FloatArray) -> FloatArray:
    """Matrices [v]x, shape (n, 3, 3), of vectors (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2] = -v[:, 2], v[:, 1]
    out[:, 1, 0], out[:, 1, 2] = v[:, 2], -v[:, 0]
    out[:, 2, 0], out[:, 2, 1] = -v[:, 1], v[:, 0]
    return out


def _noise(seen: PaperRims, D: FloatArray) -> FloatArray:
    """Block-diagonal covariance of rows whose derivatives in their rim's chart are D (n, k, 5)."""
    return np.asarray(block_diag(*(D @ seen.rims.covariance @ np.swapaxes(D, 1, 2))))


def _line_matrices(q: FloatArray) -> FloatArray:
    """K = -4 adj(Q) of eq. (12), shape (n, 3, 3)."""
    A, B, C, D, E, F = q.T
    k1, k2, k3 = 2 * C * D - B * E, 2 * A * E - B * D, B * B - 4 * A * C
    k4, k5, k6 = E * E - 4 * C * F, 2 * B * F - D * E, D * D - 4 * A * F
    rows = [[k4, k5, k1], [k5, k6, k2], [k1, k2, k3]]
    return np.moveaxis(np.array(rows), 2, 0)
