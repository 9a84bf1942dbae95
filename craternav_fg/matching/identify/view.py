"""The rims of an image as identification takes them: directions, sizes and shapes, whatever the lens."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import matrix_of_chart, seen_through_lens

FloatArray = npt.NDArray[np.float64]

# Along each side of the image, to bound its undistorted pixels.
_BORDER_POINTS = 9

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
    charts = seen_through_lens(ellipses_px, camera)
    l11, l22 = np.exp(charts[:, 2]), np.exp(charts[:, 4])
    moments = matrix_of_chart(charts).reshape(-1, 4)[:, [0, 1, 3]]
    rays = np.concatenate([charts[:, :2], np.ones((len(charts), 1))], axis=1)
    length = np.linalg.norm(rays, axis=1)
    fx, fy = camera.fx_px, camera.fy_px
    radius_px = np.sqrt(l11 * l22 * fx * fy)
    centre_px = np.hypot(CENTRE_PX, CENTRE_SHARE * radius_px)
    # Errors of L, the lower triangular root of S, relative to it: its own two sizes and, doubled in variance
    # as ever across the axes of a round rim, the element below.
    relative = [fx * l11 / AXIS_PX, l11 / l22 * radius_px / (np.sqrt(2.0) * AXIS_PX), fy * l22 / AXIS_PX]
    precision = np.stack([fx / centre_px, fy / centre_px, *relative], axis=-1)
    edge = camera.pinhole.pixels(camera.normalised(camera.border_px(_BORDER_POINTS)))
    # Of one layout: another would be compiled for anew.
    whole = np.ascontiguousarray
    return View(
        whole(rays / length[:, None]), whole(0.5 * np.log(l11 * l22) - 1.5 * np.log(length)), whole(moments),
        whole(charts), whole(radius_px), whole(camera.pinhole.pixels(charts[:, :2])), whole(precision),
        camera.focal_px, np.concatenate([edge.min(axis=0), edge.max(axis=0)]), fx, fy,
        np.array([camera.cx_px, camera.cy_px]),
    )  # fmt: skip
