"""Tables of ellipses fitted to the rims of one image, in the columns of NASA's crater detection challenge.

Three tables have these columns: ellipses of unknown craters, which `craternav identify` reads; detected ones
with the image's name, which `craternav detect` writes; and matched ones with the identifier of the crater,
which `craternav identify` writes and `craternav pose` reads. Pixel (0, 0) is the centre of the top-left
pixel, and an ellipse is given by centre, semi-axes and rotation of the major axis, from the image's x axis
towards its y axis.
"""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.columns import ID
from craternav_fg.ellipse import chart_of_axes, half_sides
from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.tables import Column, Table, read_table
from craternav_fg.tables.sizes import LARGEST
from factors.arrays import BoolArray, FloatArray

CENTRE_X = "ellipseCenterX(px)"
CENTRE_Y = "ellipseCenterY(px)"
MAJOR = "ellipseSemimajor(px)"
MINOR = "ellipseSemiminor(px)"
ROTATION = "ellipseRotation(deg)"
ELLIPSE = (CENTRE_X, CENTRE_Y, MAJOR, MINOR, ROTATION)
IMAGE = "inputImage"
CLASSIFICATION = "crater_classification"
SIGMA = "sigma_px"
COVARIANCE = "covariance"
TRACED = "traced"
# The challenge's code for a state of degradation that is not given.
NOT_CLASSIFIED = -1
# Accepted standard deviations of edge points, px: beyond them the covariance of a fit is rounding errors.
SIGMA_RANGE_PX = (1e-6, 1e3)
# Rims that are all in the quarter of the image at the origin are of an image of half the size, if they are so
# many (by chance once in 1e6) and fill so much of its width and height.
_MIN_RIMS_OF_QUARTER, _FILLED_SHARE = 10, 0.8
# Rotations of so many elongated rims, all of at most pi, are in radians: degrees are by chance once in 1e6.
# More elongated rims do not count: an oblique view makes them, and aligns them with the horizon.
_MIN_TURNED_RIMS, _ELONGATED, _FORESHORTENED = 4, 1.05, 1.3
# Accepted semi-axes: a tenth of a pixel, to this many times the longer side of the image.
_MIN_SEMI_AXIS_PX = 0.1
# Smallest eigenvalue of the correlations of an ellipse's errors: a smaller one is rounding.
_MIN_EIGENVALUE = 1e-9
_MAX_SEMI_AXIS_IMAGES = 10


@dataclass(frozen=True)
class MatchedEllipses:
    """Ellipses with the craters they are matched to.

    Attributes
    ----------
    table : Table
        What was read, to name file and line of a row.
    ellipses_px : ndarray, shape (n, 5)
        Centre x, y, semi-axes a >= b, px, and direction of a, rad.
    craters : tuple of str, length n
        Identifiers.
    sigmas_px : ndarray, shape (n,), or None
        Standard deviation of each rim's edge points along its normal; None without such a column.
    covariances : ndarray, shape (n, 5, 5), or None
        Covariance of each row of `ellipses_px`, px and rad; None without such a column.
    """

    table: Table
    ellipses_px: FloatArray
    craters: tuple[str, ...]
    sigmas_px: FloatArray | None
    covariances: FloatArray | None

    def __len__(self) -> int:
        return len(self.craters)


def read_detected_ellipses(path: Path, camera: Camera) -> tuple[FloatArray, BoolArray]:
    """Read the ellipses of an image, and whether their rims were traced.

    Parameters
    ----------
    path : Path
        CSV: ellipseCenterX(px), ellipseCenterY(px), ellipseSemimajor(px), ellipseSemiminor(px),
        ellipseRotation(deg) and optionally `traced`, 0 for coarse ellipses. Further columns are not read.
    camera : Camera
        Whose image it is.

    Returns
    -------
    ellipses_px : ndarray, shape (n, 5)
        Centre x, y, semi-axes a >= b, px, and direction of a, rad; possibly no rows.
    traced : ndarray of bool, shape (n,)
        All true without such a column.

    Raises
    ------
    InputError
        Naming file, line and column: a value out of range, a rim outside the image, rims that only fill the
        quarter of the image at the origin, or rotations in radians.
    """
    columns = (*(Column(name) for name in ELLIPSE), Column(TRACED, optional=True))
    table = read_table(path, columns, others=True)
    ellipses = _ellipses(table, camera)
    traced = table.columns.get(TRACED)
    return ellipses, np.ones(len(ellipses), np.bool_) if traced is None else traced != 0.0


