"""Overlay of the rims found in an image."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.ellipse import chart_of_axes, points_on
from craternav_fg.files import replacing
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.detect import FoundRims

# Blue, green, red; the better the rim, the more of the second.
_POOR, _GOOD = np.array([0.0, 94.0, 213.0]), np.array([115.0, 158.0, 0.0])
_LIGHT = (66, 228, 240)
# Smaller images are enlarged to about this size.
_SIDE_PX = 900
_OUTLINE_POINTS = 180


def write_overlay(path: Path, image: npt.NDArray[np.generic], rims: FoundRims) -> None:
    """Draw the rims on the image: green the good, orange the poor, and where the light comes from."""
    grey = np.nan_to_num(brightness(image), nan=0.0).clip(0.0, 255.0).astype(np.uint8)
    zoom = int(np.clip(_SIDE_PX // max(grey.shape), 1, 8))
    size = (zoom * grey.shape[1], zoom * grey.shape[0])
    canvas = cv2.cvtColor(cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC), cv2.COLOR_GRAY2BGR)
    width = 1 + max(size) // 1500
    outlines = zoom * (points_on(chart_of_axes(rims.ellipses_px), _OUTLINE_POINTS) + 0.5) - 0.5
    for points, quality in zip(outlines, rims.quality, strict=True):
        colour = tuple(float(k) for k in _POOR + quality * (_GOOD - _POOR))
        # Four fractional bits: rims are known to parts of a pixel.
        fixed = np.rint(16.0 * points).astype(np.int32)
        cv2.polylines(canvas, [fixed], True, colour, width, cv2.LINE_AA, 4)
    if not np.isnan(rims.sun_angle_rad):
        direction = np.array([np.cos(rims.sun_angle_rad), np.sin(rims.sun_angle_rad)])
        reach = 0.06 * min(size)
        middle = np.array([1.5 * reach, 1.5 * reach])
        ends = [tuple(int(k) for k in np.rint(middle + sign * reach * direction)) for sign in (1.0, -1.0)]
        cv2.arrowedLine(canvas, ends[0], ends[1], _LIGHT, width, cv2.LINE_AA, 0, 0.3)
    _, data = cv2.imencode(".png", canvas)
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
