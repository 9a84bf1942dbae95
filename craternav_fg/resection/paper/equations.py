"""Residuals of the paper's resection methods and their derivatives: eqs. (10), (13), (19), (23), (25).

Each function returns the residual e (m,) and its Jacobian J (m, 6) for the camera's right twist [w, rho]. The
functions `*_noise` return the covariance (m, m) of e due to the charts' noise: the unweighted estimate does
not use it, but its covariance follows from it.

Conics are scaled to |q| = 1, and (19) and (23) take lengths in km, the paper's unit. Both choices matter:
without weights they decide how the rows count against one another.

References
----------
Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966; docs/equations.md.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from craternav_fg.ellipse import conics_of_charts
from craternav_fg.measurements import SunTilt
from craternav_fg.resection.problem import MatchedRims
from factors.arrays import FloatArray, IntArray
from factors.kernels import los, shape
from factors.kernels.sun import sun_tilt, wrap

# The paper's unit of length.
_UNIT_M = 1e3


@dataclass(frozen=True)
class PaperRims:
    """Matched rims in the quantities of the paper's equations.

    Attributes
    ----------
    rims : MatchedRims
    """

    rims: MatchedRims

    @cached_property
    def conics(self) -> FloatArray:
        """Conics q of the image ellipses, shape (n, 6), normalised to |q| = 1.

        References
        ----------
        Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (2); docs/equations.md.
        """
        return conics_of_charts(self.rims.chart)[0]

    @cached_property
    def conic_slopes(self) -> FloatArray:
        """Derivatives of the conics in the charts, shape (n, 6, 5)."""
        return conics_of_charts(self.rims.chart)[1]

    @cached_property
    def semi_axes(self) -> FloatArray:
        """Semi-axes a and b of the rims, m, shape (n, 2)."""
        return np.linalg.norm(self.rims.axes, axis=2)

    @cached_property
    def gRl(self) -> FloatArray:
        """Rotations from the craters' local frames l to g, shape (n, 3, 3)."""
        units = self.rims.axes / self.semi_axes[:, :, None]
        return np.stack([units[:, 0], units[:, 1], self.normals], axis=-1)

    @cached_property
    def normals(self) -> FloatArray:
        """Outward unit normals of the rims' planes in g, shape (n, 3)."""
        return self.rims.normals

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """Rows of the first and of the second rim of each pair, shape (pairs,) each."""
        return np.triu_indices(len(self.rims), 1)

    @cached_property
    def image_centres(self) -> FloatArray:
        """Unit vectors in c to the centres of the image ellipses, shape (n, 3).

        References
        ----------
        Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (4); docs/equations.md.
        """
        v = np.column_stack([self.rims.chart[:, :2], np.ones(len(self.rims))])
        return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))

    def true_centres(self, gRc: FloatArray) -> FloatArray:
        """Compute the directions to the craters' centres from the rims' images.

        Parameters
        ----------
        gRc : ndarray, shape (3, 3)
            Rotation of the camera.

        Returns
        -------
        ndarray, shape (n, 3)
            Unit vectors in c.

        References
        ----------
        Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (9); docs/equations.md.
        """
        normals = self.normals @ gRc
        return np.array([los.line_of_sight(q, n) for q, n in zip(self.conics, normals, strict=True)])


