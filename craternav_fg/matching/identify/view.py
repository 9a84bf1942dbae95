"""The rims of an image as identification takes them: directions, sizes and shapes, whatever the lens."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera

FloatArray = npt.NDArray[np.float64]

# A distorted ellipse is followed at so many points.
_POINTS = 32
# Errors of a rim whose noise is `1 px`: of each coordinate of its centre and of its semi-axes, px; that of a
# centre grows with the rim, as its map and its shape do.
CENTRE_PX, AXIS_PX = 1.0, 0.5
CENTRE_SHARE = 0.01


class View(NamedTuple):
    """Rims in normalised image coordinates, as arrays; n rims."""

    directions: FloatArray
    """Unit vectors (n, 3) to their centres, in the camera's frame."""
    log_angle: FloatArray
    """Logarithm (n,) of the root of the solid angle over pi: of the mean angular radius."""
    moments: FloatArray
    """S_xx, S_xy, S_yy (n, 3) in normalised coordinates."""
    charts: FloatArray
    """Charts (n, 5) in normalised coordinates."""
    radius_px: FloatArray
    """Geometric mean of the semi-axes (n,), px."""
    points_px: FloatArray
    """Centres (n, 2) in pixels without distortion."""
    precision: FloatArray
    """Inverse standard deviations (n, 5) of the charts at a noise of 1 px."""
    focal_px: float
    """Geometric mean of the focal lengths."""
    corners: FloatArray
    """Undistorted pixels that bound the image: least x, least y, largest x, largest y (4,)."""
    fx_px: float
    """For the size of craters in pixels."""
    fy_px: float
    """Likewise."""
    middle_px: FloatArray
    """Principal point (2,)."""


def view_of(ellipses_px: FloatArray, camera: Camera) -> View:
    """Take an image's ellipses through the lens.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre, semi-axes, angle of the first from x towards y, as seen in the image.
    camera : Camera
    """
    charts = _charts(ellipses_px, camera)
    l11, beta, l22 = np.exp(charts[:, 2]), charts[:, 3], np.exp(charts[:, 4])
    moments = np.stack([l11**2, beta * l11**2, l22**2 + (beta * l11) ** 2], axis=-1)
    rays = np.concatenate([charts[:, :2], np.ones((len(charts), 1))], axis=1)
    length = np.linalg.norm(rays, axis=1)
    fx, fy = camera.fx_px, camera.fy_px
    radius_px = np.sqrt(l11 * l22 * fx * fy)
    centre_px = np.hypot(CENTRE_PX, CENTRE_SHARE * radius_px)
    # Errors of L, the lower triangular root of S, relative to it: its own two sizes and, doubled in variance
    # as ever across the axes of a round rim, the element below.
    relative = [fx * l11 / AXIS_PX, l11 / l22 * radius_px / (np.sqrt(2.0) * AXIS_PX), fy * l22 / AXIS_PX]
    precision = np.stack([fx / centre_px, fy / centre_px, *relative], axis=-1)
    sides = np.linspace(0.0, 1.0, 9)
    x, y = sides * (camera.width_px - 1), sides * (camera.height_px - 1)
    border = [np.stack(np.broadcast_arrays(x, end), axis=-1) for end in (y[0], y[-1])]
    border += [np.stack(np.broadcast_arrays(end, y), axis=-1) for end in (x[0], x[-1])]
    edge = camera.pinhole.pixels(camera.normalised(np.concatenate(border)))
    # Of one layout: another would be compiled for anew.
    whole = np.ascontiguousarray
    return View(
        whole(rays / length[:, None]), whole(0.5 * np.log(l11 * l22) - 1.5 * np.log(length)), whole(moments),
        whole(charts), whole(radius_px), whole(camera.pinhole.pixels(charts[:, :2])), whole(precision),
        camera.focal_px, np.concatenate([edge.min(axis=0), edge.max(axis=0)]), fx, fy,
        np.array([camera.cx_px, camera.cy_px]),
    )  # fmt: skip


def _charts(ellipses_px: FloatArray, camera: Camera) -> FloatArray:
    """Charts (n, 5) of the ellipses that best follow the undistorted rims."""
    if not len(ellipses_px):
        return np.empty((0, 5))
    x, y, a, b, angle = ellipses_px.T
    c, s = np.cos(angle), np.sin(angle)
    turn = 2.0 * np.pi * np.arange(_POINTS) / _POINTS
    along, aside = np.cos(turn), np.sin(turn)
    u = x[:, None] + (a * c)[:, None] * along - (b * s)[:, None] * aside
    v = y[:, None] + (a * s)[:, None] * along + (b * c)[:, None] * aside
    points = camera.normalised(np.stack([u, v], axis=-1))
    # The first harmonic of a closed curve is the ellipse nearest to it.
    centre = points.mean(axis=1)
    p = 2.0 / _POINTS * np.einsum("nkd,k->nd", points, along)
    q = 2.0 / _POINTS * np.einsum("nkd,k->nd", points, aside)
    sxx = p[:, 0] ** 2 + q[:, 0] ** 2
    sxy = p[:, 0] * p[:, 1] + q[:, 0] * q[:, 1]
    area = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    log = 0.5 * np.log(sxx)
    return np.column_stack([centre, log, sxy / sxx, np.log(area) - log])
