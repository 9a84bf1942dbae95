"""Frames with their rims drawn on them: measured, predicted, and the catalogue's at the estimated pose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.ellipse import points_on
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.pipeline.reconstruct import Reconstruction
from craternav_fg.plots.figures import save

FloatArray = npt.NDArray[np.float64]


SHEET_FRAMES = 12
_SHEET_COLUMNS = 4
# Okabe and Ito's: bright ones on dark ground, told apart by hue and by line.
MEASURED, PREDICTED, CATALOGUE, SUN = "#F0E442", "#D55E00", "#56B4E9", "#FFFFFF"
# Catalogue rims that seem smaller are left out.
_LEAST_PX = 5.0
# Smaller images are enlarged to about this many pixels.
_SIDE_PX = 900
_DPI = 100
# Of labels: size in points, how wide a letter is and how high a line, of that.
_LABEL_PT, _LETTER, _LINE = 7.5, 0.62, 1.3
_STRIP_PX = 62


@dataclass(frozen=True)
class Overlay:
    """A frame and what is drawn on it.

    Attributes
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
    frame : FrameMeasurement
        Measured rims and sun's tilt.
    gTb : ndarray, shape (4, 4)
        Estimated pose: the catalogue's rims are drawn from there.
    predicted_gTb : ndarray, shape (4, 4), or None
        Pose that was predicted before the image was seen.
    title : str
    """

    image: ImageArray
    frame: FrameMeasurement
    gTb: FloatArray
    predicted_gTb: FloatArray | None
    title: str


def overlay(dataset: Dataset, result: Reconstruction, number: int) -> Overlay:
    """Gather what is to be drawn on a frame; the pose is that of the first trajectory.

    Parameters
    ----------
    dataset : Dataset
        With images.
    result : Reconstruction
    number : int
        Of the frame.
    """
    trajectory = next(iter(result.trajectories.values()))
    frame = result.frames[number]
    seconds = 1e-9 * float(trajectory.stamps_ns[number] - trajectory.stamps_ns[0])
    altitude_km = float(dataset.body.altitude_m(trajectory.gP[number])) / 1e3
    expected = "" if result.expected_rims is None else f" of {result.expected_rims[number]}"
    title = f"{seconds:.0f} s, {altitude_km:.3g} km, {len(frame.rims)}{expected} rims"
    predicted = None if result.predicted is None else result.predicted[number]
    return Overlay(dataset.image(number), frame, trajectory.gTb[number], predicted, title)


def draw_overlay(one: Overlay, camera: Camera, catalog: Catalog) -> Figure:
    """Draw a frame with its rims, the measured ones named, one pixel of the image on one or more."""
    zoom = max(1, round(_SIDE_PX / max(camera.width_px, camera.height_px)))
    width, height = zoom * camera.width_px, zoom * camera.height_px
    figure = Figure(figsize=(width / _DPI, (height + _STRIP_PX) / _DPI), dpi=_DPI, facecolor="k")
    axes = figure.add_axes((0.0, _STRIP_PX / (height + _STRIP_PX), 1.0, height / (height + _STRIP_PX)))
    _draw(axes, one, camera, catalog, 1.0)
    _name(axes, one.frame, camera, catalog, zoom)
    figure.text(
        0.5, (_STRIP_PX - 15.0) / (height + _STRIP_PX), one.title, color="w", ha="center", va="center"
    )
    _legend(figure, "lower center")
    return figure


def draw_contact_sheet(overlays: Sequence[Overlay], camera: Camera, catalog: Catalog) -> Figure:
    """Draw a grid of frames with their rims."""
    columns = min(_SHEET_COLUMNS, len(overlays))
    rows = -(-len(overlays) // columns)
    side = 3.1
    aspect = camera.height_px / camera.width_px
    figure = Figure(figsize=(columns * side, rows * (side * aspect + 0.28) + 0.4), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.0, hspace=0.0)  # type: ignore[union-attr,call-arg]
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, one in zip(panels, overlays, strict=False):
        _draw(axes, one, camera, catalog, 0.6)
        axes.set_title(one.title, fontsize=9, pad=3)
    for axes in panels[len(overlays) :]:
        axes.set_axis_off()
    _legend(figure, "outside lower center")
    return figure


def contact_sheet(dataset: Dataset, result: Reconstruction) -> Figure:
    """Draw some frames of a reconstruction, evenly spaced, on one sheet."""
    numbers = np.unique(np.linspace(0, len(dataset) - 1, min(SHEET_FRAMES, len(dataset))).astype(int))
    overlays = [overlay(dataset, result, int(number)) for number in numbers]
    return draw_contact_sheet(overlays, dataset.camera, dataset.catalog)


def write_overlays(
    dataset: Dataset,
    result: Reconstruction,
    folder: Path,
    every: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Write a PNG per frame, named by its number and the seconds since the first, into a folder.

    Parameters
    ----------
    dataset : Dataset
        With images.
    result : Reconstruction
    folder : Path
    every : int
        Each of how many frames.
    progress : callable, optional
    """
    numbers = range(0, len(dataset), every)
    for done, number in enumerate(numbers, 1):
        one = overlay(dataset, result, number)
        figure = draw_overlay(one, dataset.camera, dataset.catalog)
        seconds = 1e-9 * float(one.frame.stamp_ns - dataset.stamps_ns[0])
        save(figure, folder / f"frame_{number:05d}_{seconds:.1f}s.png", _DPI)
        if progress is not None:
            progress("overlays", done, len(numbers))


