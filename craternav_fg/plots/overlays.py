"""Frames with rims drawn on them: measured, predicted, and those of the catalogue at the estimated pose."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from os import cpu_count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
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
from craternav_fg.errors import CraternavError
from craternav_fg.measurements import FrameMeasurement, SunTilt
from craternav_fg.pipeline.result import Reconstruction
from craternav_fg.plots.style import save
from craternav_fg.workers import each_result, processes
from factors.arrays import FloatArray

# A contact sheet has so many frames, in so many columns.
SHEET_FRAMES = 12
_SHEET_COLUMNS = 4
# Okabe and Ito's colours, bright on dark ground, distinguished by hue and by line.
MEASURED, PREDICTED, CATALOGUE, SUN = "#F0E442", "#D55E00", "#56B4E9", "#FFFFFF"
# In the overview, whose images may be bright.
_SUN_ON_BRIGHT = "#D55E00"
# Length of the arrow towards the sun, of the image's width.
_ARROW_LENGTH = 0.07
# Rims of the catalogue with a smaller semi-minor axis are not drawn.
_MIN_SEMI_MINOR_PX = 5.0
# Smaller images are enlarged to about this many pixels.
_SIDE_PX = 900
_DPI = 100
# Of labels: size in points; width of a letter and height of a line in multiples of it.
_LABEL_PT, _LETTER, _LINE = 7.5, 0.62, 1.3
# Height of the strip below the image that holds title and legend.
_STRIP_PX = 62
# Frames that take as long to draw as a process to start.
_WORTH_A_PROCESS = 12
# Points that draw a rim.
_RIM_POINTS = 120


@dataclass(frozen=True)
class Overlay:
    """A frame and what to draw on it.

    Attributes
    ----------
    image : ndarray of uint8 or uint16, shape (H, W)
    frame : FrameMeasurement
        Measured rims and sun tilt.
    gTb : ndarray, shape (4, 4)
        Estimated pose of the body: where the catalogue's rims are seen from.
    predicted_gTb : ndarray, shape (4, 4), or None
        Pose of the body that was predicted before the image was measured.
    title : str
    """

    image: ImageArray
    frame: FrameMeasurement
    gTb: FloatArray
    predicted_gTb: FloatArray | None
    title: str


def overlay(dataset: Dataset, result: Reconstruction, index: int) -> Overlay:
    """Collect what to draw on a frame; the pose is that of the first trajectory.

    Parameters
    ----------
    dataset : Dataset
        With images.
    result : Reconstruction
    index : int
        Index of the frame.

    Returns
    -------
    Overlay
    """
    trajectory = next(iter(result.trajectories.values()))
    frame = result.frames[index]
    seconds = 1e-9 * float(trajectory.stamps_ns[index] - trajectory.stamps_ns[0])
    altitude_km = float(dataset.body.altitude_m(trajectory.gP[index])) / 1e3
    expected = "" if result.expected_rims is None else f" of {result.expected_rims[index]}"
    title = f"{seconds:.0f} s, {altitude_km:.3g} km, {len(frame.rims)}{expected} rims"
    predicted = None if result.predicted is None else result.predicted[index]
    return Overlay(dataset.image(index), frame, trajectory.gTb[index], predicted, title)


def draw_overlay(one: Overlay, camera: Camera, catalog: Catalog) -> Figure:
    """Draw a frame with its rims, the measured ones named; an image pixel takes one or more of the figure.

    Parameters
    ----------
    one : Overlay
    camera : Camera
    catalog : Catalog

    Returns
    -------
    Figure
    """
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
    """Draw a grid of frames with their rims.

    Parameters
    ----------
    overlays : sequence of Overlay
    camera : Camera
    catalog : Catalog

    Returns
    -------
    Figure
    """
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
    """Draw evenly spaced frames of a reconstruction on one sheet.

    Parameters
    ----------
    dataset : Dataset
        With images.
    result : Reconstruction

    Returns
    -------
    Figure
    """
    chosen = np.unique(np.linspace(0, len(dataset) - 1, min(SHEET_FRAMES, len(dataset))).astype(int))
    overlays = [overlay(dataset, result, int(index)) for index in chosen]
    return draw_contact_sheet(overlays, dataset.camera, dataset.catalog)


def write_overlays(
    dataset: Dataset,
    result: Reconstruction,
    folder: Path,
    every: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Write a PNG per frame into a folder, named by frame index and seconds since the first frame.

    Many frames are drawn on all cores.

    Parameters
    ----------
    dataset : Dataset
        With images.
    result : Reconstruction
    folder : Path
    every : int
        Every Nth frame is drawn.
    progress : callable, optional

    Raises
    ------
    InputError
        When an image cannot be read.
    CraternavError
        When a process that draws has died, for example of lack of memory.
    """
    drawings = _Drawings(dataset, result, folder, every)
    count = min(cpu_count() or 1, len(drawings) // _WORTH_A_PROCESS)
    with ExitStack() as stack:
        if count < 2:
            written: Iterator[None] = map(_write, drawings.values())
        else:
            scratch = stack.enter_context(TemporaryDirectory(prefix="craternav-"))
            workers = stack.enter_context(processes(count, Path(scratch)))
            written = each_result(workers, _write, drawings, _died, "overlays")
        for done, _ in enumerate(written, 1):
            if progress is not None:
                progress("overlays", done, len(drawings))


@dataclass(frozen=True)
class _Drawing:
    """What a process needs to draw a frame."""

    overlay: Overlay
    camera: Camera
    catalog: Catalog
    path: Path


class _Drawings(Mapping[int, _Drawing]):
    """Frames to draw by their index; each image is read when it is asked for."""

    def __init__(self, dataset: Dataset, result: Reconstruction, folder: Path, every: int) -> None:
        self._dataset, self._result, self._folder = dataset, result, folder
        self._chosen = range(0, len(dataset), every)

    def __getitem__(self, index: int) -> _Drawing:
        data = self._dataset
        one = overlay(data, self._result, index)
        seconds = 1e-9 * float(one.frame.stamp_ns - data.stamps_ns[0])
        path = self._folder / f"frame_{index:05d}_{seconds:.1f}s.png"
        return _Drawing(one, data.camera, data.catalog, path)

    def __iter__(self) -> Iterator[int]:
        return iter(self._chosen)

    def __len__(self) -> int:
        return len(self._chosen)


def _write(drawing: _Drawing) -> None:
    figure = draw_overlay(drawing.overlay, drawing.camera, drawing.catalog)
    save(figure, drawing.path, _DPI)


def _died(index: int) -> None:
    raise CraternavError(f"overlay of frame {index}: the process that draws it has died")


def draw_rims(axes: Axes, image: ImageArray, frame: FrameMeasurement, camera: Camera) -> None:
    """Draw the image of a frame with its measured rims and the direction towards the sun.

    Parameters
    ----------
    axes : Axes
    image : ndarray of uint8 or uint16, shape (H, W)
    frame : FrameMeasurement
    camera : Camera
    """
    axes.imshow(image, cmap="gray", vmin=0, vmax=camera.full_scale)
    _rims(axes, camera.pixels(points_on(frame.rims.chart, _RIM_POINTS)), color=MEASURED, lw=1.0)
    _sun(axes, frame.sun, camera, {"arrowstyle": "->", "color": _SUN_ON_BRIGHT, "lw": 1.5})
    _bare(axes, camera)


def _draw(axes: Axes, one: Overlay, camera: Camera, catalog: Catalog, width: float) -> None:
    axes.imshow(one.image, cmap="gray", vmin=0, vmax=camera.full_scale, interpolation="antialiased")
    _rims(axes, _visible(one.gTb, camera, catalog), color=CATALOGUE, lw=2.6 * width, alpha=0.85)
    measured = camera.pixels(points_on(one.frame.rims.chart, _RIM_POINTS))
    _rims(axes, measured, color=MEASURED, lw=1.3 * width)
    if one.predicted_gTb is not None:
        predicted = _visible(one.predicted_gTb, camera, catalog)
        _rims(axes, predicted, color=PREDICTED, lw=1.3 * width, linestyles=(0, (3, 5)))
    _sun(axes, one.frame.sun, camera, {"arrowstyle": "-|>", "color": SUN, "lw": 1.6 * width})
    _bare(axes, camera)


def _visible(gTb: FloatArray, camera: Camera, catalog: Catalog) -> FloatArray:
    """Rims (n, points, 2), px, in view from a pose, also in part; only whole ones where a lens distorts."""
    margin_px = 0.0 if camera.distorts else -0.25 * min(camera.width_px, camera.height_px)
    _, charts = catalog.visible(camera, gTb, min_semi_minor_px=_MIN_SEMI_MINOR_PX, margin_px=margin_px)
    return camera.pixels(points_on(charts, _RIM_POINTS))


def _sun(axes: Axes, sun: SunTilt | None, camera: Camera, arrow: dict[str, Any]) -> None:
    """Draw an arrow towards the sun from the place where its tilt was measured."""
    if sun is None:
        return
    length = _ARROW_LENGTH * camera.width_px
    x, y = camera.pixels(sun.point)
    dx, dy = length * np.cos(sun.tilt_rad), length * np.sin(sun.tilt_rad)
    axes.annotate("", (x + dx, y + dy), (x, y), arrowprops=arrow)


def _bare(axes: Axes, camera: Camera) -> None:
    """Show the whole image and nothing around it."""
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])


def _rims(axes: Axes, rims: FloatArray, **style: object) -> None:
    closed = np.concatenate([rims, rims[:, :1]], axis=1)
    axes.add_collection(LineCollection(list(closed), **style))  # type: ignore[arg-type]


def _name(axes: Axes, frame: FrameMeasurement, camera: Camera, catalog: Catalog, zoom: int) -> None:
    """Write identifiers below the measured rims, the largest first, where there is room."""
    rims = camera.pixels(points_on(frame.rims.chart, _RIM_POINTS))
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
    # The lines are bright: they need a dark ground on any page.
    figure.legend(
        handles=handles, loc=place, ncols=4, fontsize=9, facecolor="0.25", edgecolor="none", framealpha=1.0,
        labelcolor="w",
    )  # fmt: skip
