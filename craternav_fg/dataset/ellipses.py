"""Tables of ellipses fitted to the rims of an image, in the columns that `craternav detect` writes."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.catalogs.columns import ID
from craternav_fg.files import write_whole
from craternav_fg.tables import Column, Table, read_table

FloatArray = npt.NDArray[np.float64]

CENTRE_X = "ellipseCenterX(px)"
CENTRE_Y = "ellipseCenterY(px)"
MAJOR = "ellipseSemimajor(px)"
MINOR = "ellipseSemiminor(px)"
ROTATION = "ellipseRotation(deg)"
ELLIPSE = (CENTRE_X, CENTRE_Y, MAJOR, MINOR, ROTATION)
_SMALLEST_AXIS_PX = 0.1
_LARGEST_IMAGES = 10


def read_ellipses(path: Path, camera: Camera) -> FloatArray:
    """Read the ellipses of an image, whatever crater they belong to.

    Parameters
    ----------
    path : Path
        CSV: ellipseCenterX(px), ellipseCenterY(px), ellipseSemimajor(px), ellipseSemiminor(px),
        ellipseRotation(deg) (of the major axis, from the image's x axis towards its y axis). Further columns
        are not read.
    camera : Camera

    Returns
    -------
    ndarray, shape (n, 5)
        Centre, semi-axes a >= b, angle of a, rad; possibly no rows.

    Raises
    ------
    InputError
        Naming file, line and column: a value out of range, a rim outside the image.
    """
    table = read_table(path, tuple(Column(name) for name in ELLIPSE), others=True)
    check_axes(table, camera)
    x, y, a, b, turn = table.numbers(*ELLIPSE).T
    angle = np.radians(turn)
    half = np.stack(
        [np.hypot(a * np.cos(angle), b * np.sin(angle)), np.hypot(a * np.sin(angle), b * np.cos(angle))]
    )
    check_inside(table, np.stack([x, y], axis=-1), half.T, camera)
    return np.column_stack([x, y, a, b, angle])


def write_matched(path: Path, ellipses_px: FloatArray, craters: Sequence[str | None]) -> None:
    """Write the ellipses whose crater is known, with it, as `craternav pose` reads them; whole or not at all.

    Parameters
    ----------
    path : Path
    ellipses_px : ndarray, shape (n, 5)
        See `read_ellipses`.
    craters : sequence of str or None, length n
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*ELLIPSE, ID))
    for (x, y, a, b, angle), crater in zip(ellipses_px, craters, strict=True):
        if crater is not None:
            writer.writerow([*(f"{value:.4f}" for value in (x, y, a, b, np.degrees(angle))), crater])
    write_whole(path, text.getvalue().encode())


def check_axes(table: Table, camera: Camera) -> None:
    """Refuse axes that no image shows, and that arithmetic does not survive."""
    largest = _LARGEST_IMAGES * max(camera.width_px, camera.height_px)
    for name in (MINOR, MAJOR):
        check_range(table, name, (_SMALLEST_AXIS_PX, largest))
    for row in np.flatnonzero(table.columns[MINOR] > table.columns[MAJOR]).tolist():
        table.fail(
            row, MINOR,
            f"expected at most the semi-major axis {table.columns[MAJOR][row]:g}, "
            f"found {table.columns[MINOR][row]:g}",
        )  # fmt: skip


def check_range(table: Table, name: str, limits: tuple[float, float]) -> None:
    """Refuse values of a column, px, that are out of range."""
    least, most = limits
    values = table.columns[name]
    for row in np.flatnonzero((values < least) | (values > most)).tolist():
        table.fail(row, name, f"expected {least:g} to {most:g} px, found {values[row]:g}")


def check_inside(table: Table, centre_px: FloatArray, half_px: FloatArray, camera: Camera) -> None:
    """Refuse rims of centres and half extents (n, 2) that do not reach into the image."""
    size = np.array([camera.width_px, camera.height_px])
    outside = (centre_px + half_px < -0.5) | (centre_px - half_px > size - 0.5)
    for row in np.flatnonzero(outside.any(axis=1)).tolist():
        axis = int(np.argmax(outside[row]))
        table.fail(
            row, (CENTRE_X, CENTRE_Y)[axis],
            f"expected a rim that reaches into the {size[0]} x {size[1]} image, found its centre at "
            f"{centre_px[row, axis]:g}",
        )  # fmt: skip