def _draw(axes: Axes, one: Overlay, camera: Camera, catalog: Catalog, width: float) -> None:
    axes.imshow(one.image, cmap="gray", vmin=0, vmax=camera.full_scale, interpolation="antialiased")
    _rims(axes, _seen(one.gTb, camera, catalog), color=CATALOGUE, lw=2.6 * width, alpha=0.85)
    measured = camera.pixels(points_on(one.frame.rims.chart, 120))
    _rims(axes, measured, color=MEASURED, lw=1.3 * width)
    if one.predicted_gTb is not None:
        predicted = _seen(one.predicted_gTb, camera, catalog)
        _rims(axes, predicted, color=PREDICTED, lw=1.3 * width, linestyles=(0, (3, 5)))
    sun = one.frame.sun
    if sun is not None:
        length = 0.07 * camera.width_px
        x, y = camera.pixels(sun.point)
        dx, dy = length * np.cos(sun.tilt_rad), length * np.sin(sun.tilt_rad)
        style = {"arrowstyle": "-|>", "color": SUN, "lw": 1.6 * width}
        axes.annotate("", (x + dx, y + dy), (x, y), arrowprops=style)
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])


def _seen(gTb: FloatArray, camera: Camera, catalog: Catalog) -> FloatArray:
    """Rims (n, 120, 2), px, that a pose shows, also in part; of a lens that distorts only whole ones."""
    margin_px = 0.0 if camera.distorts else -0.25 * min(camera.width_px, camera.height_px)
    _, charts = catalog.visible(camera, gTb, min_semi_minor_px=_LEAST_PX, margin_px=margin_px)
    return camera.pixels(points_on(charts, 120))


def _rims(axes: Axes, rims: FloatArray, **style: object) -> None:
    closed = np.concatenate([rims, rims[:, :1]], axis=1)
    axes.add_collection(LineCollection(list(closed), **style))  # type: ignore[arg-type]


def _name(axes: Axes, frame: FrameMeasurement, camera: Camera, catalog: Catalog, zoom: int) -> None:
    """Write identifiers below the measured rims, large ones first, where there is room."""
    rims = camera.pixels(points_on(frame.rims.chart, 120))
    order = np.argsort(-np.ptp(rims, axis=1).max(axis=1)) if len(rims) else np.empty(0, dtype=int)
    height = _LINE * _LABEL_PT * _DPI / 72.0 / zoom
    taken: list[tuple[float, float, float, float]] = []
    for k in order:
        text = catalog.identifiers[frame.rims.craters[k]]
        half = 0.5 * _LETTER * _LABEL_PT * _DPI / 72.0 / zoom * len(text)
        x = float(np.clip(rims[k, :, 0].mean(), half, camera.width_px - 1.0 - half))
        y = float(rims[k, :, 1].max()) + 0.25 * height
        if y + height > camera.height_px:
            y = float(rims[k, :, 1].min()) - 1.25 * height
        box = (x - half, y, x + half, y + height)
        if any(b[0] < box[2] and box[0] < b[2] and b[1] < box[3] and box[1] < b[3] for b in taken):
            continue
        taken.append(box)
        label = axes.text(x, y, text, color=MEASURED, fontsize=_LABEL_PT, ha="center", va="top")
        label.set_path_effects([patheffects.withStroke(linewidth=2.0, foreground="k", alpha=0.7)])


def _legend(figure: Figure, place: Literal["lower center", "outside lower center"]) -> None:
    handles = [
        Line2D([], [], color=MEASURED, lw=1.8, label="measured"),
        Line2D([], [], color=PREDICTED, lw=1.8, ls=(0, (3, 2)), label="predicted"),
        Line2D([], [], color=CATALOGUE, lw=3.0, label="catalogue, at the estimated pose"),
        Line2D([], [], color=SUN, marker=r"$\rightarrow$", ms=14, ls="", mec="0.4", label="towards the sun"),
    ]
    # Bright lines show on a dark ground only, on whatever page.
    figure.legend(
        handles=handles, loc=place, ncols=4, fontsize=9, facecolor="0.25", edgecolor="none", framealpha=1.0,
        labelcolor="w",
    )  # fmt: skip
