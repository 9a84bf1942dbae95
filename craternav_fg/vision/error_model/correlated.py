"""What of rims' errors outlasts a frame: of each crater, and of all of them alike.

The ground differs from an ellipse and from level ground as long as it is looked at, so part of a rim's error
is the same in the next frame, up to what the view does to it: it is fixed to the ground, in directions of
the rim's plane. Beside that all rims of a descent err alike. A crest is not seen as sharp as it is and hides
the ground behind it, which shifts blurred rims towards the camera and stretches them along the line of sight,
by pixels and by parts of the radius; what is not known of the ground's brightness shifts them along the
light, those of irregular outlines by parts of the radius, as the ground about the landing site has a slope of
its own; other crests than the canonical one make all rims larger or smaller.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.measurements import SHARED_SIZE
from factors.kernels.rim_errors import ground_slopes

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Of `ground_slopes`: what moves a rim in its own plane.
_IN_PLANE = [0, 1, 3, 4, 5]


@dataclass(frozen=True)
class CorrelatedErrorOptions:
    """How large errors are that outlast a frame.

    Attributes
    ----------
    crater_share : float
        Part of a rim's systematic variance (`RimFit.systematic`) that its crater keeps. The rest is new in
        each frame: the gaps in an outline, its neighbours, the pixels' grid are not the same in each.
    excess_white_share : float
        Part of the systematic variance that is new in each frame besides, where a frame's rims scatter more
        than they say: for each unit by which their variance, that of the median rim, is larger than that. On
        rough ground many rims are worse than the median, and near ones alike: of use to those who fuse
        frames; 0 is honest for a single image.
    camera_shift_px : float
        Common shift of rims towards the camera, seen along the ground: px for a camera at the horizon, that
        grows with the sine of the angle to the vertical, and as much that grows with its cube.
    sun_shift_px : float
        Common shift of rims towards the light, px for a sun at the horizon.
    stretch_px, stretch_share : float
        Common growth of the radius along the line of sight, seen along the ground, for a camera at the
        horizon: px, and radii. Grows with the sine's square.
    size_px, size_share : float
        Common growth of the radius: px, and radii.
    brightness_share : float
        Part of the variance of `RimFit.level` that all rims have in common.
    arc_px, arc_share : float
        Error of an arc's edge points that they share and keep: px, and radii.
    """

    crater_share: float = 0.7
    excess_white_share: float = 2.0
    camera_shift_px: float = 0.1
    sun_shift_px: float = 0.05
    stretch_px: float = 0.1
    stretch_share: float = 0.004
    size_px: float = 0.05
    size_share: float = 0.002
    brightness_share: float = 0.4
    arc_px: float = 0.2
    arc_share: float = 0.004


def in_plane_slopes(rows: IntArray, gTb: FloatArray, camera: Camera, catalog: Catalog) -> FloatArray:
    """Differentiate charts for errors of rims in their own planes.

    Parameters
    ----------
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    gTb : ndarray, shape (4, 4)
    camera : Camera
    catalog : Catalog

    Returns
    -------
    ndarray, shape (n, 5, 5)
        Columns in units of the rim's mean radius: shift along l1 and l2, growth along l1, shear, growth
        along l2.
    """
    return ground_slopes(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])[:, :, _IN_PLANE]


def correlated_roots(
    systematic: FloatArray,
    level: FloatArray,
    rows: IntArray,
    gTb: FloatArray,
    sun_g: FloatArray,
    camera: Camera,
    catalog: Catalog,
    options: CorrelatedErrorOptions,
) -> tuple[FloatArray, FloatArray]:
    """Roots of what lasts of the errors of a frame's rims.

    Parameters
    ----------
    systematic : ndarray, shape (n, 5, 5)
        Systematic part of the charts' covariances.
    level : ndarray, shape (n, 5)
        Root of the part of it that is from the level of the ground's brightness.
    rows : ndarray of int, shape (n,)
        The rims' craters in the catalogue.
    gTb : ndarray, shape (4, 4)
        Pose that sees them.
    sun_g : ndarray, shape (3,)
        Unit vector towards the sun in g.
    camera : Camera
    catalog : Catalog
    options : CorrelatedErrorOptions

    Returns
    -------
    correlated, shared : ndarray, shapes (n, 5, 5), (n, 5, 8)
        As in `RimSet`.
    """
    centres, axes = catalog.centres[rows], catalog.axes[rows]
    slopes = in_plane_slopes(rows, gTb, camera, catalog)
    inverse = np.linalg.inv(slopes)
    own = systematic - options.brightness_share * level[:, :, None] * level[:, None, :]
    on_ground = options.crater_share * inverse @ own @ np.swapaxes(inverse, 1, 2)
    correlated = slopes @ np.linalg.cholesky(0.5 * (on_ground + np.swapaxes(on_ground, 1, 2)))
    length_m = np.linalg.norm(axes, axis=-1)
    view = camera.gTc(gTb)[:3, 3] - centres
    range_m = np.linalg.norm(view, axis=-1)
    radius_px = camera.focal_px * np.sqrt(length_m.prod(axis=-1)) / range_m
    # Towards the camera and the light, along l1 and l2.
    along = axes / length_m[:, :, None]
    toward = np.einsum("nki,ni->nk", along, view / range_m[:, None])
    lit = along @ sun_g
    sine2 = np.sum(toward**2, axis=-1, keepdims=True)
    x, y = toward.T
    # Of the map 1 + t t': growth along l1, shear, growth along l2.
    stretch = np.stack([x * x, x * y, y * y], axis=-1)
    px = 1.0 / radius_px[:, None]
    errors = np.zeros((len(rows), 5, SHARED_SIZE))
    errors[:, :2, 0] = options.camera_shift_px * px * toward
    errors[:, :2, 1] = options.camera_shift_px * px * sine2 * toward
    errors[:, :2, 2] = options.sun_shift_px * px * lit
    errors[:, 2:, 3] = options.stretch_px * px * stretch
    errors[:, 2:, 4] = options.stretch_share * stretch
    errors[:, [2, 4], 5] = options.size_px * px
    errors[:, [2, 4], 6] = options.size_share
    shared = slopes @ errors
    shared[:, :, 7] = np.sqrt(options.brightness_share) * level
    return correlated, shared