def angles(seen: PaperRims, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eq. (10): cosines of angles between craters less cosines of angles between their image centres.

    Each pair stands twice in the printed sum, hence the factor of the root of 2.

    Parameters
    ----------
    seen : PaperRims
    position : ndarray, shape (3,)
        Position of the camera in g, m.

    Returns
    -------
    e : ndarray, shape (pairs,)
        Residual, differences of cosines.
    J : ndarray, shape (pairs, 3)
        Jacobian in the position in g, per m.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (10); docs/equations.md.
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
    """Differentiate the residual of eq. (10) in the directions to the image centres.

    Parameters
    ----------
    seen : PaperRims

    Returns
    -------
    ndarray, shape (n, pairs, 3)
        Derivatives in unit vectors in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (10); docs/equations.md.
    """
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
        Pose of the camera.
    printed_sign : bool
        Use P - L as printed. With outward normals, no pose that sees the rims from outside then gives zero.
        Two craters on one plane give zero from beneath it: the pose rotated by 180 deg about the line through
        their centres.

    Returns
    -------
    e : ndarray, shape (n, 3)
        Residual, differences of unit vectors in c.
    J : ndarray, shape (n, 3, 6)
        Jacobian for the camera's right twist [w, rho], per rad and m in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (9), (11), (12);
    docs/equations.md.
    """
    sign = -1.0 if printed_sign else 1.0
    e, J = los.lines_of_sight(gTc, seen.rims.centres, seen.normals, seen.conics, sign)
    return np.asarray(e), np.asarray(J)


def line_slopes(seen: PaperRims, gRc: FloatArray) -> FloatArray:
    """Differentiate the directions K n_c / |K n_c| in the charts.

    Parameters
    ----------
    seen : PaperRims
    gRc : ndarray, shape (3, 3)
        Rotation of the camera.

    Returns
    -------
    ndarray, shape (n, 3, 5)
        Derivatives of unit vectors in c.
    """
    normals = seen.normals @ gRc
    slopes = [los.line_of_sight_jacobian(q, n) for q, n in zip(seen.conics, normals, strict=True)]
    return np.array(slopes) @ seen.conic_slopes


def shapes(seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eq. (19), with lengths in km.

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    h : ndarray, shape (n, 5)
        Residuals, in units of km^2 for |q| = 1.
    H : ndarray, shape (n, 5, 6)
        Jacobians for the camera's right twist [w, rho], per rad and m in c.
    D : ndarray, shape (n, 5, 5)
        Derivatives of the residuals in the charts.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (19); docs/equations.md.
    """
    scaled = gTc.copy()
    scaled[:3, 3] /= _UNIT_M
    h, H, D, _ = shape.shape_jacobian(
        scaled, np.eye(4), seen.rims.centres / _UNIT_M, seen.gRl, seen.semi_axes / _UNIT_M, seen.conics
    )
    H[:, :, 3:] /= _UNIT_M
    return h, H, D @ seen.conic_slopes


def edges(seen: PaperRims, gTc: FloatArray, *, printed_sign: bool = False) -> tuple[FloatArray, FloatArray]:
    """Eq. (13): the lines of sight of all craters.

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.
    printed_sign : bool
        See `lines_of_sight`.

    Returns
    -------
    e : ndarray, shape (3 n,)
        Residual, differences of unit vectors in c.
    J : ndarray, shape (3 n, 6)
        Jacobian for the camera's right twist [w, rho], per rad and m in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (13); docs/equations.md.
    """
    e, J = lines_of_sight(seen, gTc, printed_sign=printed_sign)
    return e.ravel(), J.reshape(-1, 6)


def edges_noise(seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Compute the covariance of the residual of eq. (13).

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    ndarray, shape (3 n, 3 n)
        Covariance due to the charts' noise.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (13); docs/equations.md.
    """
    return _noise(seen, -line_slopes(seen, gTc[:3, :3]))


def two_craters(
    seen: PaperRims, gTc: FloatArray, *, printed_sign: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Eq. (23): the lines of sight and the first two rows of eq. (19), of any number of craters.

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.
    printed_sign : bool
        See `lines_of_sight`.

    Returns
    -------
    e : ndarray, shape (5 n,)
        Residual, of each crater differences of unit vectors in c, then rows of eq. (19).
    J : ndarray, shape (5 n, 6)
        Jacobian for the camera's right twist [w, rho], per rad and m in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (23); docs/equations.md.
    """
    e, J = lines_of_sight(seen, gTc, printed_sign=printed_sign)
    h, H, _ = shapes(seen, gTc)
    return np.concatenate([e, h[:, :2]], axis=1).ravel(), np.concatenate([J, H[:, :2]], axis=1).reshape(-1, 6)


def two_craters_noise(seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Compute the covariance of the residual of eq. (23).

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    ndarray, shape (5 n, 5 n)
        Covariance due to the charts' noise.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (23); docs/equations.md.
    """
    _, _, D = shapes(seen, gTc)
    return _noise(seen, np.concatenate([-line_slopes(seen, gTc[:3, :3]), D[:, :2]], axis=1))


def conic_shapes(seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eq. (19) of all craters, with lengths in km.

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    e : ndarray, shape (5 n,)
        Residual, in units of km^2 for |q| = 1.
    J : ndarray, shape (5 n, 6)
        Jacobian for the camera's right twist [w, rho], per rad and m in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (19); docs/equations.md.
    """
    h, H, _ = shapes(seen, gTc)
    return h.ravel(), H.reshape(-1, 6)


def conic_shapes_noise(seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Compute the covariance of the residual of eq. (19).

    Parameters
    ----------
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    ndarray, shape (5 n, 5 n)
        Covariance due to the charts' noise.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (19); docs/equations.md.
    """
    _, _, D = shapes(seen, gTc)
    return _noise(seen, D)


def with_sun(sun: SunTilt, seen: PaperRims, gTc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eq. (25): eq. (19) and the sun's tilt (24), in perspective and with atan2.

    Parameters
    ----------
    sun : SunTilt
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    e : ndarray, shape (m,)
        Residual of m = 5 n + 1 elements, rows of eq. (19), then the tilt in rad.
    J : ndarray, shape (m, 6)
        Jacobian for the camera's right twist [w, rho], per rad and m in c.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eqs. (24), (25);
    docs/equations.md.
    """
    e, J = conic_shapes(seen, gTc)
    J_sun = np.empty((1, 6))
    tilt, _ = sun_tilt(gTc, np.eye(4), sun.direction, sun.point[0], sun.point[1], J_sun)
    return np.append(e, wrap(tilt - sun.tilt_rad)), np.concatenate([J, J_sun])


def with_sun_noise(sun: SunTilt, seen: PaperRims, gTc: FloatArray) -> FloatArray:
    """Compute the covariance of the residual of eq. (25).

    Parameters
    ----------
    sun : SunTilt
    seen : PaperRims
    gTc : ndarray, shape (4, 4)
        Pose of the camera.

    Returns
    -------
    ndarray, shape (m, m)
        Covariance of m = 5 n + 1 elements due to the noise of the charts and of the tilt.

    References
    ----------
    Tian et al., J. Navigation 72 (2019) 648, DOI 10.1017/S0373463318000966, eq. (25); docs/equations.md.
    """
    noise = np.pad(conic_shapes_noise(seen, gTc), (0, 1))
    noise[-1, -1] = sun.sigma_rad**2
    return noise


def _noise(seen: PaperRims, D: FloatArray) -> FloatArray:
    """Block-diagonal covariance of rows with the derivatives D (n, k, 5) in their rim's chart."""
    return np.asarray(block_diag(*(D @ seen.rims.covariance @ np.swapaxes(D, 1, 2))))
