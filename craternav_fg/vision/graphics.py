"""Graphics burnt into an image: captions, scale bars, crosses and fiducial marks, which are no craters.

Their black and white areas end within a pixel all around. Those of photographs do not: ground that is
overexposed, or in shadow, fades into its surroundings at least along a part of its outline.

They deceive the network. The template method finds no rims in them, as their areas have no shading.
"""

import cv2
import numpy as np

from craternav_fg.ellipse import matrix_of_chart
from factors.arrays import BoolArray, FloatArray, ImageArray

# Black is up to this brightness, and white as near to the largest: compression leaves no area quite even.
_EVEN_BRIGHTNESS = 10.0
_WHITE = 255.0
# An area, of this many pixels and at most this share of the image, is graphics if along this share of its
# outline the brightness two pixels on differs by more than the step.
_MIN_AREA_PX, _MAX_AREA_SHARE = 12, 0.25
_MIN_ABRUPT_SHARE, _ABRUPT_STEP = 0.8, 50.0
# Rims are judged by points evenly spread over so many radii, in these many rings of so many.
_REACH_RADII, _RINGS, _POINTS_PER_RING = 1.5, 12, 48
_OUTSIDE_RADII = 1.05
# Share of the points, and of those outside of the rim, from which a rim is one of graphics: a crater full of
# shadow is black as well, but not around it. On annotated images none of 2,600 rims has as much, and three
# quarters of those in captions put into them.
_MAX_SHARE = 0.25


def on_ground(image: ImageArray, charts_px: FloatArray) -> BoolArray:
    """Tell which rims do not lie on graphics.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255; NaN in holes.
    charts_px : ndarray, shape (n, 5)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if len(charts_px) == 0:
        return np.zeros(0, dtype=np.bool_)
    return ~_on_graphics(_graphics(image), charts_px)


def _graphics(image: ImageArray) -> BoolArray:
    """Where graphics are."""
    # Holes are neither black nor white, and as bright as what they are compared with.
    black, white = image <= _EVEN_BRIGHTNESS, image >= _WHITE - _EVEN_BRIGHTNESS
    return _abrupt(image, black, 0.0) | _abrupt(image, white, _WHITE)


def _abrupt(image: ImageArray, even: BoolArray, level: float) -> BoolArray:
    """Areas of one brightness that end abruptly."""
    small, large = (np.ones((side, side), dtype=np.uint8) for side in (3, 5))
    plain = even.astype(np.uint8)
    # Lines of a pixel or two are no areas.
    core = cv2.dilate(cv2.erode(plain, small), small)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(core, connectivity=8)
    if count == 1:
        return np.zeros(image.shape, dtype=np.bool_)
    # Dilation takes the larger of two labels where two areas are near.
    around = (cv2.dilate(core, large) > 0) & (cv2.dilate(core, small) == 0)
    of = cv2.dilate(labels.astype(np.float32), large)[around].astype(np.intp)
    steps = np.abs(image[around] - np.float32(level)) > _ABRUPT_STEP
    outline = np.bincount(of, minlength=count)
    abrupt = np.bincount(of, weights=steps, minlength=count)
    size = stats[:, cv2.CC_STAT_AREA]
    chosen = (size >= _MIN_AREA_PX) & (size <= _MAX_AREA_SHARE * image.size)
    chosen &= abrupt > _MIN_ABRUPT_SHARE * np.maximum(outline, 1)
    chosen[0] = False
    return np.asarray(chosen[labels], dtype=np.bool_)


def _on_graphics(graphics: BoolArray, charts_px: FloatArray) -> BoolArray:
    """Tell which rims (n, 5) lie on graphics (H, W)."""
    if not graphics.any():
        return np.zeros(len(charts_px), dtype=np.bool_)
    radius, angle = np.meshgrid(
        _REACH_RADII * np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS),
        2.0 * np.pi * np.arange(_POINTS_PER_RING) / _POINTS_PER_RING,
        indexing="ij",
    )
    disc = np.stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()], axis=-1)
    root = np.linalg.cholesky(matrix_of_chart(charts_px))
    points = charts_px[:, None, :2] + disc @ np.swapaxes(root, -1, -2)
    column, row = np.moveaxis(np.rint(points).astype(np.intp), -1, 0)
    height, width = graphics.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    on = inside & graphics[row.clip(0, height - 1), column.clip(0, width - 1)]
    outside = radius.ravel() > _OUTSIDE_RADII
    return np.asarray((on.mean(axis=1) > _MAX_SHARE) & (on[:, outside].mean(axis=1) > _MAX_SHARE))