def read_matched_ellipses(path: Path, camera: Camera) -> MatchedEllipses:
    """Read ellipses with the craters they are matched to.

    Parameters
    ----------
    path : Path
        CSV with the ellipses' columns (`read_detected_ellipses`), CRATER_ID and optionally sigma_px or
        covariance: the upper triangle, row by row, of the covariance of centre x, y, semi-axes, px, and
        rotation, deg, as fifteen numbers with blanks between. Further columns are not read.
    camera : Camera
        Whose image it is.

    Raises
    ------
    InputError
        As `read_detected_ellipses`; also when there is no row, a crater twice, or a covariance is not
        positive definite.
    """
    columns = (
        *(Column(name) for name in ELLIPSE), Column(ID, "text"), Column(SIGMA, optional=True),
        Column(COVARIANCE, "text", optional=True),
    )  # fmt: skip
    table = read_table(path, columns, others=True)
    if not len(table):
        raise InputError(path, "expected at least one rim, found none")
    ellipses = _ellipses(table, camera)
    sigmas: FloatArray | None = table.columns.get(SIGMA)
    if sigmas is not None:
        _check_range(table, SIGMA, SIGMA_RANGE_PX)
    craters = tuple(table.columns[ID])
    seen: dict[str, int] = {}
    for row, crater in enumerate(craters):
        if crater in seen:
            first = table.line(seen[crater])
            table.fail(row, ID, f"expected each crater once, found {crater!r} again, first in line {first}")
        seen[crater] = row
    covariances = _covariances(table) if COVARIANCE in table.columns else None
    return MatchedEllipses(table, ellipses, craters, sigmas, covariances)


def write_matched_ellipses(path: Path, ellipses_px: FloatArray, craters: Sequence[str | None]) -> None:
    """Write the ellipses whose crater is known, as `read_matched_ellipses` reads them.

    Parameters
    ----------
    path : Path
        The file appears whole or not at all.
    ellipses_px : ndarray, shape (n, 5)
        As `read_detected_ellipses` returns them.
    craters : sequence of str or None, length n
        Identifiers; rows without one are left out.
    """
    known = [row for row, crater in enumerate(craters) if crater is not None]
    _write(path, (ID,), ellipses_px[known], ([craters[row]] for row in known), decimals=4)


def write_detected_ellipses(path: Path, ellipses_px: FloatArray, traced: BoolArray, image_name: str) -> None:
    """Write the ellipses found in an image, in the columns of NASA's crater detection challenge and `traced`.

    Parameters
    ----------
    path : Path
        The file appears whole or not at all.
    ellipses_px : ndarray, shape (n, 5)
        As `read_detected_ellipses` returns them, best first.
    traced : ndarray of bool, shape (n,)
        Whether the rim was traced: 1, else 0.
    image_name : str
        Name of the image's file.
    """
    added = ([image_name, NOT_CLASSIFIED, int(each)] for each in traced)
    _write(path, (IMAGE, CLASSIFICATION, TRACED), ellipses_px, added, decimals=3)


def detections_as_plain_data(
    ellipses_px: FloatArray,
    charts_covariance_px: FloatArray,
    quality: FloatArray,
    traced: BoolArray,
    sun_angle_rad: float,
) -> dict[str, Any]:
    """Convert the ellipses found in an image to lists and numbers, for JSON.

    Parameters
    ----------
    ellipses_px : ndarray, shape (n, 5)
        As `read_detected_ellipses` returns them, best first.
    charts_covariance_px : ndarray, shape (n, 5, 5)
        Covariances of their charts in pixels.
    quality : ndarray, shape (n,)
        From 0 to 1: how surely each is the rim of a crater.
    traced : ndarray of bool, shape (n,)
        Whether each rim was traced.
    sun_angle_rad : float
        Direction in the image, from x towards y, towards the sun; NaN when unknown.
    """
    keys = ("center_x_px", "center_y_px", "semi_major_px", "semi_minor_px")
    rows = []
    for ellipse, covariance, good, exact in zip(
        ellipses_px, charts_covariance_px, quality, traced, strict=True
    ):
        row = {key: round(float(value), 3) for key, value in zip(keys, ellipse, strict=False)}
        row["rotation_deg"] = round(float(np.rad2deg(ellipse[4])), 3)
        row["quality"] = round(float(good), 4)
        row["traced"] = bool(exact)
        row["center_sigma_px"] = round(float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]))), 3)
        rows.append(row)
    sun_angle_deg = None if np.isnan(sun_angle_rad) else round(float(np.rad2deg(sun_angle_rad)), 1)
    return {"sun_angle_deg": sun_angle_deg, "rims": rows}


