"""Overlay of the rims found in an image."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import chart_of_axes, points_on
from craternav_fg.files import replacing
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.detect import FoundRims

# Colours in the order blue, green, red: of rims of quality 0 and 1, and of the arrow towards the sun.
_POOR, _GOOD = np.array([0.0, 94.0, 213.0]), np.array([115.0, 158.0, 0.0])
_SUN = (66, 228, 240)
# Smaller images are enlarged to about this size, at the most so many times.
_SIDE_PX, _MAX_ZOOM = 900, 8
# Points that draw a rim.
_OUTLINE_POINTS = 180
# Lines are one pixel wider for every so many pixels of the image.
_PX_PER_LINE_WIDTH = 1500
# Half the length of the arrow, of the image's shorter side; its tip, of the arrow.
_HALF_ARROW, _ARROW_TIP = 0.06, 0.3
# OpenCV draws to fractions of a pixel by so many binary digits.
_FRACTION_BITS = 4


def write_overlay(path: Path, image: npt.NDArray[np.generic], rims: FoundRims) -> None:
    """Draw the detected rims on their image, from orange to green by quality, with an arrow towards the sun.

    Parameters
    ----------
    path : Path
        PNG to write.
    image : ndarray, shape (H, W) or (H, W, 3)
        Grey levels or colours, of any scale.
    rims : FoundRims

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    grey = np.nan_to_num(brightness(image), nan=0.0).clip(0.0, 255.0).astype(np.uint8)
    zoom = int(np.clip(_SIDE_PX // max(grey.shape), 1, _MAX_ZOOM))
    size = (zoom * grey.shape[1], zoom * grey.shape[0])
    canvas = cv2.cvtColor(cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC), cv2.COLOR_GRAY2BGR)
    width = 1 + max(size) // _PX_PER_LINE_WIDTH
    outlines = zoom * (points_on(chart_of_axes(rims.ellipses_px), _OUTLINE_POINTS) + 0.5) - 0.5
    for points, quality in zip(outlines, rims.quality, strict=True):
        colour = tuple(float(k) for k in _POOR + quality * (_GOOD - _POOR))
        fixed = np.rint(2.0**_FRACTION_BITS * points).astype(np.int32)
        cv2.polylines(canvas, [fixed], True, colour, width, cv2.LINE_AA, _FRACTION_BITS)
    if not np.isnan(rims.sun_angle_rad):
        direction = np.array([np.cos(rims.sun_angle_rad), np.sin(rims.sun_angle_rad)])
        reach = _HALF_ARROW * min(size)
        middle = np.array([1.5 * reach, 1.5 * reach])
        tail, tip = (
            tuple(np.rint(middle + sign * reach * direction).astype(int).tolist()) for sign in (-1, 1)
        )
        cv2.arrowedLine(canvas, tail, tip, _SUN, width, cv2.LINE_AA, 0, _ARROW_TIP)
    _, data = cv2.imencode(".png", canvas)
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
