"""Pictures in the folder of a run, scaled down for a page."""

import base64
from pathlib import Path

import cv2
import numpy as np

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import InputError
from craternav_fg.files import entries, exists
from craternav_fg.reports.page import Pictures
from craternav_fg.runs.store import FIGURES, OVERLAYS

# Figures shown in place of overlays where there are none, the better one first.
SUBSTITUTES = ("contact_sheet.png", "overview.png")
# With so many pictures of this size and quality a page has a few megabytes.
MAX_PICTURES = 24
MAX_WIDTH_PX = 1000
JPEG_QUALITY = 80


def frame_pictures(run: Path) -> Pictures | None:
    """Give the overlays of a run's frames, or its overview; None for a run without images.

    Parameters
    ----------
    run : Path
        Folder of the run.

    Returns
    -------
    Pictures or None

    Raises
    ------
    InputError
        When a picture is damaged.
    """
    overlays = [path for path in _within(run / OVERLAYS) if path.suffix == ".png"]
    caption = "Frames with their rims."
    if len(overlays) > MAX_PICTURES:
        caption = f"{MAX_PICTURES} of {len(overlays)} frames with their rims; all are in {OVERLAYS}/."
        chosen = np.linspace(0, len(overlays) - 1, MAX_PICTURES).astype(int)
        overlays = [overlays[k] for k in chosen]
    if not overlays:
        overlays = [p for p in (run / FIGURES / name for name in SUBSTITUTES) if exists(p)][:1]
        caption = "Some frames with their rims."
    if not overlays:
        return None
    return Pictures([(_data_uri(path), path.stem.replace("_", " ")) for path in overlays], caption)


def _within(folder: Path) -> list[Path]:
    """List a folder; nothing when there is none."""
    return entries(folder) if exists(folder) else []


def _data_uri(path: Path) -> str:
    """Give a picture as a data URI of a JPEG, no wider than a page."""
    read = read_foreign_image(path)
    if read.dtype != np.uint8 or read.ndim != 3 or read.shape[2] not in (3, 4):
        raise InputError(path, "expected a PNG image of colours, found another")
    # OpenCV has blue first.
    picture = np.ascontiguousarray(read[:, :, 2::-1], dtype=np.uint8)
    scale = MAX_WIDTH_PX / picture.shape[1]
    if scale < 1.0:
        size = (MAX_WIDTH_PX, max(round(scale * picture.shape[0]), 1))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(coded.tobytes()).decode('ascii')}"