def _write(
    path: Path,
    added_columns: Sequence[str],
    ellipses_px: FloatArray,
    added: Iterable[Sequence[object]],
    *,
    decimals: int,
) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*ELLIPSE, *added_columns))
    for (x, y, a, b, angle), cells in zip(ellipses_px, added, strict=True):
        writer.writerow([*(f"{value:.{decimals}f}" for value in (x, y, a, b, np.rad2deg(angle))), *cells])
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _ellipses(table: Table, camera: Camera) -> FloatArray:
    """Ellipses (n, 5) of a table, checked; see `read_detected_ellipses`."""
    largest = _MAX_SEMI_AXIS_IMAGES * max(camera.width_px, camera.height_px)
    for name in (MINOR, MAJOR):
        _check_range(table, name, (_MIN_SEMI_AXIS_PX, largest))
    for row in np.flatnonzero(table.columns[MINOR] > table.columns[MAJOR]).tolist():
        table.fail(
            row, MINOR,
            f"expected at most the semi-major axis {table.columns[MAJOR][row]:g}, "
            f"found {table.columns[MINOR][row]:g}",
        )  # fmt: skip
    ellipses = table.numbers(*ELLIPSE)
    _check_degrees(table, ellipses)
    ellipses[:, 4] = np.radians(ellipses[:, 4])
    _check_inside(table, ellipses, camera)
    _check_size(table, ellipses, camera)
    return ellipses


def _covariances(table: Table) -> FloatArray:
    """Covariances (n, 5, 5), px and rad, of a table's ellipses."""
    out = np.zeros((len(table), 5, 5))
    upper = np.triu_indices(5)
    to_rad = np.array([1.0, 1.0, 1.0, 1.0, np.pi / 180.0])
    for row, cell in enumerate(table.columns[COVARIANCE]):
        try:
            numbers = [float(word) for word in cell.split()]
        except ValueError:
            numbers = []
        if len(numbers) != len(upper[0]):
            table.fail(row, COVARIANCE, f"expected {len(upper[0])} numbers with blanks between")
        out[row][upper] = out[row].T[upper] = numbers
        out[row] *= np.outer(to_rad, to_rad)
        variances = np.diag(out[row])
        sound = (np.abs(out[row]) <= LARGEST).all() and variances.min() > 0.0
        scale = np.sqrt(np.outer(variances, variances)) if sound else np.ones((5, 5))
        if not sound or np.linalg.eigvalsh(out[row] / scale)[0] <= _MIN_EIGENVALUE:
            table.fail(row, COVARIANCE, "expected a positive definite matrix")
    return out


def _check_range(table: Table, name: str, limits: tuple[float, float]) -> None:
    """Refuse values of a column, px, that are out of range."""
    least, most = limits
    values = table.columns[name]
    for row in np.flatnonzero((values < least) | (values > most)).tolist():
        table.fail(row, name, f"expected {least:g} to {most:g} px, found {values[row]:g}")


def _check_inside(table: Table, ellipses_px: FloatArray, camera: Camera) -> None:
    """Refuse ellipses (n, 5) that do not reach into the image."""
    size = np.array([camera.width_px, camera.height_px])
    centre, half = ellipses_px[:, :2], half_sides(chart_of_axes(ellipses_px))
    outside = (centre + half < -0.5) | (centre - half > size - 0.5)
    for row in np.flatnonzero(outside.any(axis=1)).tolist():
        axis = int(np.argmax(outside[row]))
        table.fail(
            row, (CENTRE_X, CENTRE_Y)[axis],
            f"expected a rim that reaches into the {size[0]} x {size[1]} image, found its centre at "
            f"{centre[row, axis]:g}",
        )  # fmt: skip


def _check_size(table: Table, ellipses_px: FloatArray, camera: Camera) -> None:
    """Refuse ellipses (n, 5) that fill the quarter of the image at the origin, and no more."""
    if len(ellipses_px) < _MIN_RIMS_OF_QUARTER:
        return
    quarter = 0.5 * np.array([camera.width_px, camera.height_px])
    most = (ellipses_px[:, :2] + half_sides(chart_of_axes(ellipses_px))).max(axis=0)
    if (most < quarter).all() and (most > _FILLED_SHARE * quarter).all():
        raise InputError(
            table.path,
            f"expected rims all over the camera's {camera.width_px} x {camera.height_px} image, found all "
            f"{len(ellipses_px)} in its first quarter: are they of an image of half the size?",
        )


def _check_degrees(table: Table, ellipses: FloatArray) -> None:
    """Refuse rotations of ellipses (n, 5) that are in radians; those of circles mean nothing."""
    ratio = ellipses[:, 2] / ellipses[:, 3]
    turned = (ratio > _ELONGATED) & (ratio < _FORESHORTENED) & (ellipses[:, 4] != 0.0)
    if turned.sum() >= _MIN_TURNED_RIMS and np.abs(ellipses[turned, 4]).max() <= np.pi:
        raise InputError(
            table.path,
            f"expected rotations in degrees, found {turned.sum()} of elongated rims from "
            f"{ellipses[turned, 4].min():.3g} to {ellipses[turned, 4].max():.3g}: they are in radians",
            column=ROTATION,
        )
