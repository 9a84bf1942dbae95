"""Figures of a few frames: rims without their photographs, offsets from a-priori states."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import points_on
from craternav_fg.evaluation.offsets import Offsets
from craternav_fg.measurements import FrameMeasurement
from factors.arrays import FloatArray


def draw_rims(
    frames: Sequence[FrameMeasurement], poses: FloatArray, camera: Camera, catalog: Catalog
) -> Figure:
    """Draw the measured rims of all frames, and those of the catalogue at estimated poses.

    Parameters
    ----------
    frames : sequence of FrameMeasurement, length k
    poses : ndarray, shape (k, 4, 4)
        Poses of the body in g, m.
    camera : Camera
    catalog : Catalog

    Returns
    -------
    Figure
    """
    columns = min(3, len(frames))
    rows = -(-len(frames) // columns)
    figure = Figure(figsize=(3.1 * columns, 3.1 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat[len(frames) :]:
        axis.axis("off")
    for k, (axis, frame) in enumerate(zip(axes.flat, frames, strict=False)):
        predicted = catalog.visible(camera, poses[k], min_semi_minor_px=8.0)[1]
        for outline in camera.pixels(points_on(predicted)):
            axis.plot(*outline.T, color="0.7", lw=0.7)
        for outline in camera.pixels(points_on(frame.rims.chart)):
            axis.plot(*outline.T, color="C3", lw=1.0)
        axis.set(xlim=(0, camera.width_px), ylim=(camera.height_px, 0), aspect="equal", xticks=[], yticks=[])
        axis.set_title(f"frame {k}: {len(frame.rims)} rims", fontsize="small")
    return figure


def draw_offsets(found: Offsets) -> Figure:
    """Draw offsets east, north and up with their standard deviations.

    Parameters
    ----------
    found : Offsets

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9.3, 2.8), layout="constrained")
    axes = figure.subplots(1, 3)
    for k, (axis, name) in enumerate(zip(axes, ("east", "north", "up"), strict=True)):
        axis.errorbar(found.frames, found.enu_m[:, k], found.sigma_m[:, k], fmt="o", capsize=3)
        axis.axhline(found.enu_m[:, k].mean(), color="0.6", lw=0.8)
        axis.set(xlabel="frame", ylabel=f"{name}, m", xticks=found.frames)
    return figure
