"""Rims found in an image as files: a table in the columns of NASA's crater challenge, and an overlay."""

import csv
import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.files import replacing
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.detect import FoundRims

COLUMNS = (
    "ellipseCenterX(px)",
    "ellipseCenterY(px)",
    "ellipseSemimajor(px)",
    "ellipseSemiminor(px)",
    "ellipseRotation(deg)",
    "inputImage",
    "crater_classification",
)
# How worn a crater is: not told.
NOT_CLASSIFIED = -1
# Blue, green, red; the better the rim, the more of the second.
_POOR, _GOOD = np.array([0.0, 94.0, 213.0]), np.array([115.0, 158.0, 0.0])
_LIGHT = (66, 228, 240)
# Smaller images are enlarged to about this size.
_SIDE_PX = 900


def write_rims_csv(path: Path, rims: FoundRims, image_name: str) -> None:
    """Write one row per rim, best first; the file appears whole or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for x, y, a, b, angle in rims.ellipses_px:
        numbers = [f"{value:.3f}" for value in (x, y, a, b, np.rad2deg(angle))]
        writer.writerow([*numbers, image_name, NOT_CLASSIFIED])
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def rims_json(rims: FoundRims) -> dict[str, Any]:
    """Give the rims with their quality and what their parameters may be wrong by."""
    light = float(rims.light_rad)
    keys = ("center_x_px", "center_y_px", "semi_major_px", "semi_minor_px")
    rows = []
    for ellipse, covariance, quality in zip(rims.ellipses_px, rims.covariance_px, rims.quality, strict=True):
        row = {key: round(float(value), 3) for key, value in zip(keys, ellipse, strict=False)}
        row["rotation_deg"] = round(float(np.rad2deg(ellipse[4])), 3)
        row["quality"] = round(float(quality), 4)
        row["center_sigma_px"] = round(float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]))), 3)
        rows.append(row)
    return {"light_deg": None if np.isnan(light) else round(float(np.rad2deg(light)), 1), "rims": rows}


def write_overlay(path: Path, image: npt.NDArray[np.generic], rims: FoundRims) -> None:
    """Draw the rims on the image: green the good, orange the poor, and where the light comes from."""
    grey = np.nan_to_num(brightness(image), nan=0.0).clip(0.0, 255.0).astype(np.uint8)
    zoom = int(np.clip(_SIDE_PX // max(grey.shape), 1, 8))
    size = (zoom * grey.shape[1], zoom * grey.shape[0])
    canvas = cv2.cvtColor(cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC), cv2.COLOR_GRAY2BGR)
    width = 1 + max(size) // 1500
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    for (x, y, a, b, angle), quality in zip(rims.ellipses_px, rims.quality, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        u, v = a * np.cos(turn), b * np.sin(turn)
        points = zoom * (np.stack([x + c * u - s * v, y + s * u + c * v], axis=-1) + 0.5) - 0.5
        colour = tuple(float(k) for k in _POOR + quality * (_GOOD - _POOR))
        # Four fractional bits: rims are known to parts of a pixel.
        fixed = np.rint(16.0 * points).astype(np.int32)
        cv2.polylines(canvas, [fixed], True, colour, width, cv2.LINE_AA, 4)
    if not np.isnan(rims.light_rad):
        direction = np.array([np.cos(rims.light_rad), np.sin(rims.light_rad)])
        reach = 0.06 * min(size)
        middle = np.array([1.5 * reach, 1.5 * reach])
        ends = [tuple(int(k) for k in np.rint(middle + sign * reach * direction)) for sign in (1.0, -1.0)]
        cv2.arrowedLine(canvas, ends[0], ends[1], _LIGHT, width, cv2.LINE_AA, 0, 0.3)
    _, data = cv2.imencode(".png", canvas)
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
