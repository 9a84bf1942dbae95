"""Rims of one image as identification uses them: directions, sizes and shapes without lens distortion."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_axes, matrix_of_chart
from craternav_fg.undistortion import seen_through_lens
from factors.arrays import FloatArray
from factors.kernels.compiled import njit

# Points along each side of the image, by which its undistorted bounds are found.
_BORDER_POINTS = 9

# Error model of a rim at a noise of 1 px: standard deviation of each coordinate of its centre and of its
# semi-axes, px. An axis is assumed to be measured twice as well as a centre (`simulation.catalog_views`).
CENTRE_SIGMA_PX, AXIS_SIGMA_PX = 1.0, 0.5
# The centre's standard deviation that grows with the rim, over its radius: catalogued centres and irregular
# outlines are off by about a percent of the size.
CENTRE_SHARE = 0.01
# Relative standard deviation of the sizes beside the noise: of ellipses against a catalogue of ellipses.
SIZE_SHARE = 0.02

# Ellipses closer than this in centre and axes, px, are one rim given twice.
_SAME_PX = 0.05


class View(NamedTuple):
    """The n rims of an image in normalised image coordinates, as arrays; and the image's bounds."""

    directions: FloatArray
    """Unit vectors to the rims' centres in c, shape (n, 3)."""
    log_angle: FloatArray
    """Natural logarithms of the mean angular radii, the roots of the solid angles over pi, shape (n,)."""
    moments: FloatArray
    """Elements S_xx, S_xy, S_yy of the ellipses' matrices in normalised image coordinates, shape (n, 3)."""
    charts: FloatArray
    """Ellipse charts, shape (n, 5)."""
    radius_px: FloatArray
    """Geometric means of the semi-axes, px, shape (n,)."""
    points_px: FloatArray
    """Centres in pixels without distortion, shape (n, 2)."""
    precision: FloatArray
    """Inverse standard deviations of the charts at a noise of 1 px, shape (n, 5)."""
    focal_px: float
    """Geometric mean of the focal lengths."""
    bounds_px: FloatArray
    """Bounds of the image in pixels without distortion: minimum x and y, largest x and y, shape (4,)."""
    fx_px: float
    """Focal length along x."""
    fy_px: float
    """Focal length along y."""
    principal_px: FloatArray
    """Principal point, shape (2,)."""
    size_share: float
    """Relative standard deviation of the sizes beside the noise, see `IdentifyOptions`."""
    centre_share: float
    """Standard deviation of the centres beside the noise, over the radius, see `IdentifyOptions`."""
    quality: FloatArray
    """Probability of each rim to be a crater's, shape (n,)."""
    traced: npt.NDArray[np.bool_]
    """Array of bool: whether each ellipse shows the rim's shape, else only place and size, shape (n,)."""


def view_of(
    ellipses_px: FloatArray, camera: Camera, size_share: float = SIZE_SHARE,
    centre_share: float = CENTRE_SHARE, quality: FloatArray | None = None,
    traced: npt.NDArray[np.bool_] | None = None,
) -> View:  # fmt: skip
    """Remove the lens distortion from an image's ellipses.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        Centre, semi-axes, angle of the first axis from x towards y, rad; px, as seen in the image.
    camera : Camera
    size_share, centre_share : float, optional
        See `View`.
    quality : ndarray, shape (n,), optional
        See `View`; 1 if not given.
    traced : ndarray of bool, shape (n,), optional
        See `View`; all if not given.

    Returns
    -------
    View
    """
    charts = seen_through_lens(chart_of_axes(ellipses_px), camera)
    l11, l22 = np.exp(charts[:, 2]), np.exp(charts[:, 4])
    moments = matrix_of_chart(charts).reshape(-1, 4)[:, [0, 1, 3]]
    rays = np.concatenate([charts[:, :2], np.ones((len(charts), 1))], axis=1)
    length = np.linalg.norm(rays, axis=1)
    fx, fy = camera.fx_px, camera.fy_px
    radius_px = np.sqrt(l11 * l22 * fx * fy)
    centre_px = np.hypot(CENTRE_SIGMA_PX, centre_share * radius_px)
    # Relative errors of L, the lower triangular root of S: of its diagonal those of the axes; of the element
    # below, twice the variance, so that errors of a circle do not depend on direction.
    below = l11 / l22 * radius_px / (np.sqrt(2.0) * AXIS_SIGMA_PX)
    relative = [fx * l11 / AXIS_SIGMA_PX, below, fy * l22 / AXIS_SIGMA_PX]
    precision = np.stack([fx / centre_px, fy / centre_px, *relative], axis=-1)
    edge = camera.pinhole.pixels(camera.normalised(camera.border_px(_BORDER_POINTS)))
    # Kernels are compiled again for each memory layout: all arrays are C-ordered.
    ordered = np.ascontiguousarray
    return View(
        directions=ordered(rays / length[:, None]),
        log_angle=ordered(0.5 * np.log(l11 * l22) - 1.5 * np.log(length)),
        moments=ordered(moments),
        charts=ordered(charts),
        radius_px=ordered(radius_px),
        points_px=ordered(camera.pinhole.pixels(charts[:, :2])),
        precision=ordered(precision),
        focal_px=camera.focal_px,
        bounds_px=np.concatenate([edge.min(axis=0), edge.max(axis=0)]),
        fx_px=fx,
        fy_px=fy,
        principal_px=np.array([camera.cx_px, camera.cy_px]),
        size_share=size_share,
        centre_share=centre_share,
        quality=np.ones(len(charts)) if quality is None else ordered(quality),
        traced=np.ones(len(charts), dtype=np.bool_) if traced is None else ordered(traced),
    )


def distinct_rows(ellipses_px: FloatArray) -> npt.NDArray[np.int64]:
    """Select the ellipses that repeat none before them.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        See `view_of`.

    Returns
    -------
    ndarray of int, shape (m,)
        Rows.
    """
    return np.flatnonzero(_distinct(np.argsort(ellipses_px[:, 0]), np.ascontiguousarray(ellipses_px[:, :4])))


@njit(cache=True, error_model="numpy")
def _distinct(by_first: npt.NDArray[np.int64], rows: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether rows (n, 4) repeat none before them that is kept; their order by the first number."""
    kept = np.ones(len(rows), dtype=np.bool_)
    place = np.empty(len(rows), dtype=np.int64)
    for k in range(len(rows)):
        place[by_first[k]] = k
    # In the order of the rows: one that repeats a row left out is kept.
    for i in range(len(rows)):
        if not kept[i]:
            continue
        for step in (-1, 1):
            k = place[i] + step
            while 0 <= k < len(rows) and abs(rows[by_first[k], 0] - rows[i, 0]) <= _SAME_PX:
                j = by_first[k]
                if j > i and kept[j]:
                    same = True
                    for c in range(1, 4):
                        same = same and abs(rows[j, c] - rows[i, c]) <= _SAME_PX
                    kept[j] = not same
                k += step
    return kept
