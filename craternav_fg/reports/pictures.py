"""Pictures of a run's frames with their rims, small enough for a page."""

import base64
import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pyarrow.compute as pc

from craternav_fg.dataset import Dataset
from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.ellipse import points_on
from craternav_fg.errors import InputError
from craternav_fg.files import entries, exists
from craternav_fg.reports.page import Picture, Pictures
from craternav_fg.runs.columns import list_values
from craternav_fg.runs.read import Run, read_residuals
from craternav_fg.runs.store import FIGURES, OVERLAYS

Colours = npt.NDArray[np.uint8]

# Figures shown where there are neither overlays nor images, the better one first.
SUBSTITUTES = ("contact_sheet.png", "overview.png")
MAX_PICTURES = 24
# Widths and qualities that are tried in turn, until all pictures together have so many bytes.
_STEPS = ((1000, 80), (800, 70), (640, 60), (512, 50))
_BUDGET_BYTES = 2_200_000
# Of measured rims (yellow) and those of the map at the estimated pose (blue), as OpenCV orders them.
_MEASURED, _MAP = (66, 228, 240), (233, 180, 86)
_RIM_POINTS, _MIN_MAP_PX = 64, 8.0


def frame_pictures(run: Run, dataset: Dataset | None) -> Pictures | None:
    """Return pictures of a run's frames with their rims; None for a run without images.

    Parameters
    ----------
    run : Run
        Its overlays are taken, if it has some.
    dataset : Dataset or None
        Otherwise its images are drawn.

    Returns
    -------
    Pictures or None

    Raises
    ------
    InputError
        When a picture is damaged.
    """
    overlays = [path for path in _within(run.path / OVERLAYS) if path.suffix == ".png"]
    if overlays:
        chosen = _chosen(len(overlays))
        named = [(_read(overlays[k]), overlays[k].stem.replace("_", " ")) for k in chosen]
        numbers = [re.search(r"\d+", caption) for _, caption in named]
        frames = [None if found is None else int(found[0]) for found in numbers]
        note = f"; all are in {OVERLAYS}/" if len(chosen) < len(overlays) else ""
        caption = f"{len(chosen)} of {len(overlays)} frames with their rims{note}."
        return _pictures(named, frames, caption)
    if dataset is not None and dataset.measurements is None:
        drawn = _chosen(len(dataset))
        named = [
            (picture, f"frame {k}") for k, picture in zip(drawn, _drawn(run, dataset, drawn), strict=True)
        ]
        caption = (
            f"{len(drawn)} of {len(dataset)} frames. Yellow: measured rims; blue: the catalogue's rims at "
            f"the pose of {next(iter(run.trajectories))}. Click a picture to enlarge it."
        )
        return _pictures(named, drawn, caption)
    found = [path for path in (run.path / FIGURES / name for name in SUBSTITUTES) if exists(path)][:1]
    if not found:
        return None
    return _pictures(
        [(_read(found[0]), found[0].stem.replace("_", " "))], [None], "Some frames with their rims."
    )


def _chosen(count: int) -> list[int]:
    """Evenly spread indices, not more than a page holds."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_PICTURES)).astype(int)).tolist()


def _read(path: Path) -> Colours:
    read = read_foreign_image(path)
    if read.dtype != np.uint8 or read.ndim != 3 or read.shape[2] not in (3, 4):
        raise InputError(path, "expected a PNG image of colours, found another")
    # OpenCV has blue first.
    return np.ascontiguousarray(read[:, :, 2::-1], dtype=np.uint8)


def _within(folder: Path) -> list[Path]:
    """List a folder; nothing when there is none."""
    return entries(folder) if exists(folder) else []


def _drawn(run: Run, dataset: Dataset, chosen: Sequence[int]) -> list[Colours]:
    """Images of some frames with their rims."""
    name, trajectory = next(iter(run.trajectories.items()))
    table = read_residuals(run.path)
    own = table.filter(pc.equal(table["estimator"], name))
    stamps, charts = own["stamp_ns"].to_numpy(), list_values(own["chart"])
    camera, out = dataset.camera, []
    for k in chosen:
        grey = (255.0 / camera.full_scale * dataset.image(k)).astype(np.uint8)
        picture = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        rows = np.flatnonzero(trajectory.stamps_ns == dataset.stamps_ns[k])
        if len(rows):
            _, mapped = dataset.catalog.visible(
                camera, trajectory.gTb[rows[0]], min_semi_minor_px=_MIN_MAP_PX
            )
            _outline(picture, camera.pixels(points_on(mapped, _RIM_POINTS)), _MAP)
        if charts is not None:
            measured = charts[stamps == dataset.stamps_ns[k]]
            _outline(picture, camera.pixels(points_on(measured, _RIM_POINTS)), _MEASURED)
        out.append(picture)
    return out


def _outline(picture: Colours, outlines_px: npt.NDArray[np.float64], hue: tuple[int, int, int]) -> None:
    width = max(1, round(picture.shape[1] / 500))
    # In 1/16 px, as OpenCV draws between pixels.
    for outline in np.round(16.0 * outlines_px).astype(np.int32):
        cv2.polylines(picture, [outline], True, hue, width, cv2.LINE_AA, 4)


def _pictures(named: Sequence[tuple[Colours, str]], frames: Sequence[int | None], caption: str) -> Pictures:
    """Code pictures as JPEG, as large and good as the page has room for."""
    coded: list[bytes] = []
    for width, quality in _STEPS:
        coded = [_jpeg(picture, width, quality) for picture, _ in named]
        if sum(map(len, coded)) <= _BUDGET_BYTES:
            break
    uris = [f"data:image/jpeg;base64,{base64.b64encode(one).decode('ascii')}" for one in coded]
    said = [caption for _, caption in named]
    return Pictures([Picture(*parts) for parts in zip(uris, said, frames, strict=True)], caption)


def _jpeg(picture: Colours, width_px: int, quality: int) -> bytes:
    scale = width_px / picture.shape[1]
    if scale < 1.0:
        size = (width_px, max(round(scale * picture.shape[0]), 1))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(data.tobytes())
